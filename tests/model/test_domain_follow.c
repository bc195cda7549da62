/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Meshes that follow the walls of a density: where the walls are known in closed form. */
#include "pipeline/model/domain.h"

#include "pipeline/model/dms.h"
#include "pipeline/model/domain_internal.h"

#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

enum { SIDE = 48 };
static const double STEP = 10, BLUR = 10, RADIUS = 150;

static double ball(const double u[3])
{
    const double x = u[0] - 238, y = u[1] - 243, z = u[2] - 240;

    return sqrt(x * x + y * y + z * z) - RADIUS;
}

static double two_balls(const double u[3])
{
    const double x[2] = { u[0] - 131, u[0] - 352 }, y = u[1] - 243, z = u[2] - 240;

    return fmin(sqrt(x[0] * x[0] + y * y + z * z), sqrt(x[1] * x[1] + y * y + z * z)) - 100;
}

static double tilt(const double u[3])
{
    return u[0] / 4 + u[1] / 8 - 100;
}

/* gives: 0.9 inside and 0.1 outside of the surface where the distance is 0, as blurred as said. */
static struct gsn_grid *drawn(double (*distance)(const double u[3]), double blur, double noise)
{
    const struct gsn_lattice at = {
        SIDE, SIDE, SIDE, { STEP / 2, STEP / 2, STEP / 2 }, { STEP, STEP, STEP }
    };
    struct gsn_grid *grid = NULL;
    struct gsn_error err = { 0 };
    uint64_t dice = 5;

    CHECK_OK(gsn_grid_new(&at, &grid, &err), err);
    for (size_t i = 0, z = 0; z < SIDE; z++)
        for (size_t y = 0; y < SIDE; y++)
            for (size_t x = 0; x < SIDE; x++, i++) {
                const struct gsn_vec3 c = gsn_lattice_centre(&at, x, y, z);
                const double d = distance((const double[3]){ c.x, c.y, c.z });

                grid->value[i] = (float)(0.1 + 0.8 * 0.5 * erfc(d / blur / M_SQRT2) +
                                         noise * shape_normal(&dice));
            }
    return grid;
}

static int in_the_middle(size_t x, size_t y, size_t z)
{
    return x > 1 && y > 1 && z > 1 && x < SIDE - 2 && y < SIDE - 2 && z < SIDE - 2;
}

static int a_round_bar(size_t x, size_t y, size_t z)
{
    const double dx = (double)x - 24, dy = (double)y - 24;

    (void)z;
    return dx * dx + dy * dy < 100;
}

static struct gsn_wall_layers *layers_of(const struct gsn_grid *grid, const struct gsn_mask *region)
{
    const struct gsn_wall_options options = { 0 };
    struct gsn_wall_layers *layers = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_wall_layers_find(grid, region, &options, &layers, &err), err);
    return layers;
}

TEST(plateaus_noise_and_blur_are_read_off_the_voxels)
{
    static const double NOISE[2] = { 0, 0.04 };
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, in_the_middle);

    for (size_t k = 0; k < 2; k++) {
        gsn_auto(gsn_grid) grid = drawn(ball, BLUR, NOISE[k]);
        gsn_auto(gsn_wall_layers) layers = layers_of(grid, region);

        CHECK_NEAR(layers->low, 0.1, 0.01);
        CHECK_NEAR(layers->high, 0.9, 0.03);
        CHECK_NEAR(layers->noise, NOISE[k], 0.1 * NOISE[k] + 1e-3);
        CHECK_NEAR(layers->blur_um / BLUR, 1, 0.15);
    }
}

TEST(layers_lie_one_and_three_blurs_beside_the_wall)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, in_the_middle);
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0);
    gsn_auto(gsn_wall_layers) layers = layers_of(grid, region);
    size_t on[4] = { 0 };

    for (size_t i = 0; i < layers->walls; i++) {
        static const double OFFSET[4] = { -3, -1, 1, 3 };
        const double d = ball(layers->at[i]) / layers->blur_um;

        for (size_t k = 0; k < 4; k++)
            on[k] += fabs(d - OFFSET[k]) < 0.15;
    }
    CHECK(on[0] + on[1] + on[2] + on[3] == layers->walls);
    /* each a closed surface: V - F / 2 = 2 */
    CHECK(layers->facets == 2 * layers->walls - 4 * 4);
}

TEST(a_longer_edge_keeps_to_the_points_that_are_allowed)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, in_the_middle);
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0);
    const struct gsn_wall_options few = { .most_points = 300 };
    gsn_auto(gsn_wall_layers) layers = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_wall_layers_find(grid, region, &few, &layers, &err), err);
    CHECK_NEAR((double)layers->walls, 300, 60);
}

