/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/dms.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include <string.h>

enum { ROOM = 4000 };

static const size_t CUBE[3] = { 4, 4, 4 };
static const size_t SMALL[3] = { 2, 2, 2 };

static double sum_at(const struct gsn_dms *space, const double u[3], size_t *hint)
{
    struct gsn_dms_term term[ROOM];
    size_t count;
    double sum = 0;

    CHECK(gsn_dms_basis(space, u, 0, hint, term, ROOM, &count) == GSN_OK);
    CHECK(count <= ROOM);
    for (size_t i = 0; i < count; i++)
        sum += term[i].value;
    return sum;
}

static void check_ones(double jitter, unsigned degree, double fraction)
{
    gsn_auto(gsn_dms) space = kuhn_space(CUBE, jitter, degree, fraction, GSN_DMS_SHARED);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    uint64_t seed = 3;
    size_t hint = 0;

    for (size_t t = 0; t < mesh->tet_count; t += 3) {
        const uint32_t *v = mesh->tet[t];
        double u[3];

        draw_inside(mesh, t, &seed, u);
        CHECK_NEAR(sum_at(space, u, &hint), 1, 1e-12);
        /* Vertices, the middles of edges and of faces, as far as they are inside the cube. */
        for (unsigned subset = 1; subset < 15; subset++) {
            double weight = 0;
            int inner = 1;

            memset(u, 0, sizeof u);
            for (int k = 0; k < 4; k++) {
                weight += subset >> k & 1;
                for (int c = 0; c < 3; c++)
                    u[c] += (subset >> k & 1) * mesh->vertex[v[k]][c];
            }
            for (int c = 0; c < 3; c++) {
                u[c] /= weight;
                inner = inner && u[c] >= 0 && u[c] < 4;
            }
            if (inner)
                CHECK_NEAR(sum_at(space, u, &hint), 1, 1e-12);
        }
    }
}

TEST(the_basis_sums_to_one_on_vertices_edges_faces_and_inside)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        check_ones(0, degree, 0.01);
        check_ones(0, degree, 0.1);
        check_ones(0.2, degree, 0.01);
        check_ones(0.2, degree, 0.1);
    }
}

TEST(the_basis_sums_to_one_on_a_voxel_grid_that_lies_in_the_mesh_planes)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0, degree, 0.05, GSN_DMS_SHARED);
        size_t hint = 0;

        for (int i = 0; i < 16 * 16 * 16; i++) {
            const double u[3] = { i % 16 / 8.0, i / 16 % 16 / 8.0, i / 256 / 8.0 };

            CHECK_NEAR(sum_at(space, u, &hint), 1, 1e-12);
        }
    }
}

TEST(every_point_of_the_half_open_cube_lies_in_one_tetrahedron_whatever_the_hint)
{
    gsn_auto(gsn_dms) space = kuhn_space(CUBE, 0, 1, 0.02, GSN_DMS_SHARED);
    const size_t tets = gsn_dms_mesh(space)->tet_count;
    uint64_t seed = 5;

    for (int i = 0; i < 9 * 9 * 9; i++) {
        const double u[3] = { i % 9 / 2.0, i / 9 % 9 / 2.0, i / 81 / 2.0 };
        const int inside = u[0] < 4 && u[1] < 4 && u[2] < 4;
        size_t first = 0, again = 0;

        CHECK(gsn_dms_locate(space, u, 0, &first) == (inside ? GSN_OK : GSN_DMS_OUTSIDE));
        for (int h = 0; h < 5; h++) {
            const size_t hint = (size_t)(draw(&seed) * (double)tets);

            CHECK(gsn_dms_locate(space, u, hint, &again) == (inside ? GSN_OK : GSN_DMS_OUTSIDE));
            CHECK(again == first);
        }
    }
}

TEST(a_point_that_is_no_point_lies_outside)
{
    gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0, 2, 0.02, GSN_DMS_SHARED);
    const double strange[3][3] = { { NAN, 1, 1 }, { 1, INFINITY, 1 }, { 1, 1, -1e300 } };

    for (int i = 0; i < 3; i++) {
        size_t hint = 99999, tet = 7, count = 5;

        CHECK(gsn_dms_locate(space, strange[i], hint, &tet) == GSN_DMS_OUTSIDE);
        CHECK(tet == 7);
        CHECK(gsn_dms_basis(space, strange[i], 1, &hint, NULL, 0, &count) == GSN_DMS_OUTSIDE);
        CHECK(count == 0 && hint == 99999);
    }
}

