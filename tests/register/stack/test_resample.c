/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/stack/resample.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <string.h>

enum { SIDE = 40 };
static const struct gsn_lattice LATTICE = { 12, 10, 4, { -60, -48, 12 }, { 7, 7, 24 } };

static int is_hole(float value)
{
    return isnan(value) ? 1 : 0;
}

/* A panel of SIDE x SIDE pixels of 8 um, turned by 0.3 around its middle in the block's origin. */
static struct gsn_affine pose(void)
{
    const double c = 8 * cos(0.3), s = 8 * sin(0.3), middle = SIDE / 2;

    return (struct gsn_affine){ c, -s, -middle * (c - s), s, c, -middle * (s + c) };
}

/* Onto a lattice where nothing is known yet. */
static int resample(const struct gsn_stack_section *sections, size_t count,
                    const struct gsn_lattice *at, double interval_um, unsigned threads,
                    struct gsn_grid **ret_grid, struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = NULL;
    int r = gsn_grid_new(at, &grid, err);

    for (size_t i = 0; r >= 0 && i < gsn_lattice_count(at); i++)
        grid->value[i] = NAN;
    if (r >= 0)
        r = gsn_stack_resample(sections, count, interval_um, threads, grid, err);
    if (r >= 0)
        *ret_grid = gsn_steal(&grid);
    return r;
}

static double polynomial(struct gsn_point p, int degree)
{
    const double x = (p.x - 20) / 10, y = (p.y - 20) / 10;

    return 0.5 + 0.2 * x - 0.1 * y + (degree > 1 ? 0.3 * x * x - 0.2 * x * y + 0.1 * y * y : 0);
}

static void draw_polynomial(struct gsn_plane *plane, int degree)
{
    for (size_t i = 0; i < SIDE * SIDE; i++) {
        const struct gsn_point p = { (double)(i % SIDE) + 0.5, (double)(i / SIDE) + 0.5 };

        plane->value[i] = (float)polynomial(p, degree);
    }
}

static struct gsn_stack_section section_of(const struct gsn_plane *plane, unsigned serial)
{
    return (struct gsn_stack_section){ .serial = serial,
                                       .density = plane,
                                       .panel_to_block_um = pose(),
                                       .width = SIDE,
                                       .height = SIDE };
}

static void check_polynomial(int degree)
{
    float value[SIDE * SIDE];
    struct gsn_plane plane = { SIDE, SIDE, value };
    const struct gsn_affine map = pose(), back = gsn_affine_inverse(&map);
    struct gsn_stack_section section = section_of(&plane, 2);
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    draw_polynomial(&plane, degree);
    CHECK_OK(resample(&section, 1, &LATTICE, 24, 1, &grid, &err), err);
    for (size_t y = 0; y < LATTICE.ny; y++) {
        for (size_t x = 0; x < LATTICE.nx; x++) {
            const struct gsn_vec3 at = gsn_lattice_centre(&LATTICE, x, y, 2);
            const struct gsn_point um = { at.x, at.y };

            CHECK_NEAR(grid->value[gsn_lattice_index(&LATTICE, x, y, 2)],
                       polynomial(gsn_affine_apply(&back, um), degree), 3e-6);
        }
    }
}

TEST(a_linear_ramp_is_reproduced)
{
    check_polynomial(1);
}

TEST(a_quadratic_is_reproduced)
{
    check_polynomial(2);
}

TEST(a_missing_section_leaves_a_gap)
{
    float value[SIDE * SIDE];
    struct gsn_plane plane = { SIDE, SIDE, value };
    struct gsn_stack_section sections[2] = { section_of(&plane, 3), section_of(&plane, 0) };
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    draw_fill(&plane, 0.25);
    CHECK_OK(resample(sections, 2, &LATTICE, 24, 1, &grid, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&LATTICE); i++) {
        const size_t z = i / (LATTICE.nx * LATTICE.ny);

        if (z == 0 || z == 3)
            CHECK_NEAR(grid->value[i], 0.25, 1e-7);
        else
            CHECK(is_hole(grid->value[i]));
    }
}

TEST(a_plane_shows_the_section_whose_serial_number_its_z_says)
{
    /* z = 54, 66, 78, 90: sections 1.75 -> 2, 2.25 -> 2, 2.75 -> 3 and 3.25 -> 3. */
    const struct gsn_lattice at = { 1, 1, 4, { 0, 0, 54 }, { 8, 8, 12 } };
    float two[SIDE * SIDE], three[SIDE * SIDE];
    struct gsn_plane second = { SIDE, SIDE, two }, third = { SIDE, SIDE, three };
    struct gsn_stack_section sections[2] = { section_of(&third, 3), section_of(&second, 2) };
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    draw_fill(&second, 2);
    draw_fill(&third, 3);
    CHECK_OK(resample(sections, 2, &at, 24, 1, &grid, &err), err);
    for (size_t z = 0; z < 4; z++)
        CHECK_NEAR(grid->value[z], z < 2 ? 2 : 3, 1e-6);
}

