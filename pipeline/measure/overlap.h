/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The tetrahedra of the domain whose functions reach each voxel of a region, and that the region
 * lies in the domain at all. */
#ifndef GSN_MEASURE_OVERLAP_H
#define GSN_MEASURE_OVERLAP_H

#include "pipeline/core/grid.h"
#include "pipeline/measure/local_polynomial.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_voxel_overlap {
    struct gsn_lattice at;
    size_t voxel_count; /* of the region, in lattice order */
    size_t *voxel;      /* lattice index of each */
    size_t *first;      /* voxel_count + 1: its tetrahedra are tet[first[v]..first[v + 1] - 1] */
    uint32_t *tet;      /* rising within a voxel */
};

/* gives: a superset of the pairs of a voxel and a tetrahedron whose functions reach it. pieces: one
 * per tetrahedron of the space's mesh.
 * Fails with GSN_E_INPUT when the region is empty or one of its voxels sticks out of the mesh
 * (named), GSN_E_NOMEM. */
int gsn_voxel_overlap_new(const struct gsn_mask *region, const struct gsn_dms *space,
                          const struct gsn_local_polynomial *pieces,
                          struct gsn_voxel_overlap **ret_overlap, struct gsn_error *err);
void gsn_voxel_overlap_free(struct gsn_voxel_overlap *overlap);
GSN_DEFINE_AUTO(gsn_voxel_overlap);

/* The box of one voxel of a lattice. */
struct gsn_aabb gsn_voxel_aabb(const struct gsn_lattice *at, size_t index);

/* First and one past the last voxel, along one axis, whose closed cells meet low..high. */
void gsn_voxel_range(const struct gsn_lattice *at, int axis, double low, double high,
                     size_t *ret_first, size_t *ret_end);

#ifdef __cplusplus
}
#endif
#endif
