/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much of a tetrahedral cell is denser than a threshold, with bounds that are guaranteed.
 *
 * Equation (10) where it is stated, on a tetrahedron. The cell is first cut along the faces of the
 * mesh. On a part inside one tetrahedron s is a polynomial p plus something known
 * (boundary_layer.h). With b the Bernstein coefficients of p over the part, l the linear function
 * through the four of its corners, and r = b - l,
 *
 *     vol{ l + min r > t }  <=  vol{ p > t }  <=  vol{ l + max r > t },
 *
 * both sides a half-space cut out of a tetrahedron: closed form. Parts are halved across an edge,
 * the one with the largest difference first. Where s is a polynomial the difference falls like the
 * reciprocal of the number of parts; half-spaces are exact. Volumes in um^3. */
#ifndef GSN_MEASURE_LEVEL_SET_CELL_H
#define GSN_MEASURE_LEVEL_SET_CELL_H

#include "pipeline/measure/level_set.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_level_set_cell_options {
    double gap;        /* wanted (upper - lower) / max(upper, 1 % of the cell); 0: 1e-3 */
    size_t most_cells; /* parts at the end, about 400 bytes each; 0: 100 000 */
};

/* lower <= vol{u in cell: s(u) > threshold} <= upper, for a cell of either orientation. When
 * most_cells is spent first, the bounds are as true but wider than wanted. options may be NULL.
 * Fails with GSN_E_INPUT when a coordinate or the threshold is not finite, when the cell is flat or
 * when it sticks out of the mesh, where there is no data; GSN_E_NOMEM. */
int gsn_level_set_cell(const struct gsn_spline *spline, const double cell[4][3], double threshold,
                       const struct gsn_level_set_cell_options *options,
                       struct gsn_volume_bound *ret_bound, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
