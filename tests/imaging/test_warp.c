/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/warp.h"

#include "tests/check.h"

#include <string.h>

enum { CASES = 200 };

static struct gsn_image *draw(uint32_t width, uint32_t height, uint32_t channels, uint32_t bits,
                              uint32_t *seed)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(width, height, channels, bits, &image, &err), err);
    for (size_t i = 0; i < gsn_image_bytes(image); i++) {
        *seed = *seed * 1664525u + 1013904223u;
        ((uint8_t *)image->samples)[i] = (uint8_t)(*seed >> 24);
    }
    return image;
}

/* Pixel by pixel: a mirror sends column x to width - 1 - x, a quarter clockwise (x, y) to
 * (height - 1 - y, x). */
TEST(every_pixel_goes_where_mirror_and_quarters_send_it)
{
    uint32_t seed = 7;

    for (unsigned k = 0; k < CASES; k++) {
        const int mirrored = k % 2 == 1;
        const unsigned quarters = k / 2 % 4;
        const uint32_t w = 1 + k % 37, h = 1 + k % 29;
        const uint32_t channels = k % 3 ? 3 : 1, bits = k % 5 ? 8 : 16;
        gsn_auto(gsn_image) was = draw(w, h, channels, bits, &seed);
        gsn_auto(gsn_image) image = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_image_new(w, h, channels, bits, &image, &err), err);
        memcpy(image->samples, was->samples, gsn_image_bytes(was));
        CHECK_OK(gsn_turn_image(image, mirrored, quarters, &err), err);
        CHECK(image->width == (quarters % 2 ? h : w) && image->height == (quarters % 2 ? w : h));
        for (uint32_t y = 0; y < h; y++)
            for (uint32_t x = 0; x < w; x++) {
                uint32_t u = mirrored ? w - 1 - x : x, v = y, high = h, wide = w;

                for (unsigned q = 0; q < quarters; q++) {
                    const uint32_t before = u, swap = wide;

                    u = high - 1 - v;
                    v = before;
                    wide = high;
                    high = swap;
                }
                for (uint32_t c = 0; c < channels; c++)
                    CHECK(gsn_image_at(image, u, v, c) == gsn_image_at(was, x, y, c));
            }
    }
}

static int turn_once(struct gsn_image *image, struct gsn_error *err)
{
    return gsn_turn_image(image, 0, 1, err);
}

TEST(without_memory_the_picture_stays)
{
    uint32_t seed = 8;
    gsn_auto(gsn_image) image = draw(5, 3, 3, 8, &seed);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(turn_once(image, &err), err);
}
