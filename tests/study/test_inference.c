/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/study/inference.h"

#include "tests/check.h"

#include <math.h>

/* A builtin in a CHECK() would be folded to an int. */
static int is_nan(double x)
{
    return isnan(x) ? 1 : 0;
}

TEST(a_mean_has_students_interval_and_one_animal_has_none)
{
    const double value[] = { 1, 2, 3, 4 };
    const struct gsn_group_mean four = gsn_group_mean_of(value, 4);
    const struct gsn_group_mean one = gsn_group_mean_of(value, 1);

    CHECK_NEAR(four.mean, 2.5, 1e-15);
    CHECK_NEAR(four.sd, sqrt(5.0 / 3.0), 1e-15);
    /* t.test(c(1, 2, 3, 4))$conf.int of R 4.2 */
    CHECK_NEAR(four.lower, 0.4457397432391210, 1e-12);
    CHECK_NEAR(four.upper, 4.5542602567608790, 1e-12);
    CHECK_NEAR(one.mean, 1, 0);
    CHECK(is_nan(one.sd) && is_nan(one.lower) && is_nan(one.upper));
    CHECK(is_nan(gsn_group_mean_of(value, 0).mean));
}

TEST(the_noncentral_t_is_students_at_zero_and_the_normal_in_the_limit)
{
    /* Cauchy's at one degree of freedom. */
    CHECK_NEAR(gsn_noncentral_t(1.5, 1, 0), 0.5 + atan(1.5) / M_PI, 1e-8);
    CHECK_NEAR(gsn_noncentral_t(2, 1e6, 1), 0.5 * erfc(-1 / sqrt(2.0)), 2e-6);
    /* At t = 0 it is the normal whatever the freedom. */
    CHECK_NEAR(gsn_noncentral_t(0, 3, 0.7), 0.5 * erfc(0.7 / sqrt(2.0)), 1e-8);
    /* P(T <= t | delta) + P(T <= -t | -delta) = 1 */
    CHECK_NEAR(gsn_noncentral_t(1.3, 5, 0.8) + gsn_noncentral_t(-1.3, 5, -0.8), 1, 1e-8);
}

TEST(equal_groups_differ_by_nothing_and_a_shift_moves_only_the_difference)
{
    const double a[] = { 1, 2, 4, 5 }, b[] = { 11, 12, 14, 15 };
    const struct gsn_group_mean x = gsn_group_mean_of(a, 4), y = gsn_group_mean_of(b, 4);
    const struct gsn_group_difference same = gsn_group_compare(&x, &x);
    const struct gsn_group_difference apart = gsn_group_compare(&y, &x);

    CHECK_NEAR(same.p, 1, 1e-12);
    CHECK_NEAR(same.g, 0, 1e-12);
    CHECK_NEAR(same.g_lower, -same.g_upper, 1e-6);
    CHECK_NEAR(apart.difference, 10, 1e-12);
    CHECK_NEAR(apart.freedom, 6, 1e-12);
    CHECK_NEAR(apart.upper - apart.lower, same.upper - same.lower, 1e-12);
    /* J(6) d with the exact factor: gamma(3) / (sqrt(3) gamma(5/2)). */
    CHECK_NEAR(apart.g, 10 / sqrt(10.0 / 3.0) * 2 / (sqrt(3.0) * 1.329340388179137), 1e-9);
    CHECK(apart.g_lower < apart.g && apart.g < apart.g_upper);
}

TEST(a_single_animal_gives_a_difference_and_no_p)
{
    const double a[] = { 1 }, b[] = { 2, 3 };
    const struct gsn_group_mean x = gsn_group_mean_of(a, 1), y = gsn_group_mean_of(b, 2);
    const struct gsn_group_difference d = gsn_group_compare(&x, &y);
    const struct gsn_group_loss loss = gsn_group_loss_of(&x, &y);

    CHECK_NEAR(d.difference, -1.5, 1e-15);
    CHECK(is_nan(d.p) && is_nan(d.lower) && is_nan(d.g));
    CHECK_NEAR(loss.percent, 60, 1e-12);
    CHECK(is_nan(loss.lower) && is_nan(loss.upper));
}

