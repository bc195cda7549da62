/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/fourier.h"

#include "tests/check.h"

#include <string.h>

enum { CASES = 200, MOST = 16 };

/* The sum of the definition, for one frequency. */
static void sum_up(const float *z, uint32_t w, uint32_t h, uint32_t u, uint32_t v, double ret[2])
{
    ret[0] = ret[1] = 0;
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++) {
            const double angle = -2 * M_PI * ((double)(u * x) / w + (double)(v * y) / h);
            const double re = (double)z[2 * (y * w + x)], im = (double)z[2 * (y * w + x) + 1];

            ret[0] += re * cos(angle) - im * sin(angle);
            ret[1] += re * sin(angle) + im * cos(angle);
        }
}

/* All sizes up to 16 by 13; there and back is the plane again, times its size. */
TEST(transforms_are_the_sums_of_the_definition)
{
    uint32_t seed = 21;

    for (uint32_t k = 0; k < CASES; k++) {
        const uint32_t w = 1 + k % MOST, h = 1 + k % 13, n = w * h;
        float z[2 * MOST * MOST], was[2 * MOST * MOST];
        struct gsn_error err = { 0 };

        for (uint32_t i = 0; i < 2 * n; i++) {
            seed = seed * 1664525u + 1013904223u;
            was[i] = z[i] = (float)(seed >> 8) / (1 << 23) - 1;
        }
        CHECK_OK(gsn_fourier(z, w, h, 0, &err), err);
        for (uint32_t i = 0; i < n; i++) {
            double truth[2];

            sum_up(was, w, h, i % w, i / w, truth);
            CHECK_NEAR((double)z[2 * i], truth[0], 2e-5);
            CHECK_NEAR((double)z[2 * i + 1], truth[1], 2e-5);
        }
        CHECK_OK(gsn_fourier(z, w, h, 1, &err), err);
        for (uint32_t i = 0; i < 2 * n; i++)
            CHECK_NEAR((double)z[i] / n, (double)was[i], 2e-6);
    }
}
