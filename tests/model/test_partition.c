/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The functions sum to one, polynomials are reproduced, and collapsed clouds are Bernstein's
 * polynomials: at random points of a large mesh, and wherever its planes meet.
 *
 * The meshes fill the cube [0, top)^3. By the half-open rule its faces x, y, z = top belong to no
 * tetrahedron, and nothing else that is looked at here does not.
 *
 * $GIESON_PARTITION_POINTS sets the number of random points; 1000000 takes minutes. */
#include "tests/bench/bench.h"
#include "tests/check.h"
#include "tests/model/kuhn.h"
#include "tests/model/paths.h"

#include "pipeline/model/batch.h"
#include "pipeline/model/resample.h"

#include <stdlib.h>
#include <string.h>

/* Instrumented, the large mesh takes hours: a smaller one, and fewer points. */
#ifdef __SANITIZE_ADDRESS__
static const enum bench_size LARGE = BENCH_4K;
enum { LEAST_TETS = 3500, RANDOM_POINTS = 1000, PLANES = 4 };
#else
static const enum bench_size LARGE = BENCH_27K;
enum { LEAST_TETS = 25000, RANDOM_POINTS = 10000, PLANES = 12 };
#endif
/* GIESON_PARTITION_POINTS=100000: as many random points in place of these. */
enum { TERMS = 8000 };

int bench_quick; /* what cube.c asks: no */

struct points {
    size_t count;
    double (*at)[3];
};

static struct points points_new(size_t count)
{
    struct points points = { .count = count, .at = gsn_alloc_array(count, sizeof *points.at) };

    assert_non_null(points.at);
    return points;
}

static const double CLOUD = 0.03;
static const size_t CUBES[3] = { 3, 3, 3 };

/* A space over the mesh of TetGen's, with shared control points. */
static struct gsn_dms *large_space(unsigned degree)
{
    struct bench_case bench = bench_case_new(LARGE, degree, CLOUD);

    CHECK(bench.mesh->tet_count > LEAST_TETS && bench.mesh->tet_count < 30000);
    gsn_spline_free(bench.spline);
    gsn_tets_free(bench.mesh);
    return bench.space;
}

static size_t random_count(void)
{
    const char *asked = getenv("GIESON_PARTITION_POINTS");

    return asked ? strtoull(asked, NULL, 10) : RANDOM_POINTS;
}

static struct points random_points(size_t count, double top)
{
    struct points points = points_new(count);
    uint64_t seed = 41;

    for (size_t i = 0; i < 3 * count; i++)
        points.at[i / 3][i % 3] = top * draw(&seed);
    return points;
}

/* A lattice with centres on the faces of the cube, the upper ones included. */
static struct gsn_lattice aligned(double top, size_t steps)
{
    const double step = top / (double)steps;

    return (
        struct gsn_lattice){ steps + 1, steps + 1, steps + 1, { 0, 0, 0 }, { step, step, step } };
}

static struct points lattice_points(const struct gsn_lattice *at)
{
    struct points points = points_new(gsn_lattice_count(at));

    for (size_t i = 0; i < points.count; i++) {
        const struct gsn_vec3 p =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);

        memcpy(points.at[i], (const double[3]){ p.x, p.y, p.z }, sizeof *points.at);
    }
    return points;
}

/* Where axis-parallel planes through vertices of the mesh cross. */
static struct points vertex_planes(const struct gsn_tets *mesh)
{
    struct points points = points_new(PLANES * PLANES * PLANES);

    for (size_t i = 0; i < points.count; i++) {
        const size_t of[3] = { i % PLANES, i / PLANES % PLANES, i / PLANES / PLANES };

        for (size_t c = 0; c < 3; c++)
            points.at[i][c] = mesh->vertex[(of[c] * 3 + c) * mesh->vertex_count / (3 * PLANES)][c];
    }
    return points;
}

static int by_number(const void *left, const void *right)
{
    const uint64_t a = *(const uint64_t *)left, b = *(const uint64_t *)right;

    return (a > b) - (a < b);
}

/* Every edge once, as smaller vertex << 32 | larger vertex. */
static uint64_t *list_edges(const struct gsn_tets *mesh, size_t *ret_count)
{
    uint64_t *edge = gsn_alloc_array(6 * mesh->tet_count, sizeof *edge);
    size_t all = 0, count = 0;

    assert_non_null(edge);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (int j = 0; j < 4; j++) {
            for (int k = 0; k < 4; k++) {
                if (mesh->tet[t][j] < mesh->tet[t][k])
                    edge[all++] = (uint64_t)mesh->tet[t][j] << 32 | mesh->tet[t][k];
            }
        }
    }
    qsort(edge, all, sizeof *edge, by_number);
    for (size_t i = 0; i < all; i++) {
        if (i == 0 || edge[i] != edge[i - 1])
            edge[count++] = edge[i];
    }
    *ret_count = count;
    return edge;
}

