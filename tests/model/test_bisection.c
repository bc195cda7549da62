/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/bisection.h"

#include "pipeline/model/domain_internal.h"

#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

static int two_blocks_and_a_step(size_t x, size_t y, size_t z)
{
    return (x < 4 && (y < 2 || z < 2)) || x > 8;
}

static double det(const double *o, const double *a, const double *b, const double *c)
{
    double u[3], v[3], w[3];

    for (size_t k = 0; k < 3; k++) {
        u[k] = a[k] - o[k];
        v[k] = b[k] - o[k];
        w[k] = c[k] - o[k];
    }
    return u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) +
           u[2] * (v[0] * w[1] - v[1] * w[0]);
}

/* The tetrahedron that holds p, by trying them all. */
static size_t holder(const struct gsn_tets *mesh, const double p[3])
{
    double best = -INFINITY;
    size_t found = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double *v[4];
        double least;

        for (size_t c = 0; c < 4; c++)
            v[c] = mesh->vertex[mesh->tet[t][c]];
        least = fmin(fmin(det(p, v[1], v[2], v[3]), det(v[0], p, v[2], v[3])),
                     fmin(det(v[0], v[1], p, v[3]), det(v[0], v[1], v[2], p))) /
                det(v[0], v[1], v[2], v[3]);
        if (least > best) {
            best = least;
            found = t;
        }
    }
    return found;
}

TEST(limits_are_kept_and_the_domain_stays)
{
    gsn_auto(gsn_mask) region = shape_mask(10, 5, 5, 16, 16, 24, two_blocks_and_a_step);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 6000);
    gsn_auto(gsn_tets) fine = NULL;
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
    struct gsn_error err = { 0 };

    CHECK(limit);
    for (size_t t = 0; t < mesh->tet_count; t++)
        limit[t] = mesh->vertex[mesh->tet[t][0]][0] > 60 ? 0 : gsn_tets_volume(mesh, t) / 3;
    CHECK_OK(gsn_tets_bisect(mesh, limit, &fine, &err), err);

    CHECK(fine->tet_count > mesh->tet_count);
    CHECK_NEAR(gsn_domain_volume(fine) / gsn_domain_volume(mesh), 1, 1e-9);
    CHECK_NEAR(gsn_domain_area(fine) / gsn_domain_area(mesh), 1, 1e-9);
    for (size_t t = 0; t < fine->tet_count; t++) {
        double centre[3] = { 0 };
        size_t place;

        for (size_t c = 0; c < 4; c++)
            for (size_t k = 0; k < 3; k++)
                centre[k] += fine->vertex[fine->tet[t][c]][k] / 4;
        place = holder(mesh, centre);
        CHECK(limit[place] == 0 || gsn_tets_volume(fine, t) <= limit[place] * (1 + 1e-9));
    }
}

TEST(without_limits_the_mesh_is_the_same)
{
    gsn_auto(gsn_mask) region = shape_mask(6, 6, 6, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 6000);
    gsn_auto(gsn_tets) fine = NULL;
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
    struct gsn_error err = { 0 };

    CHECK(limit);
    CHECK_OK(gsn_tets_bisect(mesh, limit, &fine, &err), err);
    CHECK(fine->tet_count == mesh->tet_count && fine->vertex_count == mesh->vertex_count);
    CHECK(memcmp(fine->vertex, mesh->vertex, mesh->vertex_count * sizeof *mesh->vertex) == 0);
    CHECK(memcmp(fine->tet, mesh->tet, mesh->tet_count * sizeof *mesh->tet) == 0);
}

/* Kuhn's tetrahedron, of which Maubach 1995 proves it: three bisections by the longest edge make
 * eight pieces of one volume and at most three shapes, and again and again. */
