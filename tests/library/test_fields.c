/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/library/gieson-spline.h"

#include <string.h>
#include <unistd.h>

#include "tests/check.h"

/* One cube of six tetrahedra, and samples of a plane in it. */
static const uint32_t TET[6][4] = { { 0, 1, 3, 7 }, { 0, 1, 5, 7 }, { 0, 2, 3, 7 },
                                    { 0, 2, 6, 7 }, { 0, 4, 5, 7 }, { 0, 4, 6, 7 } };
enum { SAMPLES = 343 };

static double at[SAMPLES][3], value[2][SAMPLES];

static void make_samples(void)
{
    for (size_t i = 0; i < SAMPLES; i++) {
        for (size_t k = 0, from = i; k < 3; k++, from /= 7)
            at[i][k] = (1 + 2 * (double)(from % 7)) / 14;
        value[0][i] = at[i][0] + 3 * at[i][1];
        value[1][i] = 5 - at[i][2];
    }
}

/* Everything that asks for memory, once. */
static int use_all(struct gsn_error *err)
{
    double corner[8][3];
    const struct gsn_data data = { .count = SAMPLES, .at = (const double(*)[3])at };
    const struct gsn_data shown = { .count = SAMPLES,
                                    .at = (const double(*)[3])at,
                                    .value = value[0] };
    const double *const channel[2] = { value[0], value[1] };
    const struct gsn_voxels region = { .size = { 2, 2, 2 },
                                       .origin = { 0.4, 0.4, 0.4 },
                                       .step = { 0.2, 0.2, 0.2 } };
    const double vertex[3][3] = { { 0.6, 0.3, 0.45 }, { 0.61, 0.3, 0.45 }, { 0.6, 0.31, 0.45 } };
    const double threshold = 2, a[3] = { 0.1, 0.1, 0.1 }, b[3] = { 0.9, 0.8, 0.7 };
    struct gsn_space *space = NULL;
    struct gsn_field *field[2] = { NULL, NULL }, *moved = NULL;
    struct gsn_field_volume volume;
    double sum, length, mean[6];
    int r;

    for (size_t i = 0; i < 8; i++)
        for (size_t k = 0; k < 3; k++)
            corner[i][k] = (double)(i >> k & 1);
    r = gsn_space_new((const double(*)[3])corner, 8, TET, 6, NULL, &space, err);
    if (r >= 0)
        r = gsn_field_fit_many(space, &data, channel, 2, NULL, field, NULL, err);
    CHECK(r >= 0 || (!field[0] && !field[1]));
    if (r >= 0)
        r = gsn_field_fit_free(space, &shown, NULL, 1, &moved, NULL, NULL, err);
    CHECK(r >= 0 || !moved);
    gsn_field_free(moved);
    moved = NULL;
    if (r >= 0)
        r = gsn_field_insert(field[0], vertex, &moved, err);
    CHECK(r >= 0 || !moved);
    gsn_field_free(moved);
    if (r >= 0)
        r = gsn_field_segment(field[0], a, b, &sum, &length, err);
    if (r >= 0)
        r = gsn_field_means(field[0], 1, mean, err);
    if (r >= 0)
        r = gsn_field_volume_above(field[0], &region, &threshold, 1, 0.1, 1, NULL, &volume, err);
    if (r >= 0)
        r = gsn_field_write_cells(field[1], "fields.csv", err);
    if (r >= 0)
        r = gsn_field_write_surface(field[1], 4.5, 0, "fields.stl", err);
    if (r >= 0)
        r = gsn_field_write_grid(field[1], &region, "fields.nii", err);
    gsn_field_free(field[0]);
    gsn_field_free(field[1]);
    gsn_space_free(space);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    make_samples();
    CHECK_EVERY_OOM(use_all(&err), err);
    (void)unlink("fields.csv");
    (void)unlink("fields.stl");
    (void)unlink("fields.nii");
}

TEST(no_channels_are_refused)
{
    struct gsn_error err = { 0 };
    const struct gsn_data data = { .count = 0 };
    const double *const none[1] = { NULL };
    struct gsn_field *field = NULL;
    double corner[8][3];
    struct gsn_space *space = NULL;

    for (size_t i = 0; i < 8; i++)
        for (size_t k = 0; k < 3; k++)
            corner[i][k] = (double)(i >> k & 1);
    CHECK_OK(gsn_space_new((const double(*)[3])corner, 8, TET, 6, NULL, &space, &err), err);
    CHECK(gsn_field_fit_many(space, &data, none, 0, NULL, &field, NULL, &err) == GSN_E_INPUT);
    CHECK(gsn_field_fit_many(space, &data, none, 1, NULL, &field, NULL, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "there are no samples to fit") == 0 && !field);
    gsn_space_free(space);
}
