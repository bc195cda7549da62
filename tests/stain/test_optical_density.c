/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/optical_density.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

enum { WIDTH = 57, HEIGHT = 43 };

static struct gsn_image *picture(unsigned bits)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };
    uint32_t seed = 3;

    CHECK_OK(gsn_image_new(WIDTH, HEIGHT, 3, bits, &image, &err), err);
    for (size_t i = 0; i < 3 * WIDTH * HEIGHT; i++) {
        seed = seed * 1664525u + 1013904223u;
        if (bits == 8)
            ((uint8_t *)image->samples)[i] = (uint8_t)(seed >> 24);
        else
            ((uint16_t *)image->samples)[i] = (uint16_t)(seed >> 16);
    }
    return image;
}

static struct gsn_flat_field uneven(enum gsn_light light)
{
    struct gsn_flat_field glass = { .light = light, .width = WIDTH, .height = HEIGHT };

    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 6; k++)
            glass.surface[c][k] = -0.02 * (c + 1) + 0.01 * k;
    return glass;
}

/* All channels of a row of the box, and red of every third pixel of it. */
static void check_row(const struct gsn_od_reader *absorber, const struct gsn_image *image,
                      const struct gsn_flat_field *glass, const struct gsn_pixel_box *box,
                      uint32_t y)
{
    const uint32_t first = (uint32_t)box->x, width = (uint32_t)box->width;
    float row[3][WIDTH], *const to[3] = { row[0], row[1], row[2] };

    gsn_od_reader_row(absorber, first, y, width, to);
    for (unsigned c = 0; c < 3; c++)
        for (uint32_t x = 0; x < width; x++)
            CHECK_NEAR(row[c][x], paint_density(image, glass, first + x, y, c), 2e-6);
    gsn_od_reader_red(absorber, first, y, 3, (width + 2) / 3, row[0]);
    for (uint32_t x = 0; x < width; x += 3)
        CHECK_NEAR(row[0][x / 3], paint_density(image, glass, first + x, y, 0), 2e-6);
}

TEST(a_box_holds_the_density_of_each_of_its_samples)
{
    static const struct gsn_pixel_box boxes[] = { { 0, 0, WIDTH, HEIGHT },
                                                  { 5, 7, 20, 11 },
                                                  { WIDTH - 1, HEIGHT - 1, 1, 1 } };
    struct gsn_error err = { 0 };

    for (unsigned bits = 8; bits <= 16; bits += 8)
        for (size_t b = 0; b < sizeof boxes / sizeof *boxes; b++) {
            const struct gsn_flat_field glass =
                uneven(bits == 8 ? GSN_LIGHT_SRGB : GSN_LIGHT_CODES_LINEAR);
            const struct gsn_pixel_box *box = &boxes[b];
            gsn_auto(gsn_image) image = picture(bits);
            gsn_auto(gsn_od_reader) absorber = NULL;

            CHECK_OK(gsn_od_reader_new(image, &glass, &absorber, &err), err);
            for (int y = box->y; y < box->y + box->height; y++)
                check_row(absorber, image, &glass, box, (uint32_t)y);
        }
}

TEST(the_total_is_the_sum_of_three)
{
    const struct gsn_flat_field glass = uneven(GSN_LIGHT_CODES_LINEAR);
    gsn_auto(gsn_image) image = picture(8);
    gsn_auto(gsn_plane) total = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_od_total(image, &glass, &total, &err), err);
    for (uint32_t i = 0; i < WIDTH * HEIGHT; i++) {
        double sum = 0;

        for (unsigned c = 0; c < 3; c++)
            sum += paint_density(image, &glass, i % WIDTH, i / WIDTH, c);
        CHECK_NEAR(total->value[i], sum, 1e-5);
    }
}

TEST(grey_pictures_and_glass_of_another_size_are_refused)
{
    struct gsn_flat_field glass = uneven(GSN_LIGHT_SRGB);
    gsn_auto(gsn_image) image = picture(8);
    struct gsn_od_reader *absorber = NULL;
    struct gsn_plane *plane[3] = { NULL };
    struct gsn_error err = { 0 };

    glass.width--;
    CHECK(gsn_od_total(image, &glass, plane, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "the glass was measured on 56 x 43 pixels, not on 57 x 43") == 0);
    CHECK(gsn_od_reader_new(image, &glass, &absorber, &err) == GSN_E_INPUT && absorber == NULL);
    glass.width++;
    image->channels = 1;
    CHECK(gsn_od_total(image, &glass, plane, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "a grey picture tells no dyes apart") == 0);
    CHECK(plane[0] == NULL);
}

static int absorb_once(const struct gsn_image *image, struct gsn_error *err)
{
    const struct gsn_flat_field glass = uneven(GSN_LIGHT_CODES_LINEAR);
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_plane) total = NULL;
    const int r = gsn_od_total(image, &glass, &total, err);

    return r < 0 ? r : gsn_od_reader_new(image, &glass, &absorber, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = picture(8);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(absorb_once(image, &err), err);
}
