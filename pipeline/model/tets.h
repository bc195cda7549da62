/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A tetrahedral mesh in micrometres: the domain a spline lives on. */
#ifndef GSN_MODEL_TETS_H
#define GSN_MODEL_TETS_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Tetrahedra are positively oriented: det[v1 - v0, v2 - v0, v3 - v0] > 0. neighbour[t][k] is the
 * tetrahedron across the face opposite corner k, or -1 on the boundary. */
struct gsn_tets {
    size_t vertex_count, tet_count;
    double (*vertex)[3];
    uint32_t (*tet)[4];
    int32_t (*neighbour)[4];
};

/* gives: a mesh of copies; orients every tetrahedron and finds the neighbours.
 * Fails with GSN_E_MESH on an index out of range, a flat tetrahedron, a face shared by more than
 * two, a vertex no tetrahedron uses or a coordinate that is not finite; with GSN_E_NOMEM. */
int gsn_tets_new(const double (*vertex)[3], size_t vertex_count, const uint32_t (*tet)[4],
                 size_t tet_count, struct gsn_tets **ret_mesh, struct gsn_error *err);
void gsn_tets_free(struct gsn_tets *mesh);
GSN_DEFINE_AUTO(gsn_tets);

/* Volume of one tetrahedron, um^3; > 0. */
double gsn_tets_volume(const struct gsn_tets *mesh, size_t tet);
/* Its lowest height by its longest edge: 0.82 for a regular one. What the exact predicate takes for
 * positive may be 0 or less here, in rounding. */
double gsn_tets_height(const struct gsn_tets *mesh, size_t tet);

#ifdef __cplusplus
}
#endif
#endif
