/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/tissue_segmentation.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

static const struct gsn_lattice BLOCK = { 100, 90, 20, { -1584, -1424, 12 }, { 32, 32, 24 } };

/* Distance from the axis of a root that widens with depth, minus its radius there. */
static double beyond_root(struct gsn_vec3 u)
{
    return hypot(u.x - 60, u.y + 40) - (300 + 0.3 * u.z);
}

/* A root with its pulp, a ligament of 200 um, bone, loose tissue, glass; with grain. The lesion
 * leaves a share of bone and ligament, least beside the root. */
static struct gsn_grid *draw_block(const struct gsn_lattice *at, int with_ligament, double lesion)
{
    struct dice dice = { 3 };
    struct gsn_grid *grid = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(at, &grid, &err), err);
    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const struct gsn_vec3 u = gsn_lattice_centre(at, x, y, z);
                const double d = beyond_root(u), r = hypot(u.x, u.y);
                double value = r > 1350 ? 0 : r > 1150 ? 0.2 : 0.85;

                value *= 1 - lesion * exp(-pow(hypot(u.x - 500, u.y - 300) / 400, 2));
                if (with_ligament && d < 200)
                    value = d >= 0 ? 0.4 : hypot(u.x - 60, u.y + 40) < 120 ? 0.1 : 0.55;
                grid->value[i] = (float)(value * (1 + 0.15 * dice_normal(&dice)));
            }
    /* What is masked says nothing. */
    for (size_t i = at->nx / 3; i < at->nx / 2; i++)
        grid->value[gsn_lattice_index(at, i, at->ny / 2, at->nz / 2)] = NAN;
    return grid;
}

/* Dice's coefficient with the root that was drawn. */
static double likeness(const struct gsn_mask *root)
{
    size_t truth = 0, both = 0;

    for (size_t i = 0, z = 0; z < BLOCK.nz; z++)
        for (size_t y = 0; y < BLOCK.ny; y++)
            for (size_t x = 0; x < BLOCK.nx; x++, i++) {
                const int in = beyond_root(gsn_lattice_centre(&BLOCK, x, y, z)) < 0;

                truth += (size_t)in;
                both += in && root->inside[i];
            }
    return 2.0 * (double)both / (double)(truth + gsn_mask_count(root));
}

/* The levels of a block whose root is found, as like the drawn one as this at least. */
static struct gsn_tissue_levels find_root(const struct gsn_grid *block, double least)
{
    gsn_auto(gsn_mask) root = NULL;
    struct gsn_tissue_levels levels;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_find(block, GSN_TISSUE_ROOT, &root, &levels, &err), err);
    CHECK(likeness(root) > least);
    return levels;
}

TEST(the_root_is_found_with_its_pulp)
{
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 1, 0);
    const struct gsn_tissue_levels levels = find_root(block, 0.96);

    CHECK_NEAR(levels.dentine, 0.55, 0.03);
    CHECK_NEAR(levels.bone, 0.85, 0.03);
    CHECK(levels.border > 0.42 && levels.border < 0.53);
}

/* Tissue is 1350 um wide around the middle, bone 1150. */
TEST(bone_is_found_without_root_and_ligament_and_the_outline_with_everything)
{
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 1, 0);
    gsn_auto(gsn_mask) bone = NULL;
    gsn_auto(gsn_mask) all = NULL;
    struct gsn_tissue_levels levels;
    struct gsn_error err = { 0 };
    const double plane = BLOCK.step_um.x * BLOCK.step_um.y;
    double ring = 0;

    CHECK_OK(gsn_tissue_find(block, GSN_TISSUE_ALL, &all, &levels, &err), err);
    CHECK_NEAR((double)gsn_mask_count(all) * plane / (double)BLOCK.nz, M_PI * 1350 * 1350, 2e5);
    CHECK_OK(gsn_tissue_find(block, GSN_TISSUE_BONE, &bone, &levels, &err), err);
    for (size_t z = 0; z < BLOCK.nz; z++)
        ring += M_PI * (1150 * 1150 - pow(500 + 0.3 * gsn_lattice_centre(&BLOCK, 0, 0, z).z, 2));
    CHECK_NEAR((double)gsn_mask_count(bone) * plane / ring, 1, 0.06);
    for (size_t i = 0, z = 0; z < BLOCK.nz; z++)
        for (size_t y = 0; y < BLOCK.ny; y++)
            for (size_t x = 0; x < BLOCK.nx; x++, i++)
                CHECK(!bone->inside[i] || beyond_root(gsn_lattice_centre(&BLOCK, x, y, z)) > 130);
}

