/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/knots.h"

#include "tests/check.h"
#include "tests/model/formula.h"
#include "tests/model/kuhn.h"

#include <string.h>

static const size_t SMALL[3] = { 2, 2, 2 };

/* A vertex somewhere inside a tetrahedron and knots around it, up to reach away. */
static void draw_cloud(const struct gsn_tets *mesh, size_t tet, unsigned degree, double reach,
                       uint64_t *seed, double ret_cloud[GSN_DMS_MAX_DEGREE + 1][3])
{
    double u[3];

    draw_inside(mesh, tet, seed, u);
    for (unsigned l = 0; l <= degree; l++) {
        for (int c = 0; c < 3; c++)
            ret_cloud[l][c] = u[c] + (l > 0 ? reach * (2 * draw(seed) - 1) : 0);
    }
}

/* Two splines agree in cores and skins, around the new vertex, and outside. */
static void check_same(const struct gsn_spline *old, const struct gsn_dms *space,
                       const double *control, const double middle[3], uint64_t *seed)
{
    const struct gsn_dms *before = gsn_spline_space(old);

    for (size_t i = 0; i < 30; i++) {
        double u[3];

        if (i % 3 == 0)
            draw_in_skins(gsn_dms_mesh(space),
                          (size_t)(draw(seed) * (double)gsn_dms_mesh(space)->tet_count), seed, u);
        for (int c = 0; i % 3 == 1 && c < 3; c++)
            u[c] = middle[c] + 0.5 * (2 * draw(seed) - 1) * draw(seed);
        for (int c = 0; i % 3 == 2 && c < 3; c++)
            u[c] = 2.2 * draw(seed) - 0.1;
        CHECK_NEAR(formula_at(space, control, u, NULL),
                   formula_at(before, gsn_spline_controls(old), u, NULL), 1e-12);
    }
}

/* Counts what was taken and what was refused of some insertions. */
static void check_inserts(struct gsn_dms *made, double reach, uint64_t *seed, size_t count[2])
{
    gsn_auto(gsn_dms) space = made;
    gsn_auto(gsn_spline) spline = random_spline(space, seed);

    for (int i = 0; i < 12; i++) {
        const struct gsn_tets *mesh = gsn_dms_mesh(space);
        const size_t tet = (size_t)(draw(seed) * (double)mesh->tet_count);
        double cloud[GSN_DMS_MAX_DEGREE + 1][3], *control = NULL;
        gsn_auto(gsn_dms) split = NULL;
        struct gsn_error err = { 0 };
        int r;

        draw_cloud(mesh, tet, gsn_dms_degree(space), reach, seed, cloud);
        r = gsn_insert_vertex(spline, tet, (const double(*)[3])cloud, &split, &control, &err);
        count[r == GSN_OK]++;
        if (r < 0) {
            CHECK(r == GSN_E_MESH && strstr(err.text, "smaller knot clouds"));
            CHECK(split == NULL && control == NULL);
            continue;
        }
        CHECK(gsn_dms_mesh(split)->tet_count == mesh->tet_count + 3);
        CHECK(gsn_dms_mesh(split)->vertex_count == mesh->vertex_count + 1);
        check_same(spline, split, control, cloud[0], seed);
        gsn_free(control);
    }
}

TEST(an_inserted_vertex_changes_nothing_in_cores_in_skins_and_outside)
{
    uint64_t seed = 91;

    for (unsigned degree = 1; degree <= 3; degree++) {
        size_t small[2] = { 0 }, large[2] = { 0 };

        check_inserts(kuhn_space(SMALL, 0.2, degree, 0.02, GSN_DMS_OWN), 0.002, &seed, small);
        check_inserts(kuhn_space(SMALL, 0.2, degree, 0.02, GSN_DMS_SHARED), 0.002, &seed, small);
        CHECK(small[1] > 12);
        check_inserts(kuhn_space(SMALL, 0.2, degree, 0.02, GSN_DMS_OWN), 0.08, &seed, large);
        CHECK(large[0] > 2 && large[1] > 2);
    }
}

TEST(coinciding_knots_are_as_good)
{
    uint64_t seed = 93;

    for (unsigned degree = 1; degree <= 3; degree++) {
        size_t count[2] = { 0 };

        check_inserts(shrunk_space(SMALL, 0.2, degree, 0, GSN_DMS_OWN), 0, &seed, count);
        check_inserts(shrunk_space(SMALL, 0.2, degree, 0, GSN_DMS_OWN), 0.001, &seed, count);
        check_inserts(shrunk_space(SMALL, 0.2, degree, 1, GSN_DMS_OWN), 0, &seed, count);
        CHECK(count[1] > 24);
    }
}

TEST(slivers_are_as_good)
{
    uint64_t seed = 94;

    for (unsigned degree = 1; degree <= 3; degree++) {
        size_t count[2] = { 0 };

        check_inserts(flat_space(SMALL, 0.2, degree, 1e-4, GSN_DMS_OWN), 1e-7, &seed, count);
        CHECK(count[1] > 4);
    }
}

