/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A region of interest as it is stated: a mask file, a shape, or a band about a body. Lengths are
 * micrometres in the block frame. */
#ifndef GSN_PIPELINE_REGION_H
#define GSN_PIPELINE_REGION_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/grid.h"
#include "pipeline/stain/tissue_segmentation.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_region_kind {
    GSN_REGION_NONE, /* not stated: everything that has data (volumes), or withheld (sections) */
    GSN_REGION_MASK, /* a file */
    GSN_REGION_BOX,
    GSN_REGION_CYLINDER, /* axis along z */
    GSN_REGION_SPHERE,
    GSN_REGION_BAND, /* at a distance from a body: a tissue, or a mask file */
};

struct gsn_region {
    enum gsn_region_kind kind;
    enum gsn_tissue_kind from; /* the body of a band that names no file */
    char *file; /* a mask, relative to the job's folder: the region, or the band's body; or NULL */
    struct gsn_vec3 low, high; /* box; the cylinder's and the band's z range is low.z..high.z */
    struct gsn_vec3 centre;    /* cylinder, sphere; the cylinder that limits a band */
    double radius_um;          /* of the same; 0: the band is not limited */
    double low_um, high_um;    /* band: distances from the body's surface, outward */
};

/* Whether it is said in coordinates of the block's x and y: a mask, a shape, a band from a file or
 * within a cylinder. */
int gsn_region_has_coordinates(const struct gsn_region *region);

/* gives: the shape as a mask on this lattice, by voxel centres.
 * Fails with GSN_E_INPUT when no voxel centre lies inside. The kind is box, cylinder or sphere. */
int gsn_region_raster(const struct gsn_region *region, const struct gsn_lattice *at,
                      struct gsn_mask **ret_mask, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
