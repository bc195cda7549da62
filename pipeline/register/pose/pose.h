/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How each section lies in the block: all sections of a stack solved together.
 *
 * Every section is laid rigidly (determinant exactly 1, after the pixel size) on the mean triangle
 * of the whole stack, never on its neighbour: chains drift as the square root of their length, the
 * common triangle does not. Where the laser's axes are not parallel, the triangle is that of three
 * straight lines at the section's z (gsn_axes_at). The residual of a section says nothing about its
 * error at the target; that is predicted from the localisation error (FLE) of the whole stack
 * (tre.h). Residuals serve to find gross mistakes, and, where they are larger than the marks'
 * errors make them, to say how much the sections are stretched. Lengths are micrometres in the
 * block frame: that of the protocol's marks, or else the origin at the mean triangle's centroid and
 * x from mark 1 towards mark 2. */
#ifndef GSN_REGISTER_POSE_POSE_H
#define GSN_REGISTER_POSE_POSE_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/tre.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Laser axes that are straight lines, but not parallel: the triangle changes along z.
 *
 * Each section's shape is known only up to a rigid motion, so what can be seen of three axes'
 * slopes is how the triangle changes: three numbers of the six. A slope or a bend that all three
 * axes share, and a common twist about z, look exactly like the way the sections were laid on the
 * glass: no marks can show them, and they remain in the block frame. What is reported is therefore
 * each axis against the three axes' common motion. A shrinkage that grows along z looks the same as
 * axes that converge. */
struct gsn_axes {
    int slanted, bent;         /* beyond the 0.1 % that chance does; only then used in the poses */
    double middle, half;       /* serial numbers: the middle and half the length of the stack */
    struct gsn_point slope[3]; /* um per section, of each axis against the common motion */
    struct gsn_point bend[3];  /* um: the ends of the stack against its middle, likewise */
    double slope_sd;           /* standard deviation per axis and coordinate, root mean square */
    double bend_sd;
};

/* The triangle at a section: as it is in the middle, moved along the axes. */
void gsn_axes_at(const struct gsn_axes *axes, double serial, const struct gsn_point triangle[3],
                 struct gsn_point ret_onto[3]);

struct gsn_pose_input {
    unsigned serial; /* 0-based; used in sentences only */
    struct gsn_fiducial marks[GSN_FIDUCIALS];
    double px_um;
    int mirrored; /* what gsn_fiducials_match() said; used only where two marks were found, since
                     three tell by themselves */
};

enum gsn_pose_state {
    GSN_POSE_NONE,      /* fewer than two marks: everything below is 0 */
    GSN_POSE_TWO_MARKS, /* rigid on two marks: larger TRE, a person should look */
    GSN_POSE_OK,
};

/* A section whose three marks contradict the stack, laid on two of them. One of the three is right
 * if one mark is wrong; which one, the marks alone misname in one case of eight, so it is for a
 * person, or for the tissue of the neighbours, to say. */
struct gsn_pose_candidate {
    struct gsn_affine panel_to_block_um;
    double tre_um; /* predicted, as below */
    double chi2;   /* of the side between the two: 1 degree of freedom */
    double share;  /* how likely the mark left out is the wrong one, by the marks: sums to 1 */
};

struct gsn_pose {
    enum gsn_pose_state state;
    int flipped;                         /* mounted face down: mirrored back by panel_to_block_um */
    int rotated180;                      /* turned by more than 90 degrees */
    struct gsn_affine panel_to_block_um; /* determinant px_um^2, negative when flipped */
    double residual_um[GSN_FIDUCIALS];   /* distance of each mark from the mean triangle's; 0 where
                                        it was not found */
    struct gsn_point onto_um[GSN_FIDUCIALS]; /* where the common triangle has each mark, and how */
    struct gsn_point
        off_um[GSN_FIDUCIALS]; /* far from it the section's lies: the residual's vector */
    double rms_um;             /* root mean square of those found */
    double tre_um;             /* predicted, root mean square over the targets */
    double chi2; /* of the residuals under the stack's covariance: 3 degrees of freedom with three
                    marks, 1 with two */
    int gross;   /* the marks contradict the stack by more than 0.1 % of good sections do, by the
                    likelihood of one of three being wrong (outlier.h), or by chi2 of two: a mark
                    is wrong or the section is torn or stretched. The pose is that of all marks and
                    must not be used: a person chooses a candidate */
    struct gsn_pose_candidate candidate[GSN_FIDUCIALS]; /* gross with three marks: [i] leaves out
                                                       mark i; otherwise 0 */
    struct gsn_pose_error error; /* from which the error at any point follows */
    double strain[3]; /* of this section, shrunk by its noise: common, x against y, shear. The pose
                         does not use it (strain.h does); 0 where the stack shows none */
    unsigned char
        order[GSN_FIDUCIALS]; /* mark i is the input's marks[order[i]]; other than 0 1 2 only
                             where flips cannot be told and two marks were swapped back */
};

