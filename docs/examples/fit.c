/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Fits scattered samples: a cubic comes back as it was, a wave nearly, and noise is smoothed as
 * much as two halves of the samples ask for. */
#include "cube.h"

enum { SAMPLES = 20000 };

static double cubic(const double u[3])
{
    return 1 + u[0] - 2 * u[1] * u[2] + 3 * u[0] * u[0] * u[1] - u[2] * u[2] * u[2];
}

static double wave(const double u[3])
{
    return sin(4 * u[0]) * cos(3 * u[1]) + u[2];
}

static double noisy_wave(const double u[3])
{
    return wave(u) + 0.3 * (drawn() + drawn() + drawn() - 1.5);
}

/* The largest error at places that were no samples. */
static double worst_error(const struct gsn_field *field, double (*f)(const double u[3]))
{
    struct gsn_data probe = cube_samples(1000, f);
    double *value = malloc(probe.count * sizeof *value), most = 0;
    struct gsn_error err;

    if (!value)
        exit(1);
    must(gsn_field_at(field, probe.at, probe.count, 0, value, NULL, &err), &err);
    for (size_t i = 0; i < probe.count; i++)
        most = fmax(most, fabs(value[i] - probe.value[i]));
    free(value);
    samples_free(&probe);
    return most;
}

static double fit(double (*f)(const double u[3]), double (*truth)(const double u[3]),
                  const struct gsn_field_options *options, const uint8_t *fold)
{
    struct gsn_space *space = cube_space(3, 3);
    struct gsn_data data = cube_samples(SAMPLES, f);
    struct gsn_field *field = NULL;
    struct gsn_field_report report;
    struct gsn_error err;
    double most;

    data.fold = fold;
    must(gsn_field_fit(space, &data, options, &field, &report, &err), &err);
    most = worst_error(field, truth);
    printf("%zu unknowns, %u iterations, rms %.3g, off by %.3g at most\n", report.unknowns,
           report.iterations, report.rms, most);
    gsn_field_free(field);
    gsn_space_free(space);
    samples_free(&data);
    return most;
}

int main(void)
{
    const struct gsn_field_options exact = { .smoothing = 0, .tolerance = 1e-13 };
    static uint8_t half[SAMPLES];
    double plain, smoothed;

    for (size_t i = 0; i < SAMPLES; i++)
        half[i] = i % 2;
    same("a cubic", fit(cubic, cubic, &exact, NULL), 0, 1e-8);
    same("a wave", fit(wave, wave, NULL, NULL), 0, 0.02);
    plain = fit(noisy_wave, wave, NULL, NULL);
    smoothed = fit(noisy_wave, wave, NULL, half);
    same("smoothing helps", smoothed < plain, 1, 0);
    return 0;
}
