/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/small.h"

#include <assert.h>
#include <math.h>

int gsn_small_solve(double a[GSN_SMALL][GSN_SMALL], double b[GSN_SMALL][GSN_SMALL], size_t n,
                    size_t columns)
{
    assert(n <= GSN_SMALL && columns <= GSN_SMALL);

    for (size_t k = 0; k < n; k++) {
        size_t pivot = k;

        for (size_t i = k + 1; i < n; i++)
            if (fabs(a[i][k]) > fabs(a[pivot][k]))
                pivot = i;
        if (!(fabs(a[pivot][k]) > 0))
            return -1;
        for (size_t j = 0; j < n; j++) {
            const double swap = a[k][j];

            a[k][j] = a[pivot][j];
            a[pivot][j] = swap;
        }
        for (size_t j = 0; j < columns; j++) {
            const double swap = b[k][j];

            b[k][j] = b[pivot][j];
            b[pivot][j] = swap;
        }
        for (size_t i = 0; i < n; i++) {
            const double f = a[i][k] / a[k][k];

            if (i == k || f == 0)
                continue;
            for (size_t j = k; j < n; j++)
                a[i][j] -= f * a[k][j];
            for (size_t j = 0; j < columns; j++)
                b[i][j] -= f * b[k][j];
        }
    }
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < columns; j++)
            b[i][j] /= a[i][i];
    return 0;
}

/* Cholesky's factor, below the diagonal of lower and on it; -1: not positive definite. */
static int factor(double a[GSN_SMALL][GSN_SMALL], size_t n, double lower[GSN_SMALL][GSN_SMALL])
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            double sum = a[i][j];

            for (size_t k = 0; k < j; k++)
                sum -= lower[i][k] * lower[j][k];
            if (i == j && !(sum > 0))
                return -1;
            lower[i][j] = i == j ? sqrt(sum) : sum / lower[j][j];
        }
    return 0;
}

int gsn_small_invert(double a[GSN_SMALL][GSN_SMALL], size_t n)
{
    double lower[GSN_SMALL][GSN_SMALL] = { 0 }, back[GSN_SMALL][GSN_SMALL] = { 0 };

    assert(n <= GSN_SMALL);

    if (factor(a, n, lower) < 0)
        return -1;
    for (size_t j = 0; j < n; j++)
        for (size_t i = j; i < n; i++) {
            double sum = i == j;

            for (size_t k = j; k < i; k++)
                sum -= lower[i][k] * back[k][j];
            back[i][j] = sum / lower[i][i];
        }
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) {
            a[i][j] = 0;
            for (size_t k = i > j ? i : j; k < n; k++)
                a[i][j] += back[k][i] * back[k][j];
        }
    return 0;
}

int gsn_small_cholesky3(const double a[3][3], double ret_lower[3][3])
{
    double whole[GSN_SMALL][GSN_SMALL] = { 0 }, lower[GSN_SMALL][GSN_SMALL] = { 0 };

    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            whole[i][j] = a[i][j];
    if (factor(whole, 3, lower) < 0)
        return -1;
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            ret_lower[i][j] = lower[i][j];
    return 0;
}

/* One of Jacobi's turns: makes a[p][q] vanish. */
static void turn(double a[3][3], double v[3][3], size_t p, size_t q)
{
    const double theta = 0.5 * atan2(2 * a[p][q], a[p][p] - a[q][q]);
    const double c = cos(theta), s = sin(theta);

    for (size_t k = 0; k < 3; k++) {
        const double x = a[k][p], y = a[k][q];

        a[k][p] = c * x + s * y;
        a[k][q] = c * y - s * x;
    }
    for (size_t k = 0; k < 3; k++) {
        const double x = a[p][k], y = a[q][k], u = v[k][p], w = v[k][q];

        a[p][k] = c * x + s * y;
        a[q][k] = c * y - s * x;
        v[k][p] = c * u + s * w;
        v[k][q] = c * w - s * u;
    }
}

