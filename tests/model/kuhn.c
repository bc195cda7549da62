/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/model/kuhn.h"

#include "tests/check.h"

#include <string.h>

double draw(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (double)(*seed >> 11) * 0x1p-53;
}

static uint32_t number(const size_t cells[3], size_t x, size_t y, size_t z)
{
    return (uint32_t)((z * (cells[1] + 1) + y) * (cells[0] + 1) + x);
}

static void place(const size_t cells[3], double jitter, double (*vertex)[3])
{
    uint64_t seed = 7;

    for (size_t z = 0; z <= cells[2]; z++) {
        for (size_t y = 0; y <= cells[1]; y++) {
            for (size_t x = 0; x <= cells[0]; x++) {
                const size_t at[3] = { x, y, z };
                double *v = vertex[number(cells, x, y, z)];
                int inner = 1;

                for (int c = 0; c < 3; c++)
                    inner = inner && at[c] > 0 && at[c] < cells[c];
                for (int c = 0; c < 3; c++)
                    v[c] = (double)at[c] + (inner ? jitter * (2 * draw(&seed) - 1) : 0);
            }
        }
    }
}

struct gsn_tets *kuhn_mesh(const size_t cells[3], double jitter)
{
    static const int orders[6][3] = { { 0, 1, 2 }, { 0, 2, 1 }, { 1, 0, 2 },
                                      { 1, 2, 0 }, { 2, 0, 1 }, { 2, 1, 0 } };
    const size_t vertices = (cells[0] + 1) * (cells[1] + 1) * (cells[2] + 1);
    const size_t cubes = cells[0] * cells[1] * cells[2];
    double(*vertex)[3] = gsn_alloc_array(vertices, sizeof *vertex);
    uint32_t(*tet)[4] = gsn_alloc_array(6 * cubes, sizeof *tet);
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    place(cells, jitter, vertex);
    for (size_t i = 0; i < 6 * cubes; i++) {
        const size_t cube = i / 6;
        size_t at[3] = { cube % cells[0], cube / cells[0] % cells[1], cube / cells[0] / cells[1] };

        tet[i][0] = number(cells, at[0], at[1], at[2]);
        for (int k = 0; k < 3; k++) {
            at[orders[i % 6][k]]++;
            tet[i][k + 1] = number(cells, at[0], at[1], at[2]);
        }
    }
    CHECK_OK(gsn_tets_new((const double(*)[3])vertex, vertices, (const uint32_t(*)[4])tet,
                          6 * cubes, &mesh, &err),
             err);
    gsn_free(vertex);
    gsn_free(tet);
    return mesh;
}

struct gsn_dms *kuhn_space_on(struct gsn_tets *mesh, unsigned degree, double fraction,
                              enum gsn_dms_sharing sharing)
{
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_dms_clouds(mesh, degree, fraction, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, sharing, &space, &err), err);
    gsn_free(knots);
    gsn_tets_free(mesh);
    return space;
}

struct gsn_dms *kuhn_space(const size_t cells[3], double jitter, unsigned degree, double fraction,
                           enum gsn_dms_sharing sharing)
{
    return kuhn_space_on(kuhn_mesh(cells, jitter), degree, fraction, sharing);
}

void draw_inside(const struct gsn_tets *mesh, size_t t, uint64_t *seed, double ret_u[3])
{
    double lambda[4], sum = 0;

    for (int k = 0; k < 4; k++)
        sum += lambda[k] = -log(1 - draw(seed));
    for (int c = 0; c < 3; c++) {
        ret_u[c] = 0;
        for (int k = 0; k < 4; k++)
            ret_u[c] += lambda[k] / sum * mesh->vertex[mesh->tet[t][k]][c];
    }
}

struct polynomial draw_polynomial(unsigned degree, uint64_t *seed)
{
    struct polynomial p = { .degree = degree };

    for (int j = 0; j < 20; j++) {
        p.weight[j] = 2 * draw(seed) - 1;
        p.constant[j] = 2 * draw(seed) - 1;
        for (int c = 0; c < 3; c++)
            p.slope[j][c] = draw(seed) - 0.5;
    }
    return p;
}

static double factor(const struct polynomial *p, int j, const double u[3])
{
    return p->constant[j] + p->slope[j][0] * u[0] + p->slope[j][1] * u[1] + p->slope[j][2] * u[2];
}

double polynomial_at(const struct polynomial *p, const double u[3], double *ret_gradient)
{
    double sum = 0;

    for (int c = 0; ret_gradient && c < 3; c++)
        ret_gradient[c] = 0;
    for (int j = 0; j < 20; j++) {
        const double f = factor(p, j, u);

        sum += p->weight[j] * pow(f, p->degree);
        for (int c = 0; ret_gradient && c < 3; c++)
            ret_gradient[c] += p->weight[j] * p->degree * pow(f, p->degree - 1.0) * p->slope[j][c];
    }
    return sum;
}

double polynomial_polar(const struct polynomial *p, const double *const arg[])
{
    double sum = 0;

    for (int j = 0; j < 20; j++) {
        double product = p->weight[j];

        for (unsigned i = 0; i < p->degree; i++)
            product *= factor(p, j, arg[i]);
        sum += product;
    }
    return sum;
}

double *polynomial_controls(const struct polynomial *p, const struct gsn_dms *space)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const double(*knot)[3] = gsn_dms_knots(space);
    double *control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);

    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            const uint8_t *beta = gsn_dms_beta(space, f);
            const double *arg[GSN_DMS_MAX_DEGREE];
            unsigned n = 0;

            for (unsigned k = 0; k < 4; k++) {
                for (unsigned l = 0; l < beta[k]; l++)
                    arg[n++] = knot[mesh->tet[t][k] * (p->degree + 1) + l];
            }
            control[gsn_dms_control_ids(space, t)[f]] = polynomial_polar(p, arg);
        }
    }
    return control;
}

struct kuhn_made kuhn_make(struct gsn_dms *space)
{
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    struct kuhn_made made = { .space = space };
    struct gsn_error err = { 0 };
    uint64_t seed = 11;

    assert_non_null(control);
    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = draw(&seed);
    CHECK_OK(gsn_spline_new(space, control, &made.spline, &err), err);
    return made;
}

void kuhn_unmake(struct kuhn_made *made)
{
    gsn_spline_free(made->spline);
    gsn_dms_free(made->space);
}
