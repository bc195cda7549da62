/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of the domain share behind domain.h: cells, the mesher, order and verification. */
#ifndef GSN_MODEL_DOMAIN_INTERNAL_H
#define GSN_MODEL_DOMAIN_INTERNAL_H

#include "pipeline/core/grid.h"
#include "pipeline/model/domain.h"
#include "pipeline/model/tetgen_wire.h"
#include "pipeline/model/tets.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Cubes of a coarse lattice that cover a region, and the surface around them.
 *
 * Cells are cubes of edge_um whose planes pass through the corner of the mask's first voxel (its
 * origin less half a step), so cells that are multiples of the voxels have no voxel centre on a
 * plane. A layer of empty cells always surrounds the filled ones. Micrometres throughout. */

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

/* One question to the mesher's process, and its answer as a mesh. */

/* gives: the answer, conforming, oriented and in the order of space; whether it fills the right
 * place is the caller's to verify. The quality is that of the options, whatever the question's say;
 * its largest volume is kept. Fails with GSN_E_MESH, GSN_E_PROCESS, GSN_E_NOMEM. */
int gsn_domain_ask(const struct gsn_domain_options *options,
                   const struct gsn_mesh_question *question, struct gsn_tets **ret_mesh,
                   struct gsn_error *err);

/* Vertices and tetrahedra in the order of space: neighbours in space are neighbours in memory, and
 * a mesh has one order whoever made it. */

/* Sorts vertices, and tetrahedra by their centroids, by Morton code over the bounding box (21 bits
 * an axis, equal codes in the old order), and each tetrahedron's corners ascending. The caller
 * guarantees finite coordinates and corners in range. Fails with GSN_E_NOMEM. */
int gsn_domain_order(struct gsn_soup *soup, struct gsn_error *err);

/* Whether a mesh fills what it should: nothing that TetGen says is believed unseen. */

/* The mesh fills exactly the cells: volume and boundary area agree to 1e-9, every boundary face
 * lies between a filled and an empty cell, every voxel centre of the region is inside, and the
 * heights are those of gsn_domain_verify_heights().
 * Fails with GSN_E_MESH saying what does not hold, GSN_E_NOMEM. */
int gsn_domain_verify_cells(const struct gsn_tets *mesh, const struct gsn_cells *cells,
                            const struct gsn_mask *region, struct gsn_error *err);

/* No tetrahedron is too flat to carry knots: the exact predicate takes any that is not degenerate.
 * Fails with GSN_E_MESH. */
int gsn_domain_verify_heights(const struct gsn_tets *mesh, struct gsn_error *err);

/* Every voxel centre of the region is inside. Fails with GSN_E_MESH, GSN_E_NOMEM. */
int gsn_domain_verify_voxels(const struct gsn_tets *mesh, const struct gsn_mask *region,
                             struct gsn_error *err);

/* The voxels from first to before end, along each axis, whose centres lie within margin (in voxels)
 * of the tetrahedron's box. */
void gsn_domain_voxels_near(const struct gsn_tets *mesh, size_t tet, const struct gsn_lattice *at,
                            double margin, size_t ret_first[3], size_t ret_end[3]);

/* um^3, um^2. */
double gsn_domain_volume(const struct gsn_tets *mesh);
double gsn_domain_area(const struct gsn_tets *mesh);

#ifdef __cplusplus
}
#endif
#endif
