/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A closed surface of flat facets in micrometres: what a mesher is asked to fill. */
#ifndef GSN_MODEL_SURFACE_H
#define GSN_MODEL_SURFACE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The fourth corner of a triangle. */
#define GSN_SURFACE_NONE UINT32_MAX

/* Facets are flat, convex and anticlockwise seen from outside; four corners, or three and
 * GSN_SURFACE_NONE. */
struct gsn_surface {
    size_t vertex_count, facet_count;
    double (*vertex)[3];
    uint32_t (*facet)[4];
};

/* gives: zeroed vertices and facets. Fails with GSN_E_NOMEM. */
int gsn_surface_new(size_t vertex_count, size_t facet_count, struct gsn_surface **ret_surface,
                    struct gsn_error *err);
void gsn_surface_free(struct gsn_surface *surface);
GSN_DEFINE_AUTO(gsn_surface);

/* Corners of one facet: 3 or 4. */
size_t gsn_surface_corners(const struct gsn_surface *surface, size_t facet);

/* Passes a surface that encloses something: coordinates finite, corners in range and distinct, and
 * every edge run through exactly once in each direction. Crossings are the mesher's to find.
 * Fails with GSN_E_MESH naming the vertex, facet or edge; with GSN_E_NOMEM. */
int gsn_surface_check(const struct gsn_surface *surface, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
