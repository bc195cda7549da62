/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/canvas.h"

#include <string.h>

#include "tests/check.h"

static const struct gsn_colour white = { 255, 255, 255 }, black = { 0, 0, 0 };

static struct gsn_image *sheet(uint32_t width, uint32_t height)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_canvas_new(width, height, white, &image, &err), err);
    return image;
}

/* Ink on a white sheet, in pixels of full black. */
static double ink(const struct gsn_image *image)
{
    double sum = 0.0;

    for (uint32_t y = 0; y < image->height; y++) {
        for (uint32_t x = 0; x < image->width; x++)
            sum += (255.0 - gsn_image_at(image, x, y, 1)) / 255.0;
    }
    return sum;
}

static double lightness(struct gsn_colour c)
{
    return 0.2126 * pow(c.r / 255.0, 2.2) + 0.7152 * pow(c.g / 255.0, 2.2) +
           0.0722 * pow(c.b / 255.0, 2.2);
}

TEST(colour_maps_rise_in_lightness_from_end_to_end)
{
    for (int map = GSN_MAP_VIRIDIS; map <= GSN_MAP_GREY; map++) {
        double before = -1.0;

        for (int i = 0; i <= 100; i++) {
            const double here = lightness(gsn_colour_of((enum gsn_colour_map)map, i / 100.0));

            CHECK(here > before);
            before = here;
        }
        /* Beyond the ends is the end. */
        CHECK_NEAR(lightness(gsn_colour_of((enum gsn_colour_map)map, 7.0)), before, 0.0);
    }
    CHECK(gsn_colour_of(GSN_MAP_VIRIDIS, 0.0).r == 68);
    CHECK(gsn_colour_of(GSN_MAP_VIRIDIS, 1.0).r == 253);
}

TEST(no_data_looks_like_no_value)
{
    gsn_auto(gsn_image) image = sheet(16, 16);

    for (int i = 0; i < 256; i++)
        gsn_canvas_no_data(image, i % 16, i / 16);
    for (uint32_t i = 0; i < 256; i++) {
        for (int k = 0; k <= 1000; k++) {
            for (int map = GSN_MAP_VIRIDIS; map <= GSN_MAP_GREY; map++) {
                const struct gsn_colour c = gsn_colour_of((enum gsn_colour_map)map, k / 1000.0);

                CHECK(c.r != gsn_image_at(image, i % 16, i / 16, 0) ||
                      c.g != gsn_image_at(image, i % 16, i / 16, 1) ||
                      c.b != gsn_image_at(image, i % 16, i / 16, 2));
            }
        }
    }
    /* Hatched: two greys. */
    CHECK(gsn_image_at(image, 0, 0, 0) != gsn_image_at(image, 4, 0, 0));
}

TEST(a_line_lays_down_its_length_times_its_width)
{
    for (int angle = 0; angle < 360; angle += 7) {
        gsn_auto(gsn_image) image = sheet(100, 100);
        const double c = cos(angle * M_PI / 180.0), s = sin(angle * M_PI / 180.0);

        gsn_canvas_line(image, 50.0 - 30.0 * c, 50.0 - 30.0 * s, 50.0 + 30.0 * c, 50.0 + 30.0 * s,
                        2.0, black);
        /* Round ends add up to the area of a disc of the width. */
        CHECK(ink(image) > 114.0 && ink(image) < 132.0);
    }
}

TEST(what_lies_outside_the_sheet_is_clipped)
{
    gsn_auto(gsn_image) image = sheet(20, 10);
    gsn_auto(gsn_image) stamp = sheet(8, 8);

    gsn_canvas_line(image, -1e6, -1e6, 1e6, 1e6, 3.0, black);
    gsn_canvas_line(image, 50.0, 50.0, 60.0, 50.0, 3.0, black);
    gsn_canvas_text(image, -9, -3, 2, "gieson", black);
    gsn_canvas_text(image, 15, 7, 3, "gieson", black);
    gsn_canvas_box(image, -5, -5, 3, 3, black);
    gsn_canvas_box(image, 18, 8, 30, 30, black);
    gsn_canvas_paste(image, stamp, -4, 6);
    gsn_canvas_paste(image, stamp, 16, -4);
    CHECK(gsn_image_at(image, 19, 9, 0) == 0);
}

