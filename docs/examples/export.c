/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Files for other programs: tetrahedra, the surface of a level, values on a grid. They are written
 * into the folder that the program is started in. */
#include "cube.h"

static double ball(const double u[3])
{
    return pow(u[0] - 0.5, 2) + pow(u[1] - 0.5, 2) + pow(u[2] - 0.5, 2);
}

static long bytes_of(const char *path)
{
    FILE *file = fopen(path, "rb");
    long size;

    if (!file)
        return 0;
    fseek(file, 0, SEEK_END);
    size = ftell(file);
    fclose(file);
    return size;
}

int main(void)
{
    static const char *const NAME[] = { "cells.vtu", "cells.csv", "ball.stl",
                                        "ball.ply",  "ball.nrrd", "ball.nii.gz" };
    const struct gsn_voxels grid = { .size = { 32, 32, 32 },
                                     .origin = { 1.0 / 64, 1.0 / 64, 1.0 / 64 },
                                     .step = { 1.0 / 32, 1.0 / 32, 1.0 / 32 } };
    struct gsn_space *space = cube_space(3, 2);
    struct gsn_data data = cube_samples(20000, ball);
    struct gsn_field *field = NULL;
    struct gsn_error err;

    must(gsn_field_fit(space, &data, NULL, &field, NULL, &err), &err);
    must(gsn_field_write_cells(field, NAME[0], &err), &err);
    must(gsn_field_write_cells(field, NAME[1], &err), &err);
    must(gsn_field_write_surface(field, 0.09, 0, NAME[2], &err), &err);
    must(gsn_field_write_surface(field, 0.09, 0, NAME[3], &err), &err);
    must(gsn_field_write_grid(field, &grid, NAME[4], &err), &err);
    must(gsn_field_write_grid(field, &grid, NAME[5], &err), &err);
    for (int i = 0; i < 6; i++) {
        printf("%s: %ld bytes\n", NAME[i], bytes_of(NAME[i]));
        same("something was written", bytes_of(NAME[i]) > 1000, 1, 0);
    }
    /* An ending that is none of them. */
    same("refused", gsn_field_write_surface(field, 0.09, 0, "ball.obj", &err), GSN_E_UNSUPPORTED,
         0);
    printf("%s\n", err.text);
    gsn_field_free(field);
    gsn_space_free(space);
    samples_free(&data);
    return 0;
}
