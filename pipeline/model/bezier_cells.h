/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline as VTK's Bezier tetrahedra (cell type 78), one a tetrahedron of the mesh, for files that
 * other programs open.
 *
 * Every cell has points of its own, in the order of vtkHigherOrderTetra: corners, along the edges,
 * inside the faces; in micrometres. The values are the Bernstein coefficients of p_I, the
 * polynomial that the spline is on the core of its tetrahedron (gsn_spline_bernstein()). */
#ifndef GSN_MODEL_BEZIER_CELLS_H
#define GSN_MODEL_BEZIER_CELLS_H

#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_BEZIER_TETRAHEDRON = 78 };

struct gsn_bezier_cells {
    size_t tets, points;   /* points: of all cells together */
    double (*point)[3];    /* um */
    double *s;             /* one a point */
    int64_t *connectivity; /* 0, 1, ... points - 1 */
    int64_t *offset;       /* tets + 1 of them, the first 0 */
    uint8_t *type;
};

/* gives. borrows: spline. Fails with GSN_E_NOMEM. */
int gsn_bezier_cells_new(const struct gsn_spline *spline, struct gsn_bezier_cells **ret_cells,
                         struct gsn_error *err);
void gsn_bezier_cells_free(struct gsn_bezier_cells *cells);
GSN_DEFINE_AUTO(gsn_bezier_cells);

#ifdef __cplusplus
}
#endif
#endif
