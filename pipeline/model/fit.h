/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Least squares: the control points that make the spline follow the samples.
 *
 * Minimises  sum (s(u_i) - f_i)^2 + smoothing * d * h^2 * integral |grad s|^2,  d the samples per
 * um^3 where there are samples, h the edge of a regular tetrahedron of the mean volume. The penalty
 * fills tetrahedra without samples harmonically from those around them (a part of the mesh without
 * any gets the mean of all samples) and leaves the mean residual at 0.
 *
 * The normal equations are assembled tetrahedron by tetrahedron and solved by conjugate gradients
 * with Jacobi preconditioning; sums run in a fixed order, so the answer does not depend on the
 * number of threads. */
#ifndef GSN_MODEL_FIT_H
#define GSN_MODEL_FIT_H

#include "pipeline/core/progress.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_samples {
    size_t count;
    const double (*at)[3]; /* um; those outside the mesh are refused */
    const float *value;    /* finite */
};

struct gsn_fit_options {
    double smoothing;    /* relative weight of the gradient penalty; 0: 1e-6 */
    double tolerance;    /* relative residual of the solver; 0: 1e-10 */
    unsigned iterations; /* at most; 0: 2000 */
    unsigned threads;    /* 0: all */
    const struct gsn_progress *progress;
};

struct gsn_fit_report {
    size_t unknowns, samples, empty_tets; /* empty: no sample inside, "no data" */
    unsigned iterations;
    double rms, worst; /* of the residuals s(u_i) - f_i */
};

/* gives: the spline, and per tetrahedron the number of samples in it and their rms residual (each
 * may be NULL; otherwise gives arrays of tet_count). keeps: space. Fails with GSN_E_INPUT naming
 * the first sample that is not finite or lies outside the mesh, GSN_E_FIT when the solver does not
 * reach its tolerance, GSN_E_NOMEM. */
int gsn_fit(const struct gsn_dms *space, const struct gsn_samples *samples,
            const struct gsn_fit_options *options, struct gsn_spline **ret_spline,
            struct gsn_fit_report *ret_report, uint32_t **ret_tet_samples, double **ret_tet_rms,
            struct gsn_error *err);

/* How well a spline space predicts samples it has not seen: what decides between a coarse and a
 * fine space. The residual of a fit cannot, it falls with every unknown that follows the noise. */

/* Root mean square error at the samples of one fold of a fit to those of the other, both ways.
 *
 * fold: 0 or 1 for every sample, each at least once. What repeats in both folds is signal: with
 * alternate sections as folds the micro texture of a stain, which no two sections share, counts as
 * noise although it is smooth within a section. borrows: everything. Fails as gsn_fit() does. */
int gsn_cross_validate(const struct gsn_dms *space, const struct gsn_samples *samples,
                       const uint8_t *fold, const struct gsn_fit_options *options, double *ret_rms,
                       struct gsn_error *err);

/* The same from one fit alone, for independent noise: generalised cross-validation (Craven and
 * Wahba 1979, 10.1007/BF01404567), rms / (1 - unknowns / samples). Unknowns of tetrahedra without
 * samples follow nothing and are not counted. tets: of the mesh. INFINITY when the samples do not
 * carry the unknowns. */
double gsn_generalised_cross_validation(const struct gsn_fit_report *fit, size_t tets);

#ifdef __cplusplus
}
#endif
#endif