TEST(every_printable_character_has_a_face_of_its_own)
{
    struct gsn_image *cell[95];

    for (int c = 0; c < 95; c++) {
        const char text[2] = { (char)(c + 32), '\0' };

        cell[c] = sheet(GSN_CANVAS_CELL_WIDTH, GSN_CANVAS_CELL_HEIGHT);
        gsn_canvas_text(cell[c], 0, 0, 1, text, black);
        CHECK((ink(cell[c]) > 0.0) == (c > 0));
        for (int other = 0; other < c; other++)
            CHECK(memcmp(cell[c]->samples, cell[other]->samples, gsn_image_bytes(cell[c])) != 0);
    }
    for (int c = 0; c < 95; c++)
        gsn_image_free(cell[c]);
}

TEST(text_is_as_wide_as_its_characters_not_its_bytes)
{
    gsn_auto(gsn_image) micro = sheet(6, 10);
    gsn_auto(gsn_image) unknown = sheet(6, 10);
    gsn_auto(gsn_image) broken = sheet(60, 10);

    CHECK(gsn_canvas_text_width("24 um", 1) == 30);
    CHECK(gsn_canvas_text_width("24 \xc2\xb5m", 2) == 60);
    CHECK(gsn_canvas_text_width("\xe2\x82\xac", 1) == 6);
    gsn_canvas_text(micro, 0, 0, 1, "\xc2\xb5", black);
    gsn_canvas_text(unknown, 0, 0, 1, "\xe2\x82\xac", black);
    CHECK(memcmp(micro->samples, unknown->samples, gsn_image_bytes(micro)) != 0);
    CHECK(ink(unknown) > 19.9 && ink(unknown) < 20.1);
    /* Cut off in the middle of a character. */
    gsn_canvas_text(broken, 0, 0, 1, "a\xc2", black);
    CHECK(gsn_canvas_text_width("a\xc2", 1) == 12);
}

TEST(a_scale_bar_has_a_round_length)
{
    const struct {
        double um_per_px;
        int most, px;
    } sheet_of[4] = { { 10.0, 100, 100 }, { 7.0, 100, 71 }, { 16.0, 60, 31 }, { 0.3, 90, 67 } };

    for (int i = 0; i < 4; i++) {
        gsn_auto(gsn_image) image = sheet(120, 30);
        int dark = 0;

        gsn_canvas_scale_bar(image, 5, 28, sheet_of[i].um_per_px, sheet_of[i].most, black);
        for (uint32_t x = 0; x < 120; x++)
            dark += gsn_image_at(image, x, 26, 0) == 0;
        CHECK(dark == sheet_of[i].px);
    }
}

TEST(a_colour_bar_runs_from_low_below_to_high_above)
{
    gsn_auto(gsn_image) image = sheet(100, 140);

    gsn_canvas_colour_bar(image, 10, 30, 14, 100, GSN_MAP_GREY, 0.0, 1.0, "density", black);
    for (uint32_t y = 31; y < 130; y++)
        CHECK(gsn_image_at(image, 15, y, 0) <= gsn_image_at(image, 15, y - 1, 0));
    CHECK(gsn_image_at(image, 15, 30, 0) > 250 && gsn_image_at(image, 15, 129, 0) < 5);
    /* Nothing is written beyond the room it says it needs. */
    for (uint32_t y = 0; y < 140; y++) {
        for (uint32_t x = 10 + 14 + GSN_CANVAS_SCALE_ROOM; x < 100; x++)
            CHECK(gsn_image_at(image, x, y, 0) == 255);
    }
}

static int new_sheet(struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;

    return gsn_canvas_new(8, 8, white, &image, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(new_sheet(&err), err);
}
