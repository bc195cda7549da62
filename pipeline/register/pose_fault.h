/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether one of a section's three marks is wrong.
 *
 * The residuals of a section, whitened, are z. If one mark is off by d standard deviations into the
 * direction t, their mean is g(t) = d (cos t off[0] + sin t off[1]) of that mark. With any of the
 * three and all directions equally likely, the likelihood ratio against no mistake is
 *     L(z) = mean over marks and t of exp(g(t)' z - |g(t)|^2 / 2),
 * and by Neyman and Pearson's lemma no test of equal false alarms finds more of such mistakes. L is
 * convex and even, so that what is farther off is found the more surely. How often the marks of a
 * good section contradict as much follows from the surface of equal L and the distribution of |z|,
 * which is independent of its direction. */
#ifndef GSN_REGISTER_POSE_FAULT_H
#define GSN_REGISTER_POSE_FAULT_H

#include "pipeline/register/markers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The chance of an L at least as large as that of left where all marks are right. left and off are
 * those of pose_fit.h; |left|^2 / widening is three times Fisher's F with 3 and freedom degrees of
 * freedom (INFINITY: chi-squared), as the scale of left was itself estimated. Deterministic, good
 * to a hundredth of itself where it is about 0.001. */
double gsn_pose_fault_chance(const double left[3], const double off[GSN_MARKS][2][3],
                             double freedom, double widening);

#ifdef __cplusplus
}
#endif
#endif