static void add_point(struct points *points, const struct gsn_tets *mesh, const uint32_t *vertex,
                      int corners)
{
    double *at = points->at[points->count++];

    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < corners; k++)
            at[c] += mesh->vertex[vertex[k]][c];
        at[c] /= corners;
    }
}

/* Every vertex, the middle of every edge and of every face. */
static struct points features(const struct gsn_tets *mesh)
{
    struct points points = points_new(mesh->vertex_count + 10 * mesh->tet_count);
    size_t edges;
    gsn_auto_mem(uint64_t) edge = list_edges(mesh, &edges);

    points.count = 0;
    for (uint32_t i = 0; i < mesh->vertex_count; i++)
        add_point(&points, mesh, &i, 1);
    for (size_t i = 0; i < edges; i++)
        add_point(&points, mesh,
                  (const uint32_t[2]){ (uint32_t)(edge[i] >> 32), (uint32_t)edge[i] }, 2);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const uint32_t *v = mesh->tet[t];

        for (int k = 0; k < 4; k++) {
            const uint32_t face[3] = { v[(k + 1) % 4], v[(k + 2) % 4], v[(k + 3) % 4] };

            if (mesh->neighbour[t][k] < (int32_t)t)
                add_point(&points, mesh, face, 3);
        }
    }
    return points;
}

static int is_outside(const double u[3], double top)
{
    return u[0] == top || u[1] == top || u[2] == top;
}

static size_t count_outside(const struct points *points, double top)
{
    size_t outside = 0;

    for (size_t i = 0; i < points->count; i++)
        outside += is_outside(points->at[i], top) != 0;
    return outside;
}

static void free_points(struct points *points)
{
    gsn_free(points->at);
}

/* ---- the sum of all functions ---- */

static void check_sum(const struct gsn_dms *space, struct points points, double top,
                      const char *what)
{
    static struct gsn_dms_term term[TERMS];
    size_t hint = 0, count, outside = 0;
    double worst = 0;

    for (size_t i = 0; i < points.count; i++) {
        double sum = 0;

        if (is_outside(points.at[i], top)) {
            CHECK(gsn_dms_basis(space, points.at[i], 0, &hint, term, TERMS, &count) ==
                  GSN_DMS_OUTSIDE);
            CHECK(count == 0);
            outside++;
            continue;
        }
        CHECK(gsn_dms_basis(space, points.at[i], 0, &hint, term, TERMS, &count) == GSN_OK);
        CHECK(count <= TERMS);
        for (size_t j = 0; j < count; j++)
            sum += term[j].value;
        CHECK_NEAR(sum, 1, 1e-12);
        worst = fmax(worst, fabs(sum - 1));
    }
    print_message("n = %u, %zu %s (%zu outside): sum N off by %.1e at most\n",
                  gsn_dms_degree(space), points.count, what, outside, worst);
    free_points(&points);
}

TEST(the_functions_sum_to_one_at_random_points_of_a_large_mesh)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = large_space(degree);

        check_sum(space, random_points(random_count(), 1), 1, "random points");
    }
}

TEST(the_functions_sum_to_one_at_every_vertex_edge_and_face_and_on_planes_of_a_large_mesh)
{
    const struct gsn_lattice at = aligned(1, 16);

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = large_space(degree);

        check_sum(space, lattice_points(&at), 1, "voxels on faces of the cube");
        check_sum(space, vertex_planes(gsn_dms_mesh(space)), 1, "points on planes of vertices");
        check_sum(space, features(gsn_dms_mesh(space)), 1, "vertices, edges and faces");
    }
}

/* All inner faces of this mesh are planes that voxels lie in. */
TEST(the_functions_sum_to_one_where_voxels_lie_in_every_plane_of_the_mesh)
{
    const struct gsn_lattice at = aligned(3, 24);

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(CUBES, 0, degree, 0.05, GSN_DMS_SHARED);

        check_sum(space, lattice_points(&at), 3, "voxels of a Kuhn mesh");
        check_sum(space, features(gsn_dms_mesh(space)), 3, "vertices, edges and faces of it");
    }
}

/* ---- polynomials ---- */

