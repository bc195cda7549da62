/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The page of large sections, from drawn panels to the bytes of its pictures. */
#include "pipeline/specimen/process.h"

#include "pipeline/core/mem.h"
#include "pipeline/decode/decode.h"
#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double DENSITY = 0.6;

static struct gsn_specimen_result *worked(const struct drawn_specimen *d, unsigned threads)
{
    const struct gsn_specimen_options options = { .mesher = GSN_MESHER, .threads = threads };
    struct gsn_specimen_result *result = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_process(&d->specimen, &options, &result, &err), err);
    return result;
}

static const struct gsn_specimen_file *page_in(const struct gsn_specimen_result *result)
{
    for (size_t i = 0; i < result->file_count; i++)
        if (strcmp(result->file[i].name, "sections.html") == 0)
            return &result->file[i];
    return NULL;
}

/* RFC 4648. */
static size_t decode64(const char *text, size_t length, uint8_t *to)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    unsigned held = 0, bits = 0;
    size_t count = 0;

    for (size_t i = 0; i < length && text[i] != '='; i++) {
        held = held << 6 | (unsigned)(strchr(digits, text[i]) - digits);
        bits += 6;
        if (bits >= 8)
            to[count++] = (uint8_t)(held >> (bits -= 8));
    }
    return count;
}

/* gives: the first picture behind this text. */
static struct gsn_picture *picture_behind(const char *page, const char *text)
{
    const char *const at = strstr(strstr(page, text), ";base64,") + 8;
    const size_t length = strcspn(at, "\"");
    gsn_auto_mem(uint8_t) bytes = gsn_alloc(length);
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };

    CHECK(bytes != NULL);
    CHECK_OK(gsn_decode(bytes, decode64(at, length, bytes), NULL, &picture, &err), err);
    return picture;
}

static double number_of(const char *page, const char *name)
{
    gsn_auto_mem(char) attribute = gsn_format(" data-%s=\"", name);
    const char *const at = strstr(page, attribute);

    CHECK(at != NULL);
    return strtod(at + strlen(attribute), NULL); /* door */
}

static char *page_text(const struct gsn_specimen_result *result)
{
    const struct gsn_specimen_file *page = page_in(result);

    CHECK(page != NULL);
    return gsn_format("%.*s", (int)page->size, (const char *)page->bytes);
}

/* Tissue where it was drawn, as large as the scanner saw it. */
static void check_glass(const char *page, const char *figure)
{
    const double x = number_of(page, "x"), y = number_of(page, "y"), um = number_of(page, "um");
    gsn_auto(gsn_picture) picture = picture_behind(page, figure);
    const struct gsn_image *image = picture->image;
    double right = 0;

    CHECK_NEAR(um, 24, 2);
    for (uint32_t v = 0; v < image->height; v++)
        for (uint32_t u = 0; u < image->width; u++) {
            const int tissue = hypot((x + (u + 0.5) * um) / DRAWN_WIDTH_UM,
                                     (y + (v + 0.5) * um) / DRAWN_HEIGHT_UM) < 1;

            right += (gsn_image_at(image, u, v, 1) < 200) == tissue;
        }
    CHECK(right / ((double)image->width * image->height) > 0.97);
}

/* Known and as drawn within the region, which is that of the job. */
static void check_density(const char *page, const char *figure)
{
    const double x = number_of(page, "density-x"), um = number_of(page, "density-um-x");
    const double y = number_of(page, "density-y"), low = number_of(page, "low");
    const double step = (number_of(page, "high") - low) / 254;
    gsn_auto_mem(char) place = gsn_format("%s", strstr(page, figure));
    gsn_auto(gsn_picture) picture = picture_behind(place, "class=\"density\"");
    const struct gsn_image *image = picture->image;
    size_t inside = 0;

    CHECK(step > 0);
    for (uint32_t v = 0; v < image->height; v++)
        for (uint32_t u = 0; u < image->width; u++) {
            const double a = x + (u + 0.5) * um, b = y + (v + 0.5) * um;
            /* A voxel is inside where its middle is; a middle on a face is at the lower end. */
            const int in_region = a >= -288 && a < 288 && b >= -168 && b < 168;

            CHECK((gsn_image_at(image, u, v, 1) > 0) == in_region);
            if (!in_region)
                continue;
            CHECK(gsn_image_at(image, u, v, 0) > 0);
            CHECK_NEAR(low + (gsn_image_at(image, u, v, 0) - 1) * step,
                       DENSITY * (1 + DRAWN_SLOPE * a), 0.02 + step);
            inside++;
        }
    CHECK_NEAR((double)inside * um * um, 576. * 336, 1);
}

/* What a mark burnt is not measured, the tissue in the middle is. */
static void check_masked(const char *page, const char *figure)
{
    const double x = number_of(page, "x"), y = number_of(page, "y");
    const double um = number_of(page, "masked-um");
    gsn_auto_mem(char) place = gsn_format("%s", strstr(page, figure));
    gsn_auto(gsn_picture) picture = picture_behind(place, "class=\"masked\"");
    const struct gsn_image *image = picture->image;

    for (size_t i = 0; i < 3; i++)
        CHECK(gsn_image_at(image, (uint32_t)((drawn_marks_um[i].x - x) / um),
                           (uint32_t)((drawn_marks_um[i].y - y) / um), 0) == 1);
    CHECK(gsn_image_at(image, (uint32_t)(-x / um), (uint32_t)(-y / um), 0) == 0);
    assert_non_null(strstr(page, " data-reasons=\"halo,fold,"));
}

TEST(each_section_lies_there_with_its_density_and_what_is_not_measured)
{
    static const char *const figures[] = { "id=\"section-3\"", "id=\"section-8\"" };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    gsn_auto(gsn_specimen_result) result = worked(&d, 2);
    gsn_auto_mem(char) page = page_text(result);

    for (size_t i = 0; i < 2; i++) {
        check_glass(page, figures[i]);
        check_density(page, figures[i]);
        check_masked(page, figures[i]);
    }
    /* 12 sections, of which ten lie in the region's box. */
    CHECK(strstr(page, "id=\"section-11\"") && !strstr(page, "id=\"section-12\""));
}

TEST(one_thread_or_two_make_the_same_page)
{
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, DENSITY);
    gsn_auto(gsn_specimen_result) one = worked(&d, 1);
    gsn_auto(gsn_specimen_result) two = worked(&d, 2);
    const struct gsn_specimen_file *const a = page_in(one), *const b = page_in(two);

    CHECK(a && b && a->size == b->size && memcmp(a->bytes, b->bytes, a->size) == 0);
}

/* A withheld figure has no density, and where nothing lies in place there is no page. */
TEST(what_is_withheld_is_not_shown_and_without_poses_there_is_no_page)
{
    static const char no_region[] = "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD "}";
    struct drawn_panel panels[3];
    drawn_auto d, unlaid;

    drawn_specimen_even(&d, no_region, DENSITY);
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);
    gsn_auto_mem(char) page = page_text(result);

    CHECK(result->withheld);
    assert_non_null(strstr(page, "id=\"section-3\""));
    assert_null(strstr(page, "class=\"density\""));
    for (unsigned i = 0; i < 3; i++) {
        panels[i] = drawn_panel_of(i + 1, 24, DENSITY);
        for (size_t k = 0; k < 4; k++)
            panels[i].section[k].no_marks = 3;
    }
    drawn_specimen_init(&unlaid, DRAWN_JOB, panels, 3);
    gsn_auto(gsn_specimen_result) nothing = worked(&unlaid, 1);

    CHECK(nothing->withheld && page_in(nothing) == NULL);
}
