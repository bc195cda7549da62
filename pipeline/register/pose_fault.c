/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose_fault.h"

#include "pipeline/core/distributions.h"

#include <assert.h>
#include <math.h>

/* The mistake that is looked for, in standard deviations of a mark. Looking for 12 would find not a
 * thousandth more of those that are 12 off, and a thirtieth less of those that are 8 off. */
static const double OFF = 10;
/* Half of the directions, as L is even. L has a width of 1 / |g|, above 1 / OFF, in t: the
 * trapezoidal rule is then exact to 1e-7. */
enum { TURNS = 24, TERMS = GSN_MARKS * TURNS, WAYS = 200, STEPS = 40 };
/* Farther out no chance is left that matters. */
static const double FAR = 1e3;

/* L without what it has everywhere: the sum over k of weight cosh(g' z). */
struct ratio {
    double g[TERMS][3], half[TERMS]; /* |g|^2 / 2 */
};

static struct ratio ratio_of(const double off[GSN_MARKS][2][3])
{
    struct ratio ratio;

    for (int m = 0; m < GSN_MARKS; m++)
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

static struct ray ray_of(const struct ratio *ratio, const double way[3])
{
    struct ray ray;

    for (int k = 0; k < TERMS; k++)
        ray.a[k] =
            fabs(ratio->g[k][0] * way[0] + ratio->g[k][1] * way[1] + ratio->g[k][2] * way[2]);
    return ray;
}

/* ln L at the distance r, and its derivative. */
static double log_at(const struct ratio *ratio, const struct ray *ray, double r, double *ret_slope)
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
static double reach(const struct ratio *ratio, const struct ray *ray, double level, double start)
{
    double r = start;

    for (int step = 0; step < STEPS; step++) {
        double slope;
        const double over = log_at(ratio, ray, r, &slope) - level;
        const double next = slope > 0 ? fmin(fmax(r - over / slope, 0), FAR) : FAR;

        if (fabs(next - r) < 1e-4 * r)
            return next;
        r = next;
    }
    return r;
}

double gsn_pose_fault_chance(const double left[3], const double off[GSN_MARKS][2][3],
                             double freedom, double widening)
{
    const double far = sqrt(left[0] * left[0] + left[1] * left[1] + left[2] * left[2]);
    const struct ratio ratio = ratio_of(off);
    double sum = 0, slope, level, r = far;
    struct ray ray;

    assert(freedom >= 2 && widening > 0);

    if (!(far > 0))
        return 1;
    ray = ray_of(&ratio, (double[]){ left[0] / far, left[1] / far, left[2] / far });
    level = log_at(&ratio, &ray, far, &slope);
    /* Evenly over half of the sphere: equal heights, turned by the golden angle. */
    for (int k = 0; k < WAYS; k++) {
        const double z = (k + 0.5) / WAYS, across = sqrt(1 - z * z);
        const double turn = M_PI * (3 - sqrt(5)) * k;

        ray = ray_of(&ratio, (double[]){ across * cos(turn), across * sin(turn), z });
        r = reach(&ratio, &ray, level, r > 0 ? r : far);
        sum += gsn_ratio_tail(3, freedom, r * r / widening);
    }
    return sum / WAYS;
}
