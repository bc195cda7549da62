/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/analysis.h"

#include "pipeline/stain/normalisation.h"
#include "pipeline/core/srgb.h"
#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"
#include "tests/specimen/often.h"

#include <string.h>

static const struct gsn_analysis_options OPTIONS = { .mesher = GSN_MESHER, .threads = 1 };
static const char JOB[] = "{\"specimen\": \"x\", \"thresholds\": [0.3, 0.5, 0.7]}";

/* The fit is smoothed a little, so a slope is not met to the last digit. */
#define SMOOTHED 2e-4

enum { NX = 8, NY = 6, NZ = 8, EDGE = 2 };
#define STEP 24.0

/* A box of NX x NY x NZ voxels inside a grid that is larger by EDGE on each side. */
static struct gsn_mask *box_region(const struct gsn_lattice *at)
{
    struct gsn_mask *mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(at, &mask, &err), err);
    for (size_t z = EDGE; z < NZ + EDGE; z++)
        for (size_t y = EDGE; y < NY + EDGE; y++)
            for (size_t x = EDGE; x < NX + EDGE; x++)
                mask->inside[gsn_lattice_index(at, x, y, z)] = 1;
    return mask;
}

/* base + slope . (u - centre of the box) */
static struct gsn_grid *linear_grid(double base, struct gsn_vec3 slope)
{
    const struct gsn_lattice at = { .nx = NX + 2 * EDGE,
                                    .ny = NY + 2 * EDGE,
                                    .nz = NZ + 2 * EDGE,
                                    .origin_um = { -STEP * (NX + 2 * EDGE - 1) / 2,
                                                   -STEP * (NY + 2 * EDGE - 1) / 2,
                                                   -STEP * (NZ + 2 * EDGE - 1) / 2 },
                                    .step_um = { STEP, STEP, STEP } };
    struct gsn_grid *grid = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&at, &grid, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&at); i++) {
        const struct gsn_vec3 u =
            gsn_lattice_centre(&at, i % at.nx, i / at.nx % at.ny, i / at.nx / at.ny);

        grid->value[i] = (float)(base + slope.x * u.x + slope.y * u.y + slope.z * u.z);
    }
    return grid;
}

static const double BOX_UM3 = STEP * STEP * STEP * NX * NY * NZ;

static struct gsn_analysis *account_of(const struct gsn_grid *grid, const char *job)
{
    gsn_auto(gsn_protocol) protocol = drawn_protocol(job);
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    struct gsn_analysis *analysis = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_analyse(grid, region, protocol, &OPTIONS, &analysis, &err), err);
    return analysis;
}

TEST(an_even_density_is_its_own_mean_in_every_unit)
{
    gsn_auto(gsn_grid) grid = linear_grid(0.6, (struct gsn_vec3){ 0, 0, 0 });
    gsn_auto(gsn_analysis) analysis = account_of(grid, JOB);

    CHECK_NEAR(analysis->density.mean, 0.6, 1e-6);
    CHECK_NEAR(analysis->density.volume_um3, BOX_UM3, 1e-6 * BOX_UM3);
    CHECK_NEAR(analysis->coverage, 1, 0);
    CHECK_NEAR(analysis->summary.min, 0.6, 1e-5);
    CHECK_NEAR(analysis->summary.max, 0.6, 1e-5);
    CHECK(analysis->bound_count == 3 && analysis->over_tolerance == 0);
    for (size_t i = 0; i < 3; i++) {
        const double truth = i < 2 ? BOX_UM3 : 0;

        CHECK_NEAR(analysis->bound[i].threshold, 0.3 + 0.2 * (double)i, 1e-12);
        CHECK_NEAR(analysis->bound[i].lower_um3, truth, 1e-3 * BOX_UM3);
        CHECK_NEAR(analysis->bound[i].upper_um3, truth, 1e-3 * BOX_UM3);
    }
    CHECK_NEAR(analysis->above_threshold, 0.5, 0);
    CHECK_NEAR(analysis->above_share, 1, 0);
}

