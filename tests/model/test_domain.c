/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/domain.h"

#include "pipeline/core/file.h"
#include "pipeline/model/domain_internal.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

static double largest(const struct gsn_tets *mesh)
{
    double most = 0;

    for (size_t t = 0; t < mesh->tet_count; t++)
        most = fmax(most, gsn_tets_volume(mesh, t));
    return most;
}

/* How many pieces hang together through faces. */
static size_t parts(const struct gsn_tets *mesh)
{
    gsn_auto_mem(uint32_t) stack = gsn_alloc_array(mesh->tet_count, sizeof *stack);
    gsn_auto_mem(uint8_t) seen = gsn_alloc_array(mesh->tet_count, 1);
    size_t count = 0;

    CHECK(stack && seen);
    for (size_t start = 0; start < mesh->tet_count; start++) {
        size_t depth = 0;

        if (seen[start])
            continue;
        count++;
        seen[start] = 1;
        stack[depth++] = (uint32_t)start;
        while (depth > 0) {
            const size_t t = stack[--depth];

            for (size_t k = 0; k < 4; k++) {
                const int32_t next = mesh->neighbour[t][k];

                if (next < 0 || seen[next])
                    continue;
                seen[next] = 1;
                stack[depth++] = (uint32_t)next;
            }
        }
    }
    return count;
}

static int corner_block(size_t x, size_t y, size_t z)
{
    return (x < 4 && y < 4) || (x < 4 && z < 3) || (y < 4 && x < 8 && z > 5);
}

TEST(an_anisotropic_region_with_reentrant_corners_is_filled_to_size)
{
    gsn_auto(gsn_mask) region = shape_mask(10, 9, 8, 16, 16, 24, corner_block);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 24, 3000);
    gsn_auto(gsn_cells) cells = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_cells_cover(region, 24, &cells, &err), err);
    CHECK_OK(gsn_cells_close(cells, &err), err);
    CHECK_NEAR(gsn_domain_volume(mesh) / gsn_cells_volume(cells), 1, 1e-9);
    CHECK(largest(mesh) <= 3000 * (1 + 1e-9));
    CHECK(parts(mesh) == 1);
}

static int two_blocks(size_t x, size_t y, size_t z)
{
    (void)y;
    (void)z;
    return x < 2 || x > 8;
}

TEST(two_separate_parts_are_meshed_as_two)
{
    gsn_auto(gsn_mask) region = shape_mask(11, 3, 3, 16, 16, 24, two_blocks);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 16, 2000);

    CHECK(parts(mesh) == 2);
}

static int ball_with_hole(size_t x, size_t y, size_t z)
{
    const double dx = (double)x - 8, dy = (double)y - 8, dz = (double)z - 8;
    const double r = dx * dx + dy * dy + dz * dz;

    return r < 64 && r > 30;
}

TEST(a_cavity_becomes_part_of_the_domain)
{
    gsn_auto(gsn_mask) region = shape_mask(17, 17, 17, 10, 10, 10, ball_with_hole);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 10, 1000);

    /* Larger than the ball of 8 voxels' radius, so nothing of the hole is left. */
    CHECK(gsn_domain_volume(mesh) > 4 * M_PI / 3 * 80 * 80 * 80);
    CHECK(parts(mesh) == 1);
}

TEST(the_same_region_gives_the_same_bytes)
{
    gsn_auto(gsn_mask) region = shape_mask(10, 9, 8, 16, 16, 24, corner_block);
    gsn_auto(gsn_tets) a = shape_mesh(region, 24, 3000);
    gsn_auto(gsn_tets) b = shape_mesh(region, 24, 3000);

    CHECK(a->tet_count == b->tet_count && a->vertex_count == b->vertex_count);
    CHECK(memcmp(a->vertex, b->vertex, a->vertex_count * sizeof *a->vertex) == 0);
    CHECK(memcmp(a->tet, b->tet, a->tet_count * sizeof *a->tet) == 0);
}

TEST(neighbours_in_space_are_neighbours_in_memory)
{
    gsn_auto(gsn_mask) region = shape_mask(10, 9, 8, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 16, 700);
    double sum = 0;
    size_t faces = 0;

    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            if (mesh->neighbour[t][k] >= 0) {
                sum += fabs((double)mesh->neighbour[t][k] - (double)t);
                faces++;
            }
    /* Without an order the mean distance of two numbers is a third of their range. */
    CHECK(sum / (double)faces < 0.06 * (double)mesh->tet_count);
}

