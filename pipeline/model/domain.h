/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The tetrahedral domain over a region of interest.
 *
 * The region's mask, grown by a voxel, is covered with cubes of a coarse lattice; cavities that the
 * cubes enclose on all sides are filled, the boundary of their union is closed into a manifold
 * (domain_cells.c), and TetGen makes a constrained Delaunay tetrahedralisation of it, refined
 * to a size. The domain is larger than the region by at least a voxel, so that the basis sums to
 * one everywhere inside the region whatever the boundary clouds. TetGen runs in a process of its
 * own. */
#ifndef GSN_MODEL_DOMAIN_H
#define GSN_MODEL_DOMAIN_H

#include "pipeline/core/grid.h"
#include "pipeline/model/tets.h"
#include "pipeline/model/wall_layers.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_domain_options {
    const char *mesher;  /* path of the gieson-mesh program */
    double cell_um;      /* edge of the covering cells */
    double max_tet_um3;  /* no tetrahedron is larger */
    unsigned wall_s;     /* the mesher's time limit; 0: 120 */
    size_t memory_bytes; /* the mesher's memory limit; 0: 2 GiB */
    double radius_edge;  /* most circumradius over shortest edge; 0: 1.4 */
    double dihedral_deg; /* least dihedral angle, aimed at; 0: 14 */
};

/* gives: the mesh, vertices and tetrahedra in Morton order; the same region gives the same bytes.
 * Fails with GSN_E_INPUT on an empty mask, GSN_E_LIMIT when cell_um makes more than 2^24 cells,
 * GSN_E_MESH when TetGen gives up or its answer does not verify (orientation, volume, conforming
 * boundary, every voxel centre inside), GSN_E_PROCESS when the mesher dies or exceeds a limit. */
int gsn_domain_build(const struct gsn_mask *region, const struct gsn_domain_options *options,
                     struct gsn_tets **ret_mesh, struct gsn_error *err);

/* What a mesh follows, and what was found on the way. */
enum gsn_domain_kind {
    GSN_DOMAIN_WALLS, /* layers along the walls of the density (wall_layers.h), and the region's rim
                       */
    GSN_DOMAIN_RIM,   /* the region's rim: no wall is sharp */
    GSN_DOMAIN_CUBES, /* a cover of cubes: the mesher refused what is better */
};
struct gsn_domain_report {
    enum gsn_domain_kind kind;
    double low, high, noise, blur_um; /* as in struct gsn_wall_layers */
    size_t wall_points;
    double radius_edge,
        dihedral_deg;     /* the quality that it has: what a refinement should ask for */
    struct gsn_error why; /* with cubes: what the mesher said */
};

/* gives: a mesh of the region that follows the density in it: constrained Delaunay in a box, around
 * layers along the walls and points around the region, of which only the tetrahedra that touch a
 * voxel of the region are kept, so that its surface is as smooth as the points are. When the mesher
 * refuses the layers they are made once more, by a fifth finer; when it refuses again, the mesh is
 * that of gsn_domain_build(). max_tet_um3 may be 0, no limit, but for that one. Fails as
 * gsn_domain_build() and gsn_wall_layers_find() do. */
int gsn_domain_follow(const struct gsn_grid *grid, const struct gsn_mask *region,
                      const struct gsn_wall_options *walls,
                      const struct gsn_domain_options *options, struct gsn_tets **ret_mesh,
                      struct gsn_domain_report *ret_report, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
