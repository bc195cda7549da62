/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Volumes of tissue against the truth of drawn stacks: the density of the phantom, known in closed
 * form, times the grain of a real stain, drawn for each section. GIESON_SEEDS=12 takes more of them
 * than the two of the short tier. */
#include "pipeline/measure/tissue_volume.h"

#include "pipeline/decode/volume.h"
#include "pipeline/phantom/geometry.h"
#include "pipeline/phantom/texture.h"
#include "pipeline/phantom/truth.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tests/check.h"

enum { THRESHOLDS = 3, GROUPS = 3, FINE_XY = 2, FINE_Z = 3 };

static const double THRESHOLD[THRESHOLDS] = { 0.3, 0.5, 0.7 };
static const double DEPTH[GROUPS] = { 0, 0.3698, 0.8153 }; /* of the lesion: none, small, large */
static const double GRAIN = 0.25; /* relative to the density, of a voxel, as measured on stacks */

struct block {
    struct gsn_grid *density; /* at the voxels, without grain */
    struct gsn_mask *region;
    double truth_um3[THRESHOLDS];
};

static struct block make_block(double depth)
{
    const struct gsn_phantom_geometry *g = gsn_phantom_geometry();
    const struct gsn_lattice at = gsn_phantom_region_lattice(g);
    struct gsn_lattice fine = at;
    gsn_auto(gsn_grid) grid = NULL;
    struct block b = { .density = NULL };
    struct gsn_error err = { 0 };

    fine.nx *= FINE_XY;
    fine.ny *= FINE_XY;
    fine.nz *= FINE_Z;
    fine.step_um =
        gsn_vec3_make(at.step_um.x / FINE_XY, at.step_um.y / FINE_XY, at.step_um.z / FINE_Z);
    fine.origin_um =
        gsn_vec3_make(at.origin_um.x - at.step_um.x / 4, at.origin_um.y - at.step_um.y / 4,
                      at.origin_um.z - at.step_um.z / 3);
    CHECK_OK(gsn_phantom_region_mask(g, &at, &b.region, &err), err);
    CHECK_OK(gsn_phantom_density_grid(g, &fine, depth, 1, 0, &grid, &err), err);
    CHECK_OK(gsn_grid_new(&at, &b.density, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&fine); i++) {
        const size_t x = i % fine.nx, y = i / fine.nx % fine.ny, z = i / fine.nx / fine.ny;
        const size_t voxel = gsn_lattice_index(&at, x / FINE_XY, y / FINE_XY, z / FINE_Z);

        /* A section is thin: the middle of its voxel. */
        if (z % FINE_Z == 1)
            b.density->value[voxel] += grid->value[i] / (FINE_XY * FINE_XY);
        for (int t = 0; b.region->inside[voxel] && t < THRESHOLDS; t++)
            b.truth_um3[t] +=
                (double)grid->value[i] > THRESHOLD[t] ? gsn_lattice_voxel_um3(&fine) : 0;
    }
    return b;
}

static void block_done(struct block *b)
{
    gsn_grid_free(b->density);
    gsn_mask_free(b->region);
}

/* The block's density with a grain of its own on each section. */
static struct gsn_grid *draw_stack(const struct block *b, uint64_t seed)
{
    const struct gsn_lattice *at = &b->density->at;
    struct gsn_grid *stack = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(at, &stack, &err), err);
    for (size_t z = 0; z < at->nz; z++) {
        struct gsn_phantom_random random =
            gsn_phantom_random_make(seed, GSN_PHANTOM_STREAM_YELLOW_TEXTURE, z, 0);
        struct gsn_plane *quilt = NULL;
        const double shift[2] = { gsn_phantom_uniform(&random), gsn_phantom_uniform(&random) };

        CHECK_OK(gsn_phantom_quilt(GSN_PHANTOM_T1, (uint32_t)at->nx + 2, (uint32_t)at->ny + 2,
                                   &random, &quilt, &err),
                 err);
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++) {
                const size_t i = gsn_lattice_index(at, x, y, z);
                const double grain = gsn_phantom_texture_at(quilt, (double)x + 0.5 + shift[0],
                                                            (double)y + 0.5 + shift[1]);

                stack->value[i] = (float)((double)b->density->value[i] * (1 + GRAIN * grain));
            }
        gsn_plane_free(quilt);
    }
    return stack;
}

static struct gsn_tissue_volumes ask(const struct block *b, const struct gsn_grid *stack)
{
    struct gsn_tissue_volumes volumes;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_volumes(stack, b->region, THRESHOLD, THRESHOLDS, 0, &volumes, &err), err);
    return volumes;
}

/* A mean over seeds is held to what a mean of so few can be: 1 % (2 % where the threshold cuts the
 * falling side of the histogram) and twice its standard error. */
