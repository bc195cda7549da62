/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where a region ends, smoothly: the signed distance from its border, positive inside, so that the
 * border is a level set like any other and no staircase of voxels. In um. */
#ifndef GSN_RENDER_REGION_BORDER_H
#define GSN_RENDER_REGION_BORDER_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_border;

/* gives: the border of a region. Halfway between a voxel inside and a neighbour outside the
 * distance is 0, but for a smoothing by 0.7 voxel; beyond the region's lattice nothing is inside.
 * Fails with GSN_E_NOMEM. borrows: region. The same bytes for any number of threads. */
int gsn_border_new(const struct gsn_mask *region, unsigned threads, struct gsn_border **ret_border,
                   struct gsn_error *err);
void gsn_border_free(struct gsn_border *border);
GSN_DEFINE_AUTO(gsn_border);

/* The distance at u, trilinear between voxels, and its gradient unless ret_gradient is NULL; far
 * from the region it is at most what it is at the end of the lattice. */
double gsn_border_at(const struct gsn_border *border, const double u[3], double *ret_gradient);

#ifdef __cplusplus
}
#endif
#endif
