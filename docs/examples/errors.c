/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What goes wrong, and how it is told: in the report what a fit can live with, as a code and one
 * sentence what it cannot. And how long work says where it is. */
#include "cube.h"

static double linear(const double u[3])
{
    return u[0] + u[1] + u[2];
}

static void show(void *context, const char *stage, size_t done, size_t total)
{
    int *calls = context;

    printf("%s: %zu of %zu\n", stage, done, total);
    ++*calls;
}

int main(void)
{
    int calls = 0;
    const struct gsn_progress progress = { show, &calls };
    struct gsn_field_options options = { .smoothing = GSN_FIT_SMOOTHING, .progress = &progress };
    const double point[4][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };
    const uint32_t tet[1][4] = { { 0, 1, 2, 3 } };
    const struct gsn_space_options thin = { .cloud = 1e-12 };
    struct gsn_space *space = cube_space(3, 2), *none = NULL;
    struct gsn_data data = cube_samples(5000, linear);
    double(*at)[3] = (double(*)[3])data.at;
    struct gsn_field *field = NULL;
    struct gsn_field_report report;
    struct gsn_error err;

    /* Two samples are elsewhere: the report counts them. */
    at[17][0] = at[99][1] = 40;
    must(gsn_field_fit(space, &data, &options, &field, &report, &err), &err);
    printf("%zu samples outside, the first is number %zu\n", report.outside, report.first_outside);
    same("outside", (double)report.outside, 2, 0);
    same("the first", (double)report.first_outside, 17, 0);
    same("progress was told", calls > 1, 1, 0);
    gsn_field_free(field);

    /* A solver that may not go on gives what it has. */
    options.iterations = 2;
    must(gsn_field_fit(space, &data, &options, &field, &report, &err), &err);
    same("unconverged", report.unconverged, 1, 0);
    gsn_field_free(field);

    /* Strictly, both are failures, and field stays what it was. */
    options.strict = 1;
    field = NULL;
    same("refused", gsn_field_fit(space, &data, &options, &field, &report, &err), GSN_E_INPUT, 0);
    printf("%s: %s\n", gsn_code_name(err.code), err.text);
    same("no field", field != NULL, 0, 0);

    /* Knots too near to each other for double precision. */
    same("too thin", gsn_space_new(point, 4, tet, 1, &thin, &none, &err), GSN_E_MESH, 0);
    printf("%s: %s\n", gsn_code_name(err.code), err.text);
    samples_free(&data);
    gsn_space_free(space);
    return 0;
}
