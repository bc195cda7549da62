/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/tets.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include <string.h>

static const double CORNERS[6][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 },
                                      { 0, 0, 1 }, { 1, 1, 1 }, { 2, 2, 2 } };

static int make(size_t vertices, const uint32_t (*tet)[4], size_t tets, struct gsn_error *err)
{
    gsn_auto(gsn_tets) mesh = NULL;

    return gsn_tets_new(CORNERS, vertices, tet, tets, &mesh, err);
}

TEST(every_tetrahedron_is_turned_positive_and_knows_its_neighbours)
{
    const uint32_t tet[2][4] = { { 0, 1, 2, 3 }, { 1, 2, 3, 4 } };
    const uint32_t turned[2][4] = { { 0, 1, 3, 2 }, { 1, 2, 4, 3 } };
    gsn_auto(gsn_tets) mesh = NULL;
    gsn_auto(gsn_tets) again = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tets_new(CORNERS, 5, tet, 2, &mesh, &err), err);
    CHECK_OK(gsn_tets_new(CORNERS, 5, turned, 2, &again, &err), err);
    CHECK(memcmp(mesh->tet, tet, sizeof tet) == 0);
    CHECK(memcmp(again->tet[0], tet[0], sizeof tet[0]) == 0);
    CHECK_NEAR(gsn_tets_volume(mesh, 0), 1.0 / 6, 1e-16);
    CHECK_NEAR(gsn_tets_volume(mesh, 1), 1.0 / 3, 1e-16);
    CHECK(mesh->neighbour[0][0] == 1 && mesh->neighbour[1][3] == 0);
    CHECK(mesh->neighbour[0][1] == -1 && mesh->neighbour[1][0] == -1);
}

TEST(a_box_of_cubes_is_filled_and_closed)
{
    const size_t cells[3] = { 3, 2, 4 };
    gsn_auto(gsn_tets) mesh = kuhn_mesh(cells, 0.2);
    double volume = 0;
    size_t outer = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        volume += gsn_tets_volume(mesh, t);
        for (int k = 0; k < 4; k++) {
            const int32_t other = mesh->neighbour[t][k];
            int back = 0;

            outer += other < 0;
            for (int j = 0; other >= 0 && j < 4; j++)
                back += mesh->neighbour[other][j] == (int32_t)t;
            CHECK(back == (other >= 0));
        }
    }
    CHECK_NEAR(volume, 24, 1e-12);
    CHECK(outer == 2 * 2 * (3 * 2 + 2 * 4 + 4 * 3));
}

TEST(what_is_no_mesh_is_refused_with_its_reason)
{
    const uint32_t range[1][4] = { { 0, 1, 2, 9 } }, flat[1][4] = { { 0, 4, 5, 1 } };
    const uint32_t twice[2][4] = { { 0, 1, 2, 3 }, { 0, 1, 2, 4 } };
    const uint32_t three[3][4] = { { 0, 1, 2, 3 }, { 1, 2, 3, 4 }, { 1, 2, 3, 5 } };
    const uint32_t one[1][4] = { { 0, 1, 2, 3 } };
    const double broken[4][3] = { { 0, 0, 0 }, { 1, NAN, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK(make(4, range, 1, &err) == GSN_E_MESH && strstr(err.text, "vertex 9"));
    CHECK(make(6, flat, 1, &err) == GSN_E_MESH && strstr(err.text, "flat"));
    CHECK(make(5, twice, 2, &err) == GSN_E_MESH && strstr(err.text, "overlap"));
    CHECK(make(6, three, 3, &err) == GSN_E_MESH && strstr(err.text, "more than two"));
    CHECK(make(5, one, 1, &err) == GSN_E_MESH && strstr(err.text, "vertex 4 belongs to no"));
    CHECK(make(4, one, 0, &err) == GSN_E_MESH);
    CHECK(gsn_tets_new(broken, 4, one, 1, &mesh, &err) == GSN_E_MESH &&
          strstr(err.text, "vertex 1"));
    CHECK(mesh == NULL);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const uint32_t tet[2][4] = { { 0, 1, 2, 3 }, { 1, 2, 3, 4 } };
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(make(5, tet, 2, &err), err);
}