TEST(no_section_at_all_is_one_large_gap)
{
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(resample(NULL, 0, &LATTICE, 24, 1, &grid, &err), err);
    CHECK(is_hole(grid->value[0]));
}

/* Identity pose: lattice points at whole pixels show the mask rules one by one. */
TEST(a_masked_pixel_is_a_hole_and_its_neighbours_are_interpolated_without_it)
{
    const struct gsn_affine identity = { 1, 0, 0, 0, 1, 0 };
    const struct gsn_lattice at = { 4, 1, 1, { 10.5, 10.5, 0.5 }, { 0.25, 1, 1 } };
    float value[SIDE * SIDE];
    struct gsn_plane plane = { SIDE, SIDE, value };
    struct gsn_stack_section section = section_of(&plane, 0);
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    draw_fill(&plane, 1);
    value[10 * SIDE + 10] = 3;
    value[10 * SIDE + 11] = NAN;
    section.panel_to_block_um = identity;
    CHECK_OK(resample(&section, 1, &at, 1, 1, &grid, &err), err);
    CHECK(grid->value[0] == 3);
    /* A quarter of the way to the hole, only the valid pixel of the two counts. */
    CHECK(grid->value[1] == 3);
    CHECK(is_hole(grid->value[2]));
    CHECK(is_hole(grid->value[3]));
}

TEST(nothing_outside_the_box_is_read)
{
    const struct gsn_affine identity = { 1, 0, 0, 0, 1, 0 };
    const struct gsn_lattice at = { SIDE, SIDE, 1, { 0.7, 0.6, 0.5 }, { 1, 1, 1 } };
    float value[SIDE * SIDE];
    struct gsn_plane plane = { SIDE, SIDE, value };
    struct gsn_stack_section section = section_of(&plane, 0);
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    draw_fill(&plane, 1e9);
    draw_box(&plane, 10, 12, 8, 9, 0.5);
    section.panel_to_block_um = identity;
    section.x = 10;
    section.y = 12;
    section.width = 8;
    section.height = 9;
    CHECK_OK(resample(&section, 1, &at, 1, 1, &grid, &err), err);
    for (size_t i = 0; i < SIDE * SIDE; i++) {
        const size_t x = i % SIDE, y = i / SIDE;
        const int inside = x >= 10 && x < 18 && y >= 12 && y < 21;

        CHECK(inside ? fabsf(grid->value[i] - 0.5f) < 1e-6f : is_hole(grid->value[i]));
    }
}

TEST(the_number_of_threads_does_not_matter)
{
    float value[SIDE * SIDE];
    struct gsn_plane plane = { SIDE, SIDE, value };
    struct gsn_stack_section sections[3] = { section_of(&plane, 0), section_of(&plane, 1),
                                             section_of(&plane, 3) };
    struct draw_chance chance = { 3 };
    gsn_auto(gsn_grid) one = NULL;
    gsn_auto(gsn_grid) two = NULL;
    struct gsn_error err = { 0 };

    draw_fill(&plane, 0.4);
    draw_noise(&plane, &chance, 0.1);
    CHECK_OK(resample(sections, 3, &LATTICE, 24, 1, &one, &err), err);
    CHECK_OK(resample(sections, 3, &LATTICE, 24, 2, &two, &err), err);
    CHECK(memcmp(one->value, two->value, gsn_lattice_count(&LATTICE) * sizeof(float)) == 0);
}

/* How much of a wave is left on voxels of 3 pixels: it is so many voxels long, and turned against
 * both the pixels and the voxels. */
static double swing(double period_voxels)
{
    enum { FINE = 120 };
    static float value[FINE * FINE];
    struct gsn_plane plane = { FINE, FINE, value };
    const double k = 2 * M_PI / (3 * period_voxels), c = 8 * cos(0.5), s = 8 * sin(0.5);
    const struct gsn_lattice at = { 24, 24, 1, { -12 * 24, -12 * 24, 12 }, { 24, 24, 24 } };
    const struct gsn_stack_section section = { .density = &plane,
                                               .panel_to_block_um = { c, -s, -60 * (c - s), s, c,
                                                                      -60 * (s + c) },
                                               .width = FINE,
                                               .height = FINE };
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };
    double most = 0;

    for (size_t i = 0; i < FINE * FINE; i++)
        value[i] = (float)cos(k * (0.8 * (double)(i % FINE) + 0.6 * (double)(i / FINE)));
    CHECK_OK(resample(&section, 1, &at, 24, 1, &grid, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&at); i++)
        most = fmax(most, fabs((double)grid->value[i]));
    return most;
}

