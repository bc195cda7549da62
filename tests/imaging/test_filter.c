/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/filter.h"

#include "tests/check.h"

#include <stdlib.h>

enum { CASES = 200 };

static int near(uint32_t a, uint32_t b, uint32_t r)
{
    return (a > b ? a - b : b - a) <= r;
}

/* Added up one by one; planes narrower than the box among them. */
TEST(a_box_mean_is_the_mean_of_what_is_there)
{
    uint32_t seed = 9;

    for (uint32_t k = 0; k < CASES; k++) {
        const uint32_t width = 1 + k % 17, height = 1 + k % 13, r = k % 6;
        gsn_auto(gsn_plane) plane = NULL;
        gsn_auto(gsn_plane) mean = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_plane_new(width, height, &plane, &err), err);
        for (uint32_t i = 0; i < width * height; i++) {
            seed = seed * 1664525u + 1013904223u;
            plane->value[i] = (float)(seed >> 8) / (1 << 24);
        }
        CHECK_OK(gsn_box_mean(plane, r, &mean, &err), err);
        for (uint32_t i = 0; i < width * height; i++) {
            double sum = 0, n = 0;

            for (uint32_t j = 0; j < width * height; j++)
                if (near(i % width, j % width, r) && near(i / width, j / width, r)) {
                    sum += (double)plane->value[j];
                    n++;
                }
            CHECK_NEAR((double)mean->value[i], sum / n, 2e-7);
        }
    }
}

TEST(halving_is_the_mean_of_two_by_two)
{
    uint32_t seed = 10;

    for (uint32_t k = 0; k < CASES; k++) {
        const uint32_t w = 2 + k % 31, h = 2 + k % 23;
        float from[32 * 25], to[16 * 12];
        struct gsn_error err = { 0 };

        for (uint32_t i = 0; i < w * h; i++) {
            seed = seed * 1664525u + 1013904223u;
            from[i] = (float)(seed >> 8) / (1 << 24);
        }
        CHECK_OK(gsn_halve(from, w, h, to, &err), err);
        for (uint32_t y = 0; y < h / 2; y++)
            for (uint32_t x = 0; x < w / 2; x++) {
                const float *at = from + 2 * y * w + 2 * x;

                CHECK_NEAR((double)to[y * (w / 2) + x],
                           0.25 *
                               ((double)at[0] + (double)at[1] + (double)at[w] + (double)at[w + 1]),
                           1e-7);
            }
    }
}

static int mean_once(const struct gsn_plane *plane, struct gsn_error *err)
{
    gsn_auto(gsn_plane) mean = NULL;

    return gsn_box_mean(plane, 1, &mean, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    float value[6] = { 0 };
    const struct gsn_plane plane = { 3, 2, value };
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(mean_once(&plane, &err), err);
}

static int by_value(const void *a, const void *b)
{
    return *(const uint8_t *)a - *(const uint8_t *)b;
}

/* Sorted nine by nine, the picture going on as its edge. */
TEST(a_median_is_the_middle_of_nine)
{
    uint32_t seed = 11;

    for (uint32_t k = 0; k < CASES; k++) {
        const int w = 1 + (int)(k % 31), h = 1 + (int)(k % 23);
        uint8_t was[31 * 23], bytes[31 * 23], nine[9];
        struct gsn_error err = { 0 };

        for (int i = 0; i < w * h; i++) {
            seed = seed * 1664525u + 1013904223u;
            was[i] = bytes[i] = (uint8_t)(k % 2 ? seed >> 24 : seed >> 31);
        }
        CHECK_OK(gsn_median_3(bytes, (uint32_t)w, (uint32_t)h, &err), err);
        for (int i = 0; i < w * h; i++) {
            for (int n = 0; n < 9; n++) {
                const int x = i % w + n % 3 - 1, y = i / w + n / 3 - 1;

                nine[n] = was[(y < 0    ? 0
                               : y >= h ? h - 1
                                        : y) *
                                  w +
                              (x < 0    ? 0
                               : x >= w ? w - 1
                                        : x)];
            }
            qsort(nine, 9, 1, by_value);
            CHECK(bytes[i] == nine[4]);
        }
    }
}

TEST(differences_are_exact)
{
    uint32_t seed = 12;

    for (uint32_t k = 0; k < CASES; k++) {
        const int w = 1 + (int)(k % 37), h = 1 + (int)(k % 29);
        const float scale = k % 2 ? 1 : 0.5F;
        float from[37 * 29], dx[37 * 29], dy[37 * 29];
        struct gsn_error err = { 0 };

        for (int i = 0; i < w * h; i++) {
            seed = seed * 1664525u + 1013904223u;
            from[i] = (float)(seed >> 8) / (1 << 20) - 3;
        }
        CHECK_OK(gsn_differences(from, (uint32_t)w, (uint32_t)h, (double)scale, dx, dy, &err), err);
        for (int i = 0; i < w * h; i++) {
            const int x = i % w, y = i / w;
            const float left = from[i - (x > 0)], right = from[i + (x + 1 < w)];
            const float upper = from[i - (y > 0 ? w : 0)], lower = from[i + (y + 1 < h ? w : 0)];

            CHECK(dx[i] == scale * (right - left));
            CHECK(dy[i] == scale * (lower - upper));
        }
    }
}
