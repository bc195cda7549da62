/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a spline does when its knots move: the derivative by every knot, and how far a knot may go.
 *
 * With p a vertex, j its place in tetrahedron I, 0 <= l <= n,
 *
 *     D_{t_{p,l},v} s = - sum_{I, b: b_j >= l} c_b |det X_b|
 *                               sum_m mu_m(v | W) M(u | (V_b + t_{p,l}) \ k_m)
 *                       + sum_{I, b: b_j = l} mu_j(v | X_b) c_b N_b(u),     W of V_b + t_{p,l},
 *
 * which is the paper's equation (6) with its summation limits put right (docs/MATH.md, section 3).
 * Control points stay as they are. Moving all knots moves s: the sum over all knots is - grad s.
 *
 * The formula holds as long as every det X_b keeps its sign; gsn_knots_check() is the barrier that
 * a step must not cross. */
#ifndef GSN_MODEL_KNOTS_H
#define GSN_MODEL_KNOTS_H

#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Adds weight times the gradient of s(u) with respect to knot l of vertex p to
 * total[p * (degree + 1) + l], for all knots: units of s per um. With weight 2 (s(u) - f) summed
 * over samples that is the gradient of the sum of squares.
 *
 * s(u) is as smooth in the knots as in u: where the gradient of s jumps, so does this one, and the
 * result is the limit from the side of the half-open rule. hint as in gsn_dms_locate(), updated.
 * Returns GSN_OK, or GSN_DMS_OUTSIDE with total untouched. */
int gsn_knots_gradient_add(const struct gsn_spline *spline, const double u[3], size_t *hint,
                           double weight, double (*total)[3]);

/* Whether these knots, (degree + 1) per vertex as in gsn_dms_new(), are valid in all tetrahedra
 * around one vertex: every X_b with |b| <= degree positive with a margin, and sum delta < 1. The
 * vertices are the knots of number 0; those of mesh are not looked at, so a vertex may move as
 * well. Looks through the whole mesh for the tetrahedra. A space of knots whose vertices all pass
 * is one that gsn_dms_new() takes. Fails with GSN_E_MESH naming the tetrahedron, or GSN_E_INPUT on
 * a vertex, degree or coordinate out of range. */
int gsn_knots_check(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3],
                    size_t vertex, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
