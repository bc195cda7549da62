/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much of a region is above a threshold, with bounds that are certain. */
#include "cube.h"

static double ball(const double u[3])
{
    return pow(u[0] - 0.5, 2) + pow(u[1] - 0.5, 2) + pow(u[2] - 0.5, 2);
}

int main(void)
{
    const struct gsn_field_options options = { .smoothing = 0, .tolerance = 1e-14 };
    /* Voxels of 1/16; the outermost ones of the cube are not in the region. */
    const struct gsn_voxels region = { .size = { 14, 14, 14 },
                                       .origin = { 1.5 / 16, 1.5 / 16, 1.5 / 16 },
                                       .step = { 1.0 / 16, 1.0 / 16, 1.0 / 16 } };
    const double all = pow(14.0 / 16, 3), threshold[2] = { 0.2 * 0.2, 0.35 * 0.35 };
    struct gsn_space *space = cube_space(2, 2);
    struct gsn_data data = cube_samples(20000, ball);
    struct gsn_field *field = NULL;
    struct gsn_field_volume volume[2];
    struct gsn_error err;

    must(gsn_field_fit(space, &data, &options, &field, NULL, &err), &err);
    must(gsn_field_volume_above(field, &region, threshold, 2, 1e-3, 0, NULL, volume, &err), &err);
    for (int i = 0; i < 2; i++) {
        /* All of the region but a ball. The fit reproduces it but for rounding. */
        const double truth = all - 4.0 / 3 * acos(-1) * pow(threshold[i], 1.5);

        printf("above %.4f: %.6f to %.6f, in truth %.6f\n", threshold[i], volume[i].lower,
               volume[i].upper, truth);
        same("bounds hold", volume[i].lower - 1e-9 <= truth && truth <= volume[i].upper + 1e-9, 1,
             0);
        same("bounds are narrow", volume[i].lower, volume[i].upper, 1.01e-3 * volume[i].upper);
    }
    gsn_field_free(field);
    gsn_space_free(space);
    samples_free(&data);
    return 0;
}
