/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How far off a point of the block may lie after one section was laid: the predicted error field.
 *
 * A section's error at the point x, with u = x - about, is
 *     e(x) = J(u) p + G(u) s,   J = [1 0 -u_y; 0 1 u_x],   G = [u_x u_x u_y; u_y -u_y u_x],
 * p the error of its pose (shift and angle) and s its strain (common, stretch along x against y,
 * shear), which a rigid pose leaves as it is. Both covariances come from those of the marks and
 * from what the whole stack says about itself, so this is a prediction, not the section's own
 * residual. For three marks alike and no strain its trace is
 *     TRE^2(r) = FLE^2/3 (1 + r^2 / (2 rho^2)).
 * A shift or a bend that all laser axes share moves no residual and is not in it. */
#ifndef GSN_REGISTER_POSE_TRE_H
#define GSN_REGISTER_POSE_TRE_H

#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A covariance in the plane. */
struct gsn_cov2 {
    double xx, xy, yy;
};

/* Lengths um, the angle rad, strain a pure number. */
struct gsn_pose_error {
    struct gsn_point about;          /* block frame; where strain moves nothing */
    double pose[3][3];               /* of shift x, shift y and angle */
    double cross[3][3];              /* [of those][and of the strain] */
    double strain[3][3], left[3][3]; /* of the strain, and of what is left when it is corrected */
    double freedom; /* with which the localisation error is known; INFINITY: stated, not measured */
};

/* Where the error matters: four points with the mean and the covariance of the targets. */
struct gsn_pose_targets {
    struct gsn_point at[4];
    size_t count; /* 4, or 0: none was given */
};

/* count 0 gives none. borrows: targets. */
struct gsn_pose_targets gsn_pose_targets_of(const struct gsn_point *targets, size_t count);

/* The covariance of the motion (shift in um, angle) about another point of the block. */
void gsn_pose_error_about(const struct gsn_pose_error *error, struct gsn_point at,
                          double ret_covariance[3][3]);

/* The covariance of the error at a point of the block, of a rigid pose or of one that is corrected
 * for the section's strain. */
struct gsn_cov2 gsn_pose_tre_at(const struct gsn_pose_error *error, struct gsn_point block_um,
                                int corrected);
/* The root mean square of the error over the targets (exactly that over all of them, as the error
 * is quadratic in the place). */
double gsn_pose_tre_rms(const struct gsn_pose_error *error, const struct gsn_pose_targets *targets,
                        int corrected);

/* The ellipse e' C^-1 e = k^2 with C from gsn_pose_tre_at() holds the given share of errors; this
 * is k. 5.991^(1/2) for 95 % when the localisation error is known well, more when few sections
 * tell it. */
double gsn_pose_ellipse(double freedom, double share);

/* Half axes, and the direction of the longer one from the x axis, in -pi/2 to pi/2. */
struct gsn_ellipse {
    double major, minor, angle;
};

/* That ellipse at a point of the block, of a rigid pose or of one that is corrected for strain. */
struct gsn_ellipse gsn_pose_ellipse_at(const struct gsn_pose_error *error,
                                       struct gsn_point block_um, int corrected, double share);

#ifdef __cplusplus
}
#endif
#endif
