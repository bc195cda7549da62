/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Seams at single points: which faces have something to add at u, and what it all sums to. */
#ifndef GSN_MODEL_SEAM_AT_H
#define GSN_MODEL_SEAM_AT_H

#include "pipeline/model/seam.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Calls visit for every face whose seam may not vanish at u, by the tetrahedron with the smaller
 * number and its corner opposite the face, ascending, and for others; u lies in tetrahedron home.
 *
 * In the core of home there are none. Where only the corner opposite a face is not clear of its
 * cloud, on both sides of the face, there is but that face: the other faces of the two lie beyond
 * their knots, so the functions of the two sum to one, and as none is negative no others live. */
void gsn_seam_each(const struct gsn_dms *space, size_t home, const double u[3],
                   void (*visit)(void *context, size_t tet, unsigned corner), void *context);

/* Adds what the faces have at u to the value of the polynomial of home and, unless it is NULL, to
 * its gradient. */
void gsn_spline_add_seams(const struct gsn_spline *spline, size_t home, const double u[3],
                          double *value, double *gradient);

/* All control points that s(u) depends on, ascending, and what a unit of each adds to it: with
 * adj_g the derivative of s(u) with respect to c_g (seam.h) of one tetrahedron, adj_0 = 1 at home,
 * the weights of its faces on both their sides, and
 *
 *     adj_{g+e_j} += lambda_j(u | X_g) adj_g,      |g| = 0..n-1,      N_beta = adj_beta.
 *
 * Returns GSN_OK, or GSN_E_LIMIT when there are more than room. */
int gsn_seam_row(const struct gsn_dms *space, size_t home, const double u[3], size_t room,
                 uint32_t *ret_control, double *ret_value, size_t *ret_count);

#ifdef __cplusplus
}
#endif
#endif
