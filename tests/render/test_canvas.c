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

static struct gsn_image *mount(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                               int *ret_x, int *ret_y)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_plate_new(plate, width, height, &image, ret_x, ret_y, &err), err);
    return image;
}

static int is_white(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    return gsn_image_at(image, x, y, 0) == 255 && gsn_image_at(image, x, y, 1) == 255 &&
           gsn_image_at(image, x, y, 2) == 255;
}

/* The ink of sheets. */
static int is_ink(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    return gsn_image_at(image, x, y, 0) == 40 && gsn_image_at(image, x, y, 2) == 46;
}

TEST(a_scale_bar_has_a_round_length)
{
    const struct {
        double um_per_px;
        uint32_t width; /* the bar takes a quarter of it at most */
        uint32_t px;
    } case_of[4] = { { 10.0, 400, 100 }, { 7.0, 400, 71 }, { 16.0, 240, 31 }, { 0.3, 360, 67 } };

    for (int i = 0; i < 4; i++) {
        const struct gsn_plate plate = { .um_per_px = case_of[i].um_per_px };
        uint32_t longest = 0;
        int x0, y0;
        gsn_auto(gsn_image) image = mount(&plate, case_of[i].width, 50, &x0, &y0);

        for (uint32_t y = (uint32_t)y0 + 51; y < image->height; y++) {
            uint32_t run = 0;

            for (uint32_t x = 0; x < image->width; x++) {
                run = is_ink(image, x, y) ? run + 1 : 0;
                longest = run > longest ? run : longest;
            }
        }
        CHECK(longest == case_of[i].px);
    }
}

TEST(a_colour_scale_runs_from_low_below_to_high_above)
{
    const struct gsn_plate plate = {
        .has_scale = 1, .low = 0.0, .high = 1.0, .map = GSN_MAP_GREY, .unit = "density"
    };
    unsigned before = 256, rows = 0;
    int x0, y0;
    gsn_auto(gsn_image) image = mount(&plate, 100, 140, &x0, &y0);
    const uint32_t column = (uint32_t)x0 + 100 + 12 + 7;
    uint32_t y = (uint32_t)y0 + 16;

    while (!is_ink(image, column, y))
        y++; /* the frame above */
    for (y++; !is_ink(image, column, y); y++, rows++) {
        CHECK(gsn_image_at(image, column, y, 0) <= before);
        before = gsn_image_at(image, column, y, 0);
        CHECK(rows > 0 || before > 250);
    }
    CHECK(before < 5 && rows > 80);
}

TEST(numbers_beside_a_colour_scale_stand_apart)
{
    for (uint32_t height = 1; height < 300; height += 23) {
        const struct gsn_plate plate = { .has_scale = 1, .low = -0.07, .high = 0.31 };
        int x0, y0, runs = 0, inked = 0;
        gsn_auto(gsn_image) image = mount(&plate, 60, height, &x0, &y0);

        /* Right of the scale and its ticks there are numbers alone. */
        for (uint32_t y = 0; y < image->height; y++) {
            int here = 0;

            for (uint32_t x = (uint32_t)x0 + 60 + 12 + 14 + 5; x < image->width; x++)
                here |= !is_white(image, x, y);
            runs += here && !inked;
            inked = here;
        }
        /* At least two say what the colours mean. */
        CHECK(runs >= 2 && runs <= 9);
    }
}

TEST(nothing_on_a_sheet_is_cut_off_at_its_edge)
{
    static const char *const said[4] = { NULL, "x",
                                         "density \xc3\x97 \xc2\xb5m, of the whole region",
                                         "a title that is far wider than the picture under it g" };

    for (int i = 0; i < 4 * 4 * 4 * 2; i++) {
        const struct gsn_plate plate = { .title = said[i % 4],
                                         .note = said[i / 4 % 4],
                                         .unit = said[i / 16 % 4],
                                         .um_per_px = i / 64 ? 7.3 : 0.0,
                                         .has_scale = 1,
                                         .low = -123456.0,
                                         .high = 123456.0 };
        const uint32_t side = i % 3 ? 240 : 1;
        int x0, y0;
        gsn_auto(gsn_image) image = mount(&plate, side, side, &x0, &y0);

        for (uint32_t y = 0; y < image->height; y++) {
            for (uint32_t x = 0; x < image->width; x++) {
                if (x < 8 || y < 8 || x + 8 >= image->width || y + 8 >= image->height)
                    CHECK(is_white(image, x, y));
            }
        }
    }
}

static int new_sheet(struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;

    return gsn_canvas_new(8, 8, white, &image, err);
}

static int draw_everything(struct gsn_error *err)
{
    const struct gsn_plate plate = { .title = "cut",
                                     .note = "z = 3",
                                     .unit = "density",
                                     .um_per_px = 4.0,
                                     .has_scale = 1,
                                     .low = 0.0,
                                     .high = 1.0 };
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_pen) pen = NULL;
    int x, y, r = gsn_plate_new(&plate, 60, 40, &image, &x, &y, err);

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
    CHECK_EVERY_OOM(draw_everything(&err), err);
}
