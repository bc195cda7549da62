/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The unit cube, its meshes, clouds and splines. */
#include "tests/bench/bench.h"

#include "pipeline/model/domain_internal.h"
#include "pipeline/model/barycentric.h"
#include "pipeline/model/simplex_spline.h"
#include "pipeline/model/tetgen_bridge.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Where a cloud folds a tetrahedron or takes its core, it is made smaller. gsn_dms_new() refuses at
 * 0 and 1; these keep a little away from it. */
#define FOLD_MARGIN 0.01
#define WIDEST 0.98

enum { MOST_ROUNDS = 40 };

static struct gsn_surface *cube_surface(void)
{
    static const double VERTEX[8][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 1, 1, 0 }, { 0, 1, 0 },
                                         { 0, 0, 1 }, { 1, 0, 1 }, { 1, 1, 1 }, { 0, 1, 1 } };
    static const uint32_t FACET[6][4] = { { 0, 3, 2, 1 }, { 4, 5, 6, 7 }, { 0, 1, 5, 4 },
                                          { 1, 2, 6, 5 }, { 2, 3, 7, 6 }, { 3, 0, 4, 7 } };
    struct gsn_surface *surface = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_surface_new(8, 6, 0, &surface, &err), &err, "surface");
    memcpy(surface->vertex, VERTEX, sizeof VERTEX);
    memcpy(surface->facet, FACET, sizeof FACET);
    return surface;
}

struct gsn_tets *bench_mesh(enum bench_size size)
{
    /* The largest volume that makes TetGen give about 4, 27 and 240 thousand. */
    static const double LIMIT[BENCH_SIZES] = { 9.2e-4, 1.02e-4, 1e-5 };
    static const double QUICK[BENCH_SIZES] = { 3e-2, 1e-2, 4e-3 };
    gsn_auto(gsn_surface) surface = cube_surface();
    const struct gsn_mesh_question question = {
        .options = { bench_quick ? QUICK[size] : LIMIT[size], 1.3, 14 }, .surface = surface
    };
    gsn_auto(gsn_soup) soup = NULL;
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_tetgen_mesh(&question, &soup, &err), &err, "mesh");
    bench_need(gsn_domain_order(soup, &err), &err, "mesh");
    bench_need(gsn_tets_new((const double(*)[3])soup->vertex, soup->vertex_count,
                            (const uint32_t(*)[4])soup->tet, soup->tet_count, &mesh, &err),
               &err, "mesh");
    return mesh;
}

double bench_field(const double x[3])
{
    return sin(5 * x[0] + 1) * cos(4 * x[1]) + x[2] * x[2] - 0.5 * x[0] * x[2];
}

/* Per vertex, over its edges; an edge counts once per tetrahedron around it. */
static double *mean_edges(const struct gsn_tets *mesh)
{
    double *mean = bench_alloc(mesh->vertex_count, sizeof *mean);
    size_t *edges = bench_alloc(mesh->vertex_count, sizeof *edges);

    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (int k = 0; k < 4; k++) {
            for (int j = 0; j < 4; j++) {
                const uint32_t a = mesh->tet[t][k], b = mesh->tet[t][j];
                double edge[3];

                gsn_subtract(mesh->vertex[a], mesh->vertex[b], edge);
                mean[a] += sqrt(gsn_dot(edge, edge));
                edges[a] += k != j;
            }
        }
    }
    for (size_t i = 0; i < mesh->vertex_count; i++)
        mean[i] /= (double)edges[i];
    gsn_free(edges);
    return mean;
}

static void draw_direction(uint64_t *seed, double ret[3])
{
    double size;

    do {
        for (int c = 0; c < 3; c++)
            ret[c] = 2 * bench_draw(seed) - 1;
        size = sqrt(gsn_dot(ret, ret));
    } while (size < 0.1 || size > 1);
    for (int c = 0; c < 3; c++)
        ret[c] /= size;
}

static void draw_frame(uint64_t *seed, double ret[3][3])
{
    double size;

    draw_direction(seed, ret[0]);
    do {
        draw_direction(seed, ret[2]);
        gsn_cross(ret[0], ret[2], ret[1]);
        size = sqrt(gsn_dot(ret[1], ret[1]));
    } while (size < 0.1);
    for (int c = 0; c < 3; c++)
        ret[1][c] /= size;
    gsn_cross(ret[0], ret[1], ret[2]);
}

/* A knot leaves a face of the cube that its vertex lies on to the outside: mirrored there. */
static void turn_outward(const double vertex[3], double direction[3])
{
    for (int c = 0; c < 3; c++) {
        if (vertex[c] == 0)
            direction[c] = -fabs(direction[c]);
        if (vertex[c] == 1)
            direction[c] = fabs(direction[c]);
    }
}

static void place_clouds(const struct gsn_tets *mesh, unsigned degree, const double *radius,
                         double (*knot)[3])
{
    uint64_t seed = 2024;

    for (size_t i = 0; i < mesh->vertex_count; i++) {
        double axis[3][3];

        draw_frame(&seed, axis);
        memcpy(knot[i * (degree + 1)], mesh->vertex[i], sizeof *knot);
        for (unsigned l = 1; l <= degree; l++) {
            turn_outward(mesh->vertex[i], axis[l - 1]);
            for (int c = 0; c < 3; c++)
                knot[i * (degree + 1) + l][c] = mesh->vertex[i][c] + radius[i] * axis[l - 1][c];
        }
    }
}

static const double *knot_of(const struct gsn_tets *mesh, unsigned degree, const double (*knot)[3],
                             size_t tet, unsigned k, unsigned l)
{
    return knot[mesh->tet[tet][k] * (degree + 1) + l];
}

