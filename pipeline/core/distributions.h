/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Distributions that tests and intervals need: quantiles and tail probabilities, by GSL. */
#ifndef GSN_CORE_DISTRIBUTIONS_H
#define GSN_CORE_DISTRIBUTIONS_H

#ifdef __cplusplus
extern "C" {
#endif

/* The probability that a standard normal variable stays below z. */
double gsn_normal_cdf(double z);
/* The value a standard normal variable stays below with this probability, in (0, 1). */
double gsn_normal_quantile(double probability);
/* The same for Student's t; freedom > 0 need not be whole. */
double gsn_student_quantile(double probability, double freedom);
/* The probability that Student's t exceeds t; freedom > 0 need not be whole. */
double gsn_student_tail(double t, double freedom);

/* The value that a sum of p >= 1 squares of normal numbers, over their variance, exceeds with
 * probability alpha, in (0, 1), where that variance is itself estimated with `freedom` >= 1 degrees
 * of freedom: p times Fisher's F; where it is known (freedom INFINITY), chi-squared. */
double gsn_ratio_limit(unsigned p, double freedom, double alpha);
/* The probability that this sum exceeds `square`, which may be infinite: the inverse of
 * gsn_ratio_limit(). */
double gsn_ratio_tail(unsigned p, double freedom, double square);

#ifdef __cplusplus
}
#endif
#endif
