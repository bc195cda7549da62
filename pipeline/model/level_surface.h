/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A level of a field on a lattice as few, even triangles. Internal to pipeline/model. */
#ifndef GSN_MODEL_LEVEL_SURFACE_H
#define GSN_MODEL_LEVEL_SURFACE_H

#include "pipeline/core/grid.h"

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Points on surfaces, um, and triangles of them whose corners ascend; each at most once. */
struct gsn_triangles {
    size_t points, facets;
    double (*at)[3];
    double (*normal)[3]; /* of length 1 */
    uint32_t (*facet)[3];
};
void gsn_triangles_done(struct gsn_triangles *triangles);

/* Appends the surface {field = level} as triangles of about this edge, where one of the eight
 * voxels around it is set in near; NaN is no field, and the surface ends there. Its vertices lie on
 * the level as interpolation has it. Fails with GSN_E_NOMEM. borrows: field, near, of one lattice.
 */
int gsn_level_surface_add(const struct gsn_grid *field, double level, const struct gsn_mask *near,
                          double edge_um, struct gsn_triangles *triangles, struct gsn_error *err);

/* Drops triangles that cross one that stands before them, exactly. Fails with GSN_E_NOMEM. */
int gsn_triangles_drop_crossings(struct gsn_triangles *triangles, struct gsn_error *err);

/* Central differences of a field at a voxel, one-sided at the edge of the data; 0 along an axis
 * without neighbours. */
void gsn_field_gradient(const struct gsn_grid *field, const size_t at[3], double ret[3]);

#ifdef __cplusplus
}
#endif
#endif
