/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/register/draw_picture.h"

#include <math.h>
#include <string.h>

enum { LATTICE = 64 };
static const float YELLOW[3] = { 222, 188, 105 }, ROSE[3] = { 178, 58, 92 },
                   GLASS[3] = { 234, 236, 238 }, CHAR[3] = { 44, 36, 48 };

/* Smooth noise: bilinear between random numbers cell pixels apart. */
static double smooth_noise(double lattice[LATTICE][LATTICE], double x, double y, double cell)
{
    const double u = x / cell, v = y / cell, a = u - floor(u), b = v - floor(v);
    const size_t i = (size_t)u % (LATTICE - 1), k = (size_t)v % (LATTICE - 1);

    return (1 - b) * ((1 - a) * lattice[k][i] + a * lattice[k][i + 1]) +
           b * ((1 - a) * lattice[k + 1][i] + a * lattice[k + 1][i + 1]);
}

void draw_tissue_picture(float *value, uint32_t width, uint32_t height, double reach,
                         struct draw_chance *chance)
{
    static double lattice[2][LATTICE][LATTICE];

    for (size_t i = 0; i < 2 * LATTICE * LATTICE; i++)
        (&lattice[0][0][0])[i] = draw_normal(chance);
    for (size_t i = 0; i < (size_t)width * height; i++) {
        const double x = (double)(i % width), y = (double)(i / width);
        const double fine = smooth_noise(lattice[0], x, y, 7);
        const double coarse = smooth_noise(lattice[1], x, y, 40);
        const double rose = 1 / (1 + exp(-1.5 * coarse - fine)), shade = 1 + 0.05 * fine;
        const int tissue = hypot(x - 0.5 * width, y - 0.5 * height) < reach;

        for (size_t c = 0; c < 3; c++)
            value[3 * i + c] =
                tissue ? (float)(shade * ((1 - rose) * YELLOW[c] + rose * ROSE[c])) : GLASS[c];
    }
}

void draw_spot_on(float *value, uint32_t width, uint32_t height, const struct draw_spot *spot)
{
    for (size_t i = 0; i < (size_t)width * height; i++) {
        const double x = (double)(i % width) + 0.5 - spot->centre.x;
        const double y = (double)(i / width) + 0.5 - spot->centre.y;
        const double r = hypot(x, y), t = atan2(y, x);
        double edge = spot->radius, a;

        if (r > 1.5 * spot->radius + 6)
            continue;
        for (int m = 0; m < 2; m++)
            edge += spot->radius * (spot->lobe[m][0] * cos(2 * (m + 1) * t) +
                                    spot->lobe[m][1] * sin(2 * (m + 1) * t));
        a = spot->alpha * 0.5 * erfc((r - edge) / (1.2 * M_SQRT2));
        if (!isnan(spot->cut))
            a *= 0.5 * erfc((x * cos(spot->cut) + y * sin(spot->cut) - 0.45 * spot->radius) /
                            (0.8 * M_SQRT2));
        for (size_t c = 0; c < 3; c++)
            value[3 * i + c] = (float)((1 - a) * value[3 * i + c] + a * CHAR[c]);
    }
}

void draw_codes(const float *value, struct gsn_image *image, double sd, struct draw_chance *chance)
{
    const double scale = image->bits == 8 ? 1 : 257;

    for (size_t i = 0; i < (size_t)3 * image->width * image->height; i++) {
        const double code = fmin(fmax(value[i] + sd * draw_normal(chance), 0), 255) * scale;

        if (image->bits == 8)
            ((uint8_t *)image->samples)[i] = (uint8_t)(code + 0.5);
        else
            ((uint16_t *)image->samples)[i] = (uint16_t)(code + 0.5);
    }
}