static int folds(const struct gsn_tets *mesh, unsigned degree, const double (*knot)[3], size_t tet)
{
    double whole = 0;

    for (unsigned r = 0; r <= degree; r++) {
        uint8_t beta[4] = { (uint8_t)r, 0, 0, 0 };

        do {
            const double *x[4];
            double det;

            for (unsigned k = 0; k < 4; k++)
                x[k] = knot_of(mesh, degree, knot, tet, k, beta[k]);
            det = gsn_det(x[0], x[1], x[2], x[3]);
            if (r == 0)
                whole = det;
            if (!(det > FOLD_MARGIN * whole))
                return 1;
        } while (gsn_simplex_next(beta));
    }
    return 0;
}

/* The sum over k of the greatest lambda_k of the knots of the other clouds. */
static double width(const struct gsn_tets *mesh, unsigned degree, const double (*knot)[3],
                    size_t tet)
{
    double high[4] = { 0 };
    struct gsn_barycentric frame;

    gsn_barycentric_init(
        &frame, knot_of(mesh, degree, knot, tet, 0, 0), knot_of(mesh, degree, knot, tet, 1, 0),
        knot_of(mesh, degree, knot, tet, 2, 0), knot_of(mesh, degree, knot, tet, 3, 0));
    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 1; l <= degree; l++) {
            double lambda[4];

            gsn_barycentric_at(&frame, knot_of(mesh, degree, knot, tet, k, l), lambda);
            for (unsigned j = 0; j < 4; j++)
                high[j] = j == k ? high[j] : fmax(high[j], lambda[j]);
        }
    }
    return high[0] + high[1] + high[2] + high[3];
}

/* Halves the clouds around tetrahedra that would be refused; returns whether there were any. */
static int shrink(const struct gsn_tets *mesh, unsigned degree, const double (*knot)[3],
                  const double *asked, double *radius)
{
    int any = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        if (!folds(mesh, degree, knot, t) && width(mesh, degree, knot, t) < WIDEST)
            continue;
        any = 1;
        for (int k = 0; k < 4; k++) {
            const uint32_t v = mesh->tet[t][k];

            /* Once per round, however many tetrahedra ask. */
            if (memcmp(&asked[v], &radius[v], sizeof *radius) == 0)
                radius[v] /= 2;
        }
    }
    return any;
}

static double (*make_clouds(const struct gsn_tets *mesh, unsigned degree, double cloud,
                            size_t *ret_shrunk))[3]
{
    double(*knot)[3] = bench_alloc(mesh->vertex_count * (degree + 1), sizeof *knot);
    double *full = mean_edges(mesh), *before = bench_alloc(mesh->vertex_count, sizeof *before);
    double *radius = bench_alloc(mesh->vertex_count, sizeof *radius);
    int rounds = 0;

    for (size_t i = 0; i < mesh->vertex_count; i++)
        radius[i] = full[i] * cloud;
    do {
        memcpy(before, radius, mesh->vertex_count * sizeof *radius);
        place_clouds(mesh, degree, radius, knot);
    } while (shrink(mesh, degree, (const double(*)[3])knot, before, radius) &&
             ++rounds < MOST_ROUNDS);
    *ret_shrunk = 0;
    for (size_t i = 0; i < mesh->vertex_count; i++)
        *ret_shrunk += radius[i] < full[i] * cloud;
    gsn_free(full);
    gsn_free(before);
    gsn_free(radius);
    return knot;
}

/* The field at the node of each control point, the mean of the knots t_{k,0..beta_k-1}. */
static double *make_controls(const struct gsn_dms *space)
{
    const unsigned degree = gsn_dms_degree(space);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    double *control = bench_alloc(gsn_dms_controls(space), sizeof *control);

    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (size_t f = 0; f < gsn_dms_functions(space); f++) {
            const uint8_t *beta = gsn_dms_beta(space, f);
            double node[3] = { 0 };

            for (unsigned k = 0; k < 4; k++) {
                for (unsigned l = 0; l < beta[k]; l++) {
                    const double *knot = knot_of(mesh, degree, gsn_dms_knots(space), t, k, l);

                    for (int c = 0; c < 3; c++)
                        node[c] += knot[c] / degree;
                }
            }
            control[gsn_dms_control_ids(space, t)[f]] = bench_field(node);
        }
    }
    return control;
}

struct bench_case bench_case_new(enum bench_size size, unsigned degree, double cloud)
{
    struct bench_case bench = { .mesh = bench_mesh(size) };
    double(*knot)[3] = make_clouds(bench.mesh, degree, cloud, &bench.shrunk);
    struct gsn_error err = { 0 };
    double *control;

    bench_need(gsn_dms_new(bench.mesh, degree, (const double(*)[3])knot, GSN_DMS_SHARED,
                           &bench.space, &err),
               &err, "space");
    control = make_controls(bench.space);
    bench_need(gsn_spline_new(bench.space, control, &bench.spline, &err), &err, "spline");
    gsn_free(control);
    gsn_free(knot);
    return bench;
}

void bench_case_done(struct bench_case *bench)
{
    gsn_spline_free(bench->spline);
    gsn_dms_free(bench->space);
    gsn_tets_free(bench->mesh);
}

struct gsn_lattice bench_lattice(size_t edge)
{
    const double step = 1.0 / (double)edge;

    return (struct gsn_lattice){ .nx = edge,
                                 .ny = edge,
                                 .nz = edge,
                                 .origin_um = { step / 2, step / 2, step / 2 },
                                 .step_um = { step, step, step } };
}
