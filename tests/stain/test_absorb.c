/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/absorb.h"

#include "tests/check.h"

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

static struct gsn_glass uneven(enum gsn_light light)
{
    struct gsn_glass glass = { .light = light, .width = WIDTH, .height = HEIGHT };

    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 6; k++)
            glass.surface[c][k] = -0.02 * (c + 1) + 0.01 * k;
    return glass;
}

/* The whole picture's densities, in double precision, are the reference. */
TEST(a_box_holds_what_the_whole_picture_has_there)
{
    static const struct gsn_pixel_box boxes[] = { { 0, 0, WIDTH, HEIGHT },
                                                  { 5, 7, 20, 11 },
                                                  { WIDTH - 1, HEIGHT - 1, 1, 1 } };
    struct gsn_error err = { 0 };

    for (unsigned bits = 8; bits <= 16; bits += 8)
        for (size_t b = 0; b < sizeof boxes / sizeof *boxes; b++) {
            const struct gsn_glass glass =
                uneven(bits == 8 ? GSN_LIGHT_SRGB : GSN_LIGHT_CODES_LINEAR);
            const struct gsn_pixel_box *box = &boxes[b];
            gsn_auto(gsn_image) image = picture(bits);
            struct gsn_plane *whole[3], *part[3];

            CHECK_OK(gsn_optical_density(image, &glass, 1, whole, NULL, &err), err);
            CHECK_OK(gsn_absorb_box(image, &glass, box, 3, part, &err), err);
            for (unsigned c = 0; c < 3; c++) {
                CHECK(part[c]->width == (uint32_t)box->width);
                CHECK(part[c]->height == (uint32_t)box->height);
                for (int i = 0; i < box->width * box->height; i++) {
                    const int x = box->x + i % box->width, y = box->y + i / box->width;

                    CHECK_NEAR(part[c]->value[i], whole[c]->value[y * WIDTH + x], 2e-6);
                }
                gsn_plane_free(whole[c]);
                gsn_plane_free(part[c]);
            }
        }
}

TEST(the_total_is_the_sum_of_three_and_one_plane_is_red)
{
    const struct gsn_glass glass = uneven(GSN_LIGHT_CODES_LINEAR);
    const struct gsn_pixel_box all = { 0, 0, WIDTH, HEIGHT };
    gsn_auto(gsn_image) image = picture(8);
    gsn_auto(gsn_plane) total = NULL;
    struct gsn_plane *od[3], *red[3] = { NULL };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_optical_density(image, &glass, 1, od, NULL, &err), err);
    CHECK_OK(gsn_absorb_total(image, &glass, &total, &err), err);
    CHECK_OK(gsn_absorb_box(image, &glass, &all, 1, red, &err), err);
    for (size_t i = 0; i < WIDTH * HEIGHT; i++) {
        CHECK_NEAR(total->value[i], od[0]->value[i] + od[1]->value[i] + od[2]->value[i], 1e-5);
        CHECK_NEAR(red[0]->value[i], od[0]->value[i], 2e-6);
    }
    CHECK(red[1] == NULL && red[2] == NULL);
    gsn_plane_free(red[0]);
    for (int c = 0; c < 3; c++)
        gsn_plane_free(od[c]);
}

TEST(grey_pictures_and_glass_of_another_size_are_refused)
{
    struct gsn_glass glass = uneven(GSN_LIGHT_SRGB);
    const struct gsn_pixel_box all = { 0, 0, WIDTH, HEIGHT };
    gsn_auto(gsn_image) image = picture(8);
    struct gsn_plane *plane[3] = { NULL };
    struct gsn_error err = { 0 };

    glass.width--;
    CHECK(gsn_absorb_total(image, &glass, plane, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "the glass was measured on 56 x 43 pixels, not on 57 x 43") == 0);
    CHECK(gsn_absorb_box(image, &glass, &all, 3, plane, &err) == GSN_E_INPUT);
    glass.width++;
    image->channels = 1;
    CHECK(gsn_absorb_total(image, &glass, plane, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "a grey picture tells no dyes apart") == 0);
    CHECK(plane[0] == NULL);
}

static int absorb_once(const struct gsn_image *image, struct gsn_error *err)
{
    const struct gsn_glass glass = uneven(GSN_LIGHT_CODES_LINEAR);
    const struct gsn_pixel_box box = { 1, 1, 5, 5 };
    struct gsn_plane *od[3];
    gsn_auto(gsn_plane) total = NULL;
    int r = gsn_absorb_total(image, &glass, &total, err);

    if (r < 0)
        return r;
    r = gsn_absorb_box(image, &glass, &box, 3, od, err);
    for (int c = 0; c < 3 && r >= 0; c++)
        gsn_plane_free(od[c]);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = picture(8);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(absorb_once(image, &err), err);
}
