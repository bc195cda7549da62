/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/base_cells.h"

#include "pipeline/measure/density.h"

#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { -600.0, -500.0, -300.0 }, high[3] = { 700.0, 500.0, 600.0 };
static const unsigned cells[3] = { 3, 3, 2 };
static const double corner[3] = { -410.0, -305.0, -180.0 };
static const struct quadric field = { 0.5, { 1e-4, -2e-4, 3e-4 }, { 2e-7, -1e-7, 4e-7 } };

static double draw(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (double)(*seed >> 11) / 9007199254740992.0;
}

static double signed_volume(double corner_of[4][3])
{
    double e[3][3];

    for (int k = 0; k < 3; k++)
        for (int a = 0; a < 3; a++)
            e[k][a] = corner_of[k + 1][a] - corner_of[0][a];
    return (e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) -
            e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
            e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0])) /
           6;
}

/* Barycentric coordinates by Cramer's rule. */
static int holds(double corner_of[4][3], const double u[3])
{
    const double whole = signed_volume(corner_of);
    int ret = 1;

    for (int k = 0; k < 4; k++) {
        double part[4][3];

        memcpy(part, corner_of, sizeof part);
        memcpy(part[k], u, sizeof part[k]);
        ret = ret && signed_volume(part) / whole >= -1e-9;
    }
    return ret;
}

TEST(a_point_lies_in_the_cell_that_is_named)
{
    uint64_t seed = 1;
    size_t met[GSN_BASE_TETS] = { 0 };

    for (int i = 0; i < 3000; i++) {
        const double u[3] = { 3000 * draw(&seed) - 1500, 3000 * draw(&seed) - 1500,
                              3000 * draw(&seed) - 1500 };
        const struct gsn_base_address cell = gsn_base_find(gsn_vec3_make(u[0], u[1], u[2]));
        double corner_of[4][3];

        gsn_base_corners(cell, corner_of);
        CHECK(holds(corner_of, u));
        CHECK_NEAR(fabs(signed_volume(corner_of)), pow(GSN_BASE_EDGE_UM, 3) / 6, 1e-3);
        met[cell.tet]++;
    }
    for (int t = 0; t < GSN_BASE_TETS; t++)
        CHECK(met[t] > 400 && met[t] < 600); /* of 500; sd 20 */
}

TEST(points_on_faces_edges_and_corners_have_one_cell_that_touches_them)
{
    for (int i = 0; i < 27; i++) {
        const double u[3] = { 100.0 * (i % 3) - 200, 100.0 * (i / 3 % 3), 100.0 * (i / 9) - 400 };
        double corner_of[4][3];

        gsn_base_corners(gsn_base_find(gsn_vec3_make(u[0], u[1], u[2])), corner_of);
        CHECK(holds(corner_of, u));
    }
}

TEST(cells_add_up_to_the_region)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    gsn_auto(gsn_base_cells) found = NULL;
    struct gsn_region_density density;
    struct gsn_error err = { 0 };
    double sum = 0, volume = 0;
    struct kuhn kuhn;

    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++)
        region->inside[i] = i % 7 != 0;
    CHECK_OK(kuhn_random(low, high, cells, 2, 0.05, 5, &kuhn, &err), err);
    CHECK_OK(gsn_base_cells_new(kuhn.spline, region, 2, &found, &err), err);
    CHECK_OK(gsn_region_density(kuhn.spline, region, 0, NULL, &density, &err), err);
    for (size_t i = 0; i < found->count; i++) {
        sum += found->cell[i].mean * found->cell[i].volume_um3;
        volume += found->cell[i].volume_um3;
        CHECK(i == 0 || gsn_base_compare(found->cell[i - 1].address, found->cell[i].address) < 0);
    }
    CHECK_NEAR(volume / density.volume_um3, 1, 1e-12);
    CHECK_NEAR(sum / volume, density.centres_mean, 1e-12);
    kuhn_done(&kuhn);
}