TEST(on_coarse_voxels_a_long_wave_is_kept_and_one_finer_than_a_voxel_vanishes)
{
    CHECK(swing(10) > 0.97);
    CHECK(swing(5) > 0.9);
    CHECK(swing(1.1) < 0.05);
    CHECK(swing(1) < 0.05);
    CHECK(swing(0.8) < 0.05);
}

/* Only the pixels that a lattice shows need be there. */
TEST(a_plane_cut_to_its_footprint_gives_the_same_bits)
{
    const struct gsn_lattice small = { 7, 5, 4, { -20, -30, 12 }, { 9, 9, 24 } };
    float value[SIDE * SIDE], cut[SIDE * SIDE];
    struct gsn_plane plane = { SIDE, SIDE, value }, part = { .value = cut };
    struct gsn_stack_section whole = section_of(&plane, 1), narrow = whole;
    gsn_auto(gsn_grid) all = NULL;
    gsn_auto(gsn_grid) same = NULL;
    struct gsn_error err = { 0 };

    draw_polynomial(&plane, 2);
    CHECK(gsn_stack_footprint(&small, 24, &narrow));
    CHECK(narrow.width < SIDE / 2 && narrow.height < SIDE / 2);
    part.width = (uint32_t)narrow.width;
    part.height = (uint32_t)narrow.height;
    for (int i = 0; i < narrow.width * narrow.height; i++)
        cut[i] = value[(narrow.y + i / narrow.width) * SIDE + narrow.x + i % narrow.width];
    narrow.density = &part;
    narrow.plane_x = narrow.x;
    narrow.plane_y = narrow.y;
    CHECK_OK(resample(&whole, 1, &small, 24, 1, &all, &err), err);
    CHECK_OK(resample(&narrow, 1, &small, 24, 1, &same, &err), err);
    CHECK(memcmp(all->value, same->value, gsn_lattice_count(&small) * sizeof(float)) == 0);
    whole.serial = 9;
    CHECK(!gsn_stack_footprint(&small, 24, &whole) && whole.width == SIDE);
}

TEST(two_sections_with_one_serial_number_are_refused_by_name)
{
    float value[SIDE * SIDE] = { 0 };
    struct gsn_plane plane = { SIDE, SIDE, value };
    struct gsn_stack_section sections[3] = { section_of(&plane, 6), section_of(&plane, 1),
                                             section_of(&plane, 6) };
    struct gsn_grid *grid = NULL;
    struct gsn_error err = { 0 };

    CHECK(resample(sections, 3, &LATTICE, 24, 1, &grid, &err) == GSN_E_INPUT);
    CHECK(grid == NULL);
    CHECK(strcmp(err.text, "sections 1 and 3 of 3 both carry serial number 7") == 0);
}

TEST(bad_sections_are_refused_and_the_output_stays_untouched)
{
    float value[SIDE * SIDE] = { 0 };
    struct gsn_plane plane = { SIDE, SIDE, value };
    const struct gsn_stack_section good = section_of(&plane, 0);
    struct gsn_stack_section empty = good, outside = good, flat = good;
    struct gsn_grid *grid = NULL;
    struct gsn_error err = { 0 };

    empty.density = NULL;
    outside.x = 1;
    flat.panel_to_block_um = (struct gsn_affine){ 1, 2, 0, 2, 4, 0 };
    CHECK(resample(&empty, 1, &LATTICE, 24, 1, &grid, &err) == GSN_E_INPUT);
    CHECK(resample(&outside, 1, &LATTICE, 24, 1, &grid, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "outside its panel"));
    CHECK(resample(&flat, 1, &LATTICE, 24, 1, &grid, &err) == GSN_E_INPUT);
    CHECK(resample(&good, 1, &LATTICE, 0, 1, &grid, &err) == GSN_E_INPUT);
    CHECK(grid == NULL);
}

static int stack_once(struct gsn_error *err)
{
    float value[SIDE * SIDE] = { 0 };
    const struct gsn_plane plane = { SIDE, SIDE, value };
    const struct gsn_stack_section section = section_of(&plane, 0);
    gsn_auto(gsn_grid) grid = NULL;

    return resample(&section, 1, &LATTICE, 24, 1, &grid, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(stack_once(&err), err);
}
