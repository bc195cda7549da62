/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What lies where in a stacked block: the root of the tooth, and regions at a distance from it.
 *
 * Dentine takes less red than bone, and a ligament that takes still less lies between the two. That
 * is how a root is told: the largest body, paler than bone, that stands alone in something paler
 * still, with the pulp that it encloses. Panels may be stained unequally. */
#ifndef GSN_STAIN_TISSUE_SEGMENTATION_H
#define GSN_STAIN_TISSUE_SEGMENTATION_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What lies where in a stacked block: the root of the tooth, and regions at a distance from it.
 *
 * Dentine takes less red than bone, and a ligament that takes still less lies between the two. That
 * is how a root is told: the largest body, paler than bone, that stands alone in something paler
 * still, with the pulp that it encloses. Panels may be stained unequally. */

enum gsn_tissue_kind {
    GSN_TISSUE_ROOT, /* dentine and the pulp in it */
    GSN_TISSUE_BONE, /* as dense as bone is now: without marrow and what a lesion has thinned */
    GSN_TISSUE_ALL,  /* the outline of the sections */
    GSN_TISSUE_BODIES
};

/* "root", "bone", "tissue". */
const char *gsn_tissue_name(enum gsn_tissue_kind tissue);

/* Of the red of bone: what has less is loose tissue, what has more is bone. */
#define GSN_LEAST_OF_BONE 0.35
#define GSN_MOST_OF_BONE 0.82

struct gsn_tissue_levels {
    double bone, dentine; /* densities; dentine is 0 where there is no root */
    double border;        /* what is above it belongs to the tissue that was looked for */
    double volume_um3;    /* of that: of a root its pulp included */
};

/* gives: the largest body of a tissue on a lattice of about 32 um that covers the density's.
 * density: collagen-equivalent density of a whole block, glass about 0, NaN where there is no data.
 * Fails with GSN_E_STAIN when there is no such body (the sentence says what to state instead),
 * GSN_E_NOMEM. borrows: density. */
int gsn_tissue_find(const struct gsn_grid *density, enum gsn_tissue_kind tissue,
                    struct gsn_mask **ret_body, struct gsn_tissue_levels *ret_levels,
                    struct gsn_error *err);

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