void gsn_small_eigen3(const double a[3][3], double ret_value[3], double ret_vector[3][3])
{
    double m[3][3], v[3][3] = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };

    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            m[i][j] = 0.5 * (a[i][j] + a[j][i]);
    /* Jacobi's method converges quadratically: a dozen sweeps are beyond rounding. */
    for (int sweep = 0; sweep < 12; sweep++) {
        turn(m, v, 0, 1);
        turn(m, v, 0, 2);
        turn(m, v, 1, 2);
    }
    for (size_t k = 0; k < 3; k++) {
        size_t rank = 0;

        for (size_t j = 0; j < 3; j++)
            rank += m[j][j] > m[k][k] || (m[j][j] == m[k][k] && j < k);
        ret_value[rank] = m[k][k];
        for (size_t i = 0; i < 3; i++)
            ret_vector[i][rank] = v[i][k];
    }
}

/* Proportional to the density at v, where freedom v^2 / (freedom - v^2) is the sum of squares over
 * its estimated variance: v^2 / freedom is then Beta(p / 2, freedom / 2). */
static double density(unsigned p, double freedom, double v)
{
    const double power = pow(v, p - 1.0);

    return isinf(freedom) ? power * exp(-0.5 * v * v)
                          : power * pow(fmax(1 - v * v / freedom, 0), 0.5 * freedom - 1);
}

double gsn_chance_limit(unsigned p, double freedom, double alpha)
{
    enum { STEPS = 2000 };
    /* Nothing that matters lies beyond 12 standard deviations. */
    const double far = isinf(freedom) ? 12 : fmin(12, sqrt(freedom)), step = far / STEPS;
    double cell[STEPS], whole = 0, sum = 0, v = far;

    assert(p >= 1 && p <= 6 && freedom >= 2 && alpha > 0 && alpha <= 0.5);

    /* Simpson's rule in each step. */
    for (int i = 0; i < STEPS; i++) {
        cell[i] = (density(p, freedom, i * step) + 4 * density(p, freedom, (i + 0.5) * step) +
                   density(p, freedom, (i + 1) * step)) /
                  6;
        whole += cell[i];
    }
    for (int i = 0; i < STEPS; i++) {
        if (sum + cell[i] >= (1 - alpha) * whole) {
            v = (i + ((1 - alpha) * whole - sum) / cell[i]) * step;
            break;
        }
        sum += cell[i];
    }
    return isinf(freedom) ? v * v : v * v / (1 - v * v / freedom);
}

/* Gauss's continued fraction for the incomplete beta function I_x(a, b), less the factor in front,
 * by Lentz's method; it converges fast for x < (a + 1) / (a + b + 2). */
static double beta_fraction(double a, double b, double x)
{
    double c = 1, d = 1 / (1 - (a + b) * x / (a + 1)), h = d;

    for (int m = 1; m < 300; m++) {
        const double even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m));
        const double odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1));
        double step;

        d = 1 / (1 + even * d);
        c = 1 + even / c;
        h *= d * c;
        d = 1 / (1 + odd * d);
        c = 1 + odd / c;
        step = d * c;
        h *= step;
        if (fabs(step - 1) < 1e-14)
            break;
    }
    return h;
}

static double incomplete_beta(double a, double b, double x)
{
    const double front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log(x) + b * log1p(-x));

    if (x < (a + 1) / (a + b + 2))
        return front * beta_fraction(a, b, x) / a;
    return 1 - front * beta_fraction(b, a, 1 - x) / b;
}

double gsn_chance_beyond3(double freedom, double square)
{
    assert(freedom >= 2 && !isnan(square));

    if (square <= 0)
        return 1;
    if (isinf(square))
        return 0;
    if (isinf(freedom))
        return erfc(sqrt(0.5 * square)) + sqrt(2 * square / M_PI) * exp(-0.5 * square);
    return incomplete_beta(0.5 * freedom, 1.5, freedom / (freedom + square));
}

static int factor_spd(double *a, size_t n)
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            double sum = a[i * n + j];

            for (size_t k = 0; k < j; k++)
                sum -= a[i * n + k] * a[j * n + k];
            if (i == j && !(sum > 0))
                return -1;
            a[i * n + j] = i == j ? sqrt(sum) : sum / a[j * n + j];
        }
    return 0;
}

int gsn_small_solve_spd(double *a, double *x, size_t n)
{
    if (factor_spd(a, n) < 0)
        return -1;
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < i; k++)
            x[i] -= a[i * n + k] * x[k];
        x[i] /= a[i * n + i];
    }
    for (size_t i = n; i-- > 0;) {
        for (size_t k = i + 1; k < n; k++)
            x[i] -= a[k * n + i] * x[k];
        x[i] /= a[i * n + i];
    }
    return 0;
}
