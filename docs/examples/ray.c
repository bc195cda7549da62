/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Integrals: along a segment, along a whole line as in an X-ray, over the mesh and its tetrahedra.
 */
#include "cube.h"

static double quadratic(const double u[3])
{
    return u[0] * u[0] + u[1] - u[2] * u[0];
}

int main(void)
{
    const struct gsn_field_options options = { .smoothing = 0, .tolerance = 1e-14 };
    const double a[3] = { 0.1, 0.2, 0.3 }, b[3] = { 0.9, 0.6, 0.3 };
    const double p[3] = { -5, 0.3, 0.6 }, d[3] = { 2, 0, 0 };
    struct gsn_space *space = cube_space(2, 2);
    struct gsn_data data = cube_samples(20000, quadratic);
    struct gsn_field *field = NULL;
    struct gsn_error err;
    double along, length, whole, volume, sum = 0, *mean;

    must(gsn_field_fit(space, &data, &options, &field, NULL, &err), &err);

    /* s on the segment is (0.1 + 0.8 t)^2 + 0.2 + 0.4 t - 0.3 (0.1 + 0.8 t), t from 0 to 1. */
    must(gsn_field_segment(field, a, b, &along, &length, &err), &err);
    printf("along the segment: %.12f over %.12f\n", along, length);
    same("length", length, sqrt(0.8 * 0.8 + 0.4 * 0.4), 1e-12);
    same("segment", along / length, (0.729 - 0.001) / 2.4 + 0.4 - 0.3 * 0.5, 1e-8);

    /* Beyond the mesh the field fades within the clouds of the outermost knots: those of this mesh
     * are 0.015 of a tetrahedron's altitude. */
    printf("along the line: %.6f\n", gsn_field_line(field, p, d));
    same("line", gsn_field_line(field, p, d), 1.0 / 3 + 0.3 - 0.6 / 2, 0.02);

    must(gsn_field_integral(field, 0, &whole, &volume, &err), &err);
    same("volume", volume, 1, 1e-12);
    same("integral", whole, 1.0 / 3 + 0.5 - 0.25, 1e-8);

    /* Six tetrahedra to each of 2^3 cells, all of one volume. */
    mean = malloc(gsn_space_tets(space, NULL) * sizeof *mean);
    must(gsn_field_means(field, 0, mean, &err), &err);
    for (size_t t = 0; t < gsn_space_tets(space, NULL); t++)
        sum += mean[t] / 48;
    same("mean of the means", sum, whole, 1e-10);
    free(mean);
    gsn_field_free(field);
    gsn_space_free(space);
    samples_free(&data);
    return 0;
}
