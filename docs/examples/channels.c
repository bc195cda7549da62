/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Many values at the same places, such as the three parts of a colour: the equations are made once.
 */
#include "cube.h"

enum { SAMPLES = 20000, CHANNELS = 4 };

/* Channel c is x^c. */
static double power(const double u[3], int c)
{
    return pow(u[0], c);
}

static double first(const double u[3])
{
    return power(u, 0);
}

int main(void)
{
    const struct gsn_field_options options = { .smoothing = 0, .tolerance = 1e-13 };
    struct gsn_space *space = cube_space(3, 3);
    struct gsn_data data = cube_samples(SAMPLES, first);
    static double value[CHANNELS][SAMPLES];
    const double *channel[CHANNELS];
    struct gsn_field *field[CHANNELS];
    struct gsn_field_report report[CHANNELS];
    struct gsn_error err;

    for (int c = 0; c < CHANNELS; c++) {
        channel[c] = value[c];
        for (size_t i = 0; i < SAMPLES; i++)
            value[c][i] = power(data.at[i], c);
    }
    must(gsn_field_fit_many(space, &data, channel, CHANNELS, &options, field, report, &err), &err);
    for (int c = 0; c < CHANNELS; c++) {
        const double at[1][3] = { { 0.3, 0.7, 0.2 } };
        double got;

        must(gsn_field_at(field[c], at, 1, 0, &got, NULL, &err), &err);
        printf("x^%d at 0.3: %.12f, %u iterations\n", c, got, report[c].iterations);
        same("a power", got, power(at[0], c), 1e-8);
        gsn_field_free(field[c]);
    }
    gsn_space_free(space);
    samples_free(&data);
    return 0;
}
