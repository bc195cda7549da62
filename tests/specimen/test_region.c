/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/region.h"

#include "tests/check.h"

#include <math.h>
#include <string.h>

static const struct gsn_lattice AT = {
    .nx = 40, .ny = 40, .nz = 40, .origin_um = { -19.5, -19.5, -19.5 }, .step_um = { 1, 1, 1 }
};

TEST(a_shape_covers_its_own_volume)
{
    /* Off the lattice's symmetry, where whole shells of voxels would lie on the border at once. */
    const struct gsn_region ball = { .kind = GSN_REGION_SPHERE,
                                     .centre = { 0.13, 0.27, 0.41 },
                                     .radius_um = 15 };
    const struct gsn_region box = { .kind = GSN_REGION_BOX,
                                    .low = { -3, -4, -5 },
                                    .high = { 3, 4, 5 } };
    gsn_auto(gsn_mask) in_ball = NULL;
    gsn_auto(gsn_mask) in_box = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_region_raster(&ball, &AT, &in_ball, &err), err);
    /* Lattice points of a ball: the volume within a part of the voxels its surface meets. */
    CHECK_NEAR((double)gsn_mask_count(in_ball), 4.0 / 3.0 * M_PI * 15 * 15 * 15,
               0.1 * 4 * M_PI * 15 * 15);
    CHECK_OK(gsn_region_raster(&box, &AT, &in_box, &err), err);
    CHECK(gsn_mask_count(in_box) == 6 * 8 * 10);
}

TEST(a_cylinder_has_the_same_disc_on_every_plane_between_its_ends)
{
    const struct gsn_region cylinder = { .kind = GSN_REGION_CYLINDER,
                                         .centre = { 0.13, 0.27, 400 },
                                         .radius_um = 12,
                                         .low.z = -7,
                                         .high.z = 4 };
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_error err = { 0 };
    size_t wrong = 0, inside = 0;

    CHECK_OK(gsn_region_raster(&cylinder, &AT, &mask, &err), err);
    for (size_t z = 0; z < AT.nz; z++)
        for (size_t y = 0; y < AT.ny; y++)
            for (size_t x = 0; x < AT.nx; x++) {
                const double dx = (double)x - 19.5 - 0.13, dy = (double)y - 19.5 - 0.27;
                const double at_z = (double)z - 19.5;
                const int within = dx * dx + dy * dy <= 144 && at_z > -7 && at_z < 4;

                inside += (size_t)within;
                wrong += mask->inside[gsn_lattice_index(&AT, x, y, z)] != within;
            }
    CHECK(wrong == 0);
    CHECK_NEAR((double)inside, M_PI * 144 * 11, 0.1 * 2 * M_PI * 12 * 11);
}

TEST(a_shape_beside_the_stack_is_refused_and_the_output_stays_untouched)
{
    const struct gsn_region far = { .kind = GSN_REGION_SPHERE,
                                    .centre = { 500, 0, 0 },
                                    .radius_um = 15 };
    gsn_auto(gsn_mask) nowhere = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_region_raster(&far, &AT, &nowhere, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "the region of interest holds no voxel of this stack") == 0);
    CHECK(nowhere == NULL);
}

static int raster_once(struct gsn_error *err)
{
    const struct gsn_region ball = { .kind = GSN_REGION_SPHERE, .radius_um = 3 };
    gsn_auto(gsn_mask) mask = NULL;

    return gsn_region_raster(&ball, &AT, &mask, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(raster_once(&err), err);
}
