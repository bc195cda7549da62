/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/smooth.h"

#include "tests/check.h"

#include <stdlib.h>
#include <string.h>

enum { CASES = 200, WIDEST = 150, HIGHEST = 23 };

static float drawn(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (float)(*seed >> 8) / (float)(1 << 24) - 0.5f;
}

static long clamp_to(long at, long count)
{
    return at < 0 ? 0 : at < count ? at : count - 1;
}

TEST(the_binomial_is_its_definition_with_the_border_held)
{
    static const double weight[3] = { 0.25, 0.5, 0.25 };
    static float plane[WIDEST * HIGHEST], smooth[WIDEST * HIGHEST];
    uint32_t seed = 3;

    for (long k = 0; k < CASES; k++) {
        const long w = 1 + 7 * k % WIDEST, h = 1 + k % HIGHEST;

        for (long i = 0; i < w * h; i++)
            plane[i] = drawn(&seed);
        memcpy(smooth, plane, sizeof smooth);
        gsn_smooth_binomial(smooth, (size_t)w, (size_t)h, 1);
        for (long i = 0; i < w * h; i++) {
            double sum = 0;

            for (long d = 0; d < 9; d++)
                sum +=
                    weight[d % 3] * weight[d / 3] *
                    (double)
                        plane[clamp_to(i / w + d / 3 - 1, h) * w + clamp_to(i % w + d % 3 - 1, w)];
            CHECK_NEAR((double)smooth[i], sum, 1e-6);
        }
    }
}

TEST(many_passes_keep_the_sum_and_add_their_variance)
{
    enum { SIDE = 61, TIMES = 18 };
    static float plane[SIDE * SIDE];
    double sum = 0, square = 0;

    memset(plane, 0, sizeof plane);
    plane[SIDE * SIDE / 2] = 1;
    gsn_smooth_binomial(plane, SIDE, SIDE, TIMES);
    for (int i = 0; i < SIDE * SIDE; i++) {
        sum += (double)plane[i];
        square += (double)plane[i] * pow(i % SIDE - SIDE / 2, 2);
    }
    CHECK_NEAR(sum, 1, 1e-5);
    CHECK_NEAR(square, 0.5 * TIMES, 1e-4);
}

TEST(the_gaussian_is_its_definition_with_nothing_beyond_the_border)
{
    static float plane[WIDEST * HIGHEST], smooth[WIDEST * HIGHEST], scratch[WIDEST * HIGHEST];
    uint32_t seed = 5;

    for (long k = 0; k < CASES; k++) {
        const long w = 1 + 7 * k % 40, h = 1 + k % HIGHEST;
        const double sigma = 0.5 + (double)(k % 5);
        const long reach = (long)ceil(3 * sigma);
        double all = 0;

        for (long d = -reach; d <= reach; d++)
            all += exp(-0.5 * (double)(d * d) / (sigma * sigma));
        for (long i = 0; i < w * h; i++)
            plane[i] = drawn(&seed);
        memcpy(smooth, plane, sizeof smooth);
        gsn_smooth_gaussian(smooth, (size_t)w, (size_t)h, sigma, scratch);
        for (long i = 0; i < w * h; i += 1 + k) {
            double sum = 0;

            for (long y = 0; y < h; y++)
                for (long x = 0; x < w; x++) {
                    const long u = x - i % w, v = y - i / w;

                    if (labs(u) <= reach && labs(v) <= reach)
                        sum += (double)plane[y * w + x] *
                               exp(-0.5 * (double)(u * u + v * v) / (sigma * sigma));
                }
            CHECK_NEAR((double)smooth[i], sum / (all * all), 1e-6);
        }
    }
}
