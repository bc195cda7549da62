/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How well a spline space predicts samples it has not seen: what decides between a coarse and a
 * fine space. The residual of a fit cannot, it falls with every unknown that follows the noise. */
#ifndef GSN_MODEL_CROSSVAL_H
#define GSN_MODEL_CROSSVAL_H

#include "pipeline/model/fit.h"

#ifdef __cplusplus
extern "C" {
#endif

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
