/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Saves a field and reads it back, to the last bit. ParaView opens the same file.
 *     save [FILE]        field.vtkhdf */
#include "cube.h"

static double wave(const double u[3])
{
    return sin(5 * u[0]) + u[1] * u[2];
}

int main(int argc, char **argv)
{
    const char *path = argc > 1 ? argv[1] : "field.vtkhdf";
    struct gsn_space *space = cube_space(3, 3);
    struct gsn_data data = cube_samples(20000, wave);
    struct gsn_field *field = NULL, *again = NULL;
    struct gsn_error err;
    size_t unknowns;

    must(gsn_field_fit(space, &data, NULL, &field, NULL, &err), &err);
    must(gsn_field_save(field, "a wave", path, &err), &err);
    must(gsn_field_load(path, &again, &err), &err);
    unknowns = gsn_space_unknowns(gsn_field_space(again));
    printf("%s: degree %u, %zu unknowns\n", path, gsn_space_degree(gsn_field_space(again)),
           unknowns);
    same("unknowns", (double)unknowns, (double)gsn_space_unknowns(space), 0);
    same("control values",
         memcmp(gsn_field_controls(field), gsn_field_controls(again), unknowns * sizeof(double)), 0,
         0);
    gsn_field_free(again); /* its space goes with it */
    gsn_field_free(field);
    gsn_space_free(space);
    samples_free(&data);
    return 0;
}
