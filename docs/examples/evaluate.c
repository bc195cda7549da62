/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Values, gradients and second derivatives, at points and on a grid. */
#include "cube.h"

enum { POINTS = 5000 };

static double cubic(const double u[3])
{
    return u[0] * u[1] * u[2] + u[0] * u[0] - 2 * u[2];
}

int main(void)
{
    const struct gsn_field_options options = { .smoothing = 0, .tolerance = 1e-14 };
    const struct gsn_voxels grid = { .size = { 3, 1, 1 },
                                     .origin = { 0.25, 0.5, 0.5 },
                                     .step = { 0.5, 1, 1 } };
    struct gsn_space *space = cube_space(2, 3);
    struct gsn_data data = cube_samples(20000, cubic), probe = cube_samples(POINTS, cubic);
    static double value[POINTS], gradient[POINTS][3], hessian[POINTS][6], on_grid[3];
    struct gsn_field *field = NULL;
    struct gsn_error err;

    must(gsn_field_fit(space, &data, &options, &field, NULL, &err), &err);
    must(gsn_field_at(field, probe.at, POINTS, 0, value, gradient, &err), &err);
    gsn_field_hessian(field, probe.at, POINTS, hessian);
    for (size_t i = 0; i < POINTS; i++) {
        const double *u = probe.at[i];

        same("value", value[i], probe.value[i], 1e-8);
        same("d/dx", gradient[i][0], u[1] * u[2] + 2 * u[0], 1e-7);
        same("d/dy", gradient[i][1], u[0] * u[2], 1e-7);
        same("d/dz", gradient[i][2], u[0] * u[1] - 2, 1e-7);
        same("d2/dxx", hessian[i][0], 2, 1e-4);
        same("d2/dxy", hessian[i][1], u[2], 1e-4);
    }
    must(gsn_field_on_grid(field, &grid, 0, on_grid, &err), &err);
    printf("at x = 0.25, 0.75, 1.25: %g, %g, %g\n", on_grid[0], on_grid[1], on_grid[2]);
    same("on a grid", on_grid[1], 0.75 * 0.25 + 0.75 * 0.75 - 1, 1e-8);
    same("beyond the mesh there is no data", isnan(on_grid[2]) != 0, 1, 0);
    gsn_field_free(field);
    gsn_space_free(space);
    samples_free(&data);
    samples_free(&probe);
    return 0;
}
