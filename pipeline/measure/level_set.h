/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much of the region is denser than a threshold, with bounds that are guaranteed.
 *
 * Equation (10): on an axis-aligned box inside the domain the spline differs from a linear function
 * l by something in [rmin, rmax], so that
 *
 *     vol{ l + rmin > t }  <=  vol{ s > t }  <=  vol{ l + rmax > t },
 *
 * both sides a half-space cut out of a box. Where s is one polynomial the interval comes from its
 * tensor Bernstein coefficients and shrinks with the square of the box; across the skins between
 * tetrahedra it comes from the coefficients of the gradient and shrinks in proportion
 * (enclosure.h). The boxes are the region's voxels, halved where the two sides differ most until
 * the sum of the differences is small enough. Volumes in um^3. */
#ifndef GSN_MEASURE_LEVEL_SET_H
#define GSN_MEASURE_LEVEL_SET_H

#include "pipeline/core/grid.h"
#include "pipeline/core/progress.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* lower_um3 <= vol{u in the region: s(u) > threshold} <= upper_um3. cells: how many boxes were
 * looked at for this threshold, voxels included. */
struct gsn_volume_bound {
    double threshold, lower_um3, upper_um3;
    size_t cells;
};

struct gsn_level_set_options {
    double gap;        /* wanted (upper - lower) / max(upper, 1 % of the region); 0: 1e-3 */
    size_t most_cells; /* boxes looked at per threshold, besides the voxels; 0: 1 million */
    unsigned threads;  /* 0: all; the same bytes on any number */
    const struct gsn_progress *progress; /* may be NULL */
};

/* Bounds for count thresholds, any order. When most_cells is spent first, the bounds are as true
 * but wider than wanted. options may be NULL. ret_bounds: count of them.
 * Fails with GSN_E_INPUT when the region is empty, a threshold is not finite or a voxel of the
 * region sticks out of the mesh (named), GSN_E_NOMEM. */
int gsn_level_set_volume(const struct gsn_spline *spline, const struct gsn_mask *region,
                         const double *thresholds, size_t count,
                         const struct gsn_level_set_options *options,
                         struct gsn_volume_bound *ret_bounds, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
