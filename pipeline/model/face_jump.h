/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much the gradient of a spline jumps from tetrahedron to tetrahedron, as a penalty of a fit:
 *
 *     P(s) = sum over inner faces of (hA + hB) / 2 * integral over the face of [dn s]^2,
 *
 * [dn s] the jump of the derivative along the face's normal, hA and hB the altitudes of the two
 * tetrahedra over the face (M.-J. Lai, L. L. Schumaker, "Spline Functions on Triangulations", 2007,
 * chapter 17; as a stabilisation: E. Burman, P. Hansbo, 2004, 10.1016/j.cma.2003.12.032).
 *
 * The spline on a tetrahedron is taken as the polynomial it is when all clouds are collapsed. On a
 * face [dn s] is then a polynomial of degree n - 1 with Bernstein coefficients that are linear in
 * the control points of both sides, and the integral is exact. So P = |G c|^2 with sparse rows. */
#ifndef GSN_MODEL_FACE_JUMP_H
#define GSN_MODEL_FACE_JUMP_H

#include "pipeline/model/dms.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Row r of G has the terms first[r] .. first[r + 1]. Units: values of s times the root of um. */
struct gsn_face_jumps {
    size_t rows;
    size_t *first;
    uint32_t *control;
    double *value;
};

/* gives: the rows of all inner faces of a space with shared control points.
 * Fails with GSN_E_NOMEM. */
int gsn_face_jumps_new(const struct gsn_dms *space, struct gsn_face_jumps **ret_jumps,
                       struct gsn_error *err);
void gsn_face_jumps_free(struct gsn_face_jumps *jumps);
GSN_DEFINE_AUTO(gsn_face_jumps);

/* P(s) of these control values. */
double gsn_face_jumps_energy(const struct gsn_face_jumps *jumps, const double *control);
#ifdef __cplusplus
}
#endif
#endif
