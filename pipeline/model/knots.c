/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/knots.h"

#include "pipeline/model/dms_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* An X_beta must keep this share of its tetrahedron: more than gsn_dms_new() asks for, so that what
 * passes here is taken there. */
#define MARGIN 1e-6

/* The caller's total while the tetrahedra that reach u add their share. */
struct sum {
    const struct gsn_spline *spline;
    const double *u;
    double weight, (*total)[3];
};

static void add_function(struct sum *sum, struct gsn_simplex_at *at, const uint32_t vertex[4],
                         size_t function, double weight)
{
    const struct gsn_simplex_set *set = &at->sets->set[function];
    const unsigned per_cloud = at->sets->degree + 1;

    for (unsigned i = 0; i < set->size; i++) {
        const unsigned t = set->member[i];
        double gradient[3], *total = sum->total[vertex[set->cloud[i]] * per_cloud + t % per_cloud];

        gsn_simplex_knot_gradient(at, function, t, gradient);
        for (int c = 0; c < 3; c++)
            total[c] += weight * gradient[c];
    }
}

static void add_tet(void *context, size_t tet, const double *value, const double (*gradient)[3])
{
    struct sum *sum = context;
    const struct gsn_dms *space = gsn_spline_space(sum->spline);
    const double *control = gsn_spline_controls(sum->spline);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
    struct gsn_simplex_at at;

    (void)value;
    (void)gradient;
    gsn_dms_gather(space, tet, knot);
    gsn_simplex_pick(space->sets, (const double(*)[3])knot, pick);
    gsn_simplex_at_init(&at, space->sets, (const double(*)[3])knot, pick, sum->u, 0);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        add_function(sum, &at, space->mesh->tet[tet], f, sum->weight * control[id[f]]);
}

int gsn_knots_gradient_add(const struct gsn_spline *spline, const double u[3], size_t *hint,
                           double weight, double (*total)[3])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    struct sum sum = { .spline = spline, .u = u, .weight = weight, .total = total };
    size_t tet;

    assert(hint && total);

    if (gsn_dms_locate(space, u, *hint, &tet) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    *hint = tet;
    gsn_dms_each(space, tet, u, 0, add_tet, &sum);
    return GSN_OK;
}

static int check_tet(const uint32_t v[4], unsigned degree, const double (*knots)[3],
                     struct gsn_error *err)
{
    const size_t per_cloud = degree + 1;
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    struct gsn_dms_shape shape;

    for (size_t i = 0; i < 4 * per_cloud; i++) {
        const size_t l = i % per_cloud;

        memcpy(knot[i], knots[v[i / per_cloud] * per_cloud + l], sizeof knot[i]);
        if (!isfinite(knot[i][0]) || !isfinite(knot[i][1]) || !isfinite(knot[i][2]))
            return gsn_fail(err, GSN_E_INPUT,
                            "knot %zu of vertex %u has a coordinate that is not finite", l,
                            v[i / per_cloud]);
    }
    return gsn_dms_shape_init(degree, (const double(*)[3])knot, MARGIN, 1, &shape, err);
}

int gsn_knots_check(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3],
                    size_t vertex, struct gsn_error *err)
{
    if (degree < 1 || degree > GSN_DMS_MAX_DEGREE)
        return gsn_fail(err, GSN_E_INPUT, "degree %u: a simplex spline has degree 1 to %d", degree,
                        GSN_DMS_MAX_DEGREE);
    if (vertex >= mesh->vertex_count)
        return gsn_fail(err, GSN_E_INPUT, "vertex %zu of %zu", vertex, mesh->vertex_count);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const uint32_t *v = mesh->tet[t];
        int r;

        if (v[0] != vertex && v[1] != vertex && v[2] != vertex && v[3] != vertex)
            continue;
        r = check_tet(v, degree, knots, err);
        if (r < 0) {
            (void)gsn_fail_at(err, "tetrahedron %zu (vertices %u %u %u %u)", t, v[0], v[1], v[2],
                              v[3]);
            return r;
        }
    }
    return GSN_OK;
}
