/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/dms.h"

#include "pipeline/model/dms_internal.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* An X_beta smaller than this share of its tetrahedron counts as folded: near 0 the rounded
 * determinant could not tell, and B-patches divide by it. */
#define FOLD_MARGIN 1e-9

void gsn_dms_gather(const struct gsn_dms *space, size_t tet,
                    double ret_knot[GSN_SIMPLEX_MAX_KNOTS][3])
{
    const size_t per_cloud = space->degree + 1;

    for (size_t k = 0; k < 4; k++)
        memcpy(ret_knot[k * per_cloud], space->knot[space->mesh->tet[tet][k] * per_cloud],
               per_cloud * sizeof *space->knot);
}

static int check_input(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3],
                       struct gsn_error *err)
{
    if (degree < 1 || degree > GSN_DMS_MAX_DEGREE)
        return gsn_fail(err, GSN_E_INPUT, "degree %u: a simplex spline has degree 1 to %d", degree,
                        GSN_DMS_MAX_DEGREE);
    if (mesh->tet_count >= UINT32_MAX / GSN_DMS_MAX_FUNCTIONS)
        return gsn_fail(err, GSN_E_INPUT, "%zu tetrahedra are too many", mesh->tet_count);
    for (size_t i = 0; i < mesh->vertex_count * (degree + 1); i++) {
        for (int c = 0; c < 3; c++) {
            if (!isfinite(knots[i][c]))
                return gsn_fail(err, GSN_E_INPUT,
                                "knot %zu of vertex %zu has a coordinate that is not finite",
                                i % (degree + 1), i / (degree + 1));
        }
        if (i % (degree + 1) == 0 &&
            memcmp(knots[i], mesh->vertex[i / (degree + 1)], sizeof *knots) != 0)
            return gsn_fail(err, GSN_E_INPUT, "knot 0 of vertex %zu is not the vertex",
                            i / (degree + 1));
    }
    return GSN_OK;
}

static int copy_in(const struct gsn_tets *mesh, const double (*knots)[3], struct gsn_dms *space,
                   struct gsn_error *err)
{
    int r = gsn_tets_new((const double(*)[3])mesh->vertex, mesh->vertex_count,
                         (const uint32_t(*)[4])mesh->tet, mesh->tet_count, &space->mesh, err);

    if (r == GSN_OK)
        r = gsn_simplex_sets_new(space->degree, &space->sets, err);
    if (r < 0)
        return r;
    space->knot = gsn_memdup(knots, mesh->vertex_count * (space->degree + 1) * sizeof *knots);
    space->reach = gsn_alloc_array(mesh->tet_count, sizeof *space->reach);
    if (!space->knot || !space->reach)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the knots of %zu tetrahedra",
                        mesh->tet_count);
    return GSN_OK;
}

static float round_down(double x)
{
    const float nearest = (float)x;

    return (double)nearest > x ? nextafterf(nearest, -INFINITY) : nearest;
}

static struct gsn_dms_reach reach_of(const struct gsn_dms_shape *shape)
{
    struct gsn_dms_reach reach;

    for (int k = 0; k < 4; k++) {
        reach.low[k] = round_down(shape->low[k]);
        reach.high[k] = -round_down(-shape->high[k]);
    }
    return reach;
}

static int measure_tets(struct gsn_dms *space, struct gsn_error *err)
{
    const size_t count = space->mesh->tet_count;
    gsn_auto_mem(struct gsn_box) box = gsn_alloc_array(count, sizeof *box);

    if (!box)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    for (size_t t = 0; t < count; t++) {
        const uint32_t *v = space->mesh->tet[t];
        double knot[GSN_SIMPLEX_MAX_KNOTS][3];
        struct gsn_dms_shape shape;
        int r;

        gsn_dms_gather(space, t, knot);
        r = gsn_dms_shape_init(space->degree, (const double(*)[3])knot, FOLD_MARGIN, 1, &shape,
                               err);
        if (r < 0)
            return gsn_fail_at(err, "tetrahedron %zu (vertices %u %u %u %u)", t, v[0], v[1], v[2],
                               v[3]);
        space->reach[t] = reach_of(&shape);
        box[t] = gsn_box_around((const double(*)[3])knot, 4 * (space->degree + 1));
    }
    return gsn_boxtree_new(box, count, &space->tree, err);
}

