/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/tetgen_bridge.h"

#include "pipeline/model/domain_internal.h"
#include "pipeline/model/tets.h"

#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

static const struct gsn_tetgen_options QUALITY = { 0, 1.4, 12 };

static struct gsn_tets *verified(const struct gsn_soup *soup)
{
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(
        gsn_tets_new(soup->vertex, soup->vertex_count, soup->tet, soup->tet_count, &mesh, &err),
        err);
    return mesh;
}

TEST(a_cube_is_filled_with_small_tetrahedra)
{
    gsn_auto(gsn_surface) cube = shape_cube(2);
    const struct gsn_mesh_question question = { .options = { 0.05, 1.4, 12 }, .surface = cube };
    gsn_auto(gsn_soup) soup = NULL;
    gsn_auto(gsn_tets) mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tetgen_mesh(&question, &soup, &err), err);
    mesh = verified(soup);
    CHECK_NEAR(gsn_domain_volume(mesh), 8, 1e-12);
    CHECK_NEAR(gsn_domain_area(mesh), 24, 1e-12);
    for (size_t t = 0; t < mesh->tet_count; t++)
        CHECK(gsn_tets_volume(mesh, t) <= 0.05 * (1 + 1e-12));
}

/* TetGen 1.5.0 frees its mesh twice when it throws; without the mend this test dies. */
TEST(crossing_tetrahedra_are_refused_again_and_again)
{
    gsn_auto(gsn_surface) crossing = shape_crossing();
    const struct gsn_mesh_question question = { .options = QUALITY, .surface = crossing };
    gsn_auto(gsn_soup) soup = NULL;
    struct gsn_error err = { 0 };

    for (unsigned i = 0; i < 3; i++) {
        CHECK(gsn_tetgen_mesh(&question, &soup, &err) == GSN_E_MESH);
        CHECK(strstr(err.text, "crosses itself"));
        CHECK(soup == NULL);
    }
}

TEST(an_open_surface_yields_no_mesh)
{
    gsn_auto(gsn_surface) cube = shape_cube(2);
    const struct gsn_mesh_question question = { .options = QUALITY, .surface = cube };
    gsn_auto(gsn_soup) soup = NULL;
    struct gsn_error err = { 0 };

    cube->facet_count--;
    CHECK(gsn_tetgen_mesh(&question, &soup, &err) == GSN_E_MESH);
    CHECK(soup == NULL);
}

TEST(options_out_of_range_are_refused)
{
    static const struct gsn_tetgen_options WRONG[] = {
        { -1, 1.4, 12 }, { NAN, 1.4, 12 }, { 0, 0.5, 12 }, { 0, 1.4, 60 }, { 0, NAN, 12 }
    };
    gsn_auto(gsn_surface) cube = shape_cube(2);
    gsn_auto(gsn_soup) soup = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof WRONG / sizeof *WRONG; i++) {
        const struct gsn_mesh_question question = { .options = WRONG[i], .surface = cube };

        CHECK(gsn_tetgen_mesh(&question, &soup, &err) == GSN_E_INPUT);
        CHECK(i != 2 || strstr(err.text, "a radius-edge ratio of 0.5 (1.1 to 10)"));
        CHECK(soup == NULL);
    }
}

static int mesh_once(const struct gsn_mesh_question *question, struct gsn_error *err)
{
    gsn_auto(gsn_soup) soup = NULL;

    return gsn_tetgen_mesh(question, &soup, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_surface) cube = shape_cube(2);
    const struct gsn_mesh_question question = { .options = QUALITY, .surface = cube };
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(mesh_once(&question, &err), err);
}
