/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/register/median.h"

#include <math.h>
#include <string.h>

/* Eight sweeps of Jacobi's method are beyond what float pixels are worth. */
enum { SWEEPS = 8, MOST_DIRECTIONS = 10 };

/* A direction counts when its variance is this much above the median one's, which is grain. */
static const double LARGE = 2;

/* One of Jacobi's turns of a symmetric matrix and its eigenvectors (rows of v). */
static void turn(double *a, double *v, size_t n, size_t p, size_t q)
{
    const double theta = 0.5 * atan2(2 * a[p * n + q], a[p * n + p] - a[q * n + q]);
    const double c = cos(theta), s = sin(theta);

    for (size_t k = 0; k < n; k++) {
        const double x = a[k * n + p], y = a[k * n + q];

        a[k * n + p] = c * x + s * y;
        a[k * n + q] = c * y - s * x;
    }
    for (size_t k = 0; k < n; k++) {
        const double x = a[p * n + k], y = a[q * n + k], u = v[p * n + k], w = v[q * n + k];

        a[p * n + k] = c * x + s * y;
        a[q * n + k] = c * y - s * x;
        v[p * n + k] = c * u + s * w;
        v[q * n + k] = c * w - s * u;
    }
}

static void centre(struct gsn_sequence_stack *s)
{
    double *mean = s->room, all = 0;
    const size_t n = s->n;

    for (size_t i = 0; i < n; i++) {
        mean[i] = 0;
        for (size_t j = 0; j < n; j++)
            mean[i] += s->gram[i * n + j] / (double)n;
        all += mean[i] / (double)n;
    }
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            s->gram[i * n + j] += all - mean[i] - mean[j];
}

void gsn_sequence_reduce(struct gsn_sequence_stack *s)
{
    const size_t n = s->n;
    double *v = s->room, *value = s->room + n * n, *sorted = value + n, floor;

    centre(s);
    memset(v, 0, n * n * sizeof *v);
    for (size_t i = 0; i < n; i++)
        v[i * n + i] = 1;
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (size_t p = 0; p < n; p++)
            for (size_t q = p + 1; q < n; q++)
                turn(s->gram, v, n, p, q);
    for (size_t i = 0; i < n; i++)
        value[i] = sorted[i] = s->gram[i * n + i];
    floor = LARGE * gsn_median(sorted, n);
    if (n > MOST_DIRECTIONS)
        floor = fmax(floor, sorted[n - 1 - MOST_DIRECTIONS]);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) {
            double sum = 0;

            for (size_t k = 0; k < n; k++)
                if (value[k] > floor)
                    sum += value[k] * v[k * n + i] * v[k * n + j];
            s->gram[i * n + j] = sum;
        }
}
