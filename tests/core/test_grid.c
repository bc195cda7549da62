/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/grid.h"

#include "tests/check.h"

#include <string.h>

/* A place to point at, to see whether an output was touched. */
static int somewhere;

static const struct gsn_lattice BLOCK = {
    .nx = 4, .ny = 3, .nz = 5, .origin_um = { 100, -50, 12 }, .step_um = { 16, 8, 24 }
};

static struct gsn_mask *full_mask(const struct gsn_lattice *at)
{
    struct gsn_mask *mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(at, &mask, &err), err);
    memset(mask->inside, 1, gsn_lattice_count(at));
    return mask;
}

TEST(indices_run_through_the_lattice_once_with_x_fastest)
{
    size_t next = 0;

    CHECK(gsn_lattice_count(&BLOCK) == 60);
    for (size_t z = 0; z < BLOCK.nz; z++)
        for (size_t y = 0; y < BLOCK.ny; y++)
            for (size_t x = 0; x < BLOCK.nx; x++)
                CHECK(gsn_lattice_index(&BLOCK, x, y, z) == next++);
    CHECK(next == gsn_lattice_count(&BLOCK));
}

TEST(centres_and_voxels_are_in_micrometres)
{
    const struct gsn_vec3 first = gsn_lattice_centre(&BLOCK, 0, 0, 0);
    const struct gsn_vec3 last = gsn_lattice_centre(&BLOCK, 3, 2, 4);

    CHECK(first.x == 100 && first.y == -50 && first.z == 12);
    CHECK(last.x == 148 && last.y == -34 && last.z == 108);
    CHECK_NEAR(gsn_lattice_voxel_um3(&BLOCK), 16 * 8 * 24, 0);
}

TEST(a_grid_and_a_mask_begin_as_zeros)
{
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&BLOCK, &grid, &err), err);
    CHECK_OK(gsn_mask_new(&BLOCK, &mask, &err), err);
    assert_memory_equal(&grid->at, &BLOCK, sizeof BLOCK);
    assert_memory_equal(&mask->at, &BLOCK, sizeof BLOCK);
    for (size_t i = 0; i < 60; i++)
        CHECK(grid->value[i] == 0.0F && mask->inside[i] == 0);
    CHECK(gsn_mask_count(mask) == 0);
}

TEST(a_mask_counts_its_inside)
{
    gsn_auto(gsn_mask) mask = full_mask(&BLOCK);

    CHECK(gsn_mask_count(mask) == 60);
    mask->inside[0] = mask->inside[59] = mask->inside[17] = 0;
    CHECK(gsn_mask_count(mask) == 57);
}

TEST(a_point_belongs_to_the_one_cell_that_holds_it)
{
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&BLOCK, &mask, &err), err);
    for (size_t z = 0; z < BLOCK.nz; z++)
        for (size_t y = 0; y < BLOCK.ny; y++)
            for (size_t x = 0; x < BLOCK.nx; x++) {
                const struct gsn_vec3 c = gsn_lattice_centre(&BLOCK, x, y, z);
                uint8_t *const inside = &mask->inside[gsn_lattice_index(&BLOCK, x, y, z)];

                *inside = 1;
                CHECK(gsn_mask_has(mask, c));
                CHECK(gsn_mask_has(mask, gsn_vec3_make(c.x + 7.99, c.y - 3.99, c.z + 11.99)));
                CHECK(!gsn_mask_has(mask, gsn_vec3_make(c.x + 8.01, c.y, c.z)));
                CHECK(!gsn_mask_has(mask, gsn_vec3_make(c.x, c.y - 4.01, c.z)));
                CHECK(!gsn_mask_has(mask, gsn_vec3_make(c.x, c.y, c.z + 12.01)));
                *inside = 0;
                CHECK(!gsn_mask_has(mask, c));
            }
}

