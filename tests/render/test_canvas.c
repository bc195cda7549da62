/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/canvas.h"

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

static struct gsn_pen *new_pen(const struct gsn_image *image)
{
    struct gsn_pen *pen = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_pen_new(image, &pen, &err), err);
    return pen;
}

TEST(a_line_lays_down_its_length_times_its_width)
{
    struct gsn_error err = { 0 };

    for (int angle = 0; angle < 360; angle += 7) {
        gsn_auto(gsn_image) image = sheet(100, 100);
        gsn_auto(gsn_pen) pen = new_pen(image);
        const double c = cos(angle * M_PI / 180.0), s = sin(angle * M_PI / 180.0);

        /* Twice, and in the other direction: ink is laid once. */
        gsn_pen_line(pen, 50.0 - 30.0 * c, 50.0 - 30.0 * s, 50.0 + 30.0 * c, 50.0 + 30.0 * s);
        gsn_pen_line(pen, 50.0 + 30.0 * c, 50.0 + 30.0 * s, 50.0 - 30.0 * c, 50.0 - 30.0 * s);
        CHECK_OK(gsn_pen_ink(pen, image, 2.0, black, &err), err);
        /* Round ends add up to the area of a disc of the width. */
        CHECK_NEAR(ink(image), 60.0 * 2.0 + M_PI, 1.0);
    }
}

TEST(what_lies_outside_the_sheet_is_clipped)
{
    gsn_auto(gsn_image) image = sheet(20, 10);
    gsn_auto(gsn_image) stamp = sheet(8, 8);
    gsn_auto(gsn_pen) pen = new_pen(image);
    struct gsn_error err = { 0 };

    gsn_pen_line(pen, -1e6, -1e6, 1e6, 1e6);
    gsn_pen_line(pen, 50.0, 50.0, 60.0, 50.0);
    CHECK_OK(gsn_pen_ink(pen, image, 3.0, black, &err), err);
    gsn_canvas_box(image, -5, -5, 3, 3, black);
    gsn_canvas_box(image, 18, 8, 30, 30, black);
    gsn_canvas_paste(image, stamp, -4, 6);
    gsn_canvas_paste(image, stamp, 16, -4);
    CHECK(gsn_image_at(image, 19, 9, 0) == 0);
}

static int new_sheet(struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;

    return gsn_canvas_new(8, 8, white, &image, err);
}

static int draw_line(struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_pen) pen = NULL;
    int r = gsn_canvas_new(60, 40, white, &image, err);

    if (r >= 0)
        r = gsn_pen_new(image, &pen, err);
    if (r < 0)
        return r;
    gsn_pen_line(pen, 3.0, 3.0, 30.0, 20.0);
    return gsn_pen_ink(pen, image, 1.0, black, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(new_sheet(&err), err);
    CHECK_EVERY_OOM(draw_line(&err), err);
}
