/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Intervals of differences and of ratios, quantiles of weighed values. */
#ifndef GSN_MEASURE_STATS_H
#define GSN_MEASURE_STATS_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_weighed {
    double value, weight;
};

/* Sorts by value. */
void gsn_weighed_sort(struct gsn_weighed *list, size_t count);
/* The smallest value that this share (0..1) of the weight is not above; NaN of an empty list. */
double gsn_weighed_quantile(const struct gsn_weighed *sorted, size_t count, double share);

/* Degrees of freedom of the difference of two means with these variances (of the means, not of
 * the values) and degrees of freedom: Welch and Satterthwaite. 0 stands for a known variance. */
double gsn_welch_freedom(double variance_a, double freedom_a, double variance_b, double freedom_b);

/* Fieller's interval of a ratio a / b of independent normal means: the set of rho with
 * (a - rho b)^2 <= q^2 (var_a + rho^2 var_b), q the two-sided quantile.
 *
 * Fails with GSN_E_WITHHELD when the set is not an interval, i.e. b^2 <= q^2 var_b: b itself cannot
 * be told from zero. */
int gsn_fieller(double a, double var_a, double b, double var_b, double quantile, double *ret_low,
                double *ret_high, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
