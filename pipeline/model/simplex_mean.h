/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Means of simplex splines over a tetrahedral cell, by the mean recurrence: for a simplex S of
 * dimension k with corners v_0.., and S_0 its face opposite v_0,
 *
 *     (n + k) E_k[M(V); S] = n sum_j lambda_j(v_0 | W) E_k[M(V \ k_j); S] + k E_{k-1}[M(V); S_0],
 *     E_k[M; S] = (part of S inside the tetrahedron) / |det|                 (degree 0),
 *
 * over the chain of faces v_0 v_1 v_2 v_3 > v_1 v_2 v_3 > v_2 v_3 > v_3. A face of the cell that
 * lies in a knot plane is pushed off it towards the corners left out, and all such decisions are
 * exact: cells that are tetrahedra of the mesh touch knot planes everywhere (docs/MATH.md,
 * section 5). */
#ifndef GSN_MODEL_SIMPLEX_MEAN_H
#define GSN_MODEL_SIMPLEX_MEAN_H

#include "pipeline/model/simplex_sets.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A cell and where the knots lie with respect to it. */
struct gsn_simplex_cell {
    double corner[4][3];
    double volume;      /* > 0 */
    unsigned beyond[4]; /* knots in the closed half-space beyond the face opposite corner k */
    unsigned within;    /* knots in the closed cell */
    unsigned clear;     /* clouds such that sets without a knot of them vanish all over the cell */
};

/* Finds beyond, within and volume for a cell with these corners (in any orientation; the caller
 * guarantees that they are no plane's), the corner nearest the knots first, which is the accurate
 * way round; clear is left 0. knots is the number of knots. */
void gsn_simplex_cell_init(struct gsn_simplex_cell *cell, const double (*corner)[3],
                           const double (*knot)[3], unsigned knots);

/* Whether a set of knots has no part in the cell, seen through one of its faces. */
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