/* The mean of a field over the voxels of one cell, one by one. */
TEST(a_cell_has_the_mean_of_its_voxels_and_the_planes_they_lie_in)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    gsn_auto(gsn_base_cells) found = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_OK(gsn_base_cells_new(kuhn.spline, region, 1, &found, &err), err);
    for (size_t i = 0; i < found->count; i += 17) {
        const struct gsn_base_cell *c = &found->cell[i];
        double sum = 0, count = 0, squares = 0;

        for (size_t z = 0; z < region->at.nz; z++) {
            double here = 0;

            for (size_t v = 0; v < region->at.nx * region->at.ny; v++) {
                const struct gsn_vec3 u =
                    gsn_lattice_centre(&region->at, v % region->at.nx, v / region->at.nx, z);
                const double at[3] = { u.x, u.y, u.z };

                if (gsn_base_compare(gsn_base_find(u), c->address) != 0)
                    continue;
                sum += quadric_at(&field, at);
                here++;
            }
            count += here;
            squares += here * here;
        }
        CHECK_NEAR(c->mean, sum / count, 1e-12);
        CHECK_NEAR(c->volume_um3, count * 13824, 1e-3);
        CHECK_NEAR(c->planes, count * count / squares, 1e-9);
    }
    kuhn_done(&kuhn);
}

TEST(the_same_bytes_on_any_number_of_threads)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    gsn_auto(gsn_base_cells) one = NULL;
    gsn_auto(gsn_base_cells) three = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_random(low, high, cells, 3, 0.05, 6, &kuhn, &err), err);
    CHECK_OK(gsn_base_cells_new(kuhn.spline, region, 1, &one, &err), err);
    CHECK_OK(gsn_base_cells_new(kuhn.spline, region, 3, &three, &err), err);
    CHECK(one->count == three->count);
    for (size_t i = 0; i < one->count; i++)
        CHECK(memcmp(&one->cell[i].mean, &three->cell[i].mean, sizeof(double)) == 0);
    kuhn_done(&kuhn);
}

/* Normal numbers of variance 1, by sums of twelve. */
static double draw_normal(uint64_t *seed)
{
    double sum = -6;

    for (int i = 0; i < 12; i++)
        sum += draw(seed);
    return sum;
}

TEST(what_sections_err_in_a_column_is_told_and_what_is_straight_is_no_error)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 20.0, 60, 60, 60);
    struct gsn_grid *grid = NULL;
    struct gsn_error err = { 0 };
    uint64_t seed = 3;
    double error = -1;

    CHECK_OK(gsn_grid_new(&region->at, &grid, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++)
        grid->value[i] = (float)(0.3 + 1e-3 * (double)(i / 3600) + 2e-3 * (double)(i % 60));
    CHECK_OK(gsn_base_plane_error(grid, region, &error, &err), err);
    CHECK_NEAR(error, 0, 1e-7);
    /* One number a cube and plane: 49 columns or more, 58 differences each. */
    for (size_t z = 0; z < 60; z++) {
        double off[64];

        for (int k = 0; k < 64; k++)
            off[k] = 0.02 * draw_normal(&seed);
        for (size_t i = 0; i < 3600; i++) {
            const struct gsn_vec3 u = gsn_lattice_centre(&grid->at, i % 60, i / 60, z);
            const struct gsn_base_address cell = gsn_base_find(u);

            grid->value[z * 3600 + i] += (float)off[(cell.cube[0] + 3) + 8 * (cell.cube[1] + 2)];
        }
    }
    CHECK_OK(gsn_base_plane_error(grid, region, &error, &err), err);
    CHECK_NEAR(error / 0.02, 1, 0.05);
    CHECK_EVERY_OOM(gsn_base_plane_error(grid, region, &error, &err), err);
    region->at.nz = 2;
    CHECK_OK(gsn_base_plane_error(grid, region, &error, &err), err);
    CHECK(!(error >= 0));
    gsn_grid_free(grid);
}

/* A specimen of the block as this field says. */
static struct gsn_base_cells *cells_of(const struct quadric *q, const struct gsn_mask *region)
{
    struct gsn_base_cells *ret = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, q, &kuhn, &err), err);
    CHECK_OK(gsn_base_cells_new(kuhn.spline, region, 1, &ret, &err), err);
    kuhn_done(&kuhn);
    return ret;
}

static struct quadric times(const struct quadric *q, double factor, double more)
{
    struct quadric ret = *q;

    ret.constant = factor * ret.constant + more;
    for (int a = 0; a < 3; a++) {
        ret.linear[a] *= factor;
        ret.square[a] *= factor;
    }
    return ret;
}

static const struct gsn_loss_scale plain = { .gain = 1 };

