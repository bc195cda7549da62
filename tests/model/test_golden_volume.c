/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Volumes above a threshold, of splines that are one polynomial on a cube. */
#include "tests/model/golden.h"

#include "tests/check.h"

#include "pipeline/measure/level_set.h"

#include <string.h>

enum { VOXELS = 16 }; /* along each edge */

static struct gsn_mask *cube_of(const struct gsn_tets *mesh, double *ret_volume)
{
    double low[3] = { INFINITY, INFINITY, INFINITY }, high[3] = { -INFINITY, -INFINITY, -INFINITY };
    struct gsn_lattice at = { .nx = VOXELS, .ny = VOXELS, .nz = VOXELS };
    struct gsn_mask *mask = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < mesh->vertex_count; i++) {
        for (int c = 0; c < 3; c++) {
            low[c] = fmin(low[c], mesh->vertex[i][c]);
            high[c] = fmax(high[c], mesh->vertex[i][c]);
        }
    }
    at.step_um = (struct gsn_vec3){ (high[0] - low[0]) / VOXELS, (high[1] - low[1]) / VOXELS,
                                    (high[2] - low[2]) / VOXELS };
    at.origin_um = (struct gsn_vec3){ low[0] + at.step_um.x / 2, low[1] + at.step_um.y / 2,
                                      low[2] + at.step_um.z / 2 };
    CHECK_OK(gsn_mask_new(&at, &mask, &err), err);
    memset(mask->inside, 1, gsn_lattice_count(&at));
    *ret_volume = (high[0] - low[0]) * (high[1] - low[1]) * (high[2] - low[2]);
    return mask;
}

/* What a width is a share of: the volume, but no less than 1 % of what it is looked for in; of
 * nothing there is no share. */
static double relative_to(const struct gsn_volume_bound *bound, double whole)
{
    return fmax(bound->upper_um3, 0.01 * whole);
}

static void check_volume(const struct golden_case *golden)
{
    struct golden_table exact = golden_read(golden, "isovolume_total");
    gsn_auto(gsn_spline) spline = golden_spline(golden);
    double whole;
    gsn_auto(gsn_mask) cube = cube_of(golden->mesh, &whole);

    for (size_t i = 0; i < exact.rows; i++) {
        const double *row = golden_row(&exact, i), truth = row[3];
        const double rounding = 1e-12 * whole, wanted = 1e-3;
        struct gsn_volume_bound bound;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_level_set_volume(spline, cube, row, 1, NULL, &bound, &err), err);
        CHECK(bound.lower_um3 <= truth + rounding && bound.upper_um3 >= truth - rounding);
        CHECK(bound.lower_um3 <= row[2] && bound.upper_um3 >= row[1]);
        CHECK(bound.upper_um3 - bound.lower_um3 <= wanted * relative_to(&bound, whole));
    }
    golden_done(&exact);
}

TEST(known_volumes_lie_between_their_bounds)
{
    golden_each("isovolume_total", check_volume);
}