/* A spline that is a polynomial. */
struct made {
    struct polynomial p;
    struct gsn_spline *spline;
};

static struct made make_polynomial(const struct gsn_dms *space)
{
    uint64_t seed = 42;
    struct made made = { .p = draw_polynomial(gsn_dms_degree(space), &seed) };
    gsn_auto_mem(double) control = polynomial_controls(&made.p, space);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_new(space, control, &made.spline, &err), err);
    return made;
}

/* The largest difference of these values from the polynomial; NaN where, and only where, there is
 * no data. */
static double check_values(const struct made *made, const struct points *points, double top,
                           const double *value)
{
    double worst = 0;

    for (size_t i = 0; i < points->count; i++) {
        const double truth = polynomial_at(&made->p, points->at[i], NULL);

        if (is_outside(points->at[i], top)) {
            if (!isnan(value[i]))
                fail_msg("data on the upper faces");
            continue;
        }
        CHECK_NEAR(value[i], truth, 1e-10);
        worst = fmax(worst, fabs(value[i] - truth));
    }
    return worst;
}

static void check_points(const struct made *made, struct points points, double top,
                         const char *what)
{
    gsn_auto_mem(double) value = gsn_alloc_array(points.count, sizeof *value);
    double(*slope)[3] = gsn_alloc_array(points.count, sizeof *slope), many, one;

    path_run(PATH_MANY, made->spline, (const double(*)[3])points.at, points.count, value, slope);
    many = check_values(made, &points, top, value);
    path_run(PATH_EVAL, made->spline, (const double(*)[3])points.at, points.count, value, slope);
    one = check_values(made, &points, top, value);
    print_message("n = %u, %zu %s: polynomial off by %.1e (many), %.1e (eval) at most\n",
                  made->p.degree, points.count, what, many, one);
    gsn_free(slope);
    free_points(&points);
}

static void check_grid(const struct made *made, const struct gsn_lattice *at, double top)
{
    struct points points = lattice_points(at);
    gsn_auto_mem(double) value = gsn_alloc_array(points.count, sizeof *value);
    struct gsn_error err = { 0 };

    CHECK(count_outside(&points, top) > 0);
    CHECK_OK(gsn_spline_resample(made->spline, at, 1, value, &err), err);
    print_message("n = %u, grid of %zu^3: polynomial off by %.1e at most\n", made->p.degree, at->nx,
                  check_values(made, &points, top, value));
    check_points(made, points, top, "voxels of it");
}

TEST(polynomials_are_reproduced_all_over_a_large_mesh)
{
    const struct gsn_lattice at[2] = { aligned(1, 16), aligned(1, 50) };

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = large_space(degree);
        struct made made = make_polynomial(space);

        for (int i = 0; i < 2; i++)
            check_grid(&made, &at[i], 1);
        check_points(&made, random_points(random_count(), 1), 1, "random points");
        check_points(&made, vertex_planes(gsn_dms_mesh(space)), 1, "points on planes of vertices");
        check_points(&made, features(gsn_dms_mesh(space)), 1, "vertices, edges and faces");
        gsn_spline_free(made.spline);
    }
}

TEST(polynomials_are_reproduced_where_voxels_lie_in_every_plane_of_the_mesh)
{
    const struct gsn_lattice at = aligned(3, 24);

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(CUBES, 0, degree, 0.05, GSN_DMS_SHARED);
        struct made made = make_polynomial(space);

        check_grid(&made, &at, 3);
        check_points(&made, features(gsn_dms_mesh(space)), 3, "vertices, edges and faces of it");
        gsn_spline_free(made.spline);
    }
}

/* ---- Bernstein ---- */

/* The same mesh with all knots of a vertex at the vertex. */
static struct gsn_dms *collapsed(const struct gsn_tets *mesh, unsigned degree,
                                 enum gsn_dms_sharing sharing)
{
    double(*knot)[3] = gsn_alloc_array(mesh->vertex_count * (degree + 1), sizeof *knot);
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < mesh->vertex_count * (degree + 1); i++)
        memcpy(knot[i], mesh->vertex[i / (degree + 1)], sizeof *knot);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knot, sharing, &space, &err), err);
    gsn_free(knot);
    return space;
}

static long double det(const double *const x[4])
{
    long double e[3][3];

    for (int k = 0; k < 3; k++) {
        for (int c = 0; c < 3; c++)
            e[k][c] = (long double)x[k + 1][c] - x[0][c];
    }
    return e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) +
           e[0][1] * (e[1][2] * e[2][0] - e[1][0] * e[2][2]) +
           e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
}

