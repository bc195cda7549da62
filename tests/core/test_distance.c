/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/distance.h"

#include "tests/check.h"

#include <string.h>

enum { NX = 13, NY = 9, NZ = 7, COUNT = NX * NY * NZ };

static const struct gsn_distance_box BOX = { NX, NY, NZ, 16, 10.5, 24 };

static double squared_between(size_t a, size_t b)
{
    const double x = BOX.step_x * ((double)(a % NX) - (double)(b % NX));
    const double y = BOX.step_y * ((double)(a / NX % NY) - (double)(b / NX % NY));
    const double z = BOX.step_z * ((double)(a / NX / NY) - (double)(b / NX / NY));

    return x * x + y * y + z * z;
}

static void compare_with_brute_force(const uint8_t *set, unsigned threads)
{
    struct gsn_error err = { 0 };
    float squared[COUNT];

    CHECK_OK(gsn_distance_squared(set, &BOX, threads, squared, &err), err);
    for (size_t i = 0; i < COUNT; i++) {
        double least = INFINITY;

        for (size_t j = 0; j < COUNT; j++)
            if (set[j])
                least = fmin(least, squared_between(i, j));
        CHECK(fabs(squared[i] - least) <= 1e-6 * least);
    }
}

TEST(it_is_the_distance_that_looking_at_every_pair_gives)
{
    unsigned drawn = 1;

    for (unsigned round = 0; round < 40; round++) {
        uint8_t set[COUNT] = { 0 };

        for (size_t i = 0; i < COUNT; i++) {
            drawn = drawn * 1664525u + 1013904223u;
            set[i] = (drawn >> 16) % 1000 < round * 20 + 3;
        }
        set[(drawn >> 8) % COUNT] = 1;
        compare_with_brute_force(set, round % 3 + 1);
    }
}

TEST(nothing_is_near_an_empty_set_and_everything_lies_in_a_full_one)
{
    struct gsn_error err = { 0 };
    uint8_t set[COUNT] = { 0 };
    float squared[COUNT];

    CHECK_OK(gsn_distance_squared(set, &BOX, 1, squared, &err), err);
    for (size_t i = 0; i < COUNT; i++)
        CHECK(squared[i] > 0 && isinf(squared[i]) != 0);
    memset(set, 1, sizeof set);
    CHECK_OK(gsn_distance_squared(set, &BOX, 1, squared, &err), err);
    for (size_t i = 0; i < COUNT; i++)
        CHECK(squared[i] == 0);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    uint8_t set[COUNT] = { 1 };
    float squared[COUNT];

    CHECK_EVERY_OOM(gsn_distance_squared(set, &BOX, 1, squared, &err), err);
}
