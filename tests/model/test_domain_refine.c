/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain.h"

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
    const struct gsn_domain_options options = shape_options(24, 6000);
    struct gsn_error err = { 0 };

    CHECK(limit);
    for (size_t t = 0; t < mesh->tet_count; t++)
        limit[t] = mesh->vertex[mesh->tet[t][0]][0] > 60 ? 0 : gsn_tets_volume(mesh, t) / 3;
    CHECK_OK(gsn_domain_refine(mesh, limit, &options, &fine, &err), err);

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

TEST(without_limits_hardly_anything_changes)
{
    gsn_auto(gsn_mask) region = shape_mask(6, 6, 6, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 6000);
    gsn_auto(gsn_tets) fine = NULL;
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
    const struct gsn_domain_options options = shape_options(24, 6000);
    struct gsn_error err = { 0 };

    CHECK(limit);
    CHECK_OK(gsn_domain_refine(mesh, limit, &options, &fine, &err), err);
    CHECK((double)fine->tet_count < 1.2 * (double)mesh->tet_count);
}

TEST(a_limit_that_is_no_volume_is_refused)
{
    gsn_auto(gsn_mask) region = shape_mask(3, 3, 3, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 6000);
    gsn_auto(gsn_tets) fine = NULL;
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
    const struct gsn_domain_options options = shape_options(24, 6000);
    struct gsn_error err = { 0 };

    CHECK(limit);
    limit[3] = NAN;
    CHECK(gsn_domain_refine(mesh, limit, &options, &fine, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "tetrahedron 3"));
    limit[3] = -1;
    CHECK(gsn_domain_refine(mesh, limit, &options, &fine, &err) == GSN_E_INPUT);
    CHECK(fine == NULL);
}

static int refine_once(const struct gsn_tets *mesh, const double *limit, struct gsn_error *err)
{
    const struct gsn_domain_options options = shape_options(24, 6000);
    gsn_auto(gsn_tets) fine = NULL;

    return gsn_domain_refine(mesh, limit, &options, &fine, err);
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
