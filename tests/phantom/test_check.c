/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/phantom/check.h"
#include "pipeline/phantom/geometry.h"

static const double DEPTH[GSN_PHANTOM_DEPTHS] = { 0, .3698, .8153, 1 };

TEST(the_check_values_are_met)
{
    struct gsn_phantom_check check[GSN_PHANTOM_CHECKS];
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_check_all(6, 0, check, &err), err);
    for (int i = 0; i < GSN_PHANTOM_CHECKS; i++)
        gsn_check_near(check[i].value, check[i].demanded, check[i].tolerance, check[i].name,
                       __FILE__, __LINE__);
}

TEST(a_check_value_that_is_missed_is_called_missed)
{
    struct gsn_phantom_check check[GSN_PHANTOM_CHECKS];
    struct gsn_error err = { 0 };
    int missed = 0;

    CHECK_OK(gsn_phantom_check_all(150, 0, check, &err), err);
    for (int i = 0; i < GSN_PHANTOM_CHECKS; i++)
        missed += !check[i].met;
    CHECK(missed > GSN_PHANTOM_CHECKS / 2);
}

/* The specification's own figures for sums over the section planes in 8 um pixels. */
TEST(slicing_alone_costs_a_hundredth_of_a_point)
{
    double intact = 0, lost = 0;

    for (int k = 5; k <= 29; k++)
        for (int j = 0; j < 225; j++)
            for (int i = 0; i < 225; i++) {
                const struct gsn_vec3 at = { 411 - 900 + 8 * (i + 0.5), 646 - 900 + 8 * (j + 0.5),
                                             12 + 24.0 * k };
                struct gsn_phantom_field field;

                if (!gsn_phantom_in_region(gsn_phantom_geometry(), at))
                    continue;
                gsn_phantom_field_at(gsn_phantom_geometry(), at, &field);
                intact += field.intact;
                lost += field.lost;
            }
    CHECK_NEAR(100 * .3698 * lost / intact, 16.598, 0.0015);
    CHECK_NEAR(100 * .8153 * lost / intact, 36.593, 0.0015);
}

TEST(sums_are_the_same_with_any_number_of_threads)
{
    struct gsn_phantom_sums one, three;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_sum(gsn_phantom_geometry(), 24, DEPTH, 1, 1, &one, &err), err);
    CHECK_OK(gsn_phantom_sum(gsn_phantom_geometry(), 24, DEPTH, 1, 3, &three, &err), err);
    CHECK(memcmp(&one, &three, sizeof one) == 0);
}

static int sum_once(struct gsn_error *err)
{
    struct gsn_phantom_sums sums;

    return gsn_phantom_sum(gsn_phantom_geometry(), 100, DEPTH, 1, 1, &sums, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(sum_once(&err), err);
}