TEST(a_loss_against_a_control_without_error_is_the_plain_interval)
{
    const double a[] = { 0.30, 0.32, 0.34 }, b[] = { 0.5, 0.5 + 1e-9, 0.5 - 1e-9 };
    const struct gsn_group_mean x = gsn_group_mean_of(a, 3), y = gsn_group_mean_of(b, 3);
    const struct gsn_group_loss loss = gsn_group_loss_of(&x, &y);

    CHECK_NEAR(loss.percent, 36, 1e-6);
    CHECK_NEAR(loss.lower, 100 * (1 - x.upper / 0.5), 1e-4);
    CHECK_NEAR(loss.upper, 100 * (1 - x.lower / 0.5), 1e-4);
}

TEST(no_loss_has_an_interval_where_the_control_may_be_zero)
{
    const double a[] = { 1, 2 }, b[] = { -1, 1.5 };
    const struct gsn_group_mean x = gsn_group_mean_of(a, 2), y = gsn_group_mean_of(b, 2);

    CHECK(is_nan(gsn_group_loss_of(&x, &y).lower));
}

TEST(permutations_are_counted_with_their_ties)
{
    const double a[] = { 1, 2, 3 }, b[] = { 4, 5, 6 }, same[] = { 7, 7, 7 };
    struct gsn_error err = { 0 };
    double p;

    /* The two extreme ones of twenty. */
    CHECK_OK(gsn_permutation_p(a, 3, b, 3, &p, &err), err);
    CHECK_NEAR(p, 0.1, 1e-15);
    CHECK_NEAR(gsn_permutation_least_p(3, 3), 0.1, 1e-15);
    CHECK_OK(gsn_permutation_p(same, 3, same, 3, &p, &err), err);
    CHECK_NEAR(p, 1, 1e-15);
    CHECK(gsn_permutation_p(a, 3, b, 0, &p, &err) == GSN_E_INPUT);
}

TEST(more_permutations_than_can_be_gone_through_are_refused)
{
    double value[30] = { 0 }, p = 7;
    struct gsn_error err = { 0 };

    CHECK(gsn_permutation_p(value, 15, value, 15, &p, &err) == GSN_E_LIMIT);
    CHECK_NEAR(p, 7, 0);
}

TEST(permutation_says_when_memory_runs_out)
{
    const double a[] = { 1, 2 };
    struct gsn_error err = { 0 };
    double p = 7;

    CHECK_EVERY_OOM(gsn_permutation_p(a, 2, a, 2, &p, &err), err);
}

TEST(holm_is_his_own_example_and_leaves_what_is_no_comparison)
{
    /* p.adjust(c(.01, .04, .03, .005), "holm") */
    double p[] = { 0.01, 0.04, NAN, 0.03, 0.005 };

    gsn_holm(p, 5);
    CHECK_NEAR(p[0], 0.03, 1e-15);
    CHECK_NEAR(p[1], 0.06, 1e-15);
    CHECK(is_nan(p[2]));
    CHECK_NEAR(p[3], 0.06, 1e-15);
    CHECK_NEAR(p[4], 0.02, 1e-15);
}

TEST(the_animals_needed_are_those_of_the_tables)
{
    /* Cohen 1988, table 2.4.1: 64 a group for d = 0.5, 26 for 0.8; power.t.test of R: 17 for 1. */
    CHECK(gsn_animals_needed(0.5, 0.05, 0.8) == 64);
    CHECK(gsn_animals_needed(0.8, 0.05, 0.8) == 26);
    CHECK(gsn_animals_needed(-1, 0.05, 0.8) == 17);
    CHECK(gsn_animals_needed(1e-6, 0.05, 0.8) == 0);
    CHECK_NEAR(gsn_power(0, 5, 0.05), 0.05, 1e-7);
}
