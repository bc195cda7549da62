/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Three ways to a mesh: your own points and tetrahedra, the voxels of a region, or their values too.
 *     mesh [MESHER]      where gieson-mesh is, when it is not installed */
#include "cube.h"

enum { SIDE = 24 };

/* A pyramid of two tetrahedra. */
static void own_mesh(void)
{
    const double point[5][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 }, { 1, 1, 1 } };
    const uint32_t tet[2][4] = { { 0, 1, 2, 3 }, { 4, 1, 2, 3 } };
    const struct gsn_space_options options = { .degree = 3, .cloud = 0.1 };
    struct gsn_space *space = NULL;
    struct gsn_error err;

    must(gsn_space_new(point, 5, tet, 2, &options, &space, &err), &err);
    printf("two tetrahedra of degree %u: %zu unknowns\n", gsn_space_degree(space),
           gsn_space_unknowns(space));
    /* Each has 20 control values, 10 of them on the face they share. */
    same("unknowns", (double)gsn_space_unknowns(space), 30, 0);
    gsn_space_free(space);
}

/* Tetrahedra around a ball of voxels: every one of its voxels is inside of the mesh. */
static void mesh_of_region(const char *mesher)
{
    static uint8_t inside[SIDE * SIDE * SIDE];
    static double value[SIDE * SIDE * SIDE];
    const struct gsn_voxels ball = { .size = { SIDE, SIDE, SIDE },
                                     .step = { 2, 2, 2 },
                                     .inside = inside };
    const struct gsn_space_options options = { .mesher = mesher };
    struct gsn_space *space = NULL;
    struct gsn_field *field = NULL;
    double *control;
    struct gsn_error err;

    for (int i = 0; i < SIDE * SIDE * SIDE; i++) {
        const double x = i % SIDE - 11.5, y = i / SIDE % SIDE - 11.5, z = i / SIDE / SIDE - 11.5;

        inside[i] = x * x + y * y + z * z < 8 * 8;
    }
    must(gsn_space_cover(&ball, 12, &options, &space, &err), &err);
    printf("a ball: %zu tetrahedra, %zu vertices\n", gsn_space_tets(space, NULL),
           gsn_space_points(space, NULL));
    control = malloc(gsn_space_unknowns(space) * sizeof *control);
    for (size_t i = 0; control && i < gsn_space_unknowns(space); i++)
        control[i] = 7; /* all the same: a constant */
    must(gsn_field_new(space, control, &field, &err), &err);
    must(gsn_field_on_grid(field, &ball, 0, value, &err), &err);
    for (int i = 0; i < SIDE * SIDE * SIDE; i++)
        if (inside[i])
            same("the constant", value[i], 7, 1e-12);
    gsn_field_free(field);
    gsn_space_free(space);
    free(control);
}

/* The same ball with the wall of its values: tetrahedra follow it, and the field is near the voxels
 * with few unknowns. */
static void mesh_of_values(const char *mesher)
{
    static double value[SIDE * SIDE * SIDE], at[SIDE * SIDE * SIDE][3];
    const struct gsn_voxels grid = { .size = { SIDE, SIDE, SIDE }, .step = { 2, 2, 2 } };
    const struct gsn_space_options options = { .mesher = mesher };
    const struct gsn_data data = { .count = SIDE * SIDE * SIDE,
                                   .at = (const double(*)[3])at,
                                   .value = value };
    struct gsn_space *space = NULL;
    struct gsn_field *field = NULL;
    struct gsn_field_report report;
    struct gsn_error err;

    for (int i = 0; i < SIDE * SIDE * SIDE; i++) {
        const double x = i % SIDE - 11.5, y = i / SIDE % SIDE - 11.5, z = i / SIDE / SIDE - 11.5;

        at[i][0] = 2 * (x + 11.5);
        at[i][1] = 2 * (y + 11.5);
        at[i][2] = 2 * (z + 11.5);
        value[i] = 0.5 - 0.5 * tanh(sqrt(x * x + y * y + z * z) - 7);
    }
    must(gsn_space_follow(&grid, value, 10, &options, &space, &err), &err);
    must(gsn_field_fit(space, &data, NULL, &field, &report, &err), &err);
    printf("a ball's wall: %zu unknowns leave %.3f of its height\n", report.unknowns, report.rms);
    same("the residual", report.rms, 0, 0.02);
    gsn_field_free(field);
    gsn_space_free(space);
}

int main(int argc, char **argv)
{
    own_mesh();
    mesh_of_region(argc > 1 ? argv[1] : NULL);
    mesh_of_values(argc > 1 ? argv[1] : NULL);
    return 0;
}
