/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/drawn_region.h"

#include "pipeline/core/mem.h"
#include "tests/check.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { ROOM = 1 << 20, CORNERS = 180 };

/* Planes of 24 um, pixels of 8; the first pixel's centre is not at 0. */
static struct gsn_region region_of(size_t nx, size_t ny, size_t nz)
{
    return (struct gsn_region){ .kind = GSN_REGION_DRAWN,
                                .file = (char *)(uintptr_t) "drawn.geojson",
                                .stack = { .nx = nx,
                                           .ny = ny,
                                           .nz = nz,
                                           .origin_um = { -500, 300, 36 },
                                           .step_um = { 8, 8, 24 } } };
}

static int read_text(const struct gsn_region *region, const char *text, struct gsn_mask **ret_mask,
                     char said[GSN_DRAWN_SENTENCE], struct gsn_error *err)
{
    return gsn_drawn_region_read(region, text, strlen(text), ret_mask, said, err);
}

/* Adds a circle as QuPath writes one; the first plane is its default one, which it leaves out. */
static size_t add_circle(char *text, size_t used, size_t plane, double x, double y, double radius)
{
    used += (size_t)snprintf(text + used, ROOM - used,
                             "%s{\"type\": \"Feature\", \"geometry\": {\"type\": \"Polygon\", "
                             "\"coordinates\": [[",
                             used > 1 ? ", " : "");
    for (int i = 0; i <= CORNERS; i++) {
        const double turn = 2 * M_PI * (i % CORNERS) / CORNERS;

        used += (size_t)snprintf(text + used, ROOM - used, "%s[%.2f, %.2f]", i ? ", " : "",
                                 x + radius * cos(turn), y + radius * sin(turn));
    }
    used += (size_t)snprintf(text + used, ROOM - used, "]]");
    if (plane > 0)
        used += (size_t)snprintf(text + used, ROOM - used,
                                 ", \"plane\": {\"c\": -1, \"z\": %zu, \"t\": 0}", plane);
    return used + (size_t)snprintf(text + used, ROOM - used,
                                   "}, \"properties\": {\"objectType\": \"annotation\"}}");
}

static size_t count_plane(const struct gsn_mask *mask, size_t z)
{
    const size_t size = mask->at.nx * mask->at.ny;
    size_t count = 0;

    for (size_t i = 0; i < size; i++)
        count += mask->inside[z * size + i];
    return count;
}

TEST(a_cone_drawn_on_three_planes_has_its_closed_volume_on_all_between)
{
    const struct gsn_region region = region_of(140, 130, 16);
    gsn_auto_mem(char) text = gsn_alloc(ROOM);
    gsn_auto(gsn_mask) mask = NULL;
    char said[GSN_DRAWN_SENTENCE];
    struct gsn_error err = { 0 };
    size_t used = 1, total = 0;
    double closed = 0;

    CHECK(text != NULL);
    text[0] = '[';
    /* radius 52.3 - 3 z */
    used = add_circle(text, used, 3, 70.2, 64.7, 43.3);
    used = add_circle(text, used, 9, 70.2, 64.7, 25.3);
    used = add_circle(text, used, 13, 70.2, 64.7, 13.3);
    (void)snprintf(text + used, ROOM - used, "]");
    CHECK_OK(read_text(&region, text, &mask, said, &err), err);
    for (size_t z = 0; z < 16; z++) {
        const double radius = z < 3 || z > 13 ? 0 : 52.3 - 3 * (double)z;

        /* A pixel's share of the circumference, and half a pixel of it where distances are whole.
         */
        CHECK_NEAR((double)count_plane(mask, z), M_PI * radius * radius, 0.25 * 2 * M_PI * radius);
        total += count_plane(mask, z);
        closed += M_PI * radius * radius;
    }
    /* h (R^2 + R r + r^2) pi / 3 of the frustum is the integral that this sum stands for. */
    CHECK_NEAR(closed, M_PI / 3 * 11 * (44.8 * 44.8 + 44.8 * 11.8 + 11.8 * 11.8), 0.005 * closed);
    CHECK_NEAR((double)total, closed, 0.01 * closed);
    CHECK(strstr(said,
                 "drawn on 3 of 16 planes, from z 108 to 348 um; interpolated on the 8 between; "
                 "the 3 before the first and the 2 behind") != NULL);
}

TEST(a_pixel_of_the_picture_is_the_voxel_of_the_block_that_export_wrote_there)
{
    /* Pixels 10 to 13 and 20 to 24 of plane 2: corners at whole numbers. */
    static const char text[] =
        "{\"type\": \"Polygon\", \"plane\": {\"c\": -1, \"z\": 2, \"t\": 0}, \"coordinates\": "
        "[[[10, 20], [14, 20], [14, 25], [10, 25], [10, 20]]]}";
    const struct gsn_region region = region_of(40, 40, 5);
    gsn_auto(gsn_mask) mask = NULL;
    char said[GSN_DRAWN_SENTENCE];
    struct gsn_error err = { 0 };
    double low[3], high[3];

    CHECK_OK(read_text(&region, text, &mask, said, &err), err);
    CHECK(gsn_mask_count(mask) == 4 * 5);
    gsn_mask_box(mask, low, high);
    CHECK_NEAR(low[0], -500 + 9.5 * 8, 1e-9);
    CHECK_NEAR(high[0], -500 + 13.5 * 8, 1e-9);
    CHECK_NEAR(low[1], 300 + 19.5 * 8, 1e-9);
    CHECK_NEAR(high[1], 300 + 24.5 * 8, 1e-9);
    CHECK_NEAR(low[2], 36 + 1.5 * 24, 1e-9);
    CHECK_NEAR(high[2], 36 + 2.5 * 24, 1e-9);
}

