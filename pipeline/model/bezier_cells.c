/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: Bernstein coefficients of each tetrahedron, put into VTK's order of points.
 * Reference: VTK, vtkHigherOrderTetra. Failure: memory alone. Cost: 40 bytes a point. */
#include "pipeline/model/bezier_cells.h"

#include "pipeline/model/simplex_spline.h"

#include <string.h>

/* VTK's points of a tetrahedron of any degree: corners, then along each of these edges, then inside
 * each of these faces (one point at degree 3, none below). */
static const uint8_t EDGE[6][2] = { { 0, 1 }, { 1, 2 }, { 2, 0 }, { 0, 3 }, { 1, 3 }, { 2, 3 } };
static const uint8_t FACE[4][3] = { { 0, 1, 3 }, { 1, 2, 3 }, { 0, 2, 3 }, { 0, 1, 2 } };

/* The multi-indices of VTK's points, one after the other. */
static void order_points(unsigned degree, uint8_t ret_beta[GSN_DMS_MAX_FUNCTIONS][4])
{
    size_t p = 0;

    memset(ret_beta, 0, GSN_DMS_MAX_FUNCTIONS * sizeof *ret_beta);
    for (int k = 0; k < 4; k++)
        ret_beta[p++][k] = (uint8_t)degree;
    for (int e = 0; e < 6; e++) {
        for (unsigned i = 1; i < degree; i++, p++) {
            ret_beta[p][EDGE[e][0]] = (uint8_t)(degree - i);
            ret_beta[p][EDGE[e][1]] = (uint8_t)i;
        }
    }
    for (int f = 0; degree == 3 && f < 4; f++, p++)
        for (int k = 0; k < 3; k++)
            ret_beta[p][FACE[f][k]] = 1;
}

/* The Bezier points of a straight tetrahedron divide it evenly. */
static void place_point(const struct gsn_tets *mesh, size_t tet, const uint8_t beta[4],
                        unsigned degree, double ret_point[3])
{
    for (int c = 0; c < 3; c++) {
        ret_point[c] = 0;
        for (int k = 0; k < 4; k++)
            ret_point[c] += beta[k] * mesh->vertex[mesh->tet[tet][k]][c];
        ret_point[c] /= degree;
    }
}

void gsn_bezier_cells_free(struct gsn_bezier_cells *p)
{
    if (!p)
        return;
    gsn_free(p->point);
    gsn_free(p->s);
    gsn_free(p->connectivity);
    gsn_free(p->offset);
    gsn_free(p->type);
    gsn_free(p);
}

int gsn_bezier_cells_new(const struct gsn_spline *spline, struct gsn_bezier_cells **ret_cells,
                         struct gsn_error *err)
{
    gsn_auto(gsn_bezier_cells) p = gsn_alloc_array(1, sizeof *p);
    const struct gsn_dms *space = gsn_spline_space(spline);
    const size_t each = gsn_dms_functions(space);
    uint8_t beta[GSN_DMS_MAX_FUNCTIONS][4];
    double coefficient[GSN_DMS_MAX_FUNCTIONS];

    if (!p)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the cells of a model");
    p->tets = gsn_dms_mesh(space)->tet_count;
    p->points = p->tets * each;
    p->point = gsn_alloc_array(p->points, sizeof *p->point);
    p->s = gsn_alloc_array(p->points, sizeof *p->s);
    p->connectivity = gsn_alloc_array(p->points, sizeof *p->connectivity);
    p->offset = gsn_alloc_array(p->tets + 1, sizeof *p->offset);
    p->type = gsn_alloc_array(p->tets, sizeof *p->type);
    if (!p->point || !p->s || !p->connectivity || !p->offset || !p->type)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a model of %zu tetrahedra", p->tets);
    order_points(gsn_dms_degree(space), beta);
    for (size_t t = 0; t < p->tets; t++) {
        gsn_spline_bernstein(spline, t, coefficient);
        for (size_t i = 0, at = t * each; i < each; i++, at++) {
            place_point(gsn_dms_mesh(space), t, beta[i], gsn_dms_degree(space), p->point[at]);
            p->s[at] = coefficient[gsn_simplex_place(beta[i])];
            p->connectivity[at] = (int64_t)at;
        }
        p->offset[t + 1] = (int64_t)((t + 1) * each);
        p->type[t] = GSN_BEZIER_TETRAHEDRON;
    }
    *ret_cells = gsn_steal(&p);
    return GSN_OK;
}