TEST(volumes_of_drawn_stacks_are_those_of_the_tissue)
{
    const char *said = getenv("GIESON_SEEDS");
    const int seeds = said ? (int)strtol(said, NULL, 10) : 2;
    int covered = 0, given = 0;

    for (int group = 0; group < GROUPS; group++) {
        struct block b = make_block(DEPTH[group]);
        double mean[THRESHOLDS] = { 0 }, square[THRESHOLDS] = { 0 }, half[THRESHOLDS] = { 0 };
        double largest[THRESHOLDS] = { 0 };
        int n[THRESHOLDS] = { 0 };

        for (int seed = 0; seed < seeds; seed++) {
            gsn_auto(gsn_grid) stack = draw_stack(&b, (uint64_t)(100 * group + seed + 1));
            const struct gsn_tissue_volumes v = ask(&b, stack);

            CHECK(!v.withheld && v.neighbours < 0.05);
            if (seed == 0)
                (void)printf("kernel %.0f um, %.0f across; neighbours %.3f; holes %.3f\n",
                             v.sigma_xy_um, v.sigma_z_um, v.neighbours, v.wall_share);
            for (int t = 0; t < THRESHOLDS; t++) {
                const double error = 100 * (v.volume[t].estimate_um3 / b.truth_um3[t] - 1);

                if (isnan(error))
                    continue;
                n[t]++;
                mean[t] += error;
                square[t] += error * error;
                largest[t] = fmax(largest[t], fabs(error));
                half[t] +=
                    50 * (v.volume[t].upper_um3 - v.volume[t].lower_um3) / v.volume[t].estimate_um3;
                given++;
                covered += v.volume[t].lower_um3 <= b.truth_um3[t] &&
                           v.volume[t].upper_um3 >= b.truth_um3[t];
            }
        }
        for (int t = 0; t < THRESHOLDS; t++) {
            const double m = mean[t] / n[t], sd = sqrt(fmax(0, square[t] / n[t] - m * m));

            (void)printf(
                "depth %.3f, D > %.1f: error %+.2f %% (sd %.2f, largest %.2f), half width %.2f %%, "
                "%d of %d given\n",
                DEPTH[group], THRESHOLD[t], m, sd, largest[t], half[t] / n[t], n[t], seeds);
            CHECK(n[t] > 0 &&
                  fabs(m) <= (t == 2 ? 2 + 2 * 3.5 / sqrt(seeds) : 1 + 2 * 0.6 / sqrt(seeds)));
        }
        block_done(&b);
    }
    (void)printf("%d of %d intervals hold the truth\n", covered, given);
    CHECK(covered >= given * 85 / 100);
}

/* A molar by computed tomography, its voxels taken for 16 x 16 x 24 um of density: enamel, dentine,
 * pulp chamber and canals that nobody here drew. The truth is the volume of {trilinear > t},
 * measured outside. */
#define TOOTH GSN_SHARED "/data/volumes/tooth.mhd"
enum { LEVELS = 4 };
static const double TOOTH_LEVEL[LEVELS] = { 100, 128, 200, 230 };
static const double TOOTH_VOXELS[LEVELS] = { 370594.5, 349859.5, 89003.1, 58752.9 };

static struct block take_tooth(struct gsn_error *err)
{
    struct block b = { .density = NULL };

    CHECK_OK(gsn_volume_read_grid(TOOTH, 0, 1, &b.density, err), *err);
    b.density->at.step_um = gsn_vec3_make(16, 16, 24);
    CHECK_OK(gsn_mask_new(&b.density->at, &b.region, err), *err);
    for (size_t i = 0; i < gsn_lattice_count(&b.density->at); i++) {
        b.region->inside[i] = b.density->value[i] > 40;
        b.density->value[i] /= 255;
    }
    return b;
}

TEST(volumes_of_a_real_tooth_under_a_real_grain_are_its_own)
{
    const char *said = getenv("GIESON_SEEDS");
    const int seeds = said ? (int)strtol(said, NULL, 10) : 1;
    struct gsn_error err = { 0 };
    int covered = 0, given = 0;

    if (access(TOOTH, R_OK) != 0) {
        gsn_check_skip("%s is not here", TOOTH);
        return;
    }

    struct block b = take_tooth(&err);
    const double voxel_um3 = gsn_lattice_voxel_um3(&b.density->at);
    double level[LEVELS];

    for (int t = 0; t < LEVELS; t++)
        level[t] = TOOTH_LEVEL[t] / 255;
    for (int seed = 0; seed < seeds; seed++) {
        gsn_auto(gsn_grid) stack = draw_stack(&b, (uint64_t)seed + 1);
        struct gsn_tissue_volumes v;

        CHECK_OK(gsn_tissue_volumes(stack, b.region, level, LEVELS, 0, &v, &err), err);
        (void)printf("kernel %.0f um, %.0f across; neighbours %.3f; holes %.3f %s\n", v.sigma_xy_um,
                     v.sigma_z_um, v.neighbours, v.wall_share, v.withheld ? v.withheld : "");
        for (int t = 0; t < LEVELS; t++) {
            const double truth = TOOTH_VOXELS[t] * voxel_um3;

            if (isnan(v.volume[t].estimate_um3)) {
                (void)printf("  D > %.2f: withheld\n", level[t]);
                continue;
            }
            (void)printf("  D > %.2f: %+.2f %% (%+.2f to %+.2f)\n", level[t],
                         100 * (v.volume[t].estimate_um3 / truth - 1),
                         100 * (v.volume[t].lower_um3 / truth - 1),
                         100 * (v.volume[t].upper_um3 / truth - 1));
            given++;
            covered += v.volume[t].lower_um3 <= truth && v.volume[t].upper_um3 >= truth;
        }
    }
    (void)printf("%d of %d intervals hold the truth\n", covered, given);
    /* The third is withheld now and then: its half width is near the 10 % where that happens. */
    CHECK(4 * given >= 11 * seeds && covered >= given * 85 / 100);
    block_done(&b);
}

