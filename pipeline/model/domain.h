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

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_domain_options {
    const char *mesher;  /* path of the gieson-mesh program */
    double cell_um;      /* edge of the covering cells */
    double max_tet_um3;  /* no tetrahedron is larger */
    unsigned wall_s;     /* the mesher's time limit; 0: 120 */
    size_t memory_bytes; /* the mesher's memory limit; 0: 2 GiB */
};

/* gives: the mesh, vertices and tetrahedra in Morton order; the same region gives the same bytes.
 * Fails with GSN_E_INPUT on an empty mask, GSN_E_LIMIT when cell_um makes more than 2^24 cells,
 * GSN_E_MESH when TetGen gives up or its answer does not verify (orientation, volume, conforming
 * boundary, every voxel centre inside), GSN_E_PROCESS when the mesher dies or exceeds a limit. */
int gsn_domain_build(const struct gsn_mask *region, const struct gsn_domain_options *options,
                     struct gsn_tets **ret_mesh, struct gsn_error *err);

/* gives: a refinement in which no tetrahedron whose centroid lies in tetrahedron t is larger than
 * max_um3[t] (0: no limit). The boundary stays; elsewhere the mesh may change to keep its quality.
 * Of the options, cell_um and max_tet_um3 do not matter here. Fails as gsn_domain_build() does,
 * with GSN_E_INPUT on a limit that is no volume. */
int gsn_domain_refine(const struct gsn_tets *mesh, const double *max_um3,
                      const struct gsn_domain_options *options, struct gsn_tets **ret_mesh,
                      struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