/* {x > s} in the box is a slab whose share of the volume is its share of the side. */
TEST(a_linear_density_has_the_mean_at_the_centre_and_slabs_above_thresholds)
{
    const double slope = 0.8 / (STEP * NX); /* 0.1 to 0.9 across the box */
    gsn_auto(gsn_grid) grid = linear_grid(0.5, (struct gsn_vec3){ slope, 0, 0 });
    gsn_auto(gsn_analysis) analysis = account_of(grid, JOB);
    const double share[3] = { 0.75, 0.5, 0.25 };

    CHECK_NEAR(analysis->density.mean, 0.5, SMOOTHED * 0.5);
    for (size_t i = 0; i < 3; i++) {
        CHECK(analysis->bound[i].lower_um3 <= analysis->bound[i].upper_um3);
        CHECK_NEAR(analysis->bound[i].lower_um3, share[i] * BOX_UM3, 5e-3 * BOX_UM3);
        CHECK_NEAR(analysis->bound[i].upper_um3, share[i] * BOX_UM3, 5e-3 * BOX_UM3);
    }
    CHECK_NEAR(analysis->above_share, 0.5, 1e-12);
    CHECK(analysis->summary.min < analysis->summary.median);
    CHECK_NEAR(analysis->tolerance, 0.03 * 0.8 * (NX - 1) / NX, 1e-6);
}

/* Light that rises from 0.2 to 0.8 along x, with half of it along y in green: codes of 8 bits are
 * to be found as that light, and black is no data. */
