/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Least squares: the control points that make the spline follow the samples.
 *
 * Minimises, with d the samples per um^3 where there are samples and h the edge of a regular
 * tetrahedron of the mean volume,
 *
 *     sum (s(u_i) - f_i)^2 + d h^2 ( smoothing * integral |grad s|^2 + jump * P(s) ),
 *
 * P the jump of the gradient across faces (face_jump.h), and in tetrahedra without samples a tenth
 * of h^2 times the integral of the squared second derivatives, h that of the tetrahedron. The first
 * penalty leads what has no samples to those around it (a part of the mesh without any gets the
 * mean of all) and leaves the mean residual at 0; it is small. The second is what smooths: a spline
 * of degree n >= 2 that has no jumps bends as it likes, so walls are not flattened as by the first,
 * and where there are no samples the spline goes on straight.
 *
 * How much it smooths is found by cross-validation: samples of one fold are predicted by a fit to
 * those of the other, both ways. What repeats in both folds is signal: with alternate sections as
 * folds the micro texture of a stain, which no two sections share, counts as noise although it is
 * smooth within a section.
 *
 * The normal equations are assembled tetrahedron by tetrahedron and solved by conjugate gradients,
 * preconditioned by the inverses of the equations around each vertex (fit_system.h); sums run in a
 * fixed order, so the answer does not depend on the number of threads. */
#ifndef GSN_MODEL_FIT_H
#define GSN_MODEL_FIT_H

#include "pipeline/core/progress.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_samples {
    size_t count;
    const double (*at)[3]; /* um */
    const float *value;    /* finite */
    const double *exact;   /* the same in double precision: then value may be NULL; NULL: value */
    const double *weight;  /* of each square in the sum, finite, >= 0, not all 0; NULL: 1. A weight
                              of 2 is the same sample twice */
};

/* The least that fills what holds no sample and changes nothing where there are some. */
#define GSN_FIT_SMOOTHING 1e-6

struct gsn_fit_options {
    double smoothing;    /* relative weight of the gradient penalty; 0: none */
    double jump;         /* and of the jumps across faces; with folds the least that is tried (0:
                            1e-5). Shared control points only, but for 0 without folds */
    const uint8_t *fold; /* 0 or 1 for every sample, both present; NULL: none */
    double tolerance;    /* relative residual of the solver; 0: 1e-8 */
    unsigned iterations; /* at most; 0: 10000 */
    unsigned threads;    /* 0: all */
    int forgiving;       /* samples outside the mesh are left out, a solver that does not reach its
                            tolerance gives the best that it has; the report says so. 0: both are
                            failures */
    const struct gsn_progress *progress;
};

struct gsn_fit_report {
    size_t unknowns, samples, empty_tets; /* empty: no sample inside, "no data" */
    size_t outside, first_outside; /* samples left out, and the first of them when there are any */
    unsigned iterations;
    int unconverged;   /* the solver ended above its tolerance */
    double rms, worst; /* of the residuals s(u_i) - f_i, the first with the samples' weights */
    double jump;       /* the weight that was taken */
    double predicted;  /* with folds: rms error at samples of a fold that the fit has not seen */
};

/* gives: the spline, and per tetrahedron the number of samples in it and their rms residual (each
 * may be NULL; otherwise gives arrays of tet_count). keeps: space. Fails with GSN_E_INPUT naming
 * the first sample that is not finite or lies outside the mesh, GSN_E_FIT when the solver does not
 * reach its tolerance or, without smoothing, nothing determines a control point; GSN_E_NOMEM. */
int gsn_fit(const struct gsn_dms *space, const struct gsn_samples *samples,
            const struct gsn_fit_options *options, struct gsn_spline **ret_spline,
            struct gsn_fit_report *ret_report, uint32_t **ret_tet_samples, double **ret_tet_rms,
            struct gsn_error *err);

/* Several values at the same samples, value[c][i] that of sample i in channel c: one set of normal
 * equations, one preconditioner, a solution per channel. samples->value and exact are not looked
 * at. With folds the first channel chooses the weight of the jumps for all.
 * gives: channels splines; ret_reports has room for as many. Fails as gsn_fit() does. */
int gsn_fit_channels(const struct gsn_dms *space, const struct gsn_samples *samples,
                     const double *const *value, size_t channels,
                     const struct gsn_fit_options *options, struct gsn_spline **ret_splines,
                     struct gsn_fit_report *ret_reports, struct gsn_error *err);

/* How well a fit predicts samples it has not seen, for independent noise and without folds: what
 * decides between a coarse and a fine space. The residual cannot, it falls with every unknown that
 * follows the noise. Generalised cross-validation (Craven and Wahba 1979, 10.1007/BF01404567), rms
 * / (1 - unknowns / samples). Unknowns of tetrahedra without samples follow nothing and are not
 * counted. tets: of the mesh. INFINITY when the samples do not carry the unknowns. */
double gsn_generalised_cross_validation(const struct gsn_fit_report *fit, size_t tets);

#ifdef __cplusplus
}
#endif
#endif