TEST(a_loss_that_is_one_everywhere_is_found_in_each_cell)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    const struct quadric less = times(&field, 0.7, 0);
    gsn_auto(gsn_base_cells) there = cells_of(&field, region);
    gsn_auto(gsn_base_cells) here = cells_of(&less, region);
    const struct gsn_base_side control = { there, 0.01 }, treated = { here, 0.02 };
    gsn_auto(gsn_loss_map) map = NULL;
    struct gsn_error err = { 0 };
    double squares = 0, weight = 0;

    CHECK_OK(gsn_loss_map_new(&control, 1, &treated, &plain, &map, &err), err);
    CHECK(map->count == here->count);
    CHECK_NEAR(map->shared, 1, 1e-12);
    for (size_t i = 0; i < map->count; i++) {
        const struct gsn_loss_cell *c = &map->cell[i];
        const double planes = here->cell[i].planes;

        CHECK_NEAR(c->percent, 30, 1e-9);
        CHECK_NEAR(c->error, 100 / c->control * sqrt((0.02 * 0.02 + 0.49 * 0.01 * 0.01) / planes),
                   1e-9);
        squares += c->volume_um3 * c->control * c->error * c->error;
        weight += c->volume_um3 * c->control;
    }
    CHECK_NEAR(map->low, 30, 1e-9);
    CHECK_NEAR(map->high, 30, 1e-9);
    CHECK_NEAR(map->noise, sqrt(squares / weight), 1e-9);
    CHECK_NEAR(gsn_loss_map_at(map, gsn_vec3_make(0, 0, 0)), 30, 1e-9);
    CHECK(!(gsn_loss_map_at(map, gsn_vec3_make(5000, 0, 0)) >= 0));
}

TEST(cells_weighed_by_the_controls_collagen_give_the_loss_of_the_region)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    const struct quadric other = { 0.3, { -1e-4, 1e-4, 1e-4 }, { 0, 1e-7, 0 } };
    const struct gsn_loss_scale scale = { .gain = 1.1, .offset = 0.02, .zero = 0.05 };
    gsn_auto(gsn_base_cells) there = cells_of(&field, region);
    gsn_auto(gsn_base_cells) here = cells_of(&other, region);
    const struct gsn_base_side control = { there, NAN }, treated = { here, 0.02 };
    gsn_auto(gsn_loss_map) map = NULL;
    struct gsn_error err = { 0 };
    double mean[2] = { 0 }, volume = 0, lost = 0, weight = 0;

    CHECK_OK(gsn_loss_map_new(&control, 1, &treated, &scale, &map, &err), err);
    for (size_t i = 0; i < there->count; i++) {
        mean[0] += there->cell[i].mean * there->cell[i].volume_um3;
        mean[1] += here->cell[i].mean * there->cell[i].volume_um3;
        volume += there->cell[i].volume_um3;
    }
    for (size_t i = 0; i < map->count; i++) {
        const double w = map->cell[i].volume_um3 * (map->cell[i].control - 0.05);

        lost += w * map->cell[i].percent;
        weight += w;
    }
    mean[0] = 1.1 * mean[0] / volume + 0.02;
    mean[1] /= volume;
    CHECK_NEAR(lost / weight, 100 * (mean[0] - mean[1]) / (mean[0] - 0.05), 1e-9);
    CHECK(!(map->noise >= 0));
    CHECK(map->low < map->median && map->median < map->high);
}

TEST(several_controls_are_averaged_where_they_have_the_cell)
{
    const double beside[3] = { corner[0] + 20 * 24.0, corner[1], corner[2] };
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    gsn_auto(gsn_mask) half = full_mask(beside, 24.0, 20, 25, 20);
    const struct quadric flat = { 0.5, { 0 }, { 0 } }, more = { 0.7, { 0 }, { 0 } },
                         treated_is = { 0.3, { 0 }, { 0 } };
    gsn_auto(gsn_base_cells) one = cells_of(&flat, region);
    gsn_auto(gsn_base_cells) two = cells_of(&more, half);
    gsn_auto(gsn_base_cells) here = cells_of(&treated_is, region);
    const struct gsn_base_side control[2] = { { one, 0.03 }, { two, 0.04 } }, treated = { here, 0 };
    gsn_auto(gsn_loss_map) map = NULL;
    struct gsn_error err = { 0 };
    size_t both = 0;

    CHECK_OK(gsn_loss_map_new(control, 2, &treated, &plain, &map, &err), err);
    for (size_t i = 0; i < map->count; i++) {
        const int shared = map->cell[i].control > 0.55;

        CHECK_NEAR(map->cell[i].control, shared ? 0.6 : 0.5, 1e-12);
        CHECK_NEAR(map->cell[i].percent, shared ? 50 : 40, 1e-9);
        both += (size_t)shared;
    }
    CHECK(both > 0 && both < map->count);
}

