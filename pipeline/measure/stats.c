/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Degrees of freedom of a difference (B. L. Welch, "The generalization of 'Student's' problem when
 * several different population variances are involved", 1947) and the interval of a ratio: the two
 * roots of the quadratic in rho that stands in the header (E. C. Fieller, "Some problems in
 * interval estimation", 1954).
 *
 * Failure: GSN_E_WITHHELD where its leading coefficient is not positive: the ratios that the data
 * allow are then no interval. Cost: none. */
#include "pipeline/measure/stats.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

double gsn_welch_freedom(double variance_a, double freedom_a, double variance_b, double freedom_b)
{
    const double sum = variance_a + variance_b;
    const double spread_a = freedom_a > 0.0 ? variance_a * variance_a / freedom_a : 0.0;
    const double spread_b = freedom_b > 0.0 ? variance_b * variance_b / freedom_b : 0.0;

    return spread_a + spread_b > 0.0 ? sum * sum / (spread_a + spread_b) : 0.0;
}

int gsn_fieller(double a, double var_a, double b, double var_b, double quantile, double *ret_low,
                double *ret_high, struct gsn_error *err)
{
    const double q2 = quantile * quantile;
    /* rho^2 (b^2 - q^2 var_b) - 2 rho a b + (a^2 - q^2 var_a) <= 0 */
    const double lead = b * b - q2 * var_b;
    /* (a b)^2 - lead (a^2 - q^2 var_a), written without the two large terms that cancel. */
    const double root = q2 * (b * b * var_a + a * a * var_b - q2 * var_a * var_b);

    if (!(lead > 0.0))
        return gsn_fail(err, GSN_E_WITHHELD,
                        "the baseline %.4g cannot be told from zero (standard error %.3g)", b,
                        sqrt(var_b));
    /* lead > 0 keeps root at or above q^2 a^2 var_b. */
    *ret_low = (a * b - sqrt(root)) / lead;
    *ret_high = (a * b + sqrt(root)) / lead;
    return GSN_OK;
}

static int compare_weighed(const void *a, const void *b)
{
    const double u = ((const struct gsn_weighed *)a)->value;
    const double v = ((const struct gsn_weighed *)b)->value;

    return (u > v) - (u < v);
}

void gsn_weighed_sort(struct gsn_weighed *list, size_t count)
{
    qsort(list, count, sizeof *list, compare_weighed);
}

double gsn_weighed_quantile(const struct gsn_weighed *sorted, size_t count, double share)
{
    double weight = 0, below = 0;
    size_t i = 0;

    if (count == 0)
        return (double)NAN;
    for (size_t k = 0; k < count; k++)
        weight += sorted[k].weight;
    while (i < count - 1 && below + sorted[i].weight < share * weight)
        below += sorted[i++].weight;
    return sorted[i].value;
}
