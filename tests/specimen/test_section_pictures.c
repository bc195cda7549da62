/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/section_pictures.h"

#include "pipeline/core/mem.h"
#include "pipeline/decode/decode.h"
#include "pipeline/specimen/aligned_pictures.h"
#include "pipeline/specimen/reconstruction.h"

#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"

#include <math.h>
#include <string.h>

/* Panel 2, slot 2: its second mark was not burnt. */
enum { DOUBTFUL = 5 };

static void draw(struct drawn_specimen *d)
{
    struct drawn_panel panels[3];

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.6);
    panels[1].section[1].no_marks = 2;
    drawn_specimen_init(d, DRAWN_JOB, panels, 3);
}

static struct gsn_reconstruction *assembled(const struct drawn_specimen *d)
{
    const struct gsn_specimen_options options = { .mesher = GSN_MESHER, .threads = 1 };
    struct gsn_reconstruction *a = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_reconstruct(&d->specimen, &options, &a, &err), err);
    return a;
}

static struct gsn_scan *opened(const struct drawn_specimen *d, size_t panel)
{
    struct gsn_scan *scan = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_scan_open(NULL, gsn_check_fd(d->png[panel], d->input[panel].size), d->protocol,
                           &d->panel[panel].upright, &scan, &err),
             err);
    return scan;
}

/* Whether the picture shows the tissue's ellipse where it is in the block: its share of cells that
 * are as they should be. */
static double right_share(const struct gsn_image *image, double um_per_px, double corner_um)
{
    size_t right = 0;

    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            const double u = corner_um + (x + 0.5) * um_per_px;
            const double v = corner_um + (y + 0.5) * um_per_px;
            const int tissue = hypot(u / DRAWN_WIDTH_UM, v / DRAWN_HEIGHT_UM) < 1;

            right += (gsn_image_at(image, x, y, 1) < 200) == tissue;
        }
    return (double)right / ((double)image->width * image->height);
}

TEST(a_section_is_shown_where_its_pose_lays_it_and_elsewhere_where_another_does)
{
    drawn_auto d;
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    draw(&d);
    gsn_auto(gsn_reconstruction) a = assembled(&d);
    gsn_auto(gsn_scan) scan = opened(&d, 1);
    const struct gsn_section *s = &a->poses.section[DOUBTFUL];

    CHECK(s->state == GSN_SECTION_DOUBTFUL && s->candidates.count >= 2);
    for (size_t c = 0; c < s->candidates.count; c++) {
        const struct gsn_placed_box box = { s->candidates.at[c].panel_to_block_um, s->seen.x,
                                            s->seen.y, s->seen.width, s->seen.height };
        double share;

        CHECK_OK(gsn_placed_picture(scan->picture->image, scan->glass.light, &box,
                                    (struct gsn_point){ -1200, -1200 }, 20, 120, &image, &err),
                 err);
        share = right_share(image, 20, -1200);
        gsn_image_free(image);
        CHECK(c == 0 ? share > 0.97 : share < 0.95);
    }
}

/* Only what is doubtful is drawn, over the section beside it. */
TEST(a_doubtful_section_has_a_picture_for_each_candidate_and_others_have_none)
{
    drawn_auto d;

    draw(&d);
    gsn_auto(gsn_reconstruction) a = assembled(&d);

    for (size_t i = 0; i < a->poses.section_count; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const struct gsn_section_density *shown = &a->densities.section[i];

        CHECK((s->candidates.count > 0) == (i == DOUBTFUL));
        for (size_t c = 0; c < GSN_CANDIDATES; c++)
            CHECK((shown->candidate_picture[c].size > 0) == (c < s->candidates.count));
        CHECK(shown->compared_with == (i == DOUBTFUL ? DOUBTFUL : 0)); /* serial 4, from 1 */
    }
}

TEST(a_specimen_without_doubt_has_no_sheet)
{
    struct gsn_candidate_sheet *sheet = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, 0.6);
    gsn_auto(gsn_reconstruction) a = assembled(&d);

    CHECK_OK(gsn_candidate_sheet_new(&a->poses, &sheet, &err), err);
    CHECK(sheet == NULL);
    CHECK_OK(gsn_candidate_sheet_look(sheet, &a->poses, NULL, 1, &err), err);
    CHECK_OK(gsn_candidate_sheet_draw(sheet, &a->poses, &a->densities, &err), err);
}

