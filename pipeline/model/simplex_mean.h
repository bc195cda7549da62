/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Means of simplex splines over a tetrahedral cell, by the mean recurrence: for a simplex S of
 * dimension k with corners v and faces S_v opposite them, and any point y = sum_v mu_v v of it,
 *
 *     (n + k) E[M(V); S] = n sum_j lambda_j(y | W) E[M(V \ k_j); S] + k sum_v mu_v E[M(V); S_v],
 *     E[M; S] = (part of S inside the tetrahedron) / |det|                           (degree 0),
 *
 * where S runs through the cell and its faces, edges and corners. (docs/MATH.md, section 5, has it
 * for y a corner; the right side is affine in y. The free choice keeps the lambda_j small, and
 * with them the rounding errors.)
 *
 * Cells that are tetrahedra of the mesh touch knot planes everywhere. A face, edge or corner that
 * lies in a knot plane counts as pushed off it into the cell, and all such decisions are exact. */
#ifndef GSN_MODEL_SIMPLEX_MEAN_H
#define GSN_MODEL_SIMPLEX_MEAN_H

#include "pipeline/model/simplex_spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A cell and where the knots lie with respect to it. */
struct gsn_simplex_cell {
    double corner[4][3];
    double volume; /* > 0 */
    /* Knots in the closed half-space away from the cell, for the planes of the cell's own faces and
     * of those faces of the knots' tetrahedron that have the cell on one side. A set all in one of
     * them has no part in the cell. */
    unsigned beyond[8];
    unsigned within;   /* knots in the closed cell */
    unsigned clear[4]; /* per corner, as in gsn_simplex_at_init() */
};

/* Finds everything but clear, which is left 0, for a cell with these corners (in any orientation;
 * the caller guarantees that they are no plane's) and the 4 (degree + 1) knots of a tetrahedron. */
void gsn_simplex_cell_init(struct gsn_simplex_cell *cell, const double (*corner)[3],
                           const double (*knot)[3], unsigned degree);

/* Whether some plane, of those looked at, has the cell and a set of knots on different sides. */
int gsn_simplex_cell_misses(const struct gsn_simplex_cell *cell, unsigned mask);

/* Means of M(. | V_beta) over the cell, of all functions. No four knots of any V_beta may lie in
 * one plane. pick is that of gsn_simplex_pick(). */
void gsn_simplex_mean(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                      const uint16_t *pick, const struct gsn_simplex_cell *cell, double *ret_mean);

/* The same for one function and any knots: the cell is cut at all planes of three knots, and each
 * piece, where M is a polynomial, is integrated exactly. Slow. */
double gsn_simplex_mean_by_pieces(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                                  const uint16_t *pick, const struct gsn_simplex_cell *cell,
                                  size_t function);

#ifdef __cplusplus
}
#endif
#endif