TEST(any_number_of_threads_gives_the_same_bytes)
{
    struct block b = make_block(DEPTH[2]);
    gsn_auto(gsn_grid) stack = draw_stack(&b, 77);
    struct gsn_tissue_volumes one = { .withheld = "" }, two = { .withheld = "" };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_volumes(stack, b.region, THRESHOLD, 3, 1, &one, &err), err);
    CHECK_OK(gsn_tissue_volumes(stack, b.region, THRESHOLD, 3, 3, &two, &err), err);
    CHECK(memcmp(&one.volume, &two.volume, 3 * sizeof *one.volume) == 0);
    block_done(&b);
}

/* A small grid with a slope along x; noise of size amount that goes on over so many planes. */
static struct gsn_grid *draw_small(size_t planes, double amount, size_t run)
{
    const struct gsn_lattice at = { .nx = 24, .ny = 22, .nz = planes, .step_um = { 16, 16, 24 } };
    struct gsn_grid *grid = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&at, &grid, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&at); i++) {
        const size_t plane = at.nx * at.ny;
        struct gsn_phantom_random random = gsn_phantom_random_make(
            3, GSN_PHANTOM_STREAM_NOISE, i / plane / run, (uint32_t)(i % plane));

        grid->value[i] =
            (float)(0.5 + 0.02 * (double)(i % at.nx) + gsn_phantom_normal(&random, amount));
    }
    return grid;
}

static struct gsn_mask *whole_of(const struct gsn_grid *grid)
{
    struct gsn_mask *mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&grid->at, &mask, &err), err);
    memset(mask->inside, 1, gsn_lattice_count(&grid->at));
    return mask;
}

TEST(a_slope_without_noise_has_its_own_volume)
{
    gsn_auto(gsn_grid) grid = draw_small(12, 0, 1);
    gsn_auto(gsn_mask) region = whole_of(grid);
    const double threshold = 0.71; /* between columns 10 and 11 of 24 */
    struct gsn_tissue_volumes v;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_volumes(grid, region, &threshold, 1, 1, &v, &err), err);
    CHECK(!v.withheld);
    CHECK_NEAR(v.volume[0].estimate_um3, 13.0 * 22 * 12 * 16 * 16 * 24, 1);
}

TEST(no_tissue_is_larger_than_its_region)
{
    gsn_auto(gsn_grid) grid = draw_small(12, 0.1, 1);
    gsn_auto(gsn_mask) region = whole_of(grid);
    const double threshold = -1;
    struct gsn_tissue_volumes v;
    struct gsn_error err = { 0 };
    double most;

    /* Each centre of a voxel lies in it, and it is 2 % thinner than they are together. */
    region->at.step_um.z *= 0.98;
    most = (double)gsn_mask_count(region) * gsn_lattice_voxel_um3(&region->at);
    CHECK_OK(gsn_tissue_volumes(grid, region, &threshold, 1, 1, &v, &err), err);
    CHECK(!v.withheld);
    CHECK_NEAR(v.volume[0].estimate_um3, most, 1e-6 * most);
    CHECK_NEAR(v.volume[0].upper_um3, most, 1e-6 * most);
    CHECK(v.volume[0].lower_um3 <= most);
}

TEST(noise_that_goes_on_from_section_to_section_is_withheld)
{
    gsn_auto(gsn_grid) grid = draw_small(24, 0.1, 3);
    gsn_auto(gsn_mask) region = whole_of(grid);
    struct gsn_tissue_volumes v;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_volumes(grid, region, THRESHOLD, 3, 1, &v, &err), err);
    CHECK(v.withheld && strstr(v.withheld, "no noise") && isnan(v.volume[1].estimate_um3));
}

TEST(seven_sections_are_too_few)
{
    gsn_auto(gsn_grid) grid = draw_small(7, 0.1, 1);
    gsn_auto(gsn_mask) region = whole_of(grid);
    struct gsn_tissue_volumes v;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_volumes(grid, region, THRESHOLD, 3, 1, &v, &err), err);
    CHECK(v.withheld && strstr(v.withheld, "fewer than 8 sections"));
}

static int ask_small(const struct gsn_grid *grid, const struct gsn_mask *region,
                     struct gsn_error *err)
{
    struct gsn_tissue_volumes v;

    return gsn_tissue_volumes(grid, region, THRESHOLD, 3, 1, &v, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_grid) grid = draw_small(8, 0.1, 1);
    gsn_auto(gsn_mask) region = whole_of(grid);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(ask_small(grid, region, &err), err);
}