struct gsn_pose_summary {
    size_t with_three, with_two, without, flipped;
    double fle_um;  /* root mean square distance of a mark from its true place */
    double freedom; /* degrees of freedom fle_um is known with; INFINITY: only from the fits */
    double
        rho_um; /* root mean square distance of the mean triangle's corners from their centroid */
    struct gsn_point mean_triangle[GSN_FIDUCIALS]; /* block frame */
    double scale_vs_declared; /* size of the mean triangle over that of the protocol's; 1 when
                                 none was given. Far from 1: the pixel size is wrong */
    double side_ratio[GSN_FIDUCIALS]; /* the same for sides 1-2, 2-3, 3-1 */
    double isosceles_sigma; /* smallest difference of two sides, or the smallest height when that is
                               less, over the localisation error per axis (not below a tenth of a
                               pixel) */
    int flips_told;         /* 0: isosceles_sigma < 10, a mirrored section cannot be told on this
                               block, and no section is called flipped */
    int stretches;          /* sections differ in shape by more than the marks' errors make */
    double strain_sd[3];    /* standard deviation of their strain: common, x against y, shear */
    int as_declared;        /* they do, and what that makes of the mean by chance is all that the
                               protocol's triangle differs from the mean one by
                               (gsn_strain_of_mean) */
    struct gsn_axes axes;
    int chirality; /* +1, -1: most sections have, or mirror, the protocol's triangle (+1 when no
                      triangle was given, or flips cannot be told) */
};

struct gsn_pose_options {
    const struct gsn_point *markers_um; /* the protocol's three marks in the block frame, or NULL */
    const struct gsn_point *targets_um; /* where the error matters, such as the region's voxels */
    size_t target_count;                /* 0: the TRE is given at the distance rho */
    int sizes; /* strain is looked for in the sections' sizes alone, and not in their shapes */
};

/* Solves the stack. borrows: everything. Marks weigh by the covariance of their fits and by what
 * the residuals of all sections show beyond it, alike for all marks or in proportion; the FLE is
 * that of the median mark (of the fits themselves where fewer than 3 sections have three marks).
 * Strain and slanted axes are looked for from 12 sections on. ret_poses receives count entries.
 *
 * Fails with GSN_E_MARKERS when no section has three marks, when the protocol's or the mean
 * triangle is degenerate, or when it is so nearly equilateral that not even rotations can be told;
 * with GSN_E_INPUT when a pixel size is not positive or a position not finite; GSN_E_NOMEM. */
int gsn_pose_solve(const struct gsn_pose_input *inputs, size_t count,
                   const struct gsn_pose_options *options, struct gsn_pose *ret_poses,
                   struct gsn_pose_summary *ret_summary, struct gsn_error *err);

/* What to print of a gross section with three marks, beside that it is gross: the pose of its
 * likeliest candidate, and its expected error, root mean square over the targets, if one of the
 * candidates is right: sum of share (tre^2 + distance of the two poses^2). A mark that is off by
 * many times its error leaves little doubt which two agree; one that is just off, much, and so is
 * the error. borrows: targets; count 0 gives the candidates' own tre. The caller guarantees gross.
 */
void gsn_pose_likeliest(const struct gsn_pose *pose, const struct gsn_point *targets, size_t count,
                        struct gsn_affine *ret_panel_to_block_um, double *ret_error_um);

#ifdef __cplusplus
}
#endif
#endif
