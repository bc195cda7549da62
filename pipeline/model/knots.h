/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a spline does when its knots move, or one more vertex has some.
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
 * The formula holds as long as every det X_b keeps its sign; knots beyond are refused by
 * gsn_dms_new(). */
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

/* Exact insertion of a vertex: one tetrahedron becomes four, and the spline stays what it is.
 *
 * With p a new vertex with knots p_0..p_n and F_I the polar form of the polynomial of tetrahedron
 * I, the four tetrahedra I_k = I with corner k replaced by p get
 *
 *     c^{I_k}_{g with r in place of g_k} = F_I(t_{..} of g, p_0, .., p_{r-1}),  |g| = n - r, g_k =
 * 0.
 *
 * That is repeated knot insertion, M(V) = sum_j lambda_j(p_r | X_g) M(V + p_r \ t_{j,g_j}), and
 * changes nothing anywhere, in skins and outside either, for any knots p_r that turn no new X_b
 * over (docs/MATH.md, section 8). It is a local tool: it never shortens an edge, so repeating it
 * does not make a fit converge. Splitting edges or faces is not exact. */

/* gives: a space with one vertex more, the last one, with these degree + 1 knots, and the control
 * values of the same spline on it. Both have one control point per (tetrahedron, beta), whichever
 * the old space has: shared ones cannot hold the result.
 *
 * Tetrahedron tet becomes the one without its old corner 0; those without corner 1, 2 and 3 are
 * appended. The new vertex has the place of the corner it replaces. All else keeps its number.
 *
 * Fails with GSN_E_INPUT on a tetrahedron or knot out of range; with GSN_E_MESH when the vertex is
 * not inside tet, or when the knots would turn an X_b of a new tetrahedron over or leave it no
 * core, naming it; with GSN_E_NOMEM. */
int gsn_insert_vertex(const struct gsn_spline *spline, size_t tet, const double (*knots)[3],
                      struct gsn_dms **ret_space, double **ret_control, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
