/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cubes of a coarse lattice that cover a region, and the surface around them.
 *
 * Cells are cubes of edge_um whose planes pass through the corner of the mask's first voxel (its
 * origin less half a step), so cells that are multiples of the voxels have no voxel centre on a
 * plane. A layer of empty cells always surrounds the filled ones. Micrometres throughout. */
#ifndef GSN_MODEL_DOMAIN_CELLS_H
#define GSN_MODEL_DOMAIN_CELLS_H

#include "pipeline/core/grid.h"
#include "pipeline/model/surface.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_cells {
    size_t n[3]; /* x runs fastest */
    double edge_um;
    double corner_um[3]; /* of the mask's first voxel */
    long base[3];        /* cell 0 begins at corner_um + base * edge_um */
    uint8_t *filled;     /* 0 or 1 */
};

/* gives: the cells that the region, grown by one voxel in every direction, touches.
 * Fails with GSN_E_INPUT on an empty mask or a lattice that is not positive and finite, with
 * GSN_E_LIMIT when the edge makes more than 2^24 cells, with GSN_E_NOMEM. */
int gsn_cells_cover(const struct gsn_mask *region, double edge_um, struct gsn_cells **ret_cells,
                    struct gsn_error *err);
void gsn_cells_free(struct gsn_cells *cells);
GSN_DEFINE_AUTO(gsn_cells);

/* Fills what a tetrahedral domain cannot have: cavities that are enclosed on all sides, and one
 * cell at every lattice vertex or edge where the surface would touch itself, until none is left.
 * The same cells give the same result. Never empties a cell. Fails with GSN_E_NOMEM. */
int gsn_cells_close(struct gsn_cells *cells, struct gsn_error *err);

/* Coordinate of lattice plane i (0..n[axis]) of an axis. */
double gsn_cells_plane(const struct gsn_cells *cells, size_t axis, size_t i);
size_t gsn_cells_index(const struct gsn_cells *cells, const size_t at[3]);
double gsn_cells_volume(const struct gsn_cells *cells);

/* gives: the squares between filled and empty cells, vertices shared. Fails with GSN_E_NOMEM. */
int gsn_cells_surface(const struct gsn_cells *cells, struct gsn_surface **ret_surface,
                      struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
