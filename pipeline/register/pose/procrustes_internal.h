/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A stack while its poses are being solved; shared by the files of the pose, and by them alone.
 *
 * gsn_procrustes_fit() finds the mean triangle, the numbering of every section and the scale of the
 * marks' errors; gsn_shape_prior_learn() then what the sections' shapes have in common: how they
 * stretch, and how the triangle changes along z. */
#ifndef GSN_REGISTER_POSE_PROCRUSTES_INTERNAL_H
#define GSN_REGISTER_POSE_PROCRUSTES_INTERNAL_H

#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/weighted_fit.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One section. */
struct gsn_procrustes_member {
    const struct gsn_pose_input *input;
    size_t marks;
    struct gsn_point onto[GSN_FIDUCIALS]; /* the stack's triangle at this section's z */
    double variance[GSN_FIDUCIALS];       /* of each mark per axis, um^2; input's numbering */
    int mirrored;
    unsigned char order[GSN_FIDUCIALS];
    struct gsn_rigid motion; /* onto its triangle */
    double squares;          /* weighted squared residuals; infinite where there is no motion */
    int inlier;
};

struct gsn_procrustes {
    struct gsn_procrustes_member *member;
    size_t count, with_three;
    double *scratch; /* room for 3 * count */
    struct gsn_point triangle[GSN_FIDUCIALS];
    double mark_um2; /* variance per axis of the median mark; with strain in it until learnt */
    double fit_um2;  /* the same by the fits' own account */
    double alike;  /* share of mark_um2 that is every mark's; below 0: what is more than fit_um2 */
    double finest; /* variance below which no test calls anything gross, um^2 */
    double scalene_sigma;
    int flips_told;
    const struct gsn_point *declared; /* the protocol's triangle, or NULL */
    int sizes;                        /* sections may differ in size alone */
    int stretches;                    /* strain was found beyond what the marks' errors make */
    int as_declared;                  /* see there */
    double strain[3][3];              /* its covariance; 0 otherwise */
    double freedom;                   /* with which mark_um2 is known */
    double side_limit;                /* of chi2 with 1 degree of freedom, at 0.1 % false alarms */
    double spread_freedom, widening;  /* of chi2 with 3: see gsn_outlier_false_alarm() */
    struct gsn_axes axes;
};

/* False alarms of the tests that sections are put to. */
#define GSN_POSE_ALPHA 1e-3
/* Sides must differ by this many standard deviations of a mark. */
#define GSN_POSE_SCALENE 10.0
/* The value beyond which 0.1 % of chi-squared with 3 degrees of freedom lie. */
#define GSN_POSE_CHI2_GROSS 16.26624

/* ---- procrustes.c ---------------------------------------------------------------------------- */
double gsn_triangle_side(const struct gsn_point triangle[GSN_FIDUCIALS], int i);
struct gsn_point gsn_triangle_centroid(const struct gsn_point p[GSN_FIDUCIALS]);
double gsn_triangle_rho(const struct gsn_point p[GSN_FIDUCIALS]);
/* The marks found in um, in the pose's numbering, mirrored where the section is; their number. */
size_t gsn_procrustes_observation(const struct gsn_procrustes *s,
                                  const struct gsn_procrustes_member *m,
                                  struct gsn_pose_fit_input *ret_marks);
/* Aligns every section with the triangle: numbers, mirrors and moves it. acceptable: see there; 0
 * for not yet. */
void gsn_procrustes_align(struct gsn_procrustes *s, double acceptable);
/* Takes the triangle of the section that is most like the others': the medoid. */
void gsn_procrustes_initialise(struct gsn_procrustes *s);

/* Adds the sections: counts their marks, and takes over what their fits say of them. */
void gsn_procrustes_add_observations(struct gsn_procrustes *s, const struct gsn_pose_input *inputs);
void gsn_procrustes_fit(struct gsn_procrustes *s);
/* Once the strain is learnt: tries how much of a mark's variance is every mark's alike; never none,
 * as no mark is exact because its fit says so, and never all, as a torn mark's fit says so. It is
 * left open with fewer than 12 sections, and unless the residuals are likelier for it than one more
 * unknown makes them by chance (Akaike's 2). */
void gsn_procrustes_learn_alike(struct gsn_procrustes *s);
double gsn_procrustes_acceptable(const struct gsn_procrustes *s);
/* What is added to the fits' own variance, and what that is multiplied by. */
double gsn_procrustes_excess(const struct gsn_procrustes *s, double *ret_scale);

/* ---- shape_prior.c --------------------------------------------------------------------------- */
int gsn_shape_prior_learn(struct gsn_procrustes *s, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
