/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Regular grids in the block frame: the stacked density and the region of interest.
 *
 * x runs fastest. origin_um is the centre of voxel (0,0,0), step_um the distance of neighbouring
 * centres, both in micrometres. A density of NaN means "no data"; a mask voxel is 0 or 1. */
#ifndef GSN_CORE_GRID_H
#define GSN_CORE_GRID_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_lattice {
    size_t nx, ny, nz;
    struct gsn_vec3 origin_um, step_um;
};

struct gsn_grid {
    struct gsn_lattice at;
    float *value;
};

struct gsn_mask {
    struct gsn_lattice at;
    uint8_t *inside;
};

size_t gsn_lattice_count(const struct gsn_lattice *at);
size_t gsn_lattice_index(const struct gsn_lattice *at, size_t x, size_t y, size_t z);
struct gsn_vec3 gsn_lattice_centre(const struct gsn_lattice *at, size_t x, size_t y, size_t z);
double gsn_lattice_voxel_um3(const struct gsn_lattice *at);

/* give: zeroed. Fail with GSN_E_NOMEM, also when nx * ny * nz overflows. */
int gsn_grid_new(const struct gsn_lattice *at, struct gsn_grid **ret_grid, struct gsn_error *err);
void gsn_grid_free(struct gsn_grid *grid);
GSN_DEFINE_AUTO(gsn_grid);

int gsn_mask_new(const struct gsn_lattice *at, struct gsn_mask **ret_mask, struct gsn_error *err);
void gsn_mask_free(struct gsn_mask *mask);
GSN_DEFINE_AUTO(gsn_mask);
size_t gsn_mask_count(const struct gsn_mask *mask);
/* The box around its voxels, outer faces, um; low > high when there are none. */
void gsn_mask_box(const struct gsn_mask *mask, double ret_low[3], double ret_high[3]);
/* Whether the voxel whose cell holds this point is inside; false beyond the lattice. */
int gsn_mask_has(const struct gsn_mask *mask, struct gsn_vec3 point_um);

#ifdef __cplusplus
}
#endif
#endif
