/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A region that is stated as a band at a distance from a body: a tissue that is found in the block
 * itself, or a mask. */
#ifndef GSN_PIPELINE_BAND_H
#define GSN_PIPELINE_BAND_H

#include "pipeline/core/grid.h"
#include "pipeline/region.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the voxels of the density's lattice in the band, of the stated z and within the stated
 * cylinder. body: the mask that the job names; NULL: the tissue that the region names is looked
 * for in the density. Fails as gsn_tissue_find() and gsn_tissue_band(), and with GSN_E_INPUT when
 * nothing is left. borrows: all. */
int gsn_band_region(const struct gsn_region *region, const struct gsn_mask *body,
                    const struct gsn_grid *density, unsigned threads, struct gsn_mask **ret_region,
                    struct gsn_error *err);

/* Takes the density and the region of one lattice, gives both cut down to the region's box and
 * margin voxels around it as far as the lattice goes. On failure
 * (GSN_E_NOMEM) both stay as they were. */
int gsn_band_crop(struct gsn_grid **density, struct gsn_mask **region, size_t margin,
                  struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
