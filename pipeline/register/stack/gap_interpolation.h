/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Bridges short gaps of a stack along z, and says how well that can be done on this very stack.
 *
 * A section that is lost or masked leaves a gap at its own z, never closed up. A figure over a
 * region needs a value there: left out, the gap would count as if it were like the average of what
 * was seen, which is wrong where density changes along z. It is taken from the two voxels that
 * bound the gap in its column, in a straight line. What that costs is measured by pretending: every
 * plane that is there is left out in turn and compared with its bridge. Lengths are voxels. */
#ifndef GSN_REGISTER_STACK_GAP_INTERPOLATION_H
#define GSN_REGISTER_STACK_GAP_INTERPOLATION_H

#include "pipeline/core/error.h"
#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_GAP_LONGEST = 3 }; /* planes; a longer gap stays one */

struct gsn_gap_interpolation {
    size_t region, measured, bridged; /* voxels of the region: all, with data, filled here */
    size_t planes;                    /* of the lattice in which some voxel of it was filled */
    double error; /* standard error of the region's mean from bridging; 0 without a bridge, NaN
                     where no plane could be left out to measure it */
};

/* Fills the gaps of grid (NaN) of up to GSN_GAP_LONGEST planes that both ends bound.
 *
 * Figures are counted at the voxels of grid whose centres lie in region; gaps outside it are filled
 * too. The error takes the gaps of one plane and length as wrong together and others as
 * independent. Fails with GSN_E_NOMEM; then grid is untouched. */
int gsn_gap_interpolate(struct gsn_grid *grid, const struct gsn_mask *region,
                        struct gsn_gap_interpolation *ret_bridge, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
