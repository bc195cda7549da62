/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: 1. Tyler's M-estimator of scatter (Ann. Statist. 15, 234, 1987), scaled by the median,
 * then the covariance of the inliers of the 0.1 % limit, corrected for what the limit cuts off
 * (Rousseeuw and van Zomeren 1990). 2. A likelihood-ratio test of one wrong mark of three; its
 * false-alarm probability is an integral over directions: along each, ln L is convex, Newton's
 * steps find how far out it reaches the level, and the tail of F beyond that is averaged over 200
 * directions that cover half a sphere evenly (golden angle).
 *
 * Fails (-1) where the vectors have no spread in some direction. Asked only of a section whose
 * marks contradict the stack, which is why chi-squared is asked first. */
#include "pipeline/register/pose/outlier.h"

#include "pipeline/core/distributions.h"
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
static int measure_distances(struct gsn_robust_vector *vectors, size_t count, const double c[3][3])
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
static void iterate_tyler(const struct gsn_robust_vector *vectors, size_t count, double c[3][3])
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

static double median_square(const struct gsn_robust_vector *vectors, size_t count, double *scratch)
{
    for (size_t k = 0; k < count; k++)
        scratch[k] = vectors[k].square;
    return gsn_median(scratch, count);
}

static void estimate_from_inliers(struct gsn_robust_vector *vectors, size_t count, double c[3][3])
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

int gsn_robust_covariance(struct gsn_robust_vector *vectors, size_t count, double *scratch,
                          double ret_covariance[3][3])
{
    double c[3][3] = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } }, scale;

    assert(vectors && count >= GSN_ROBUST_COVARIANCE_MIN && scratch);

    for (int round = 0; round < ROUNDS; round++) {
        if (measure_distances(vectors, count, c) < 0)
            return -1;
        iterate_tyler(vectors, count, c);
    }
    if (measure_distances(vectors, count, c) < 0)
        return -1;
    scale = median_square(vectors, count, scratch) / MEDIAN;
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            c[i][j] *= scale;
    for (int round = 0; round < REWEIGHTED; round++) {
        if (measure_distances(vectors, count, c) < 0)
            return -1;
        estimate_from_inliers(vectors, count, c);
    }
    if (measure_distances(vectors, count, c) < 0)
        return -1;
    memcpy(ret_covariance, c, sizeof c);
    return 0;
}

/* The mistake that is looked for, in standard deviations of a mark. Looking for 12 would find not a
 * thousandth more of those that are 12 off, and a thirtieth less of those that are 8 off. */
static const double OFF = 10;

/* Half of the directions, as L is even. L has a width of 1 / |g|, above 1 / OFF, in t: the
 * trapezoidal rule is then exact to 1e-7. */
enum { TURNS = 24, TERMS = GSN_FIDUCIALS * TURNS, WAYS = 200, STEPS = 40 };

/* Farther out no chance is left that matters. */
static const double FAR = 1e3;

/* L without what it has everywhere: the sum over k of weight cosh(g' z). */
struct ratio {
    double g[TERMS][3], half[TERMS]; /* |g|^2 / 2 */
};

static struct ratio ratio_of(const double off[GSN_FIDUCIALS][2][3])
{
    struct ratio ratio;

    for (int m = 0; m < GSN_FIDUCIALS; m++)
        for (int k = 0; k < TURNS; k++) {
            const double t = M_PI * k / TURNS, c = OFF * cos(t), s = OFF * sin(t);
            double *g = ratio.g[m * TURNS + k];
            double sum = 0;

            for (int i = 0; i < 3; i++) {
                g[i] = c * off[m][0][i] + s * off[m][1][i];
                sum += g[i] * g[i];
            }
            ratio.half[m * TURNS + k] = 0.5 * sum;
        }
    return ratio;
}

/* What L is made of along one way: exponents a R - b. */
struct ray {
    double a[TERMS];
};

static struct ray find_ray(const struct ratio *ratio, const double way[3])
{
    struct ray ray;

    for (int k = 0; k < TERMS; k++)
        ray.a[k] =
            fabs(ratio->g[k][0] * way[0] + ratio->g[k][1] * way[1] + ratio->g[k][2] * way[2]);
    return ray;
}

/* ln L at the distance r, and its derivative. */
static double log_ratio_at(const struct ratio *ratio, const struct ray *ray, double r,
                           double *ret_slope)
{
    double most = -INFINITY, sum = 0, slope = 0;

    for (int k = 0; k < TERMS; k++)
        most = fmax(most, ray->a[k] * r - ratio->half[k]);
    for (int k = 0; k < TERMS; k++) {
        const double above = ray->a[k] * r - ratio->half[k] - most;
        double up, down;

        /* exp(-40) is nothing beside the largest. */
        if (above < -40)
            continue;
        up = exp(above);
        down = ray->a[k] * r < 20 ? up * exp(-2 * ray->a[k] * r) : 0;
        sum += up + down;
        slope += ray->a[k] * (up - down);
    }
    *ret_slope = slope / sum;
    return most + log(sum);
}

/* How far out L reaches the level; start: a guess. ln L is convex, so Newton's steps come from
 * outside after the first. */
static double find_reach(const struct ratio *ratio, const struct ray *ray, double level,
                         double start)
{
    double r = start;

    for (int step = 0; step < STEPS; step++) {
        double slope;
        const double over = log_ratio_at(ratio, ray, r, &slope) - level;
        const double next = slope > 0 ? fmin(fmax(r - over / slope, 0), FAR) : FAR;

        if (fabs(next - r) < 1e-4 * r)
            return next;
        r = next;
    }
    return r;
}

double gsn_outlier_false_alarm(const double left[3], const double off[GSN_FIDUCIALS][2][3],
                               double freedom, double widening)
{
    const double far = sqrt(left[0] * left[0] + left[1] * left[1] + left[2] * left[2]);
    const struct ratio ratio = ratio_of(off);
    double sum = 0, slope, level, r = far;
    struct ray ray;

    assert(freedom >= 2 && widening > 0);

    if (!(far > 0))
        return 1;
    ray = find_ray(&ratio, (double[]){ left[0] / far, left[1] / far, left[2] / far });
    level = log_ratio_at(&ratio, &ray, far, &slope);
    /* Evenly over half of the sphere: equal heights, turned by the golden angle. */
    for (int k = 0; k < WAYS; k++) {
        const double z = (k + 0.5) / WAYS, across = sqrt(1 - z * z);
        const double turn = M_PI * (3 - sqrt(5)) * k;

        ray = find_ray(&ratio, (double[]){ across * cos(turn), across * sin(turn), z });
        r = find_reach(&ratio, &ray, level, r > 0 ? r : far);
        sum += gsn_ratio_tail(3, freedom, r * r / widening);
    }
    return sum / WAYS;
}
