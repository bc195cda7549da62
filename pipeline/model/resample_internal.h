/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of resample.h share: a grid, and convex bodies as its rows see them. */
#ifndef GSN_MODEL_RESAMPLE_INTERNAL_H
#define GSN_MODEL_RESAMPLE_INTERNAL_H

#include "pipeline/core/grid.h"
#include "pipeline/model/spline_internal.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_resample_job {
    const struct gsn_spline *spline;
    const struct gsn_dms *space;
    const struct gsn_lattice *at;
    const double *centre[3]; /* along each axis */
    size_t count[3];
    double origin[3], step[3], farthest;
    const size_t *cut; /* the first layers of the slabs, and the number of layers */
    double *value;
};

/* A block of voxels: low inclusive, high not. */
struct gsn_voxel_block {
    size_t low[3], high[3];
};

/* Enlarges a box to hold v. */
void gsn_resample_extend(double low[3], double high[3], const double v[3]);

/* The voxels of a slab whose centres lie in a closed box. Returns 0 when there are none. */
int gsn_resample_block_of(const struct gsn_resample_job *job, const double low[3],
                          const double high[3], const size_t layers[2],
                          struct gsn_voxel_block *ret);
/* Cuts a block into parts of at most GSN_MOST_ROWS rows, one a call; 0 after the last. The caller
 * starts with part->high = block->low. */
int gsn_resample_next_part(const struct gsn_voxel_block *block, struct gsn_voxel_block *part);

/* Bodies without faces, told from a point with these y and z. */
void gsn_resample_start(const struct gsn_voxel_block *block, const double about[3],
                        struct gsn_bodies *bodies);
/* Adds {normal . (u - about) + constant >= 0} to a body. flattest: a slope per voxel that is
 * smaller changes nothing over a row. */
void gsn_resample_half_space(const struct gsn_resample_job *job,
                             const struct gsn_voxel_block *block, const double about[3],
                             const double normal[3], double constant, double flattest,
                             struct gsn_body *body);

/* Writes the polynomials into the voxels of a slab that tetrahedra hold. */
void gsn_resample_tets(const struct gsn_resample_job *job, const size_t layers[2]);
/* Adds the seams to the voxels of a slab. */
void gsn_resample_faces(const struct gsn_resample_job *job, const size_t layers[2]);

#ifdef __cplusplus
}
#endif
#endif