/* The straight way from one arm of the U to the other leads out of the domain. */
TEST(a_notch_in_the_domain_does_not_stop_the_search)
{
    const size_t cells[3] = { 6, 2, 1 };
    gsn_auto(gsn_tets) all = kuhn_mesh(cells, 0);
    gsn_auto(gsn_tets) mesh = NULL;
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto_mem(uint32_t) kept = gsn_alloc_array(4 * all->tet_count, sizeof *kept);
    double(*knots)[3] = NULL;
    struct gsn_error err = { 0 };
    size_t count = 0, from, to;

    for (size_t t = 0; t < all->tet_count; t++) {
        double x = 0, y = 0;

        for (int k = 0; k < 4; k++) {
            x += all->vertex[all->tet[t][k]][0] / 4;
            y += all->vertex[all->tet[t][k]][1] / 4;
        }
        if (!(y > 1 && x > 2 && x < 3))
            memcpy(&kept[4 * count++], all->tet[t], sizeof *all->tet);
    }
    CHECK_OK(gsn_tets_new((const double(*)[3])all->vertex, all->vertex_count,
                          (const uint32_t(*)[4])kept, count, &mesh, &err),
             err);
    CHECK_OK(gsn_dms_clouds(mesh, 2, 0.02, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, 2, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err), err);
    CHECK(gsn_dms_locate(space, (const double[3]){ 0.3, 1.7, 0.4 }, 0, &from) == GSN_OK);
    CHECK(gsn_dms_locate(space, (const double[3]){ 5.3, 1.7, 0.4 }, from, &to) == GSN_OK);
    CHECK(gsn_dms_locate(space, (const double[3]){ 2.5, 1.5, 0.5 }, from, &to) == GSN_DMS_OUTSIDE);
    gsn_free(knots);
}

static void check_polynomial(unsigned degree, enum gsn_dms_sharing sharing)
{
    gsn_auto(gsn_dms) space = kuhn_space(CUBE, 0.2, degree, 0.08, sharing);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    uint64_t seed = 11;
    const struct polynomial p = draw_polynomial(degree, &seed);
    gsn_auto_mem(double) control = polynomial_controls(&p, space);
    size_t hint = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        static struct gsn_dms_term term[ROOM];
        double u[3], slope[3], s = 0, own[3] = { 0 };
        size_t count;
        const double truth = (draw_inside(mesh, t, &seed, u), polynomial_at(&p, u, slope));

        CHECK(gsn_dms_basis(space, u, 1, &hint, term, ROOM, &count) == GSN_OK);
        for (size_t i = 0; i < count; i++) {
            s += control[term[i].control] * term[i].value;
            for (int c = 0; c < 3; c++)
                own[c] += control[term[i].control] * term[i].gradient[c];
        }
        CHECK_NEAR(s, truth, 1e-10);
        for (int c = 0; c < 3; c++)
            CHECK_NEAR(own[c], slope[c], 1e-8);
    }
}

TEST(polynomials_up_to_the_degree_are_reproduced_with_their_gradient)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        check_polynomial(degree, GSN_DMS_SHARED);
        check_polynomial(degree, GSN_DMS_OWN);
    }
}

TEST(control_points_are_shared_by_the_multiset_of_vertices)
{
    /* Counted by hand: V, V + E and V + 2 E + F of a box of Kuhn cubes. */
    const size_t truth[4] = { 0, 27, 27 + 98, 27 + 2 * 98 + 120 };

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) shared = kuhn_space(SMALL, 0, degree, 0.02, GSN_DMS_SHARED);
        gsn_auto(gsn_dms) own = kuhn_space(SMALL, 0, degree, 0.02, GSN_DMS_OWN);

        CHECK(gsn_dms_controls(shared) == truth[degree]);
        CHECK(gsn_dms_controls(own) == 48 * gsn_dms_functions(own));
    }
}

