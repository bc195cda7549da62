/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One section laid on its triangle, each mark weighed by its whole covariance.
 *
 * The marks' residuals y = K s + n are the section's strain s, of covariance `strain`, and noise n.
 * The motion is the generalised least-squares one under Omega = V + K strain K', so that a mark
 * that is half covered counts in the direction where it is sharp. */
#ifndef GSN_REGISTER_POSE_WEIGHTED_FIT_H
#define GSN_REGISTER_POSE_WEIGHTED_FIT_H

#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/tre.h"
#include "pipeline/register/pose/rigid.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_pose_fit_input {
    size_t count;                                              /* of marks: 2 or 3 */
    struct gsn_point from[GSN_FIDUCIALS], onto[GSN_FIDUCIALS]; /* um */
    struct gsn_cov2 cov[GSN_FIDUCIALS];                        /* um^2, in the frame of from */
    struct gsn_point about;                                    /* strain moves nothing there */
    double strain[3][3];                                       /* the stack's; 0: rigid sections */
};

struct gsn_pose_fit {
    struct gsn_rigid motion;
    double chi2;                 /* 2 count - 3 degrees of freedom */
    double log_det;              /* of the residuals' covariance, but for what the triangle adds */
    double blame[GSN_FIDUCIALS]; /* how much of chi2 goes when that mark may lie anywhere */
    /* With three marks: the residuals as three numbers, independent and standard normal where no
     * mark is wrong, and what a mark adds to them that is off by its standard deviation along
     * either axis of its own covariance, strain included. */
    double left[3], off[GSN_FIDUCIALS][2][3];
    double strain[3];            /* best estimate, shrunk by its noise */
    struct gsn_pose_error error; /* freedom is left 0 */
};

/* Fails as gsn_rigid_fit(), and with GSN_E_MARKERS when a covariance is not positive. */
int gsn_pose_fit(const struct gsn_pose_fit_input *input, struct gsn_pose_fit *ret_fit,
                 struct gsn_error *err);

/* The rows of J and G of tre.h for a point at u from the centre. */
void gsn_pose_jacobian(struct gsn_point u, double ret_pose[2][3], double ret_strain[2][3]);

#ifdef __cplusplus
}
#endif
#endif
