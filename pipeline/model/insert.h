/* SPDX-License-Identifier: AGPL-3.0-or-later */

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
#ifndef GSN_MODEL_INSERT_H
#define GSN_MODEL_INSERT_H

#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

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