TEST(a_mesh_of_another_region_does_not_verify)
{
    gsn_auto(gsn_mask) region = shape_mask(4, 4, 4, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_mask) other = shape_mask(4, 4, 4, 16, 16, 24, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 16, 3000);
    gsn_auto(gsn_tets) moved = NULL;
    gsn_auto(gsn_cells) cells = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_cells_cover(region, 16, &cells, &err), err);
    CHECK_OK(gsn_domain_verify_cells(mesh, cells, region, &err), err);

    /* The right volume and area at the wrong place. */
    moved = shape_mesh(region, 16, 3000);
    for (size_t v = 0; v < moved->vertex_count; v++)
        moved->vertex[v][0] += 3;
    CHECK(gsn_domain_verify_cells(moved, cells, region, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "not on the surface") || strstr(err.text, "outside"));

    /* Voxels that no tetrahedron holds. */
    other->at.origin_um.z += 48;
    CHECK(gsn_domain_verify_cells(mesh, cells, other, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "voxel"));

    /* A tetrahedron too few. */
    mesh->tet_count--;
    CHECK(gsn_domain_verify_cells(mesh, cells, region, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "volume"));
}

TEST(crossing_tetrahedra_and_open_surfaces_come_back_as_refusals)
{
    const struct gsn_domain_options options = shape_options(1, 1);
    gsn_auto(gsn_surface) crossing = shape_crossing();
    gsn_auto(gsn_surface) open = shape_cube(1);
    struct gsn_mesh_question question = { .surface = crossing };
    gsn_auto(gsn_tets) mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_domain_ask(&options, &question, &mesh, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "crosses itself"));
    open->facet_count--;
    question.surface = open;
    CHECK(gsn_domain_ask(&options, &question, &mesh, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "not closed"));
    CHECK(mesh == NULL);
}

static int build_in(const struct gsn_mask *region, const char *mesher, unsigned wall_s,
                    struct gsn_error *err)
{
    struct gsn_domain_options options = shape_options(16, 3000);
    gsn_auto(gsn_tets) mesh = NULL;
    int r;

    options.mesher = mesher;
    options.wall_s = wall_s;
    r = gsn_domain_build(region, &options, &mesh, err);
    CHECK(r >= 0 || mesh == NULL);
    return r;
}

static int build_with(const char *mesher, unsigned wall_s, struct gsn_error *err)
{
    gsn_auto(gsn_mask) region = shape_mask(3, 3, 3, 16, 16, 24, shape_everywhere);

    return build_in(region, mesher, wall_s, err);
}

TEST(a_mesher_that_hangs_is_killed_at_its_time_limit)
{
    const time_t before = time(NULL);
    struct gsn_error err = { 0 };

    CHECK(build_with(GSN_FIXTURES "/domain/hanging_mesher", 1, &err) == GSN_E_PROCESS);
    CHECK(strstr(err.text, "within 1 s"));
    CHECK(time(NULL) - before <= 5);
}

/* Case 54. */
TEST(a_mesher_that_dies_babbles_or_is_missing_is_an_error)
{
    struct gsn_error err = { 0 };

    CHECK(build_with(GSN_FIXTURES "/domain/failing_mesher", 0, &err) == GSN_E_PROCESS);
    CHECK(strstr(err.text, "code 3: the sky fell"));
    CHECK(build_with(GSN_FIXTURES "/domain/babbling_mesher", 0, &err) == GSN_E_MESH);
    CHECK(strstr(err.text, "the mesher's answer of ") && strstr(err.text, " bytes is damaged"));
    CHECK(build_with(GSN_FIXTURES "/domain/missing_mesher", 0, &err) == GSN_E_PROCESS);
}

TEST(impossible_sizes_are_refused)
{
    gsn_auto(gsn_mask) region = shape_mask(3, 3, 3, 16, 16, 24, shape_everywhere);
    static const double WRONG[][2] = { { 0, 1 }, { 1, 0 }, { NAN, 1 }, { 1, NAN }, { -1, 1 } };
    gsn_auto(gsn_tets) mesh = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof WRONG / sizeof *WRONG; i++) {
        const struct gsn_domain_options options = shape_options(WRONG[i][0], WRONG[i][1]);

        CHECK(gsn_domain_build(region, &options, &mesh, &err) == GSN_E_INPUT);
        CHECK(mesh == NULL);
    }
}

TEST(a_real_tooth_is_meshed_and_verifies)
{
    const struct gsn_lattice at = { .nx = 140, .ny = 120, .nz = 161, .step_um = { 1, 1, 1 } };
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto(gsn_mask) region = NULL;
    gsn_auto(gsn_tets) mesh = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    if (gsn_file_read(GSN_SHARED "/data/volumes/tooth.raw", 1 << 24, &bytes, &size, &err) < 0) {
        gsn_check_skip("%s", err.text);
    }
    CHECK(size == gsn_lattice_count(&at));
    CHECK_OK(gsn_mask_new(&at, &region, &err), err);
    for (size_t i = 0; i < size; i++)
        region->inside[i] = bytes[i] > 60;
    mesh = shape_mesh(region, 8, 150);
    CHECK(mesh->tet_count > 5000);
    CHECK(gsn_domain_volume(mesh) > (double)gsn_mask_count(region));
    CHECK(largest(mesh) <= 150 * (1 + 1e-9));
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = shape_mask(3, 3, 3, 16, 16, 24, shape_everywhere);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(build_in(region, GSN_MESHER, 0, &err), err);
}