#define SQUARE(x, y, s)                                                                            \
    "[[" x ", " y "], [" s ", " y "], [" s ", " s "], [" x ", " s "], [" x ", " y "]]"

TEST(holes_are_left_out_and_features_of_a_plane_are_joined)
{
    static const char text[] =
        "{\"type\": \"FeatureCollection\", \"features\": ["
        "{\"type\": \"Feature\", \"geometry\": {\"type\": \"MultiPolygon\", \"coordinates\": "
        "[[" SQUARE("0", "0", "20") ", " SQUARE("5", "5", "15") "], [" SQUARE(
            "6", "6", "8") "]]}}, "
                           "{\"type\": \"Feature\", "
                           "\"geometry\": {\"type\": "
                           "\"Polygon\", \"coordinates\": "
                           "[" SQUARE("10", "10", "30") "]}}]}";
    const struct gsn_region region = region_of(40, 40, 1);
    gsn_auto(gsn_mask) mask = NULL;
    char said[GSN_DRAWN_SENTENCE];
    struct gsn_error err = { 0 };

    CHECK_OK(read_text(&region, text, &mask, said, &err), err);
    /* 400 - 100 + 4, and of the last 400 the 75 that are in the ring's corner already. */
    CHECK(gsn_mask_count(mask) == 304 + 400 - 75);
}

TEST(of_several_classifications_the_job_says_which)
{
    static const char text[] =
        "[{\"type\": \"Feature\", \"geometry\": {\"type\": \"Polygon\", \"coordinates\": [" SQUARE(
            "0", "0", "9") "]}, \"properties\": {\"classification\": {\"name\": \"PDL\"}}}, "
                           "{\"type\": \"Feature\", \"geometry\": {\"type\": \"Polygon\", "
                           "\"coordinates\": [" SQUARE("0", "0", "5") "]}, \"properties\": "
                                                                      "{\"classification\": "
                                                                      "{\"names\": [\"Bone\", "
                                                                      "\"old\"]}}}]";
    static const struct {
        const char *name;
        size_t pixels;
    } cases[] = { { "PDL", 81 }, { "Bone: old", 25 }, { "pdl", 0 }, { NULL, 0 } };
    struct gsn_region region = region_of(40, 40, 1);

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        gsn_auto(gsn_mask) mask = NULL;
        char said[GSN_DRAWN_SENTENCE];
        struct gsn_error err = { 0 };
        int r;

        region.class_name = (char *)(uintptr_t)cases[i].name;
        r = read_text(&region, text, &mask, said, &err);
        CHECK(cases[i].pixels ? r == GSN_OK && gsn_mask_count(mask) == cases[i].pixels
                              : r == GSN_E_INPUT && !mask && strstr(err.text, "\"PDL\"") != NULL);
    }
}

/* Cut or with a changed byte, a sound file is read or refused, and nothing else. */
TEST(damaged_files_are_read_or_refused_and_never_more)
{
    const struct gsn_region region = region_of(30, 30, 6);
    gsn_auto_mem(char) text = gsn_alloc(ROOM);
    static const char others[] = "\0[]{}\",:-9e.z\xff";
    size_t used = 1, refused = 0, tried = 0;

    CHECK(text != NULL);
    text[0] = '[';
    used = add_circle(text, used, 0, 15, 15, 9);
    used = add_circle(text, used, 4, 14, 15, 5);
    text[used++] = ']';
    for (size_t at = 0; at < used; at += 41)
        for (size_t k = 0; k < sizeof others; k++, tried++) {
            gsn_auto(gsn_mask) mask = NULL;
            char said[GSN_DRAWN_SENTENCE];
            struct gsn_error err = { 0 };
            const char kept = text[at];
            int r;

            if (k + 1 < sizeof others)
                text[at] = others[k];
            r = gsn_drawn_region_read(&region, text, k + 1 < sizeof others ? used : at, &mask, said,
                                      &err);
            text[at] = kept;
            CHECK((r == GSN_OK && mask) || (r == GSN_E_INPUT && !mask && err.text[0]));
            refused += r < 0;
        }
    CHECK(refused > tried / 4 && refused < tried);
}

static int read_once(struct gsn_error *err)
{
    static const char text[] =
        "[{\"type\": \"Polygon\", \"plane\": {\"z\": 1}, \"coordinates\": [" SQUARE(
            "0", "0", "20") ", " SQUARE("5", "5", "15") "]}, "
                                                        "{\"type\": \"Polygon\", \"plane\": "
                                                        "{\"z\": 3}, \"coordinates\": "
                                                        "[" SQUARE("0", "0", "20") "]}]";
    const struct gsn_region region = region_of(30, 30, 5);
    gsn_auto(gsn_mask) mask = NULL;
    char said[GSN_DRAWN_SENTENCE];

    return read_text(&region, text, &mask, said, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(read_once(&err), err);
}
