/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The registered sections as one regular volume.
 *
 * z comes from the serial number: section k is the plane (k + 1/2) * interval. A section that is
 * missing leaves its planes NaN: gaps stay gaps. */
#ifndef GSN_REGISTER_STACK_RESAMPLE_H
#define GSN_REGISTER_STACK_RESAMPLE_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/grid.h"
#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_stack_section {
    unsigned serial;                     /* 0-based */
    const struct gsn_plane *density;     /* NaN: masked */
    int plane_x, plane_y;                /* the panel pixel that its first one is */
    struct gsn_affine panel_to_block_um; /* pixel centres at +0.5 */
    int x, y, width, height;             /* panel pixels: none outside this box is read */
};

/* Whether plane z of the lattice is one of the section's. */
int gsn_stack_shows(const struct gsn_lattice *at, double interval_um, size_t z, unsigned serial);
/* A voxel's width in pixels, for voxels coarser than pixels; 1 where they are not (or by less than
 * a hundredth, which is the section's own stretch). */
double gsn_stack_reach(const struct gsn_affine *panel_to_block_um, const struct gsn_lattice *at);

/* Shrinks the section's box to what resampling onto the lattice reads of it. Returns 0, and leaves
 * the section alone, when that is nothing: the lattice has no plane of this section, or lies beside
 * it. */
int gsn_stack_footprint(const struct gsn_lattice *at, double interval_um,
                        struct gsn_stack_section *section);

/* Resamples the sections into their planes of the grid; other planes are left as they are. borrows:
 * sections and their planes.
 *
 * The plane k of the lattice holds section round(z_k / interval_um - 1/2). Within a section, cubic
 * convolution (Keys 1981, a = -1/2: exact for quadratics); where one of its 16 pixels is masked or
 * outside the box, bilinear over the valid ones of the nearest four; NaN where the nearest pixel
 * itself is masked or outside. Where voxels are coarser than pixels, the kernel is as many times
 * wider, so that nothing finer than a voxel shows as something coarser; over its valid pixels, NaN
 * where they are less than half of its weight. The result does not depend on threads (0: all).
 * Fails, with the grid untouched, with GSN_E_INPUT naming both when two sections carry one serial
 * number, when a box reaches outside its plane or an affine map is singular; GSN_E_NOMEM. */
int gsn_stack_resample(const struct gsn_stack_section *sections, size_t count, double interval_um,
                       unsigned threads, struct gsn_grid *grid, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