TEST(the_same_mesh_gives_the_same_clouds_of_the_promised_size)
{
    gsn_auto(gsn_tets) mesh = kuhn_mesh(SMALL, 0);
    double(*first)[3] = NULL, (*second)[3] = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_dms_clouds(mesh, 3, 0.02, &first, &err), err);
    CHECK_OK(gsn_dms_clouds(mesh, 3, 0.02, &second, &err), err);
    CHECK(memcmp(first, second, 27 * 4 * sizeof *first) == 0);
    for (size_t i = 0; i < 27 * 4; i++) {
        const double *v = first[i / 4 * 4];
        const double away = sqrt(pow(first[i][0] - v[0], 2) + pow(first[i][1] - v[1], 2) +
                                 pow(first[i][2] - v[2], 2));

        /* The smallest altitude of a Kuhn tetrahedron of edge 1 is sqrt(1/2). */
        CHECK_NEAR(away, i % 4 ? 0.02 * sqrt(0.5) : 0, 1e-15);
        for (int c = 0; c < 3; c++) {
            CHECK(v[c] != 0 || first[i][c] <= 0);
            CHECK(v[c] != 2 || first[i][c] >= 2);
        }
    }
    gsn_free(first);
    gsn_free(second);
}

TEST(clouds_that_are_asked_too_large_are_shrunk_until_they_are_valid)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(CUBE, 0.2, degree, 0.5, GSN_DMS_SHARED);
        uint64_t seed = 17;
        size_t hint = 0;

        for (size_t t = 0; t < gsn_dms_mesh(space)->tet_count; t++) {
            double u[3];

            draw_inside(gsn_dms_mesh(space), t, &seed, u);
            CHECK_NEAR(sum_at(space, u, &hint), 1, 1e-11);
        }
    }
}

/* Clouds of a mesh with one knot replaced. */
static int with_knot(const struct gsn_tets *mesh, unsigned degree, size_t which, double x,
                     struct gsn_dms **ret_space, struct gsn_error *err)
{
    double(*knots)[3] = NULL;
    int r = gsn_dms_clouds(mesh, 2, 0.02, &knots, err);

    if (r == GSN_OK) {
        for (int c = 0; c < 3; c++)
            knots[which][c] = x;
        r = gsn_dms_new(mesh, degree, (const double(*)[3])knots, GSN_DMS_SHARED, ret_space, err);
    }
    gsn_free(knots);
    return r;
}

TEST(what_is_no_space_is_refused_with_its_reason)
{
    gsn_auto(gsn_tets) mesh = kuhn_mesh(SMALL, 0);
    struct gsn_dms *space = NULL;
    double(*knots)[3] = NULL;
    struct gsn_error err = { 0 };

    CHECK(with_knot(mesh, 4, 1, 0, &space, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "degree 4"));
    CHECK(with_knot(mesh, 0, 1, 0, &space, &err) == GSN_E_INPUT);
    CHECK(with_knot(mesh, 2, 3 * 13 + 1, NAN, &space, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "knot 1 of vertex 13"));
    CHECK(with_knot(mesh, 2, 3 * 13, 1.01, &space, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "knot 0 of vertex 13"));
    CHECK(with_knot(mesh, 2, 3 * 13 + 2, -0.5, &space, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "tetrahedron ") && strstr(err.text, "fold over"));
    CHECK(gsn_dms_clouds(mesh, 4, 0.02, &knots, &err) == GSN_E_INPUT);
    CHECK(gsn_dms_clouds(mesh, 2, NAN, &knots, &err) == GSN_E_INPUT);
    CHECK(gsn_dms_clouds(mesh, 2, -1, &knots, &err) == GSN_E_INPUT);
    CHECK(space == NULL && knots == NULL);
}

static int whole_way(const struct gsn_tets *mesh, struct gsn_error *err)
{
    double(*knots)[3] = NULL;
    gsn_auto(gsn_dms) space = NULL;
    int r = gsn_dms_clouds(mesh, 2, 0.02, &knots, err);

    if (r == GSN_OK)
        r = gsn_dms_new(mesh, 2, (const double(*)[3])knots, GSN_DMS_SHARED, &space, err);
    gsn_free(knots);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    const size_t one[3] = { 1, 1, 1 };
    gsn_auto(gsn_tets) mesh = kuhn_mesh(one, 0);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(whole_way(mesh, &err), err);
}
