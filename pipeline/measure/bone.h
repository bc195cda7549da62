/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The morphometry of bone, or of whatever lies above a density: surface, thickness, pieces,
 * tunnels. Names and units are those of ASBMR (Dempster et al., J Bone Miner Res 28, 2013; Bouxsein
 * et al., 25, 2010), definitions those of BoneJ (Doube et al., Bone 47, 2010). */
#ifndef GSN_MEASURE_BONE_H
#define GSN_MEASURE_BONE_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_bone {
    double tissue_um3;   /* TV: voxels of the region that have data */
    double bone_um3;     /* BV: those of them above the threshold */
    double surface_um2;  /* BS: of the level within the region, by marching tetrahedra; where the
                            * region's border cuts bone there is none */
    double thickness_um; /* Tb.Th: mean over BV of the widest sphere that holds a voxel and lies in
                            * bone (Hildebrand and Rueegsegger 1997); NaN without bone */
    double thickness_sd; /* and its standard deviation */
    double thickness_most; /* and the largest */
    size_t components;     /* of BV, joined by faces, edges or corners */
    int64_t euler;         /* pieces - tunnels + cavities of BV */
};

/* Bone is what lies above the threshold, also beyond the region where the grid goes on, so that a
 * border makes nothing thin; no data is no bone. A thickness is known to half a voxel: bodies of
 * fewer than some ten voxels are told coarsely. region may have another lattice.
 *
 * threads 0: all; the same on any number. Fails with GSN_E_INPUT for a region without data,
 * GSN_E_LIMIT for more than GSN_BONE_VOXELS, GSN_E_NOMEM. borrows: grid, region. */
enum { GSN_BONE_VOXELS = 1 << 25 };
int gsn_bone_measure(const struct gsn_grid *grid, const struct gsn_mask *region, double threshold,
                     unsigned threads, struct gsn_bone *ret_bone, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