static struct gsn_tets *followed(const struct gsn_grid *grid, const struct gsn_mask *region,
                                 const char *mesher, struct gsn_domain_report *report)
{
    const struct gsn_wall_options walls = { 0 };
    struct gsn_domain_options options = shape_options(50, 0);
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    options.mesher = mesher ? mesher : options.mesher;
    options.max_tet_um3 = mesher ? 100000 : 0;
    CHECK_OK(gsn_domain_follow(grid, region, &walls, &options, &mesh, report, &err), err);
    return mesh;
}

/* No tetrahedron reaches from one side of a layer to the other: the layers are faces. */
TEST(no_tetrahedron_crosses_a_layer)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, in_the_middle);
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0);
    struct gsn_domain_report report;
    gsn_auto(gsn_tets) mesh = followed(grid, region, NULL, &report);

    CHECK(report.kind == GSN_DOMAIN_WALLS && report.wall_points > 500);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        double low = INFINITY, high = -INFINITY;

        for (size_t k = 0; k < 4; k++) {
            const double d = ball(mesh->vertex[mesh->tet[t][k]]) / report.blur_um;

            low = fmin(low, d);
            high = fmax(high, d);
        }
        for (int layer = -3; layer <= 3; layer += 2)
            CHECK(!(low < layer - 0.2 && high > layer + 0.2));
    }
}

TEST(where_walls_touch_their_layers_merge)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, in_the_middle);
    gsn_auto(gsn_grid) grid = drawn(two_balls, BLUR, 0);
    struct gsn_domain_report report;
    gsn_auto(gsn_tets) mesh = followed(grid, region, NULL, &report);

    CHECK(report.kind == GSN_DOMAIN_WALLS);
}

/* Corners of the region's voxels, just inside: a volume is measured voxel by voxel. */
static void check_voxels_inside(const struct gsn_tets *mesh, const struct gsn_mask *region)
{
    double(*knots)[3] = NULL;
    gsn_auto(gsn_dms) space = NULL;
    struct gsn_error err = { 0 };
    size_t tet = 0;

    CHECK_OK(gsn_dms_clouds(mesh, 1, 0.003, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, 1, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err), err);
    gsn_free(knots);
    for (size_t i = 0, z = 0; z < region->at.nz; z++)
        for (size_t y = 0; y < region->at.ny; y++)
            for (size_t x = 0; x < region->at.nx; x++, i++) {
                const struct gsn_vec3 c = gsn_lattice_centre(&region->at, x, y, z);

                if (!region->inside[i])
                    continue;
                for (int corner = 0; corner < 8; corner++) {
                    const double u[3] = {
                        c.x + (corner & 1 ? 0.499 : -0.499) * region->at.step_um.x,
                        c.y + (corner & 2 ? 0.499 : -0.499) * region->at.step_um.y,
                        c.z + (corner & 4 ? 0.499 : -0.499) * region->at.step_um.z
                    };

                    CHECK(gsn_dms_locate(space, u, tet, &tet) == GSN_OK);
                }
            }
}

/* Share of the tetrahedra in which no voxel centre of the region lies. */
static double empty_share(const struct gsn_tets *mesh, const struct gsn_mask *region)
{
    double(*knots)[3] = NULL;
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto_mem(uint8_t) holds = gsn_alloc_array(mesh->tet_count, 1);
    struct gsn_error err = { 0 };
    size_t tet = 0, empty = 0;

    CHECK(holds);
    CHECK_OK(gsn_dms_clouds(mesh, 1, 0.003, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, 1, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err), err);
    gsn_free(knots);
    for (size_t i = 0, z = 0; z < region->at.nz; z++)
        for (size_t y = 0; y < region->at.ny; y++)
            for (size_t x = 0; x < region->at.nx; x++, i++) {
                const struct gsn_vec3 c = gsn_lattice_centre(&region->at, x, y, z);

                if (region->inside[i] &&
                    gsn_dms_locate(space, (const double[3]){ c.x, c.y, c.z }, tet, &tet) == GSN_OK)
                    holds[tet] = 1;
            }
    for (size_t t = 0; t < mesh->tet_count; t++)
        empty += !holds[t];
    return (double)empty / (double)mesh->tet_count;
}

TEST(every_voxel_is_inside_and_few_tetrahedra_are_empty)
{
    static int (*const REGION[])(size_t, size_t, size_t) = { in_the_middle, a_round_bar };
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0);

    for (size_t k = 0; k < 2; k++) {
        gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, REGION[k]);
        struct gsn_domain_report report;
        gsn_auto(gsn_tets) mesh = followed(grid, region, NULL, &report);

        CHECK(report.kind == GSN_DOMAIN_WALLS);
        check_voxels_inside(mesh, region);
        if (k == 0) /* of the bar's, most lie around its rim */
            CHECK(empty_share(mesh, region) < 0.05);
    }
}

