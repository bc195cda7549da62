/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What two small groups of animals tell: means with intervals, differences, ratios, effect sizes,
 * exact permutation, correction for several comparisons, and how many animals a difference needs.
 *
 * Values are one number an animal. NaN stands for what cannot be had from so few animals; only
 * permutation needs memory, so only it can fail. Sources are named at each function; all of it is
 * compared with R where R has it (tests/study). */
#ifndef GSN_STUDY_INFERENCE_H
#define GSN_STUDY_INFERENCE_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_group_mean {
    size_t n;
    double mean;         /* NaN without animals */
    double sd;           /* n - 1 below; NaN for fewer than two animals */
    double lower, upper; /* 95 %, Student's t; NaN for fewer than two animals */
};

struct gsn_group_mean gsn_group_mean_of(const double *value, size_t n);

/* Group a against group b. Everything but the difference needs two animals on either side. */
struct gsn_group_difference {
    double difference, lower, upper; /* a - b with 95 %, Welch (1947), variances not equal */
    double t, freedom, p;            /* of Welch's test, two-sided */
    double g, g_lower, g_upper;      /* Hedges' g (1981), exact factor; 95 % by the noncentral t */
};

struct gsn_group_difference gsn_group_compare(const struct gsn_group_mean *a,
                                              const struct gsn_group_mean *b);

/* The same without the effect size, whose interval costs a thousand times the rest. */
struct gsn_group_difference gsn_group_welch(const struct gsn_group_mean *a,
                                            const struct gsn_group_mean *b);

/* 100 (1 - mean_a / mean_b), per cent, with Fieller's 95 % interval (1954) for unequal variances:
 * Student's t with Welch's freedom at the ratio found.
 *
 * lower and upper are NaN for fewer than two animals on a side, and where b cannot be told from
 * zero. */
struct gsn_group_loss {
    double percent, lower, upper;
};

struct gsn_group_loss gsn_group_loss_of(const struct gsn_group_mean *a,
                                        const struct gsn_group_mean *b);

/* Two-sided p of the exact permutation test of the difference of means (Fisher, Pitman 1937): the
 * share of all ways to deal the n_a + n_b values out whose difference is at least the one seen.
 *
 * Fails with GSN_E_LIMIT for more than GSN_PERMUTATIONS ways, GSN_E_NOMEM; GSN_E_INPUT for an
 * empty side. */
enum { GSN_PERMUTATIONS = 5000000 };
int gsn_permutation_p(const double *a, size_t n_a, const double *b, size_t n_b, double *ret_p,
                      struct gsn_error *err);

/* The smallest p that such a test, or a rank test, can reach with so many animals without ties:
 * 2 / (n_a + n_b over n_a), with equal sides or not; 1 for an empty side. */
double gsn_permutation_least_p(size_t n_a, size_t n_b);

/* Holm's step-down correction (1979), in place; NaN is no comparison and stays. */
void gsn_holm(double *p, size_t count);

/* P(T <= t) of Student's t with this freedom >= 1 and noncentrality. Absolute error below 1e-8. */
double gsn_noncentral_t(double t, double freedom, double noncentrality);

/* The probability that Student's test of two groups at level alpha, two-sided, finds a
 * difference of so many standard deviations with n animals a group and equal spread. n >= 2. */
double gsn_power(double effect, size_t n, double alpha);

/* The least n >= 2 animals a group with at least this power; 0: more than 10 000. effect is not 0,
 * alpha and power in (0, 1). */
size_t gsn_animals_needed(double effect, double alpha, double power);

#ifdef __cplusplus
}
#endif
#endif