/* A dark spot, soft enough that sampling it makes no error, around a place of a grey picture. */
static struct gsn_image *spotted(double x, double y)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(200, 160, 3, 8, &image, &err), err);
    for (uint32_t v = 0; v < 160; v++)
        for (uint32_t u = 0; u < 200; u++)
            for (uint32_t c = 0; c < 3; c++)
                ((uint8_t *)image->samples)[3 * (v * 200 + u) + c] = (uint8_t)lrint(
                    250 - 200 * exp(-(pow(u + 0.5 - x, 2) + pow(v + 0.5 - y, 2)) / (2 * 4 * 4)));
    return image;
}

/* The middle of what is dark, in pixels of the picture. */
static struct gsn_point middle_of_dark(const struct gsn_image *image)
{
    struct gsn_point sum = { 0, 0 };
    double weight = 0;

    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            const double dark = fmax(0, 246. - gsn_image_at(image, x, y, 1));

            sum.x += dark * (x + 0.5);
            sum.y += dark * (y + 0.5);
            weight += dark;
        }
    return (struct gsn_point){ sum.x / weight, sum.y / weight };
}

/* However the section was mounted: half a pixel of the scan to one side would be a whole one
 * between two sections that were mounted the other way round. */
TEST(a_placed_picture_errs_by_less_than_a_tenth_of_its_pixel)
{
    const struct gsn_point seen = { 103.3, 71.8 }; /* where the spot is on the scan */
    gsn_auto(gsn_image) image = spotted(seen.x, seen.y);

    for (int i = 0; i < 48; i++) {
        const double angle = i * M_PI / 12, px = 10.6, um_per_px = i % 3 ? 12.5 : 27;
        const double face = i % 2 ? -1 : 1;
        struct gsn_placed_box box = { .x = 20, .y = 10, .width = 160, .height = 130 };
        struct gsn_affine *map = &box.panel_to_block_um;
        gsn_auto(gsn_image) placed = NULL;
        struct gsn_error err = { 0 };
        struct gsn_point um, found;

        map->m00 = px * cos(angle);
        map->m01 = -face * px * sin(angle);
        map->m10 = px * sin(angle);
        map->m11 = face * px * cos(angle);
        um = gsn_affine_apply(map, seen);
        map->m02 = 317.7 - um.x;
        map->m12 = -120.1 - um.y;
        CHECK_OK(gsn_placed_picture(image, GSN_LIGHT_CODES_LINEAR, &box,
                                    (struct gsn_point){ -600, -1000 }, um_per_px,
                                    (unsigned)(1900 / um_per_px), &placed, &err),
                 err);
        found = middle_of_dark(placed);
        CHECK_NEAR(-600 + um_per_px * found.x, 317.7, 0.1 * um_per_px);
        CHECK_NEAR(-1000 + um_per_px * found.y, -120.1, 0.1 * um_per_px);
    }
}

TEST(all_sections_of_the_model_are_shown_where_they_lie_in_the_block)
{
    drawn_auto d;
    size_t bytes = 0, shown = 0;

    draw(&d);
    gsn_auto(gsn_reconstruction) a = assembled(&d);
    const struct gsn_densities *s = &a->densities;

    CHECK(s->aligned_um_per_px > 0);
    for (size_t i = 0; i < s->section_count; i++) {
        const struct gsn_png_picture *coded = &s->section[i].aligned;
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };
        size_t right = 0;

        CHECK((coded->size > 0) == (s->section[i].state == GSN_SECTION_USED ||
                                    s->section[i].state == GSN_SECTION_DOUBTFUL));
        if (coded->size == 0)
            continue;
        CHECK_OK(gsn_decode(coded->png, coded->size, NULL, &picture, &err), err);
        for (uint32_t y = 0; y < picture->image->height; y++)
            for (uint32_t x = 0; x < picture->image->width; x++) {
                const double u = s->aligned_corner.x + (x + 0.5) * s->aligned_um_per_px;
                const double v = s->aligned_corner.y + (y + 0.5) * s->aligned_um_per_px;
                const int tissue = hypot(u / DRAWN_WIDTH_UM, v / DRAWN_HEIGHT_UM) < 1;

                right += (gsn_image_at(picture->image, x, y, 1) < 200) == tissue;
            }
        CHECK((double)right / (coded->width * (double)coded->height) > 0.97);
        bytes += coded->size;
        shown++;
    }
    CHECK(shown == 12 && bytes <= GSN_ALIGNED_BYTES);
}

