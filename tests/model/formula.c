/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/model/formula.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include "pipeline/model/dms_internal.h"

void formula_basis(const struct gsn_dms *space, size_t tet, const double u[3], double *ret_value,
                   double (*ret_gradient)[3], double (*ret_hessian)[6])
{
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];

    gsn_dms_gather(space, tet, knot);
    gsn_simplex_pick(space->sets, (const double(*)[3])knot, pick);
    gsn_simplex_basis(space->sets, (const double(*)[3])knot, pick, u, 0, ret_value, ret_gradient);
    if (ret_hessian)
        gsn_simplex_basis_hessian(space->sets, (const double(*)[3])knot, pick, u, 0, ret_hessian);
}

/* Outside the box of its knots all functions of a tetrahedron are 0. */
static int reaches(const struct gsn_dms *space, size_t tet, const double u[3])
{
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];

    gsn_dms_gather(space, tet, knot);
    for (int c = 0; c < 3; c++) {
        unsigned below = 0, above = 0;

        for (unsigned i = 0; i < 4 * (space->degree + 1); i++) {
            below += knot[i][c] <= u[c];
            above += knot[i][c] >= u[c];
        }
        if (below == 0 || above == 0)
            return 0;
    }
    return 1;
}

double formula_at(const struct gsn_dms *space, const double *control, const double u[3],
                  double *ret_gradient)
{
    double sum = 0;

    for (int c = 0; ret_gradient && c < 3; c++)
        ret_gradient[c] = 0;
    for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
        const uint32_t *id = gsn_dms_control_ids(space, t);
        double value[GSN_DMS_MAX_FUNCTIONS], gradient[GSN_DMS_MAX_FUNCTIONS][3];

        if (!reaches(space, t, u))
            continue;
        formula_basis(space, t, u, value, ret_gradient ? gradient : NULL, NULL);
        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            sum += control[id[f]] * value[f];
            for (int c = 0; ret_gradient && c < 3; c++)
                ret_gradient[c] += control[id[f]] * gradient[f][c];
        }
    }
    return sum;
}

void formula_knots(const struct gsn_dms *space, const double *control, const double u[3],
                   double (*total)[3])
{
    const unsigned per_cloud = space->degree + 1;

    for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
        const uint32_t *id = gsn_dms_control_ids(space, t);
        double knot[GSN_SIMPLEX_MAX_KNOTS][3], gradient[3];
        uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
        struct gsn_simplex_at at;

        gsn_dms_gather(space, t, knot);
        gsn_simplex_pick(space->sets, (const double(*)[3])knot, pick);
        gsn_simplex_at_init(&at, space->sets, (const double(*)[3])knot, pick, u, 0);
        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            for (unsigned i = 0; i < 4 * per_cloud; i++) {
                const size_t place =
                    gsn_dms_mesh(space)->tet[t][i / per_cloud] * per_cloud + i % per_cloud;

                gsn_simplex_knot_gradient(&at, f, i, gradient);
                for (int c = 0; c < 3; c++)
                    total[place][c] += control[id[f]] * gradient[c];
            }
        }
    }
}

void draw_in_skins(const struct gsn_tets *mesh, size_t t, uint64_t *seed, double ret_u[3])
{
    double lambda[4], sum = 0;

    for (int k = 0; k < 4; k++)
        sum += lambda[k] = draw(seed) < 0.5 ? draw(seed) : 0.03 * draw(seed);
    for (int c = 0; c < 3; c++) {
        ret_u[c] = 0;
        for (int k = 0; k < 4; k++)
            ret_u[c] += lambda[k] / sum * mesh->vertex[mesh->tet[t][k]][c];
    }
}

struct gsn_spline *random_spline(const struct gsn_dms *space, uint64_t *seed)
{
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = 2 * draw(seed) - 1;
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    return spline;
}

struct gsn_dms *shrunk_space(const size_t cells[3], double jitter, unsigned degree, double factor,
                             enum gsn_dms_sharing sharing)
{
    struct gsn_tets *mesh = kuhn_mesh(cells, jitter);
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_dms_clouds(mesh, degree, 0.05, &knots, &err), err);
    for (size_t i = 0; i < mesh->vertex_count * (degree + 1); i++) {
        const double *v = mesh->vertex[i / (degree + 1)];

        for (int c = 0; c < 3; c++)
            knots[i][c] = v[c] + factor * (knots[i][c] - v[c]);
    }
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, sharing, &space, &err), err);
    gsn_free(knots);
    gsn_tets_free(mesh);
    return space;
}

struct gsn_dms *flat_space(const size_t cells[3], double jitter, unsigned degree, double factor,
                           enum gsn_dms_sharing sharing)
{
    struct gsn_tets *mesh = kuhn_mesh(cells, jitter), *flat = NULL;
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < mesh->vertex_count; i++)
        mesh->vertex[i][2] *= factor;
    CHECK_OK(gsn_tets_new((const double(*)[3])mesh->vertex, mesh->vertex_count,
                          (const uint32_t(*)[4])mesh->tet, mesh->tet_count, &flat, &err),
             err);
    CHECK_OK(gsn_dms_clouds(flat, degree, 0.05, &knots, &err), err);
    CHECK_OK(gsn_dms_new(flat, degree, (const double(*)[3])knots, sharing, &space, &err), err);
    gsn_free(knots);
    gsn_tets_free(mesh);
    gsn_tets_free(flat);
    return space;
}