TEST(true_colour_is_fitted_as_light)
{
    gsn_auto(gsn_grid) grid = linear_grid(0.6, (struct gsn_vec3){ 0, 0, 0 });
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    gsn_auto(gsn_protocol) protocol = drawn_protocol(JOB);
    gsn_auto(gsn_colour_grid) colour = NULL;
    gsn_auto(gsn_analysis) analysis = NULL;
    struct gsn_analysis_options options = OPTIONS;
    struct gsn_error err = { 0 };
    const double side = STEP * NX;
    size_t hint = 0;

    CHECK_OK(gsn_colour_grid_new(&grid->at, &colour, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++) {
        const struct gsn_vec3 u =
            gsn_lattice_centre(&grid->at, i % grid->at.nx, i / grid->at.nx % grid->at.ny,
                               i / grid->at.nx / grid->at.ny);
        const double light = 0.5 + 0.6 * u.x / side;

        if (i % 7 == 0)
            continue;
        colour->rgb[3 * i] = (uint8_t)lrint(255 * gsn_srgb_of_light(light));
        colour->rgb[3 * i + 1] = (uint8_t)lrint(255 * gsn_srgb_of_light(light / 2));
        colour->rgb[3 * i + 2] = 255;
    }
    options.colour = colour;
    CHECK_OK(gsn_analyse(grid, region, protocol, &options, &analysis, &err), err);
    for (int i = -4; i <= 4; i++) {
        const double u[3] = { side * i / 10, STEP / 3, -STEP / 3 }, light = 0.5 + 0.06 * i;
        const double truth[3] = { light, light / 2, 1 };

        for (int c = 0; c < 3; c++) {
            double value = NAN;

            CHECK(gsn_spline_eval(analysis->colour[c], u, &hint, &value, NULL) == GSN_OK);
            /* Less than half a code. */
            CHECK_NEAR(value, truth[c], 0.002);
        }
    }
}

/* 0.1 to 0.9 across the box; what the baseline calls 0.6 reads 0.5 here. */
TEST(volumes_above_a_density_are_on_the_baselines_scale)
{
    gsn_auto(gsn_grid) grid = linear_grid(0.5, (struct gsn_vec3){ 0.8 / (STEP * NX), 0, 0 });
    gsn_auto(gsn_protocol) protocol =
        drawn_protocol("{\"specimen\": \"x\", \"thresholds\": [0.6]}");
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    gsn_auto(gsn_analysis) analysis = NULL;
    struct gsn_analysis_options options = OPTIONS;
    struct gsn_error err = { 0 };

    options.scale = (struct gsn_gain_offset){ 0.75, 0.05 };
    CHECK_OK(gsn_analyse(grid, region, protocol, &options, &analysis, &err), err);
    CHECK_NEAR(analysis->bound[0].threshold, 0.6, 0);
    CHECK_NEAR(analysis->bound[0].lower_um3, 0.5 * BOX_UM3, 5e-3 * BOX_UM3);
    CHECK_NEAR(analysis->bound[0].upper_um3, 0.5 * BOX_UM3, 5e-3 * BOX_UM3);
    CHECK_NEAR(analysis->above_threshold, 0.6, 0);
    CHECK_NEAR(analysis->above_share, 0.5, 1e-12);
    CHECK_NEAR(analysis->density.mean, 0.5, SMOOTHED * 0.5); /* that stays its own */

    gsn_auto(gsn_analysis) own = account_of(grid, "{\"specimen\": \"x\", \"thresholds\": [0.5]}");
    const struct gsn_png_picture *const there = &analysis->picture[4], *const here =
                                                                           &own->picture[4];

    CHECK(strcmp(there->id, "isosurface") == 0 && there->size == here->size);
    CHECK(memcmp(there->png, here->png, here->size) == 0);
    CHECK(strstr(there->caption, "density is 0.6"));
}

TEST(a_slope_along_every_axis_leaves_the_mean_where_it_is)
{
    gsn_auto(gsn_grid) grid = linear_grid(0.5, (struct gsn_vec3){ 4e-4, -7e-4, 9e-4 });
    gsn_auto(gsn_analysis) analysis =
        account_of(grid, "{\"specimen\": \"x\", \"thresholds\": [0.01]}");

    CHECK_NEAR(analysis->density.mean, 0.5, SMOOTHED * 0.5);
}

/* Without thresholds a volume's are at 0.3, 0.5 and 0.7 of its range. */
TEST(a_volumes_thresholds_divide_the_range_of_its_data)
{
    const double slope = 100 / (STEP * (NX - 1));
    gsn_auto(gsn_grid) grid = linear_grid(150, (struct gsn_vec3){ slope, 0, 0 });
    gsn_auto(gsn_analysis) analysis =
        account_of(grid, "{\"specimen\": \"x\", \"kind\": \"volume\", \"file\": \"v.mhd\"}");

    for (size_t i = 0; i < 3; i++)
        CHECK_NEAR(analysis->bound[i].threshold, 130 + 20 * (double)i, 1e-3);
    CHECK_NEAR(analysis->density.mean, 150, SMOOTHED * 150);
    CHECK_NEAR(analysis->summary.low, 100, 1e-3);
    CHECK_NEAR(analysis->summary.high, 200, 1e-3);
}

TEST(the_pictures_are_three_cuts_an_x_ray_and_an_isosurface)
{
    static const char *const ids[] = { "cut-z", "cut-y", "cut-x", "x-ray", "isosurface" };
    gsn_auto(gsn_grid) grid = linear_grid(0.6, (struct gsn_vec3){ 0, 0, 0 });
    gsn_auto(gsn_analysis) analysis = account_of(grid, JOB);

    CHECK(analysis->picture_count == 5);
    for (size_t i = 0; i < 5; i++) {
        const struct gsn_png_picture *p = &analysis->picture[i];

        CHECK(strcmp(p->id, ids[i]) == 0 && p->title[0] && p->caption[0]);
        CHECK(p->size > 100 && memcmp(p->png, "\x89PNG\r\n", 6) == 0);
        CHECK(p->width > 100 && p->height > 50);
    }
}

/* Empties the planes of the box from the first on. */
static void empty_planes(struct gsn_grid *grid, size_t count)
{
    const size_t plane = grid->at.nx * grid->at.ny;

    for (size_t i = 0; i < (EDGE + count) * plane; i++)
        grid->value[i] = NAN;
}

TEST(half_a_region_gives_figures_with_its_coverage_and_less_gives_none)
{
    gsn_auto(gsn_grid) grid = linear_grid(0.6, (struct gsn_vec3){ 0, 0, 0 });
    gsn_auto(gsn_protocol) protocol = drawn_protocol(JOB);
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    struct gsn_analysis *refused = NULL;
    struct gsn_error err = { 0 };

    empty_planes(grid, 4);
    gsn_auto(gsn_analysis) half = account_of(grid, JOB);

    CHECK_NEAR(half->coverage, 0.5, 0);
    CHECK_NEAR(half->density.mean, 0.6, 1e-3);
    empty_planes(grid, 5);
    CHECK(gsn_analyse(grid, region, protocol, &OPTIONS, &refused, &err) == GSN_E_WITHHELD);
    CHECK(refused == NULL);
    CHECK(strstr(err.text, "only 38 % of the region of interest has data") == err.text);
    empty_planes(grid, NZ);
    CHECK(gsn_analyse(grid, region, protocol, &OPTIONS, &refused, &err) == GSN_E_WITHHELD);
}

TEST(a_region_without_a_voxel_of_the_grid_is_refused)
{
    gsn_auto(gsn_grid) grid = linear_grid(0.6, (struct gsn_vec3){ 0, 0, 0 });
    gsn_auto(gsn_protocol) protocol = drawn_protocol(JOB);
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    struct gsn_analysis *refused = NULL;
    struct gsn_error err = { 0 };

    region->at.origin_um.x += 1e6;
    CHECK(gsn_analyse(grid, region, protocol, &OPTIONS, &refused, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "holds no voxel") != NULL && refused == NULL);
}

TEST(a_mesher_that_is_not_there_is_a_failure_of_the_machine)
{
    const struct gsn_analysis_options none = { .mesher = "/nowhere/gieson-mesh", .threads = 1 };
    gsn_auto(gsn_grid) grid = linear_grid(0.6, (struct gsn_vec3){ 0, 0, 0 });
    gsn_auto(gsn_protocol) protocol = drawn_protocol(JOB);
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    struct gsn_analysis *refused = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_analyse(grid, region, protocol, &none, &refused, &err) == GSN_E_PROCESS);
    CHECK(refused == NULL && err.text[0]);
}

