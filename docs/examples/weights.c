/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Weights: 0 for samples that are known to be wrong, 1 / variance for those of different quality.
 */
#include "cube.h"

enum { SAMPLES = 20000 };

static double linear(const double u[3])
{
    return 2 * u[0] - u[1] + 5 * u[2];
}

/* The rms error of the field on a grid within the cube. */
static double rms_error(const struct gsn_field *field)
{
    const struct gsn_voxels grid = { .size = { 20, 20, 20 },
                                     .origin = { 0.025, 0.025, 0.025 },
                                     .step = { 0.05, 0.05, 0.05 } };
    static double value[20 * 20 * 20];
    struct gsn_error err;
    double sum = 0;

    must(gsn_field_on_grid(field, &grid, 0, value, &err), &err);
    for (int i = 0; i < 8000; i++) {
        const double u[3] = { 0.025 + 0.05 * (i % 20), 0.025 + 0.05 * (i / 20 % 20),
                              0.025 + 0.05 * (i / 400) };

        sum += pow(value[i] - linear(u), 2);
    }
    return sqrt(sum / 8000);
}

static double fit(const struct gsn_space *space, const struct gsn_data *data)
{
    const struct gsn_field_options options = { .smoothing = 0, .tolerance = 1e-13 };
    struct gsn_field *field = NULL;
    struct gsn_error err;
    double rms;

    must(gsn_field_fit(space, data, &options, &field, NULL, &err), &err);
    rms = rms_error(field);
    gsn_field_free(field);
    return rms;
}

int main(void)
{
    struct gsn_space *space = cube_space(2, 2);
    struct gsn_data data = cube_samples(SAMPLES, linear);
    static double value[SAMPLES], weight[SAMPLES];
    double plain, weighted;

    /* One sample in ten is wrong, and known to be. */
    for (size_t i = 0; i < SAMPLES; i++) {
        value[i] = data.value[i] + (i % 10 == 0 ? 1000 : 0);
        weight[i] = i % 10 != 0;
    }
    free((void *)data.value);
    data.value = value;
    data.weight = weight;
    same("without the wrong ones", fit(space, &data), 0, 1e-8);

    /* Every second sample is ten times noisier. */
    for (size_t i = 0; i < SAMPLES; i++) {
        const double sd = i % 2 ? 0.1 : 1;

        value[i] = linear(data.at[i]) + sd * (drawn() + drawn() + drawn() + drawn() - 2) * sqrt(3);
        weight[i] = 1 / (sd * sd);
    }
    weighted = fit(space, &data);
    data.weight = NULL;
    plain = fit(space, &data);
    printf("rms error %.4f without weights, %.4f with them\n", plain, weighted);
    same("weights help by half or more", weighted < plain / 2, 1, 0);
    free((void *)data.at);
    gsn_space_free(space);
    return 0;
}
