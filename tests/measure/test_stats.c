/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/distributions.h"
#include "pipeline/measure/stats.h"

#include "tests/check.h"
#include "tests/measure/draw.h"

TEST(quantiles_are_those_of_the_tables)
{
    CHECK_NEAR(gsn_normal_quantile(0.5), 0.0, 1e-15);
    CHECK_NEAR(gsn_normal_quantile(0.975), 1.959963984540054, 1e-13);
    /* One degree of freedom is Cauchy's, tan(pi (p - 1/2)); two has a closed form as well. */
    CHECK_NEAR(gsn_student_quantile(0.975, 1.0), tan(M_PI * 0.475), 1e-9);
    CHECK_NEAR(gsn_student_quantile(0.975, 2.0), 0.95 * sqrt(2.0 / (1.0 - 0.95 * 0.95)), 1e-12);
    CHECK_NEAR(gsn_student_quantile(0.975, 1e7), 1.959963984540054, 1e-6);
}

TEST(welch_gives_the_pooled_freedom_for_equal_sides_and_the_smaller_in_the_limit)
{
    CHECK_NEAR(gsn_welch_freedom(2.0, 5.0, 2.0, 5.0), 10.0, 1e-12);
    CHECK_NEAR(gsn_welch_freedom(2.0, 5.0, 0.0, 7.0), 5.0, 1e-12);
    CHECK_NEAR(gsn_welch_freedom(1.0, 5.0, 1.0, 0.0), 20.0, 1e-12);
    CHECK_NEAR(gsn_welch_freedom(1.0, 0.0, 1.0, 0.0), 0.0, 0.0);
}

TEST(fieller_without_error_below_is_the_plain_interval)
{
    double low, high;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_fieller(3.0, 0.25, 2.0, 0.0, 2.0, &low, &high, &err), err);
    CHECK_NEAR(low, (3.0 - 2.0 * 0.5) / 2.0, 1e-15);
    CHECK_NEAR(high, (3.0 + 2.0 * 0.5) / 2.0, 1e-15);
}

TEST(the_ends_of_fieller_satisfy_his_equation)
{
    const double a = 0.30, va = 4e-4, b = 0.40, vb = 9e-4, q = 1.96;
    double end[2];
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_fieller(a, va, b, vb, q, &end[0], &end[1], &err), err);
    for (int k = 0; k < 2; k++)
        CHECK_NEAR((a - end[k] * b) * (a - end[k] * b), q * q * (va + end[k] * end[k] * vb), 1e-15);
    CHECK(end[0] < a / b && a / b < end[1]);
    /* Not symmetric about the ratio: the denominator can be small. */
    CHECK(end[1] - a / b > a / b - end[0]);
}

TEST(fieller_refuses_a_denominator_that_may_be_zero)
{
    double low = 7.0, high = 8.0;
    struct gsn_error err = { 0 };

    CHECK(gsn_fieller(1.0, 0.1, 0.5, 0.1, 2.0, &low, &high, &err) == GSN_E_WITHHELD);
    CHECK_NEAR(low, 7.0, 0.0);
    CHECK_NEAR(high, 8.0, 0.0);
}

/* A standard normal variable (Box and Muller). */
static double draw_normal(uint64_t *seed)
{
    const double u = 1.0 - draw(seed), v = draw(seed);

    return sqrt(-2.0 * log(u)) * cos(2.0 * M_PI * v);
}

TEST(fieller_covers_the_ratio_as_often_as_promised)
{
    const double a = 0.30, sa = 0.03, b = 0.40, sb = 0.05;
    const double q = gsn_normal_quantile(0.975);
    const int draws = 40000;
    uint64_t seed = 11;
    int covered = 0, kept = 0;

    for (int i = 0; i < draws; i++) {
        double low, high;

        if (gsn_fieller(a + sa * draw_normal(&seed), sa * sa, b + sb * draw_normal(&seed), sb * sb,
                        q, &low, &high, NULL) < 0)
            continue;
        kept++;
        covered += low <= a / b && a / b <= high;
    }
    CHECK(kept > draws - 20);
    /* Standard deviation of the share: 0.0011. */
    CHECK_NEAR((double)covered / kept, 0.95, 0.004);
}