TEST(the_number_of_threads_does_not_matter)
{
    const struct gsn_analysis_options two = { .mesher = GSN_MESHER, .threads = 2 };
    static const char job[] = "{\"specimen\": \"x\", \"thresholds\": [0.5]}";
    gsn_auto(gsn_grid) grid = linear_grid(0.5, (struct gsn_vec3){ 1e-3, 1e-4, -5e-4 });
    gsn_auto(gsn_protocol) protocol = drawn_protocol(job);
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    gsn_auto(gsn_analysis) one = account_of(grid, job);
    gsn_auto(gsn_analysis) other = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_analyse(grid, region, protocol, &two, &other, &err), err);
    CHECK(memcmp(&one->density, &other->density, sizeof one->density) == 0);
    CHECK(memcmp(one->bound, other->bound, sizeof one->bound) == 0);
    for (size_t i = 0; i < one->picture_count; i++) {
        CHECK(one->picture[i].size == other->picture[i].size);
        CHECK(memcmp(one->picture[i].png, other->picture[i].png, one->picture[i].size) == 0);
    }
}

struct oom {
    const struct gsn_grid *grid;
    const struct gsn_mask *region;
    const struct gsn_protocol *protocol;
};

static int account_once(const struct oom *oom, struct gsn_error *err)
{
    gsn_auto(gsn_analysis) analysis = NULL;

    return gsn_analyse(oom->grid, oom->region, oom->protocol, &OPTIONS, &analysis, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_grid) grid = linear_grid(0.6, (struct gsn_vec3){ 0, 0, 0 });
    gsn_auto(gsn_protocol) protocol =
        drawn_protocol("{\"specimen\": \"x\", \"thresholds\": [0.3]}");
    gsn_auto(gsn_mask) region = box_region(&grid->at);
    const struct oom oom = { grid, region, protocol };
    struct gsn_error err = { 0 };

    CHECK_MANY_OOM(account_once(&oom, &err), err, 40, 8);
}
