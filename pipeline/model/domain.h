/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The tetrahedral domain over a region of interest.
 *
 * The region's mask is covered with cells of a coarse lattice, the boundary of their union is
 * closed into a manifold, and TetGen makes a constrained Delaunay tetrahedralisation of it, refined
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

/* gives: the mesh. Fails with GSN_E_INPUT on an empty mask, GSN_E_MESH when TetGen gives up or its
 * answer does not verify (volume, orientation, conforming boundary), GSN_E_PROCESS. */
int gsn_domain_build(const struct gsn_mask *region, const struct gsn_domain_options *options,
                     struct gsn_tets **ret_mesh, struct gsn_error *err);

/* gives: a refinement in which the part of tetrahedron t has no tetrahedron above max_um3[t]
 * (0: no limit). The boundary stays. */
int gsn_domain_refine(const struct gsn_tets *mesh, const double *max_um3,
                      const struct gsn_domain_options *options, struct gsn_tets **ret_mesh,
                      struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
