/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/imaging/threshold.h"

#include "tests/check.h"
#include <string.h>

enum { CASES = 200, BINS = 64 };

/* The variance between the classes from its definition. */
static double between(const size_t *bin, size_t cut)
{
    double n[2] = { 0 }, sum[2] = { 0 };

    for (size_t i = 0; i < BINS; i++) {
        n[i >= cut] += (double)bin[i];
        sum[i >= cut] += (double)(i * bin[i]);
    }
    return n[0] > 0 && n[1] > 0 ? n[0] * n[1] * pow(sum[0] / n[0] - sum[1] / n[1], 2) : 0;
}

TEST(no_cut_parts_better)
{
    uint32_t seed = 11;

    for (unsigned k = 0; k < CASES; k++) {
        size_t bin[BINS], cut;
        double best = 0;

        for (size_t i = 0; i < BINS; i++) {
            seed = seed * 1664525u + 1013904223u;
            bin[i] = (seed >> 24) % (1 + k % 50);
        }
        bin[k % BINS]++;
        cut = gsn_otsu_cut(bin, BINS, NULL);
        CHECK(cut >= 1 && cut <= BINS);
        for (size_t c = 1; c < BINS; c++)
            best = fmax(best, between(bin, c));
        CHECK_NEAR(between(bin, cut), best, 1e-9 * best);
    }
}

/* Two bins: every cut between them is as good, and the middle one is taken. */
TEST(a_parted_pair_is_cut_in_the_middle)
{
    for (size_t low = 0; low < 20; low++)
        for (size_t high = low + 1; high < BINS; high++) {
            size_t bin[BINS] = { 0 };
            double apart;

            bin[low] = 7;
            bin[high] = 5;
            CHECK(gsn_otsu_cut(bin, BINS, &apart) == (low + high - 1) / 2 + 1);
            CHECK_NEAR(apart, (double)(high - low), 1e-12);
        }
}

TEST(one_class_has_no_distance)
{
    size_t bin[BINS] = { [9] = 4 };
    double apart = -1;

    CHECK(gsn_otsu_cut(bin, BINS, &apart) >= 1 && apart == 0);
}

TEST(otsu_cuts_between_two_classes)
{
    float values[1000];

    for (size_t i = 0; i < 1000; i++)
        values[i] = (i < 700 ? 0.1f : 0.9f) + 0.0001f * (float)(i % 100);
    CHECK(gsn_otsu(values, 1000) > 0.11 && gsn_otsu(values, 1000) < 0.9);
    /* Equally good cuts: the middle of the gap. */
    CHECK_NEAR(gsn_otsu(values, 1000), 0.505, 0.01);
    CHECK(gsn_otsu(values, 0) != gsn_otsu(values, 0)); /* NaN */
    CHECK_NEAR(gsn_otsu(values, 1), 0.1f, 0);
}

TEST(otsu_of_a_ramp_is_its_middle)
{
    float values[4096];

    for (size_t i = 0; i < 4096; i++)
        values[i] = (float)i / 4095;
    CHECK_NEAR(gsn_otsu(values, 4096), 0.5, 1.0 / 512);
}
