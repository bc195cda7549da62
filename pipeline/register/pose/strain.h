/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much a section is stretched, beside its pose.
 *
 * The knife compresses a section along its own way, the water bath stretches it again; a pose is
 * rigid and leaves that as it is. Three marks show it, with the noise of the marks in it; the
 * stack shows how much sections of this block stretch at all, so each section's strain is shrunk
 * towards none by what its noise is worth (the best linear estimate with the stack's covariance as
 * its prior). Whether it is undone is the protocol's choice, as it changes volumes.
 *
 * Strain is (common, x against y, shear): the tensor [a+b c; c a-b]. */
#ifndef GSN_REGISTER_POSE_STRAIN_H
#define GSN_REGISTER_POSE_STRAIN_H

#include "pipeline/register/pose/pose.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_strain_mode {
    GSN_STRAIN_RIGID,     /* neither used nor said */
    GSN_STRAIN_REPORTED,  /* said beside the rigid pose */
    GSN_STRAIN_CORRECTED, /* undone when the section is resampled */
    GSN_STRAIN_TISSUE,    /* so, and then laid by the tissue of the neighbours (refine.h) */
};

/* Along its two principal directions. */
struct gsn_strain_axes {
    double most, least; /* longer (positive) or shorter by these shares */
    double angle;       /* of most, rad from block x towards y, -pi/2..pi/2 */
};

struct gsn_strain_axes gsn_strain_principal(const double strain[3]);

/* Panel pixels -> um with the section's strain undone: the rigid pose, then (1 + strain)^-1 about
 * the point that strain does not move. The pose itself where the stack shows no strain. */
struct gsn_affine gsn_strain_corrected(const struct gsn_pose *pose);

/* The block as the stack's mean triangle has it -> as the protocol's has it. Some sixty sections
 * that each stretch by a hundredth stretch by a thousandth in the mean; where the mean triangle is
 * as_declared, that is laid over the strain of each. Neither triangle lies on one line. */
struct gsn_affine gsn_strain_of_mean(const struct gsn_point mean[GSN_FIDUCIALS],
                                     const struct gsn_point declared[GSN_FIDUCIALS]);

/* What all sections have in common: the scan's fault, not the tissue's. */
struct gsn_strain_common {
    int anisotropic;    /* 1: beyond 0.1 % of chance, and beyond a practical limit */
    double along_x, sd; /* panel x longer than panel y by this share */
    double diagonal;    /* the same for the diagonal: x and y not square to each other */
    int from_declared;  /* told against the protocol's triangle, as no section is turned enough */
};

/* A stretch that stays with the panel's axes however the sections are turned. borrows: inputs and
 * poses as for gsn_pose_solve(); declared: the protocol's triangle or NULL. Where neither turning
 * nor a declared triangle can show it, nothing is found. */
struct gsn_strain_common gsn_strain_of_panel(const struct gsn_pose_input *inputs,
                                             const struct gsn_pose *poses, size_t count,
                                             const struct gsn_point *declared,
                                             const struct gsn_point mean[GSN_FIDUCIALS]);

/* The strain that turns triangle `from` into `to`, but for a rigid motion; 0 where there is none to
 * tell. */
void gsn_strain_between(const struct gsn_point from[GSN_FIDUCIALS],
                        const struct gsn_point to[GSN_FIDUCIALS], double ret_strain[3]);

#ifdef __cplusplus
}
#endif
#endif