/* n! / beta! lambda^beta, lambda by Cramer's rule. */
static void bernstein(const struct gsn_dms *space, size_t tet, const double u[3], double *ret)
{
    static const long double factorial[4] = { 1, 1, 2, 6 };
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const double *x[4];
    long double lambda[4];

    for (int k = 0; k < 4; k++)
        x[k] = mesh->vertex[mesh->tet[tet][k]];
    for (int k = 0; k < 4; k++) {
        const double *y[4] = { x[0], x[1], x[2], x[3] };

        y[k] = u;
        lambda[k] = det(y) / det(x);
        CHECK(lambda[k] > -1e-12L);
    }
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        long double value = factorial[gsn_dms_degree(space)];

        for (int k = 0; k < 4; k++) {
            for (int i = 0; i < beta[k]; i++)
                value *= lambda[k];
            value /= factorial[beta[k]];
        }
        ret[f] = (double)value;
    }
}

static struct gsn_spline *random_controls(const struct gsn_dms *space)
{
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 43;

    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = 2 * draw(&seed) - 1;
    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    return spline;
}

/* The functions at u against Bernstein's; returns the exact value of the spline. */
static double check_functions(const struct gsn_spline *spline, const double u[3], double *worst)
{
    static struct gsn_dms_term term[TERMS];
    const struct gsn_dms *space = gsn_spline_space(spline);
    double own[GSN_DMS_MAX_FUNCTIONS] = { 0 }, exact[GSN_DMS_MAX_FUNCTIONS], sum = 0;
    size_t home = 0, count;

    CHECK(gsn_dms_locate(space, u, 0, &home) == GSN_OK);
    CHECK(gsn_dms_basis(space, u, 0, &home, term, TERMS, &count) == GSN_OK);
    for (size_t i = 0; i < count; i++) {
        CHECK(term[i].tet == home);
        own[term[i].function] = term[i].value;
    }
    bernstein(space, home, u, exact);
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        CHECK_NEAR(own[f], exact[f], 1e-12);
        *worst = fmax(*worst, fabs(own[f] - exact[f]));
        sum += exact[f] * gsn_spline_controls(spline)[gsn_dms_control_ids(space, home)[f]];
    }
    return sum;
}

static void check_collapsed(const struct gsn_spline *spline, struct points points, double top)
{
    gsn_auto_mem(double) truth = gsn_alloc_array(2 * points.count, sizeof *truth);
    double(*slope)[3] = gsn_alloc_array(points.count, sizeof *slope);
    double *value = truth + points.count, worst = 0, quick = 0;

    for (size_t i = 0; i < points.count; i++)
        truth[i] =
            is_outside(points.at[i], top) ? NAN : check_functions(spline, points.at[i], &worst);
    for (enum path path = PATH_EVAL; path < PATHS; path++) {
        path_run(path, spline, (const double(*)[3])points.at, points.count, value, slope);
        for (size_t i = 0; i < points.count; i++) {
            CHECK(isnan(truth[i]) == isnan(value[i]));
            if (isnan(truth[i]))
                continue;
            CHECK_NEAR(value[i], truth[i], 1e-12);
            quick = fmax(quick, fabs(value[i] - truth[i]));
        }
    }
    print_message("n = %u, %zu points: collapsed N off by %.1e, quick values by %.1e at most\n",
                  gsn_dms_degree(gsn_spline_space(spline)), points.count, worst, quick);
    gsn_free(slope);
    free_points(&points);
}

TEST(collapsed_clouds_are_bernstein_polynomials)
{
    const struct gsn_lattice at = aligned(3, 12);
    gsn_auto(gsn_tets) large = bench_mesh(LARGE);
    gsn_auto(gsn_tets) kuhn = kuhn_mesh(CUBES, 0);

    for (int i = 0; i < 6; i++) {
        const unsigned degree = 1 + (unsigned)i % 3;
        const enum gsn_dms_sharing sharing = i < 3 ? GSN_DMS_SHARED : GSN_DMS_OWN;
        gsn_auto(gsn_dms) space = collapsed(large, degree, sharing);
        gsn_auto(gsn_dms) aligned_space = collapsed(kuhn, degree, sharing);
        gsn_auto(gsn_spline) spline = random_controls(space);
        gsn_auto(gsn_spline) aligned_spline = random_controls(aligned_space);

        check_collapsed(spline, random_points(1000, 1), 1);
        check_collapsed(aligned_spline, lattice_points(&at), 3);
        check_collapsed(aligned_spline, features(kuhn), 3);
    }
}