/* So many sections that each picture is small, of what JPEG takes most bytes for. */
TEST(the_pictures_of_any_number_of_sections_weigh_what_a_page_can_carry)
{
    enum { SECTIONS = 300 };
    struct gsn_section *section = gsn_alloc_array(SECTIONS, sizeof *section);
    struct gsn_section_density *density = gsn_alloc_array(SECTIONS, sizeof *density);
    const struct gsn_poses poses = { .section_count = SECTIONS, .section = section, .solved = 1 };
    struct gsn_densities densities = { .section_count = SECTIONS, .section = density };
    gsn_auto(gsn_image) image = spotted(100, 80);
    struct gsn_picture picture = { .image = image };
    const struct gsn_scan scan = { .picture = &picture };
    gsn_auto(gsn_aligned_pictures) pictures = NULL;
    struct gsn_error err = { 0 };
    unsigned seed = 1;
    size_t bytes = 0, large = 0;

    CHECK(section && density);
    for (size_t i = 0; i < (size_t)3 * 200 * 160; i++) /* grain in colour, as of stained tissue */
        ((uint8_t *)image->samples)[i] = (uint8_t)(((uint8_t *)image->samples)[i] -
                                                   ((seed = seed * 1664525 + 1013904223) >> 27));
    for (size_t i = 0; i < SECTIONS; i++) {
        section[i] = (struct gsn_section){ .panel = 1,
                                           .posed = 1,
                                           .state = GSN_SECTION_USED,
                                           .seen = { .width = 200, .height = 160 } };
        section[i].pose.panel_to_block_um.m00 = section[i].pose.panel_to_block_um.m11 = 10;
    }
    CHECK_OK(gsn_aligned_pictures_new(&poses, &pictures, &err), err);
    CHECK_OK(gsn_aligned_pictures_look(pictures, &poses, &scan, 1, 2, &densities, &err), err);
    CHECK_OK(gsn_aligned_pictures_code(pictures, &densities, &err), err);
    for (size_t i = 0; i < SECTIONS; i++) {
        CHECK(density[i].aligned.size > 0);
        bytes += density[i].aligned.size;
        large += density[i].glass.size;
        gsn_free(density[i].aligned.png);
        gsn_free(density[i].glass.png);
    }
    print_message("  %d pictures of %u pixels weigh %zu bytes\n", SECTIONS,
                  density[0].aligned.width, bytes);
    CHECK(bytes <= GSN_ALIGNED_BYTES && bytes > GSN_ALIGNED_BYTES / 2);
    print_message("  and large, of %u pixels, %zu bytes\n", density[0].glass.width, large);
    CHECK(density[0].glass.width > density[0].aligned.width);
    CHECK(large > GSN_ALIGNED_BYTES && large < 2 * GSN_GLASS_BYTES);
    gsn_free(section);
    gsn_free(density);
}

static int align_once(struct gsn_reconstruction *a, const struct gsn_scan *scan,
                      struct gsn_error *err)
{
    gsn_auto(gsn_aligned_pictures) pictures = NULL;
    int r = gsn_aligned_pictures_new(&a->poses, &pictures, err);

    if (r >= 0)
        r = gsn_aligned_pictures_look(pictures, &a->poses, scan, 2, 1, &a->densities, err);
    return r < 0 ? r : gsn_aligned_pictures_code(pictures, &a->densities, err);
}

static int draw_once(struct gsn_reconstruction *a, const struct gsn_scan *scan,
                     struct gsn_error *err)
{
    gsn_auto(gsn_candidate_sheet) sheet = NULL;
    struct gsn_section_density *s = &a->densities.section[DOUBTFUL];
    int r;

    for (size_t c = 0; c < GSN_CANDIDATES; c++) {
        gsn_free(s->candidate_picture[c].png);
        s->candidate_picture[c] = (struct gsn_png_picture){ .png = NULL };
    }
    r = gsn_candidate_sheet_new(&a->poses, &sheet, err);
    if (r >= 0)
        r = gsn_candidate_sheet_look(sheet, &a->poses, scan, 2, err);
    return r < 0 ? r : gsn_candidate_sheet_draw(sheet, &a->poses, &a->densities, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    drawn_auto d;

    draw(&d);
    gsn_auto(gsn_reconstruction) a = assembled(&d);
    gsn_auto(gsn_scan) scan = opened(&d, 1);

    CHECK_EVERY_OOM(draw_once(a, scan, &err), err);
    CHECK_EVERY_OOM(align_once(a, scan, &err), err);
    CHECK(a->densities.section[DOUBTFUL].candidate_picture[0].size > 0);
}
