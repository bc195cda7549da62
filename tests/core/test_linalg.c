/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/linalg.h"

#include "tests/check.h"

#include <string.h>

enum { CASES = 200, MOST = 16, LONG = 90 };

static double draw(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (double)(*seed >> 8) / (1 << 23) - 1;
}

/* B B' + 0.1, dense, in the first n columns of rows of `stride`. */
static void draw_spd(double *a, size_t n, size_t stride, uint32_t *seed)
{
    double b[MOST][MOST];

    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            b[i][j] = draw(seed);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) {
            a[i * stride + j] = i == j ? 0.1 : 0;
            for (size_t k = 0; k < n; k++)
                a[i * stride + j] += b[i][k] * b[j][k];
        }
}

/* Gauss and Jordan with full rows in long double: slow, plain, and of no library. */
static void solve_plainly(const double *a, size_t n, size_t stride, const double *b, double *ret_x)
{
    static long double m[LONG][LONG + 1];

    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j < n; j++)
            m[i][j] = a[i * stride + j];
        m[i][n] = b[i];
    }
    for (size_t k = 0; k < n; k++) {
        size_t pivot = k;

        for (size_t i = k; i < n; i++)
            pivot = fabsl(m[i][k]) > fabsl(m[pivot][k]) ? i : pivot;
        for (size_t j = 0; j <= n; j++) {
            const long double kept = m[k][j];

            m[k][j] = m[pivot][j];
            m[pivot][j] = kept;
        }
        for (size_t i = 0; i < n; i++) {
            const long double f = i == k ? 0 : m[i][k] / m[k][k];

            for (size_t j = k; i != k && j <= n; j++)
                m[i][j] -= f * m[k][j];
        }
    }
    for (size_t i = 0; i < n; i++)
        ret_x[i] = (double)(m[i][n] / m[i][i]);
}

TEST(positive_definite_systems_agree_with_plain_elimination)
{
    uint32_t seed = 1;

    for (size_t k = 0; k < CASES; k++) {
        const size_t n = 1 + k % MOST, stride = n + k % 3;
        double a[MOST * (MOST + 2)] = { 0 }, factor[MOST * (MOST + 2)], b[MOST], x[MOST],
               truth[MOST];

        draw_spd(a, n, stride, &seed);
        for (size_t i = 0; i < n; i++)
            b[i] = x[i] = draw(&seed);
        memcpy(factor, a, sizeof a);
        solve_plainly(a, n, stride, b, truth);
        CHECK(gsn_solve_spd(factor, n, stride, x) == 0);
        for (size_t i = 0; i < n; i++)
            CHECK_NEAR(x[i], truth[i], 1e-11 * (1 + fabs(truth[i])));
        memcpy(factor, a, sizeof a);
        CHECK(gsn_invert_spd(factor, n, stride) == 0);
        for (size_t i = 0; i < n; i++) {
            double sum = 0;

            for (size_t j = 0; j < n; j++)
                sum += factor[i * stride + j] * b[j];
            CHECK_NEAR(sum, truth[i], 1e-10 * (1 + fabs(truth[i])));
        }
    }
}

TEST(general_systems_agree_with_plain_elimination)
{
    uint32_t seed = 2;

    for (size_t k = 0; k < CASES; k++) {
        const size_t n = 1 + k % MOST;
        double a[MOST * MOST], spoilt[MOST * MOST], b[MOST], x[MOST * 2], truth[MOST];

        for (size_t i = 0; i < n * n; i++)
            a[i] = draw(&seed) + (i % (n + 1) == 0 ? 2 : 0);
        for (size_t i = 0; i < n; i++) {
            b[i] = draw(&seed);
            x[2 * i] = b[i];
            x[2 * i + 1] = -3 * b[i];
        }
        memcpy(spoilt, a, sizeof a);
        solve_plainly(a, n, n, b, truth);
        CHECK(gsn_solve_general(spoilt, n, n, x, 2, 2) == 0);
        for (size_t i = 0; i < n; i++) {
            CHECK_NEAR(x[2 * i], truth[i], 1e-9 * (1 + fabs(truth[i])));
            CHECK_NEAR(x[2 * i + 1], -3 * truth[i], 1e-9 * (1 + fabs(truth[i])));
        }
    }
}

TEST(banded_systems_agree_with_dense_ones)
{
    static double dense[LONG * LONG], band[LONG * MOST];
    uint32_t seed = 3;

    for (size_t k = 0; k < CASES; k++) {
        const size_t n = 1 + k * 7 % LONG, wide = 1 + k % MOST < n ? 1 + k % MOST : n;
        double b[LONG], x[LONG], truth[LONG];

        memset(dense, 0, sizeof dense);
        memset(band, 0, sizeof band);
        for (size_t i = 0; i < n; i++) {
            x[i] = b[i] = draw(&seed);
            for (size_t j = i + 1 > wide ? i + 1 - wide : 0; j <= i; j++)
                dense[i * n + j] = dense[j * n + i] = band[j * wide + (i - j)] =
                    i == j ? 2.0 * (double)wide : draw(&seed);
        }
        solve_plainly(dense, n, n, b, truth);
        CHECK(gsn_band_cholesky(band, n, wide) == 0);
        gsn_band_solve(band, n, wide, x);
        for (size_t i = 0; i < n; i++)
            CHECK_NEAR(x[i], truth[i], 1e-12);
    }
}

TEST(eigenvectors_build_the_matrix_again)
{
    uint32_t seed = 4;

    for (size_t k = 0; k < CASES; k++) {
        const size_t n = 1 + k % MOST;
        double a[MOST * MOST], spoilt[MOST * MOST], value[MOST], v[MOST * MOST];

        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j <= i; j++)
                a[i * n + j] = a[j * n + i] = draw(&seed);
        memcpy(spoilt, a, sizeof a);
        gsn_eigen_symmetric(spoilt, n, value, v);
        for (size_t i = 0; i + 1 < n; i++)
            CHECK(value[i] >= value[i + 1]);
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < n; j++) {
                double sum = 0, dot = 0;

                for (size_t m = 0; m < n; m++) {
                    sum += v[i * n + m] * value[m] * v[j * n + m];
                    dot += v[m * n + i] * v[m * n + j];
                }
                CHECK_NEAR(sum, a[i * n + j], 1e-13 * (double)n);
                CHECK_NEAR(dot, i == j, 1e-13 * (double)n);
            }
    }
}

/* An indefinite, a singular and an undefined matrix: each solver says so, and the process lives. */
TEST(what_has_no_factor_is_refused)
{
    double indefinite[] = { 1, 2, 2, 1 }, flat[] = { 1, 1, 0, 1, 1, 0, 0, 0, 1 };
    double undefined[] = { (double)NAN, 0, 0, 1 }, band[] = { 1, 2, 1, 0 }, less[] = { -1 };
    double singular[] = { 1, 2, 3, 2, 4, 6, 1, 1, 1 }, b[] = { 1, 2, 3 };

    CHECK(gsn_solve_spd(indefinite, 2, 2, b) == -1 && b[0] == 1 && b[1] == 2);
    CHECK(gsn_cholesky(flat, 3, 3) == -1);
    CHECK(gsn_cholesky(undefined, 2, 2) == -1);
    CHECK(gsn_invert_spd(less, 1, 1) == -1);
    CHECK(gsn_band_cholesky(band, 2, 2) == -1);
    CHECK(gsn_solve_general(singular, 3, 3, b, 1, 1) == -1);
}