TEST(a_polynomial_gets_the_values_of_its_polar_form)
{
    uint64_t seed = 95;

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, degree, 0.05, GSN_DMS_OWN);
        const struct polynomial p = draw_polynomial(degree, &seed);
        gsn_auto_mem(double) control = polynomial_controls(&p, space);
        gsn_auto(gsn_spline) spline = NULL;
        gsn_auto(gsn_dms) split = NULL;
        double cloud[GSN_DMS_MAX_DEGREE + 1][3], *own = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
        do
            draw_cloud(gsn_dms_mesh(space), 20, degree, 0.002, &seed, cloud);
        while (gsn_insert_vertex(spline, 20, (const double(*)[3])cloud, &split, &own, &err) < 0);
        {
            gsn_auto_mem(double) truth = polynomial_controls(&p, split);

            for (size_t i = 0; i < gsn_dms_controls(split); i++)
                CHECK_NEAR(own[i], truth[i], 1e-12);
        }
        gsn_free(own);
    }
}

/* Corner 0 of the split tetrahedron is the new vertex; the others follow at the end. */
TEST(all_else_keeps_its_number)
{
    uint64_t seed = 97;
    gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0.2, 2, 0.02, GSN_DMS_OWN);
    gsn_auto(gsn_spline) spline = random_spline(space, &seed);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const uint32_t *old = mesh->tet[5];
    gsn_auto(gsn_dms) split = NULL;
    double cloud[GSN_DMS_MAX_DEGREE + 1][3] = { { 0 } }, *control = NULL;
    struct gsn_error err = { 0 };

    for (int i = 0; i < 12; i++) {
        for (int l = 0; l < 3; l++)
            cloud[l][i % 3] += mesh->vertex[old[i / 3]][i % 3] / 4;
    }
    CHECK_OK(gsn_insert_vertex(spline, 5, (const double(*)[3])cloud, &split, &control, &err), err);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const int differ = memcmp(mesh->tet[t], gsn_dms_mesh(split)->tet[t], sizeof *mesh->tet);

        CHECK((differ != 0) == (t == 5));
        for (size_t f = 0; t != 5 && f < 10; f++)
            CHECK(control[gsn_dms_control_ids(split, t)[f]] ==
                  gsn_spline_controls(spline)[gsn_dms_control_ids(space, t)[f]]);
    }
    for (size_t k = 0; k < 4; k++) {
        const uint32_t *made = gsn_dms_mesh(split)->tet[k == 0 ? 5 : mesh->tet_count + k - 1];

        for (size_t i = 0; i < 4; i++)
            CHECK(made[i] == (i == k ? mesh->vertex_count : old[i]));
    }
    CHECK(memcmp(gsn_dms_knots(space), gsn_dms_knots(split),
                 3 * mesh->vertex_count * sizeof *cloud) == 0);
    gsn_free(control);
}

TEST(what_cannot_be_inserted_is_refused_with_its_reason)
{
    uint64_t seed = 99;
    gsn_auto(gsn_dms) space = kuhn_space(SMALL, 0, 2, 0.02, GSN_DMS_OWN);
    gsn_auto(gsn_spline) spline = random_spline(space, &seed);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    gsn_auto(gsn_dms) split = NULL;
    double cloud[3][3] = { { 0 } }, *control = NULL;
    const double(*knots)[3] = (const double(*)[3])cloud;
    struct gsn_error err = { 0 };

    for (int i = 0; i < 12; i++) {
        for (int l = 0; l < 3; l++)
            cloud[l][i % 3] += mesh->vertex[mesh->tet[0][i / 3]][i % 3] / 4;
    }
    CHECK(gsn_insert_vertex(spline, 48, knots, &split, &control, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "tetrahedron 48 of 48"));
    CHECK(gsn_insert_vertex(spline, 1, knots, &split, &control, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "not lie inside tetrahedron 1"));
    cloud[2][0] += 0.4;
    CHECK(gsn_insert_vertex(spline, 0, knots, &split, &control, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "fold over"));
    cloud[2][0] = 1e9;
    CHECK(gsn_insert_vertex(spline, 0, knots, &split, &control, &err) == GSN_E_MESH);
    cloud[2][0] = NAN;
    CHECK(gsn_insert_vertex(spline, 0, knots, &split, &control, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "knot 2 of the new vertex"));
    cloud[0][1] = INFINITY;
    CHECK(gsn_insert_vertex(spline, 0, knots, &split, &control, &err) == GSN_E_INPUT);
    memcpy(cloud[0], mesh->vertex[mesh->tet[0][2]], sizeof cloud[0]);
    memcpy(cloud[2], cloud[0], sizeof cloud[0]);
    CHECK(gsn_insert_vertex(spline, 0, knots, &split, &control, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "not lie inside"));
    CHECK(split == NULL && control == NULL);
}

static int insert_once(const struct gsn_spline *spline, const double (*knots)[3],
                       struct gsn_error *err)
{
    gsn_auto(gsn_dms) split = NULL;
    double *control = NULL;
    int r = gsn_insert_vertex(spline, 0, knots, &split, &control, err);

    gsn_free(control);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    const size_t one[3] = { 1, 1, 1 };
    uint64_t seed = 101;
    gsn_auto(gsn_dms) space = kuhn_space(one, 0, 1, 0.02, GSN_DMS_OWN);
    gsn_auto(gsn_spline) spline = random_spline(space, &seed);
    double cloud[2][3] = { { 0 } };
    struct gsn_error err = { 0 };

    for (int i = 0; i < 12; i++) {
        for (int l = 0; l < 2; l++)
            cloud[l][i % 3] +=
                gsn_dms_mesh(space)->vertex[gsn_dms_mesh(space)->tet[0][i / 3]][i % 3] / 4;
    }
    CHECK_EVERY_OOM(insert_once(spline, (const double(*)[3])cloud, &err), err);
}