/* Layers of long edges about two balls that nearly touch: between them the mesher leaves tetrahedra
 * of 5e-7 of their edge. */
TEST(what_the_mesher_leaves_flat_is_lifted)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, in_the_middle);
    gsn_auto(gsn_grid) grid = drawn(two_balls, BLUR, 0.02);
    const struct gsn_wall_options walls = { .edge_um = 110, .rim_um = 143 };
    const struct gsn_domain_options options = shape_options(60, 0);
    struct gsn_domain_report report;
    gsn_auto(gsn_tets) mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_domain_follow(grid, region, &walls, &options, &mesh, &report, &err), err);
    CHECK(report.kind == GSN_DOMAIN_WALLS && !report.why.text[0]);
    for (size_t t = 0; t < mesh->tet_count; t++)
        CHECK(gsn_tets_height(mesh, t) >= 1e-3);
    check_voxels_inside(mesh, region);
}

TEST(a_gentle_slope_has_no_walls)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, a_round_bar);
    gsn_auto(gsn_grid) grid = drawn(tilt, 8 * BLUR, 0.01);
    struct gsn_domain_report report;
    gsn_auto(gsn_tets) mesh = followed(grid, region, NULL, &report);

    CHECK(report.kind == GSN_DOMAIN_RIM && report.wall_points == 0);
    check_voxels_inside(mesh, region);
}

TEST(lost_planes_and_a_blank_volume_are_followed_as_far_as_they_go)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, in_the_middle);
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0);
    struct gsn_domain_report report;
    gsn_auto(gsn_tets) holed = NULL;
    gsn_auto(gsn_tets) blank = NULL;

    for (size_t i = 20 * SIDE * SIDE; i < 22 * SIDE * SIDE; i++)
        grid->value[i] = NAN;
    holed = followed(grid, region, NULL, &report);
    CHECK(report.kind == GSN_DOMAIN_WALLS);
    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++)
        grid->value[i] = 0.5F;
    blank = followed(grid, region, NULL, &report);
    CHECK(report.kind == GSN_DOMAIN_RIM);
}

TEST(a_mesher_that_refuses_leaves_cubes_and_its_sentence)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, a_round_bar);
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0);
    struct gsn_domain_report report;
    gsn_auto(gsn_tets) mesh = NULL;

    CHECK(setenv("GSN_MESHER", GSN_MESHER, 1) == 0);
    mesh = followed(grid, region, GSN_FIXTURES "/domain/mesher_that_takes_no_layers", &report);
    CHECK(report.kind == GSN_DOMAIN_CUBES);
    CHECK(strstr(report.why.text, "no layers"));
    CHECK(report.radius_edge == 0 && mesh->tet_count > 0);
}

TEST(the_same_voxels_give_the_same_bytes)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, a_round_bar);
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0.02);
    struct gsn_domain_report report;
    gsn_auto(gsn_tets) a = followed(grid, region, NULL, &report);
    gsn_auto(gsn_tets) b = followed(grid, region, NULL, &report);

    CHECK(a->tet_count == b->tet_count && a->vertex_count == b->vertex_count);
    CHECK(memcmp(a->vertex, b->vertex, a->vertex_count * sizeof *a->vertex) == 0);
    CHECK(memcmp(a->tet, b->tet, a->tet_count * sizeof *a->tet) == 0);
}

static int find_once(const struct gsn_grid *grid, const struct gsn_mask *region,
                     struct gsn_error *err)
{
    const struct gsn_wall_options options = { 0 };
    gsn_auto(gsn_wall_layers) layers = NULL;
    const int r = gsn_wall_layers_find(grid, region, &options, &layers, err);

    CHECK(r >= 0 || !layers);
    return r;
}

static double small_ball(const double u[3])
{
    const double x = u[0] - 60, y = u[1] - 60, z = u[2] - 60;

    return sqrt(x * x + y * y + z * z) - 35;
}

static int all_of_twelve(size_t x, size_t y, size_t z)
{
    return x < 12 && y < 12 && z < 12;
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, all_of_twelve);
    gsn_auto(gsn_grid) grid = drawn(small_ball, BLUR, 0);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(find_once(grid, region, &err), err);
}

TEST(a_region_without_data_is_refused)
{
    gsn_auto(gsn_mask) region = shape_mask(SIDE, SIDE, SIDE, STEP, STEP, STEP, a_round_bar);
    gsn_auto(gsn_grid) grid = drawn(ball, BLUR, 0);
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++)
        grid->value[i] = NAN;
    CHECK(find_once(grid, region, &err) == GSN_E_INPUT);
}