TEST(a_block_of_glass_has_no_tissue)
{
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 1, 0);
    gsn_auto(gsn_mask) all = NULL;
    struct gsn_tissue_levels levels;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < gsn_lattice_count(&BLOCK); i++)
        block->value[i] *= 0.02f;
    for (enum gsn_tissue_kind k = GSN_TISSUE_ROOT; k < GSN_TISSUE_BODIES; k++)
        CHECK(gsn_tissue_find(block, k, &all, &levels, &err) == GSN_E_STAIN && !all);
    CHECK(strcmp(err.text, "no tissue was found in this block; state the region as a mask or a "
                           "shape") == 0);
}

/* Beside the lesion there is bone of the density of dentine, with paler tissue around it. */
TEST(bone_that_a_lesion_has_thinned_is_no_root)
{
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 1, 0.8);

    CHECK_NEAR(find_root(block, 0.95).dentine, 0.55, 0.03);
}

/* Volume of the root that is found, over that which was drawn. */
static double volume_found(double lesion)
{
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 1, lesion);
    gsn_auto(gsn_mask) root = NULL;
    struct gsn_tissue_levels levels;
    struct gsn_error err = { 0 };
    size_t truth = 0;

    CHECK_OK(gsn_tissue_find(block, GSN_TISSUE_ROOT, &root, &levels, &err), err);
    for (size_t z = 0; z < BLOCK.nz; z++)
        for (size_t y = 0; y < BLOCK.ny; y++)
            for (size_t x = 0; x < BLOCK.nx; x++)
                truth += beyond_root(gsn_lattice_centre(&BLOCK, x, y, z)) < 0;
    return (double)gsn_mask_count(root) / (double)truth;
}

/* A band that counts from it must begin at the same place in a control and in a treated animal: 3 %
 * of the volume are 6 um of the radius. */
TEST(the_surface_of_the_root_is_right_whatever_is_left_of_the_bone_beside_it)
{
    const double control = volume_found(0), treated = volume_found(0.8);

    CHECK_NEAR(control, 1, 0.03);
    CHECK_NEAR(treated, 1, 0.03);
}

/* Three panels, the second of them stained by a third more than the last, so that its ligament is
 * as dense as the other's dentine; two sections are lost. */
TEST(the_root_is_found_across_panels_that_are_stained_unequally)
{
    static const double stain[] = { 0.95, 1.15, 0.85 };
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 1, 0.8);
    const size_t plane = BLOCK.nx * BLOCK.ny;

    for (size_t z = 0; z < BLOCK.nz; z++)
        for (size_t i = z * plane; i < (z + 1) * plane; i++)
            block->value[i] *= z == 11 || z == 12 ? NAN : (float)stain[z / 7];
    (void)find_root(block, 0.93);
}

TEST(a_block_without_a_root_is_refused_in_words)
{
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 0, 0);
    gsn_auto(gsn_mask) root = NULL;
    struct gsn_tissue_levels levels = { .bone = 77 };
    struct gsn_error err = { 0 };

    CHECK(gsn_tissue_find(block, GSN_TISSUE_ROOT, &root, &levels, &err) == GSN_E_STAIN);
    CHECK(strstr(err.text, "no root was found") && strstr(err.text, "state the region"));
    CHECK(root == NULL && levels.bone == 77);
}

static struct gsn_mask *ball(double radius)
{
    const struct gsn_lattice at = { 80, 80, 50, { -632, -632, -588 }, { 16, 16, 24 } };
    struct gsn_mask *mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&at, &mask, &err), err);
    for (size_t i = 0, z = 0; z < at.nz; z++)
        for (size_t y = 0; y < at.ny; y++)
            for (size_t x = 0; x < at.nx; x++, i++)
                mask->inside[i] = gsn_vec3_length(gsn_lattice_centre(&at, x, y, z)) < radius;
    return mask;
}

