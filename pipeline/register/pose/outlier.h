/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Outliers: sections among the stack's, and marks among a section's three. */
#ifndef GSN_REGISTER_POSE_OUTLIER_H
#define GSN_REGISTER_POSE_OUTLIER_H

#include "pipeline/register/fiducial/fiducial.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Fewer vectors do not tell a covariance of six numbers from chance. */
enum { GSN_ROBUST_COVARIANCE_MIN = 12 };

struct gsn_robust_vector {
    double v[3];
    double square; /* v' C^-1 v, by gsn_robust_covariance(): the squared Mahalanobis distance */
    int inlier;    /* by gsn_robust_covariance(): square is not beyond 0.1 % */
};

/* The covariance about 0: Tyler's estimator, which no distance moves and a third of wrong vectors
 * does not break, then that of the vectors within the 0.1 % limit, corrected for what the limit
 * cuts off. scratch has room for count numbers; count is at least GSN_ROBUST_COVARIANCE_MIN. 0, or
 * -1 where the vectors have no spread in some direction. */
int gsn_robust_covariance(struct gsn_robust_vector *vectors, size_t count, double *scratch,
                          double ret_covariance[3][3]);

/* Whether one of a section's three marks is wrong: the false-alarm probability.
 *
 * The residuals of a section, whitened, are z. If one mark is off by d standard deviations into the
 * direction t, their mean is g(t) = d (cos t off[0] + sin t off[1]) of that mark. With any of the
 * three and all directions equally likely, the likelihood ratio against no mistake is
 *     L(z) = mean over marks and t of exp(g(t)' z - |g(t)|^2 / 2),
 * and by Neyman and Pearson's lemma no test of equal false alarms finds more of such mistakes. L is
 * convex and even, so that what is farther off is found the more surely. How often the marks of a
 * good section contradict as much follows from the surface of equal L and the distribution of |z|,
 * which is independent of its direction.
 *
 * Returns the chance of an L at least as large as that of left where all marks are right. left and
 * off are those of weighted_fit.h; |left|^2 / widening is three times Fisher's F with 3 and freedom
 * degrees of freedom (INFINITY: chi-squared), as the scale of left was itself estimated.
 * Deterministic, good to a hundredth of itself where it is about 0.001. */
double gsn_outlier_false_alarm(const double left[3], const double off[GSN_FIDUCIALS][2][3],
                               double freedom, double widening);

#ifdef __cplusplus
}
#endif
#endif