TEST(eight_pieces_of_a_kuhn_tetrahedron_are_alike)
{
    static const double VERTEX[4][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 1, 1, 0 }, { 1, 1, 1 } };
    static const uint32_t TET[1][4] = { { 0, 1, 2, 3 } };
    gsn_auto(gsn_tets) one = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tets_new(VERTEX, 4, TET, 1, &one, &err), err);
    for (unsigned halvings = 1; halvings <= 6; halvings++) {
        gsn_auto(gsn_tets) fine = NULL;
        const double limit = 1. / 6 / (1 << halvings);

        CHECK_OK(gsn_tets_bisect(one, &limit, &fine, &err), err);
        CHECK(fine->tet_count == (size_t)1 << halvings);
        for (size_t t = 0; t < fine->tet_count; t++)
            CHECK_NEAR(gsn_tets_volume(fine, t), limit, 1e-15);
    }
}

/* Smallest altitude over longest edge. */
static double quality_of(const struct gsn_tets *mesh)
{
    double least = 1;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        double longest = 0, area = 0;

        for (unsigned c = 0; c < 4; c++)
            for (unsigned d = 0; d < c; d++) {
                const double *u = mesh->vertex[mesh->tet[t][c]], *v = mesh->vertex[mesh->tet[t][d]];

                longest = fmax(longest, hypot(hypot(u[0] - v[0], u[1] - v[1]), u[2] - v[2]));
            }
        for (unsigned c = 0; c < 4; c++) {
            const double *o = mesh->vertex[mesh->tet[t][c]],
                         *p = mesh->vertex[mesh->tet[t][(c + 1) % 4]],
                         *q = mesh->vertex[mesh->tet[t][(c + 2) % 4]];
            double u[3], v[3];

            for (size_t k = 0; k < 3; k++) {
                u[k] = p[k] - o[k];
                v[k] = q[k] - o[k];
            }
            area = fmax(area, hypot(hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2]),
                                    u[0] * v[1] - u[1] * v[0]) /
                                  2);
        }
        least = fmin(least, 3 * gsn_tets_volume(mesh, t) / area / longest);
    }
    return least;
}

/* Refined ever more towards one corner, tetrahedra of a Delaunay mesh stay as good as they were to
 * a factor that does not grow. */
TEST(no_tetrahedron_degenerates_however_often_it_is_halved)
{
    gsn_auto(gsn_mask) region = shape_mask(6, 6, 6, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 6000);
    const double before = quality_of(mesh);
    struct gsn_error err = { 0 };

    for (unsigned round = 0; round < 4; round++) {
        gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
        struct gsn_tets *fine = NULL;

        CHECK(limit);
        for (size_t t = 0; t < mesh->tet_count; t++) {
            const double *at = mesh->vertex[mesh->tet[t][0]];

            limit[t] = fmax(at[0], fmax(at[1], at[2])) < 60. / (1 << round)
                           ? gsn_tets_volume(mesh, t) / 8
                           : 0;
        }
        CHECK_OK(gsn_tets_bisect(mesh, limit, &fine, &err), err);
        gsn_tets_free(mesh);
        mesh = fine;
        CHECK(quality_of(mesh) > before / 4);
    }
}

TEST(a_limit_that_is_no_volume_is_refused)
{
    gsn_auto(gsn_mask) region = shape_mask(3, 3, 3, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 6000);
    gsn_auto(gsn_tets) fine = NULL;
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
    struct gsn_error err = { 0 };

    CHECK(limit);
    limit[3] = NAN;
    CHECK(gsn_tets_bisect(mesh, limit, &fine, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "tetrahedron 3"));
    limit[3] = -1;
    CHECK(gsn_tets_bisect(mesh, limit, &fine, &err) == GSN_E_INPUT);
    CHECK(fine == NULL);
}

static int refine_once(const struct gsn_tets *mesh, const double *limit, struct gsn_error *err)
{
    gsn_auto(gsn_tets) fine = NULL;

    return gsn_tets_bisect(mesh, limit, &fine, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = shape_mask(1, 1, 1, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 6000);
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
    struct gsn_error err = { 0 };

    CHECK(limit);
    limit[0] = gsn_tets_volume(mesh, 0) / 2;
    CHECK_EVERY_OOM(refine_once(mesh, limit, &err), err);
}