TEST(a_border_belongs_to_the_cell_behind_it)
{
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&BLOCK, &mask, &err), err);
    mask->inside[gsn_lattice_index(&BLOCK, 1, 1, 1)] = 1;
    CHECK(gsn_mask_has(mask, gsn_vec3_make(108, -46, 24)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(124, -46, 24)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(108, -38, 24)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(108, -46, 48)));
}

TEST(beyond_the_outer_borders_nothing_is_inside)
{
    static const double beyond[] = { 1e-6, 1, 1000, 1e18, 1e300, INFINITY };
    /* Outer borders: x 92 to 156, y -54 to -30, z 0 to 120. */
    const struct gsn_vec3 in = { 120, -40, 60 };
    gsn_auto(gsn_mask) mask = full_mask(&BLOCK);

    CHECK(gsn_mask_has(mask, in));
    CHECK(gsn_mask_has(mask, gsn_vec3_make(92, -54, 0)));
    CHECK(gsn_mask_has(mask, gsn_vec3_make(156 - 1e-6, -30 - 1e-6, 120 - 1e-6)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(156, in.y, in.z)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(in.x, -30, in.z)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(in.x, in.y, 120)));
    for (size_t i = 0; i < sizeof beyond / sizeof beyond[0]; i++) {
        const double d = beyond[i];

        CHECK(!gsn_mask_has(mask, gsn_vec3_make(92 - d, in.y, in.z)));
        CHECK(!gsn_mask_has(mask, gsn_vec3_make(156 + d, in.y, in.z)));
        CHECK(!gsn_mask_has(mask, gsn_vec3_make(in.x, -54 - d, in.z)));
        CHECK(!gsn_mask_has(mask, gsn_vec3_make(in.x, -30 + d, in.z)));
        CHECK(!gsn_mask_has(mask, gsn_vec3_make(in.x, in.y, 0 - d)));
        CHECK(!gsn_mask_has(mask, gsn_vec3_make(in.x, in.y, 120 + d)));
    }
}

TEST(a_point_that_is_no_number_is_nowhere)
{
    gsn_auto(gsn_mask) mask = full_mask(&BLOCK);

    CHECK(!gsn_mask_has(mask, gsn_vec3_make(NAN, -40, 60)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(120, NAN, 60)));
    CHECK(!gsn_mask_has(mask, gsn_vec3_make(120, -40, NAN)));
}

TEST(a_lattice_whose_count_overflows_is_refused_and_the_outputs_stay)
{
    /* The product wraps to 0, 0, 0 and 2: none may pass for a small lattice. */
    static const struct gsn_lattice much[] = {
        { .nx = (size_t)1 << 32, .ny = (size_t)1 << 32, .nz = 1 },
        { .nx = (size_t)1 << 32, .ny = (size_t)1 << 31, .nz = 4 },
        { .nx = 3, .ny = (size_t)1 << 32, .nz = (size_t)1 << 32 },
        { .nx = SIZE_MAX, .ny = 2, .nz = SIZE_MAX },
    };

    for (size_t i = 0; i < sizeof much / sizeof much[0]; i++) {
        struct gsn_grid *grid = (struct gsn_grid *)&somewhere;
        struct gsn_mask *mask = (struct gsn_mask *)&somewhere;
        struct gsn_error err = { 0 };

        CHECK(gsn_grid_new(&much[i], &grid, &err) == GSN_E_NOMEM);
        CHECK(strstr(err.text, "out of memory for a grid of") == err.text);
        CHECK(gsn_mask_new(&much[i], &mask, &err) == GSN_E_NOMEM);
        CHECK(strstr(err.text, "out of memory for a mask of") == err.text);
        CHECK(grid == (struct gsn_grid *)&somewhere && mask == (struct gsn_mask *)&somewhere);
    }
}

static int make_both(struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    const int r = gsn_grid_new(&BLOCK, &grid, err);

    return r < 0 ? r : gsn_mask_new(&BLOCK, &mask, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(make_both(&err), err);
}

TEST(freeing_nothing_is_fine)
{
    gsn_grid_free(NULL);
    gsn_mask_free(NULL);
}