static double shell_volume(double low, double high)
{
    return 4.0 / 3 * M_PI * (high * high * high - low * low * low);
}

TEST(a_band_around_a_ball_is_a_shell)
{
    static const double bands[][2] = { { 100, 250 }, { 0, 180 }, { -150, 50 } };
    gsn_auto(gsn_mask) body = ball(300);
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < 3; i++) {
        gsn_auto(gsn_mask) band = NULL;
        const double inner = 300 + bands[i][0], outer = 300 + bands[i][1];
        double volume;

        CHECK_OK(gsn_tissue_band(body, bands[i][0], bands[i][1], &body->at, 2, &band, &err), err);
        volume = (double)gsn_mask_count(band) * gsn_lattice_voxel_um3(&band->at);
        /* Both surfaces lie right to a quarter of a voxel. */
        CHECK_NEAR(volume, shell_volume(inner, outer),
                   4 * 4 * M_PI * (inner * inner + outer * outer));
    }
}

TEST(a_band_may_be_asked_for_on_another_lattice)
{
    const struct gsn_lattice fine = { 60, 60, 6, { -590, -590, -50 }, { 20, 20, 20 } };
    gsn_auto(gsn_mask) body = ball(300);
    gsn_auto(gsn_mask) band = NULL;
    struct gsn_error err = { 0 };
    size_t wrong = 0;

    CHECK_OK(gsn_tissue_band(body, 100, 250, &fine, 1, &band, &err), err);
    for (size_t i = 0, z = 0; z < fine.nz; z++)
        for (size_t y = 0; y < fine.ny; y++)
            for (size_t x = 0; x < fine.nx; x++, i++) {
                const double r = gsn_vec3_length(gsn_lattice_centre(&fine, x, y, z));
                const double d = fmin(fabs(r - 400), fabs(r - 550));

                wrong += d > 16 && band->inside[i] != (r >= 400 && r < 550);
            }
    CHECK(wrong == 0);
}

TEST(a_band_of_nothing_is_refused)
{
    gsn_auto(gsn_mask) body = ball(300);
    gsn_auto(gsn_mask) none = ball(0);
    gsn_auto(gsn_mask) band = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_tissue_band(none, 0, 100, &body->at, 1, &band, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "is empty"));
    CHECK(gsn_tissue_band(body, 5000, 5100, &body->at, 1, &band, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "no voxel lies 5000 to 5100 um") && band == NULL);
}

static int find_and_forget(const struct gsn_grid *block, struct gsn_error *err)
{
    gsn_auto(gsn_mask) root = NULL;
    struct gsn_tissue_levels levels;

    return gsn_tissue_find(block, GSN_TISSUE_ROOT, &root, &levels, err);
}

/* Every line of voxels asks for memory, so only some of those that are alike are made to fail. */
TEST(running_out_of_memory_for_a_root_leaks_nothing)
{
    gsn_auto(gsn_grid) block = draw_block(&BLOCK, 1, 0);
    struct gsn_error err = { 0 };
    size_t asked = SIZE_MAX;

    for (size_t n = 1; asked >= n; n += n < 12 ? 1 : 97) {
        gsn_check_fail_allocation(n);
        const int r = find_and_forget(block, &err);

        asked = gsn_check_allocations();
        gsn_check_fail_allocation(0);
        CHECK(r == (asked >= n ? GSN_E_NOMEM : GSN_OK));
    }
}

static int band_and_forget(const struct gsn_mask *body, struct gsn_error *err)
{
    gsn_auto(gsn_mask) band = NULL;

    return gsn_tissue_band(body, 10, 40, &body->at, 1, &band, err);
}

TEST(running_out_of_memory_for_a_band_leaks_nothing)
{
    const struct gsn_lattice at = { 9, 8, 5, { 0, 0, 0 }, { 16, 16, 24 } };
    gsn_auto(gsn_mask) body = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&at, &body, &err), err);
    body->inside[gsn_lattice_index(&at, 4, 4, 2)] = 1;
    CHECK_EVERY_OOM(band_and_forget(body, &err), err);
}
