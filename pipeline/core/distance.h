/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How far every voxel is from a set: the exact Euclidean distance transform.
 *
 * Felzenszwalb and Huttenlocher (2012, 10.4086/toc.2012.v008a019): along one axis the squared
 * distance is the lower envelope of parabolas, and the three axes are done one after the other, so
 * the cost is linear and voxels may have different lengths along x, y and z. Dilating by r is
 * taking what lies within r of a set, eroding is what lies farther than r from its complement. */
#ifndef GSN_CORE_DISTANCE_H
#define GSN_CORE_DISTANCE_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A box of nx * ny * nz voxels, x fastest; steps are the distances of neighbouring centres, > 0. */
struct gsn_distance_box {
    size_t nx, ny, nz;
    double step_x, step_y, step_z;
};

/* Fills ret_squared with the squared distance, in the steps' unit, from each voxel's centre to the
 * centre of the nearest voxel where set is not 0; infinity everywhere when the set is empty.
 * Does not depend on threads (0: all). Fails with GSN_E_NOMEM. borrows: set, ret_squared. */
int gsn_distance_squared(const uint8_t *set, const struct gsn_distance_box *box, unsigned threads,
                         float *ret_squared, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
