/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A mesh at whose corners every piece of a level set shows. */
#ifndef GSN_RENDER_LEVEL_CELLS_H
#define GSN_RENDER_LEVEL_CELLS_H

#include "pipeline/model/spline.h"
#include "pipeline/render/region_border.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What every piece of is to show: {s >= level}, in a region unless border is NULL. Borrowed. */
struct gsn_level {
    const struct gsn_spline *spline;
    double level;
    const struct gsn_border *border;
};

/* gives: a refinement of the spline's mesh. No closed piece of {s = level} hides in one of its
 * tetrahedra, and none bulges through a face or an edge by more than error_um (estimated), where
 * all its corners lie on one side; but for tetrahedra whose edges are all at most least_um long,
 * for what the seams between tetrahedra add, and where more than most_cells end it. The same of
 * the solid where the region ends, as far as points tell that are least_um apart, or a sixteenth of
 * the tetrahedron's longest edge. error_um >= 0, least_um > 0. Fails with GSN_E_NOMEM. Source:
 * Bernstein's bounds (Farouki 2012) and gsn_tets_bisect(). */
int gsn_level_cells(const struct gsn_level *level, double error_um, double least_um,
                    size_t most_cells, struct gsn_tets **ret_cells, struct gsn_error *err);

/* um. */
double gsn_cell_longest_edge(const struct gsn_tets *cells, size_t cell);

#ifdef __cplusplus
}
#endif
#endif
