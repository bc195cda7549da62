/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/scatter.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/robust.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Of chi-squared with 3 degrees of freedom: the median, the value beyond which 0.1 % lie, and a
 * third of the mean of what lies below that. */
static const double MEDIAN = 2.365974, LIMIT = 16.26624, BELOW = 2.984575 / 3;

enum { ROUNDS = 30, REWEIGHTED = 8 };

/* square of each vector under the covariance; -1 where it has none. */
static int measure(struct gsn_scatter_vector *vectors, size_t count, const double c[3][3])
{
    double inverse[3][3];

    memcpy(inverse, c, sizeof inverse);
    if (gsn_invert_spd(&inverse[0][0], 3, 3) < 0)
        return -1;
    for (size_t k = 0; k < count; k++) {
        const double *v = vectors[k].v;

        vectors[k].square = 0;
        for (size_t i = 0; i < 3; i++)
            for (size_t j = 0; j < 3; j++)
                vectors[k].square += v[i] * inverse[i][j] * v[j];
    }
    return 0;
}

/* One of Tyler's steps: the mean of v v' / (v' C^-1 v), scaled to a trace of 3. */
static void tyler(const struct gsn_scatter_vector *vectors, size_t count, double c[3][3])
{
    double next[3][3] = { 0 }, trace;

    for (size_t k = 0; k < count; k++) {
        if (!(vectors[k].square > 0))
            continue;
        for (size_t i = 0; i < 3; i++)
            for (size_t j = 0; j < 3; j++)
                next[i][j] += vectors[k].v[i] * vectors[k].v[j] / vectors[k].square;
    }
    trace = next[0][0] + next[1][1] + next[2][2];
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            c[i][j] = 3 * next[i][j] / trace;
}

static double median_square(const struct gsn_scatter_vector *vectors, size_t count, double *scratch)
{
    for (size_t k = 0; k < count; k++)
        scratch[k] = vectors[k].square;
    return gsn_median(scratch, count);
}

static void of_inliers(struct gsn_scatter_vector *vectors, size_t count, double c[3][3])
{
    double sum[3][3] = { 0 };
    size_t inside = 0;

    for (size_t k = 0; k < count; k++) {
        vectors[k].inlier = vectors[k].square <= LIMIT;
        if (!vectors[k].inlier)
            continue;
        inside++;
        for (size_t i = 0; i < 3; i++)
            for (size_t j = 0; j < 3; j++)
                sum[i][j] += vectors[k].v[i] * vectors[k].v[j];
    }
    for (size_t i = 0; inside > 0 && i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            c[i][j] = sum[i][j] / ((double)inside * BELOW);
}

int gsn_scatter(struct gsn_scatter_vector *vectors, size_t count, double *scratch,
                double ret_covariance[3][3])
{
    double c[3][3] = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } }, scale;

    assert(vectors && count >= GSN_SCATTER_LEAST && scratch);

    for (int round = 0; round < ROUNDS; round++) {
        if (measure(vectors, count, c) < 0)
            return -1;
        tyler(vectors, count, c);
    }
    if (measure(vectors, count, c) < 0)
        return -1;
    scale = median_square(vectors, count, scratch) / MEDIAN;
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            c[i][j] *= scale;
    for (int round = 0; round < REWEIGHTED; round++) {
        if (measure(vectors, count, c) < 0)
            return -1;
        of_inliers(vectors, count, c);
    }
    if (measure(vectors, count, c) < 0)
        return -1;
    memcpy(ret_covariance, c, sizeof c);
    return 0;
}
