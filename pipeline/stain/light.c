/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/light.h"

#include <assert.h>
#include <math.h>

static void normalise(double v[3])
{
    const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);

    for (int c = 0; c < 3; c++)
        v[c] /= length;
}

struct gsn_dyes gsn_dyes_builtin(void)
{
    struct gsn_dyes dyes = {
        .name = "van-gieson-gvp-1",
        .light = GSN_LIGHT_CODES_LINEAR,
        .red = { 0.239, 0.716, 0.655 },
        .yellow = { 0.357, 0.326, 0.875 },
        .dark = { 0.52, 0.60, 0.61 },
        .full_red_od = 0.62,
    };

    normalise(dyes.red);
    normalise(dyes.yellow);
    normalise(dyes.dark);
    return dyes;
}

static double decode(enum gsn_light light, double code)
{
    if (light != GSN_LIGHT_SRGB)
        return code;
    return code <= 0.04045 ? code / 12.92 : pow((code + 0.055) / 1.055, 2.4);
}

double gsn_light_of_sample(enum gsn_light light, unsigned sample, unsigned bits)
{
    assert(bits == 8 || bits == 16);
    return decode(light, sample / (bits == 8 ? 255.0 : 65535.0));
}

double gsn_light_encode(enum gsn_light light, double linear)
{
    if (light != GSN_LIGHT_SRGB)
        return linear;
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

int gsn_light_table(enum gsn_light light, unsigned bits, double **ret_table, struct gsn_error *err)
{
    const unsigned top = bits == 8 ? 255 : 65535;
    double *table = gsn_alloc_array((size_t)top + 1, sizeof *table);

    if (!table)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %u codes", top + 1);
    for (unsigned i = 0; i <= top; i++)
        table[i] = log10(decode(light, (i ? i : 0.5) / top));
    *ret_table = table;
    return GSN_OK;
}

int gsn_glass_given(uint32_t width, uint32_t height, enum gsn_light light, const double white[3],
                    struct gsn_glass *ret_glass, struct gsn_error *err)
{
    struct gsn_glass glass = { .light = light, .width = width, .height = height };

    for (int c = 0; c < 3; c++) {
        if (!(white[c] >= 1 && white[c] <= 255))
            return gsn_fail(err, GSN_E_INPUT, "a white of %g is not a code from 1 to 255",
                            white[c]);
        glass.white[c] = white[c];
        glass.surface[c][0] = log10(decode(light, white[c] / 255));
    }
    *ret_glass = glass;
    return GSN_OK;
}

void gsn_glass_row(const struct gsn_glass *glass, uint32_t y, unsigned channel, double ret[3])
{
    const double *s = glass->surface[channel];
    const double v = 2 * (y + 0.5) / glass->height - 1;

    ret[0] = s[0] + v * (s[2] + v * s[5]);
    ret[1] = s[1] + v * s[4];
    ret[2] = s[3];
}

double gsn_glass_at(const struct gsn_glass *glass, uint32_t x, uint32_t y, unsigned channel)
{
    const double u = 2 * (x + 0.5) / glass->width - 1;
    double row[3];

    gsn_glass_row(glass, y, channel, row);
    return pow(10, row[0] + u * (row[1] + u * row[2]));
}
