/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Intervals of differences and of ratios. */
#ifndef GSN_MEASURE_STATS_H
#define GSN_MEASURE_STATS_H

#include "pipeline/core/error.h"

#ifdef __cplusplus
extern "C" {
#endif

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
