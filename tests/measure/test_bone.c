/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Bodies whose figures are known: each is what a distance from its middle is below, so that the
 * level 0 of -distance is its surface. */
#include "pipeline/measure/bone.h"

#include <stdio.h>
#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

enum { SIDE = 44 };

struct body {
    double (*depth)(const struct body *body, struct gsn_vec3 at); /* um, above 0 inside */
    double size, second;                                          /* um */
};

static double in_ball(const struct body *b, struct gsn_vec3 at)
{
    return b->size - gsn_vec3_length(at);
}

static double in_shell(const struct body *b, struct gsn_vec3 at)
{
    const double r = gsn_vec3_length(at);

    return fmin(b->size - r, r - b->second);
}

static double in_plate(const struct body *b, struct gsn_vec3 at)
{
    return 0.5 * b->size - fabs(at.z);
}

static double in_rod(const struct body *b, struct gsn_vec3 at)
{
    return b->size - hypot(at.x, at.y);
}

/* A ring of radius second about z. */
static double in_torus(const struct body *b, struct gsn_vec3 at)
{
    return b->size - hypot(hypot(at.x, at.y) - b->second, at.z);
}

static double in_two_balls(const struct body *b, struct gsn_vec3 at)
{
    struct gsn_vec3 left = at, right = at;

    left.x += b->second;
    right.x -= b->second;
    return b->size - fmin(gsn_vec3_length(left), gsn_vec3_length(right));
}

/* The body's middle lies in the lattice's, moved by a part of a voxel. */
static struct gsn_bone measure(const struct body *body, const double step[3], double moved,
                               unsigned threads)
{
    struct gsn_lattice at = { .nx = SIDE, .ny = SIDE, .nz = SIDE };
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) region = NULL;
    struct gsn_bone bone;
    struct gsn_error err = { 0 };

    at.step_um = gsn_vec3_make(step[0], step[1], step[2]);
    at.nz = (size_t)(SIDE * step[0] / step[2]);
    at.origin_um = gsn_vec3_make(-0.5 * step[0] * (SIDE - 1 - moved), -0.5 * step[1] * (SIDE - 1),
                                 -0.5 * step[2] * ((double)at.nz - 1 - moved));
    CHECK_OK(gsn_grid_new(&at, &grid, &err), err);
    CHECK_OK(gsn_mask_new(&at, &region, &err), err);
    memset(region->inside, 1, gsn_lattice_count(&at));
    for (size_t z = 0; z < at.nz; z++)
        for (size_t y = 0; y < at.ny; y++)
            for (size_t x = 0; x < at.nx; x++)
                grid->value[gsn_lattice_index(&at, x, y, z)] =
                    (float)body->depth(body, gsn_lattice_centre(&at, x, y, z));
    CHECK_OK(gsn_bone_measure(grid, region, 0, threads, &bone, &err), err);
    return bone;
}

static const double EVEN[3] = { 12, 12, 12 };
static const double UNEVEN[3] = { 12, 12, 24 };

static void check_near(const char *name, double value, double truth, double share)
{
    printf("%s: %.4g, true %.4g (%+.2f %%)\n", name, value, truth, 100 * (value / truth - 1));
    CHECK_NEAR(value, truth, share * truth);
}

TEST(a_ball_has_its_volume_surface_and_thickness)
{
    const struct body ball = { in_ball, 220, 0 };

    for (int k = 0; k < 4; k++) {
        const struct gsn_bone bone = measure(&ball, k & 1 ? UNEVEN : EVEN, k & 2 ? 0.7 : 0, 0);

        check_near("ball, volume", bone.bone_um3, 4. / 3 * M_PI * 220 * 220 * 220, 0.01);
        check_near("ball, surface over volume", bone.surface_um2 / bone.bone_um3, 3. / 220, 0.01);
        check_near("ball, thickness", bone.thickness_um, 440, 0.03);
        CHECK(bone.components == 1 && bone.euler == 1);
    }
}

TEST(plates_of_any_number_of_voxels_have_their_thickness)
{
    for (double thick = 228; thick <= 246; thick += 9) {
        const struct body plate = { in_plate, thick, 0 };
        const struct gsn_bone bone = measure(&plate, EVEN, 0, 0);

        check_near("plate, thickness", bone.thickness_um, thick, 0.03);
        CHECK(bone.thickness_sd < 0.02 * thick);
        CHECK(bone.components == 1 && bone.euler == 1);
    }
}

TEST(a_rod_has_its_surface_and_thickness)
{
    const struct body rod = { in_rod, 130, 0 };

    for (int k = 0; k < 4; k++) {
        const struct gsn_bone bone = measure(&rod, k & 1 ? UNEVEN : EVEN, k & 2 ? 0.7 : 0, 0);

        check_near("rod, thickness", bone.thickness_um, 260, 0.03);
        /* It ends at the middles of the outer voxels. */
        check_near("rod, surface", bone.surface_um2, 2 * M_PI * 130 * (k & 1 ? 21 * 24 : 43 * 12),
                   0.01);
        CHECK(bone.components == 1 && bone.euler == 1);
    }
}

TEST(a_torus_has_one_tunnel_and_its_thickness)
{
    const struct body torus = { in_torus, 100, 150 };
    const struct gsn_bone bone = measure(&torus, EVEN, 0, 0);

    check_near("torus, thickness", bone.thickness_um, 200, 0.03);
    check_near("torus, surface", bone.surface_um2, 4 * M_PI * M_PI * 100 * 150, 0.01);
    CHECK(bone.components == 1 && bone.euler == 0);
}

TEST(pieces_and_cavities_are_counted)
{
    const struct body two = { in_two_balls, 90, 130 }, shell = { in_shell, 240, 90 };
    struct gsn_bone bone = measure(&two, EVEN, 0, 0);

    CHECK(bone.components == 2 && bone.euler == 2);
    bone = measure(&shell, EVEN, 0, 0);
    CHECK(bone.components == 1 && bone.euler == 2);
    check_near("shell, thickness", bone.thickness_um, 150, 0.05);
}

TEST(threads_change_no_bit)
{
    const struct body torus = { in_torus, 100, 150 };
    const struct gsn_bone one = measure(&torus, UNEVEN, 0.3, 1),
                          four = measure(&torus, UNEVEN, 0.3, 4);

    CHECK(one.surface_um2 == four.surface_um2 && one.thickness_um == four.thickness_um &&
          one.thickness_sd == four.thickness_sd && one.euler == four.euler);
}

static int measure_half(const struct gsn_grid *grid, const struct gsn_mask *region,
                        struct gsn_error *err)
{
    struct gsn_bone bone;

    return gsn_bone_measure(grid, region, 0.5, 1, &bone, err);
}

TEST(a_region_without_data_is_refused_and_memory_may_run_out)
{
    const double corner[3] = { 0, 0, 0 };
    gsn_auto(gsn_mask) region = full_mask(corner, 10, 8, 8, 8);
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_bone bone;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&region->at, &grid, &err), err);
    CHECK_OK(gsn_bone_measure(grid, region, 0.5, 1, &bone, &err), err); /* no bone: no thickness */
    CHECK(bone.components == 0 && bone.euler == 0 && bone.surface_um2 == 0);
    CHECK(!(bone.thickness_um >= 0));
    CHECK_EVERY_OOM(measure_half(grid, region, &err), err);
    for (size_t i = 0; i < 512; i++)
        grid->value[i] = NAN;
    CHECK(gsn_bone_measure(grid, region, 0.5, 1, &bone, &err) == GSN_E_INPUT);
}
