/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/stain/paint.h"

#include <math.h>

double dice_even(struct dice *dice)
{
    dice->state = dice->state * 6364136223846793005u + 1442695040888963407u;
    return (double)(dice->state >> 11) / 9007199254740992.0;
}

double dice_normal(struct dice *dice)
{
    const double radius = sqrt(-2 * log(1 - dice_even(dice)));

    return radius * cos(2 * M_PI * dice_even(dice));
}

double scan_light(const struct scan *scan, const struct gsn_image *image, uint32_t x, uint32_t y)
{
    const double u = (x + 0.5) / image->width - 0.55, v = (y + 0.5) / image->height - 0.45;

    return 1 - scan->falloff * (u * u + v * v) * 2;
}

static double to_linear(enum gsn_light light, double code)
{
    if (light == GSN_LIGHT_CODES_LINEAR)
        return code;
    return code > 0.04045 ? pow((code + 0.055) / 1.055, 2.4) : code / 12.92;
}

static double to_code(enum gsn_light light, double linear)
{
    if (light == GSN_LIGHT_CODES_LINEAR)
        return linear;
    return linear > 0.0031308 ? 1.055 * pow(linear, 1 / 2.4) - 0.055 : 12.92 * linear;
}

void paint(struct gsn_image *image, uint32_t x, uint32_t y, const struct scan *scan,
           const struct gsn_dyes *dyes, const double amount[3], struct dice *dice)
{
    const double top = image->bits == 8 ? 255 : 65535;
    const size_t at = ((size_t)y * image->width + x) * 3;

    for (size_t c = 0; c < 3; c++) {
        const double od =
            amount[0] * dyes->red[c] + amount[1] * dyes->yellow[c] + amount[2] * dyes->dark[c];
        const double light = to_linear(scan->light, scan->white[c] / 255) *
                             scan_light(scan, image, x, y) * pow(10, -od);
        double code = to_code(scan->light, light);

        if (scan->noise > 0)
            code += scan->noise / 255 * dice_normal(dice);
        code = floor(fmin(fmax(code, 0), 1) * top + 0.5);
        if (image->bits == 8)
            ((uint8_t *)image->samples)[at + c] = (uint8_t)code;
        else
            ((uint16_t *)image->samples)[at + c] = (uint16_t)code;
    }
}

double paint_density(const struct gsn_image *image, const struct gsn_flat_field *glass, uint32_t x,
                     uint32_t y, unsigned channel)
{
    const unsigned sample = gsn_image_at(image, x, y, channel);
    const double code = (sample ? sample : 0.5) / (image->bits == 8 ? 255 : 65535);
    const double u = 2 * (x + 0.5) / glass->width - 1, v = 2 * (y + 0.5) / glass->height - 1;
    const double *s = glass->surface[channel];

    return s[0] + s[1] * u + s[2] * v + s[3] * u * u + s[4] * u * v + s[5] * v * v -
           log10(to_linear(glass->light, code));
}

struct gsn_image *paint_glass(uint32_t width, uint32_t height, uint32_t bits,
                              const struct scan *scan, struct dice *dice)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_image *image = NULL;

    if (gsn_image_new(width, height, 3, bits, &image, NULL) < 0)
        return NULL;
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++)
            paint(image, x, y, scan, &dyes, (const double[3]){ 0, 0, 0 }, dice);
    return image;
}