TEST(regions_that_do_not_meet_have_no_map_and_of_those_that_do_it_says_how_much_they_share)
{
    const double beside[3] = { corner[0] + 20 * 24.0, corner[1], corner[2] };
    gsn_auto(gsn_mask) all = full_mask(corner, 24.0, 40, 25, 20);
    gsn_auto(gsn_mask) left = full_mask(corner, 24.0, 12, 25, 20);
    gsn_auto(gsn_mask) right = full_mask(beside, 24.0, 20, 25, 20);
    gsn_auto(gsn_base_cells) whole = cells_of(&field, all);
    gsn_auto(gsn_base_cells) there = cells_of(&field, right);
    gsn_auto(gsn_base_cells) here = cells_of(&field, left);
    const struct gsn_base_side control = { there, 0.01 }, apart = { here, 0.01 },
                               treated = { whole, 0.01 };
    struct gsn_loss_map *map = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_loss_map_new(&control, 1, &apart, &plain, &map, &err) == GSN_E_WITHHELD);
    CHECK(strstr(err.text, "no piece of the block in common"));
    CHECK(!map);
    CHECK_OK(gsn_loss_map_new(&control, 1, &treated, &plain, &map, &err), err);
    CHECK_NEAR(map->shared, 0.5, 1e-12);
    gsn_loss_map_free(map);
}

TEST(where_the_control_has_nothing_nothing_is_lost)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    const struct quadric none = { 0, { 0 }, { 0 } }, faint = { 0.01, { 0 }, { 0 } };
    gsn_auto(gsn_base_cells) nothing = cells_of(&none, region);
    gsn_auto(gsn_base_cells) little = cells_of(&faint, region);
    const struct gsn_base_side bare = { nothing, 0 }, unsure = { little, 1 }, sure = { little, 0 };
    struct gsn_loss_map *map = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_loss_map_new(&bare, 1, &sure, &plain, &map, &err) == GSN_E_WITHHELD);
    CHECK(gsn_loss_map_new(&unsure, 1, &sure, &plain, &map, &err) == GSN_E_WITHHELD);
    CHECK(strstr(err.text, "told from none"));
    CHECK_OK(gsn_loss_map_new(&sure, 1, &bare, &plain, &map, &err), err);
    CHECK_NEAR(map->median, 100, 1e-9);
    gsn_loss_map_free(map);
}

TEST(what_cannot_be_divided_is_refused)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 24.0, 40, 25, 20);
    gsn_auto(gsn_mask) vast = full_mask(corner, 1e9, 2, 2, 2);
    gsn_auto(gsn_mask) beyond = full_mask(high, 24.0, 4, 4, 4);
    struct gsn_base_cells *found = NULL;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK(gsn_base_cells_new(kuhn.spline, vast, 1, &found, &err) == GSN_E_LIMIT);
    CHECK(gsn_base_cells_new(kuhn.spline, beyond, 1, &found, &err) == GSN_E_INPUT);
    memset(region->inside, 0, gsn_lattice_count(&region->at));
    CHECK(gsn_base_cells_new(kuhn.spline, region, 1, &found, &err) == GSN_E_INPUT);
    CHECK(!found);
    kuhn_done(&kuhn);
}

static int new_and_free(const struct gsn_spline *spline, const struct gsn_mask *region,
                        struct gsn_error *err)
{
    gsn_auto(gsn_base_cells) found = NULL;

    return gsn_base_cells_new(spline, region, 1, &found, err);
}

static int map_and_free(const struct gsn_base_side *side, struct gsn_error *err)
{
    gsn_auto(gsn_loss_map) map = NULL;

    return gsn_loss_map_new(side, 1, side, &plain, &map, err);
}

TEST(out_of_memory_is_an_error_at_every_step)
{
    gsn_auto(gsn_mask) region = full_mask(corner, 48.0, 20, 12, 10);
    gsn_auto(gsn_base_cells) found = cells_of(&field, region);
    const struct gsn_base_side side = { found, 0.01 };
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 2, 0.05, &field, &kuhn, &err), err);
    CHECK_EVERY_OOM(new_and_free(kuhn.spline, region, &err), err);
    CHECK_EVERY_OOM(map_and_free(&side, &err), err);
    kuhn_done(&kuhn);
}
