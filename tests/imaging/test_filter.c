/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/filter.h"

#include "tests/check.h"

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
                           0.25 * ((double)at[0] + (double)at[1] + (double)at[w] +
                                   (double)at[w + 1]),
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