int gsn_dms_new(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3],
                enum gsn_dms_sharing sharing, struct gsn_dms **ret_space, struct gsn_error *err)
{
    gsn_auto(gsn_dms) space = NULL;
    int r;

    assert(mesh && knots && ret_space);

    r = check_input(mesh, degree, knots, err);
    if (r < 0)
        return r;
    space = gsn_alloc_array(1, sizeof *space);
    if (!space)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a spline space");
    space->degree = degree;
    space->sharing = sharing;
    space->kernels = gsn_kernels_best();
    r = copy_in(mesh, knots, space, err);
    if (r == GSN_OK)
        r = measure_tets(space, err);
    if (r == GSN_OK)
        r = gsn_dms_number(space, err);
    if (r == GSN_OK)
        r = gsn_dms_find_whole(space, err);
    if (r < 0)
        return r;
    *ret_space = gsn_steal(&space);
    return GSN_OK;
}

void gsn_dms_free(struct gsn_dms *space)
{
    if (!space)
        return;
    gsn_tets_free(space->mesh);
    gsn_simplex_sets_free(space->sets);
    gsn_boxtree_free(space->tree);
    gsn_free(space->knot);
    gsn_free(space->id);
    gsn_free(space->reach);
    gsn_free(space->whole);
    gsn_free(space);
}

void gsn_dms_use(struct gsn_dms *space, const struct gsn_kernels *kernels)
{
    space->kernels = kernels;
}

size_t gsn_dms_bytes(const struct gsn_dms *space)
{
    const struct gsn_tets *mesh = space->mesh;
    const struct gsn_simplex_sets *sets = space->sets;
    const size_t per_vertex = sizeof *mesh->vertex + (space->degree + 1) * sizeof *space->knot;
    const size_t per_tet = sizeof *mesh->tet + sizeof *mesh->neighbour +
                           sets->functions * sizeof *space->id + sizeof *space->reach +
                           sizeof *space->whole;
    const size_t table = sizeof *sets + GSN_SIMPLEX_MAX_SETS * sizeof *sets->set +
                         (sets->first[4] + 1) * sizeof *sets->quads +
                         sets->quads[sets->first[4]] * sizeof *sets->quad;

    return sizeof *space + sizeof *mesh + mesh->vertex_count * per_vertex +
           mesh->tet_count * per_tet + gsn_boxtree_bytes(space->tree) + table;
}

const struct gsn_tets *gsn_dms_mesh(const struct gsn_dms *space)
{
    return space->mesh;
}

const double (*gsn_dms_knots(const struct gsn_dms *space))[3]
{
    return (const double(*)[3])space->knot;
}

unsigned gsn_dms_degree(const struct gsn_dms *space)
{
    return space->degree;
}

enum gsn_dms_sharing gsn_dms_sharing(const struct gsn_dms *space)
{
    return space->sharing;
}

size_t gsn_dms_functions(const struct gsn_dms *space)
{
    return space->sets->functions;
}

size_t gsn_dms_controls(const struct gsn_dms *space)
{
    return space->controls;
}

const uint32_t *gsn_dms_control_ids(const struct gsn_dms *space, size_t tet)
{
    return &space->id[tet * space->sets->functions];
}

const uint8_t *gsn_dms_beta(const struct gsn_dms *space, size_t function)
{
    return space->sets->beta[function];
}

int gsn_dms_is_whole(const struct gsn_dms *space, size_t tet)
{
    return space->whole[tet];
}

void gsn_dms_core(const struct gsn_dms *space, size_t tet, double ret_delta[4])
{
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    struct gsn_dms_shape shape;

    gsn_dms_gather(space, tet, knot);
    gsn_dms_shape_of(space, tet, &shape);
    gsn_dms_measure(space->degree, (const double(*)[3])knot, &shape);
    memcpy(ret_delta, shape.high, sizeof shape.high);
}
