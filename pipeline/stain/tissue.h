/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What lies where in a stacked block: the root of the tooth, and regions at a distance from it.
 *
 * Dentine takes less red than bone, and a ligament that takes still less lies between the two. That
 * is how a root is told: the largest body, paler than bone, that stands alone in something paler
 * still, with the pulp that it encloses. Panels may be stained unequally. */
#ifndef GSN_STAIN_TISSUE_H
#define GSN_STAIN_TISSUE_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_tissue_levels {
    double bone, dentine, border; /* densities; what is above border is dentine, not ligament */
    double volume_um3;            /* of the root, pulp included */
};

/* gives: the root and its pulp on a lattice of about 32 um that covers the density's.
 * density: collagen-equivalent density of a whole block, glass about 0, NaN where there is no data.
 * Fails with GSN_E_STAIN when there is no such body (the sentence says what to state instead),
 * GSN_E_NOMEM. borrows: density. */
int gsn_tissue_root(const struct gsn_grid *density, struct gsn_mask **ret_root,
                    struct gsn_tissue_levels *ret_levels, struct gsn_error *err);

/* gives: on the lattice `at`, the voxels whose distance from the surface of a body, counted
 * outward, is at least low_um and less than high_um (either may be negative: inside). The surface
 * lies midway between the centres of the body's outermost voxels and those next to them. Points
 * beyond the body's own lattice are in no band. Fails with GSN_E_INPUT when the body is empty or
 * the band holds no voxel, GSN_E_NOMEM. borrows: body, at. */
int gsn_tissue_band(const struct gsn_mask *body, double low_um, double high_um,
                    const struct gsn_lattice *at, unsigned threads, struct gsn_mask **ret_band,
                    struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
