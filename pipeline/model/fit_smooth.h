/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The gradient penalty of a fit, tetrahedron by tetrahedron.
 *
 * The spline on a tetrahedron is taken as the polynomial it is when all clouds are collapsed:
 * Bernstein form, so that the integral has a closed form. That is off by the relative size of the
 * clouds, in a term that is small by design, and keeps what matters: constants cost nothing. */
#ifndef GSN_MODEL_FIT_SMOOTH_H
#define GSN_MODEL_FIT_SMOOTH_H

#include "pipeline/model/dms.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What does not depend on the tetrahedron: mass[f][k][g][l] is the mean over any tetrahedron of the
 * product of the Bernstein polynomials beta_f - e_k and beta_g - e_l of degree n - 1. */
struct gsn_fit_smooth {
    unsigned degree;
    size_t functions;
    double mass[GSN_DMS_MAX_FUNCTIONS][4][GSN_DMS_MAX_FUNCTIONS][4];
};

void gsn_fit_smooth_init(struct gsn_fit_smooth *smooth, const struct gsn_dms *space);

/* Adds weight * integral grad N_f . grad N_g over tetrahedron tet to block, whose entries f <= g
 * are stored row by row. weight in 1/um. */
void gsn_fit_smooth_add(const struct gsn_fit_smooth *smooth, const struct gsn_tets *mesh,
                        size_t tet, double weight, double *block);

#ifdef __cplusplus
}
#endif
#endif
