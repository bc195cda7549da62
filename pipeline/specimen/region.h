/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The region of interest: a mask file, outlines drawn on sections, a shape, or a band about a body;
 * and the lattice of the stack around it. Lengths are micrometres in the block frame. */
#ifndef GSN_SPECIMEN_REGION_H
#define GSN_SPECIMEN_REGION_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/grid.h"
#include "pipeline/stain/tissue_segmentation.h"

enum gsn_region_kind {
    GSN_REGION_NONE,  /* not stated: everything that has data (volumes), or withheld (sections) */
    GSN_REGION_DRAWN, /* a file of outlines (drawn_region.h), read as a mask */
    GSN_REGION_MASK,  /* a file */
    GSN_REGION_BOX,
    GSN_REGION_CYLINDER, /* axis along z */
    GSN_REGION_SPHERE,
    GSN_REGION_BAND, /* at a distance from a body: a tissue, or a mask file */
};

struct gsn_region {
    enum gsn_region_kind kind;
    enum gsn_tissue_kind from; /* the body of a band that names no file */
    char *file; /* a mask, relative to the job's folder: the region, or the band's body; or the
                   outlines of a drawn region; or NULL. Owned, as is the next */
    char *class_name;          /* drawn: the classification of its outlines; NULL: not stated */
    struct gsn_lattice stack;  /* drawn: the exported stack that they were drawn on */
    struct gsn_vec3 low, high; /* box; the cylinder's and the band's z range is low.z..high.z */
    struct gsn_vec3 centre;    /* cylinder, sphere; the cylinder that limits a band */
    double radius_um;          /* of the same; 0: the band is not limited */
    double low_um, high_um;    /* band: distances from the body's surface, outward */
};

void gsn_region_done(struct gsn_region *region);

/* Whether it is said in coordinates of the block's x and y: a mask, outlines, a shape, a band from
 * a file or within a cylinder. */
int gsn_region_has_coordinates(const struct gsn_region *region);

/* The rule that lays it, in words without coordinates, which are each animal's own: a mask by its
 * file's name, outlines by their classification, else by their file's name. Cut to the room. */
void gsn_region_describe(const struct gsn_region *region, char *text, size_t room);

/* gives: the shape as a mask on this lattice, by voxel centres.
 * Fails with GSN_E_INPUT when no voxel centre lies inside. The kind is box, cylinder or sphere. */
int gsn_region_raster(const struct gsn_region *region, const struct gsn_lattice *at,
                      struct gsn_mask **ret_mask, struct gsn_error *err);

/* gives: points of the region, thinned evenly: where the predicted error matters. None without a
 * region. */
int gsn_region_targets(const struct gsn_mask *region, struct gsn_point **ret_points,
                       size_t *ret_count, struct gsn_error *err);

/* ---- a band at a distance from a body: a tissue that is found in the block itself, or a mask ----
 */

/* gives: the voxels of the density's lattice in the band, of the stated z and within the stated
 * cylinder. body: the mask that the job names; NULL: the tissue that the region names is looked
 * for in the density. Fails as gsn_tissue_find() and gsn_tissue_band(), and with GSN_E_INPUT when
 * nothing is left. borrows: all. */
int gsn_band_region(const struct gsn_region *region, const struct gsn_mask *body,
                    const struct gsn_grid *density, unsigned threads, struct gsn_mask **ret_region,
                    struct gsn_error *err);
/* Takes the density and the region of one lattice, gives both cut down to the region's box and some
 * voxels around it as far as the lattice goes. On failure (GSN_E_NOMEM) both stay as they were. */
int gsn_band_crop(struct gsn_grid **density, struct gsn_mask **region, struct gsn_error *err);

/* ---- the lattice of the stack around it ---- */

struct gsn_specimen;

/* um in the block. */
struct gsn_block_box {
    struct gsn_vec3 low, high;
};

/* The side of the stack's voxels, um: as the job states it, but never finer than the finest panel's
 * pixel; 0 where no panel has sections. */
double gsn_region_voxel_um(const struct gsn_specimen *specimen);

struct gsn_block_box gsn_region_box(const struct gsn_region *region);

/* Voxels of the scan's own pixel size, on the mask's raster where that has the same step; mask may
 * be NULL. z planes are the sections' own: all that the box needs, also those that the block has
 * not, so that they count as not seen; and one more on either side where the block has one. 0 when
 * that makes no lattice that could be worked with. */
int gsn_region_lattice(struct gsn_block_box box, const struct gsn_mask *mask, double px_um,
                       double interval_um, unsigned sections, struct gsn_lattice *lattice);

/* gives: every voxel NaN. */
int gsn_grid_new_unseen(const struct gsn_lattice *lattice, struct gsn_grid **ret_grid,
                        struct gsn_error *err);

/* gives: the stated mask or shape, and the lattice around it. Fails with GSN_E_INPUT when it misses
 * the block of so many sections. */
int gsn_region_place(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                     struct gsn_mask **ret_region, struct gsn_lattice *lattice,
                     struct gsn_error *err);
/* The lattice of all posed sections, whose boxes lie in extent. */
int gsn_region_place_block(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                           const struct gsn_block_box *extent, struct gsn_lattice *lattice,
                           struct gsn_error *err);

#endif
