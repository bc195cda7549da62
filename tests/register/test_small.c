/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/small.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <string.h>

/* Tables of chi-squared and of Fisher's F (times its first degrees of freedom). */
TEST(limits_are_those_of_the_tables)
{
    CHECK_NEAR(gsn_chance_limit(1, INFINITY, 1e-3), 10.82757, 1e-3);
    CHECK_NEAR(gsn_chance_limit(3, INFINITY, 1e-3), 16.26624, 1e-3);
    CHECK_NEAR(gsn_chance_limit(2, INFINITY, 0.05), 5.99146, 1e-3);
    CHECK_NEAR(gsn_chance_limit(3, 10, 1e-3), 3 * 12.5527, 2e-3);
    CHECK_NEAR(gsn_chance_limit(1, 20, 1e-3), 14.8188, 2e-3);
    CHECK_NEAR(gsn_chance_limit(2, 33, 1e-3), 33 * (pow(1e-3, -2.0 / 33) - 1), 1e-3);
}

/* Tables again, the limits turned round, and where the two branches of the fraction meet. */
TEST(chances_are_those_of_the_tables)
{
    static const double freedoms[] = { 20, 57.5, 400, INFINITY };

    CHECK_NEAR(gsn_chance_beyond3(INFINITY, 7.814728), 0.05, 1e-7);
    CHECK_NEAR(gsn_chance_beyond3(INFINITY, 16.26624), 1e-3, 1e-8);
    CHECK_NEAR(gsn_chance_beyond3(10, 3 * 12.5527), 1e-3, 1e-7);
    CHECK_NEAR(gsn_chance_beyond3(10, 3 * 3.708265), 0.05, 1e-6);
    CHECK_NEAR(gsn_chance_beyond3(2, 3 * 19.16429), 0.05, 1e-6);
    CHECK_NEAR(gsn_chance_beyond3(3, 3 * 141.108), 1e-3, 1e-7);
    CHECK(gsn_chance_beyond3(10, 0) == 1 && gsn_chance_beyond3(10, INFINITY) == 0);
    for (size_t i = 0; i < sizeof freedoms / sizeof *freedoms; i++)
        for (double alpha = 0.5; alpha > 1e-4; alpha *= 0.1)
            CHECK_NEAR(gsn_chance_beyond3(freedoms[i], gsn_chance_limit(3, freedoms[i], alpha)) /
                           alpha,
                       1, 0.01);
}

static void fill(double a[GSN_SMALL][GSN_SMALL], struct draw_chance *chance)
{
    double b[GSN_SMALL][GSN_SMALL];

    for (int i = 0; i < GSN_SMALL; i++)
        for (int j = 0; j < GSN_SMALL; j++)
            b[i][j] = draw_normal(chance);
    for (int i = 0; i < GSN_SMALL; i++)
        for (int j = 0; j < GSN_SMALL; j++) {
            a[i][j] = 0;
            for (int k = 0; k < GSN_SMALL; k++)
                a[i][j] += b[i][k] * b[j][k];
        }
}

TEST(an_inverse_and_a_solution_give_the_identity_back)
{
    struct draw_chance chance = { 1 };
    double a[GSN_SMALL][GSN_SMALL], inverse[GSN_SMALL][GSN_SMALL], spoilt[GSN_SMALL][GSN_SMALL];
    double x[GSN_SMALL][GSN_SMALL] = { 0 };

    fill(a, &chance);
    memcpy(inverse, a, sizeof a);
    memcpy(spoilt, a, sizeof a);
    CHECK(gsn_small_invert(inverse, GSN_SMALL) == 0);
    for (int i = 0; i < GSN_SMALL; i++)
        x[i][i] = 1;
    CHECK(gsn_small_solve(spoilt, x, GSN_SMALL, GSN_SMALL) == 0);
    for (int i = 0; i < GSN_SMALL; i++)
        for (int j = 0; j < GSN_SMALL; j++) {
            double sum = 0;

            for (int k = 0; k < GSN_SMALL; k++)
                sum += a[i][k] * inverse[k][j];
            CHECK_NEAR(sum, i == j, 1e-9);
            CHECK_NEAR(x[i][j], inverse[i][j], 1e-9 * fabs(inverse[i][i]));
        }
}

TEST(what_has_no_inverse_is_refused)
{
    double a[GSN_SMALL][GSN_SMALL] = { { 1, 2 }, { 2, 4 } }, b[GSN_SMALL][GSN_SMALL] = { 0 };
    double lower[3][3];
    const double flat[3][3] = { { 1, 1, 0 }, { 1, 1, 0 }, { 0, 0, 1 } };

    CHECK(gsn_small_solve(a, b, 2, 1) == -1);
    CHECK(gsn_small_cholesky3(flat, lower) == -1);
    a[0][0] = -1;
    CHECK(gsn_small_invert(a, 1) == -1);
}

TEST(eigenvectors_build_the_matrix_again)
{
    const double a[3][3] = { { 2, 1.5, -0.5 }, { 1.5, 4, 2 }, { -0.5, 2, 1 } };
    double value[3], v[3][3];

    gsn_small_eigen3(a, value, v);
    CHECK(value[0] >= value[1] && value[1] >= value[2]);
    CHECK_NEAR(value[0] + value[1] + value[2], 7, 1e-12);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0, dot = 0;

            for (int k = 0; k < 3; k++) {
                sum += v[i][k] * value[k] * v[j][k];
                dot += v[k][i] * v[k][j];
            }
            CHECK_NEAR(sum, a[i][j], 1e-12);
            CHECK_NEAR(dot, i == j, 1e-12);
        }
}
