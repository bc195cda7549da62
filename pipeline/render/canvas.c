/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/canvas.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "pipeline/render/font.h"

static const struct gsn_colour no_data_light = { 214, 214, 216 };
static const struct gsn_colour no_data_dark = { 186, 186, 190 };

/* Viridis at 17 even places (matplotlib's map, in the public domain as CC0), linear between. */
static const struct gsn_colour viridis[17] = {
    { 68, 1, 84 },    { 72, 24, 106 },  { 71, 45, 123 },  { 66, 64, 134 },  { 59, 82, 139 },
    { 51, 99, 141 },  { 44, 114, 142 }, { 38, 130, 142 }, { 33, 145, 140 }, { 31, 160, 136 },
    { 40, 174, 128 }, { 63, 188, 115 }, { 94, 201, 98 },  { 132, 212, 75 }, { 173, 220, 48 },
    { 216, 226, 25 }, { 253, 231, 37 },
};

static uint8_t blend(uint8_t from, uint8_t to, double t)
{
    return (uint8_t)(from + (to - from) * t + 0.5);
}

static struct gsn_colour between(struct gsn_colour a, struct gsn_colour b, double t)
{
    return (struct gsn_colour){ blend(a.r, b.r, t), blend(a.g, b.g, t), blend(a.b, b.b, t) };
}

struct gsn_colour gsn_colour_of(enum gsn_colour_map map, double share)
{
    const double most = sizeof viridis / sizeof *viridis - 1;
    double place;
    size_t below;

    if (isnan(share))
        return no_data_light;
    share = fmin(1.0, fmax(0.0, share));
    if (map == GSN_MAP_GREY) {
        const uint8_t grey = (uint8_t)(255.0 * share + 0.5);

        return (struct gsn_colour){ grey, grey, grey };
    }
    place = share * most;
    below = (size_t)fmin(most - 1.0, place);
    return between(viridis[below], viridis[below + 1], place - (double)below);
}

int gsn_canvas_new(uint32_t width, uint32_t height, struct gsn_colour background,
                   struct gsn_image **ret_image, struct gsn_error *err)
{
    gsn_auto(gsn_image) image = NULL;
    const int r = gsn_image_new(width, height, 3, 8, &image, err);

    if (r < 0)
        return r;
    gsn_canvas_box(image, 0, 0, (int)width, (int)height, background);
    *ret_image = gsn_steal(&image);
    return GSN_OK;
}

/* The three samples of a pixel, NULL outside. */
static uint8_t *pixel(const struct gsn_image *image, int x, int y)
{
    if (x < 0 || y < 0 || (uint32_t)x >= image->width || (uint32_t)y >= image->height)
        return NULL;
    return (uint8_t *)image->samples + 3 * ((size_t)y * image->width + (size_t)x);
}

void gsn_canvas_put(struct gsn_image *image, int x, int y, struct gsn_colour colour)
{
    uint8_t *to = pixel(image, x, y);

    assert(image->channels == 3 && image->bits == 8);
    if (!to)
        return;
    to[0] = colour.r;
    to[1] = colour.g;
    to[2] = colour.b;
}

void gsn_canvas_mix(struct gsn_image *image, int x, int y, struct gsn_colour colour, double weight)
{
    const uint8_t *at = pixel(image, x, y);

    weight = fmin(1.0, fmax(0.0, weight));
    if (at)
        gsn_canvas_put(image, x, y,
                       between((struct gsn_colour){ at[0], at[1], at[2] }, colour, weight));
}

void gsn_canvas_box(struct gsn_image *image, int x, int y, int width, int height,
                    struct gsn_colour colour)
{
    for (int j = y; j < y + height; j++) {
        for (int i = x; i < x + width; i++)
            gsn_canvas_put(image, i, j, colour);
    }
}

void gsn_canvas_frame(struct gsn_image *image, int x, int y, int width, int height,
                      struct gsn_colour colour)
{
    gsn_canvas_box(image, x - 1, y - 1, width + 2, 1, colour);
    gsn_canvas_box(image, x - 1, y + height, width + 2, 1, colour);
    gsn_canvas_box(image, x - 1, y, 1, height, colour);
    gsn_canvas_box(image, x + width, y, 1, height, colour);
}

void gsn_canvas_no_data(struct gsn_image *image, int x, int y)
{
    /* Stripes of 2 pixels in 8, rising to the right. */
    const int stripe = ((x + y) % 8 + 8) % 8;

    gsn_canvas_put(image, x, y, stripe < 2 ? no_data_dark : no_data_light);
}

/* Distance of a point from a segment. */
static double distance(double px, double py, double x0, double y0, double x1, double y1)
{
    const double dx = x1 - x0, dy = y1 - y0, length2 = dx * dx + dy * dy;
    double t = 0.0;

    if (length2 > 0.0)
        t = fmin(1.0, fmax(0.0, ((px - x0) * dx + (py - y0) * dy) / length2));
    return hypot(px - x0 - t * dx, py - y0 - t * dy);
}

static int clamp_px(double at, uint32_t most)
{
    return (int)fmin((double)most, fmax(0.0, at));
}

/* Columns of row y that the line can reach, so that long lines cost their length and not the area
 * of their bounding box. */
static void row_span(double x0, double y0, double x1, double y1, double reach, int y, double *low,
                     double *high)
{
    const double dy = y1 - y0;

    *low = fmin(x0, x1);
    *high = fmax(x0, x1);
    if (fabs(dy) > 1e-9) {
        const double ta = fmin(1.0, fmax(0.0, (y - reach - y0) / dy));
        const double tb = fmin(1.0, fmax(0.0, (y + 1.0 + reach - y0) / dy));
        const double a = x0 + ta * (x1 - x0), b = x0 + tb * (x1 - x0);

        *low = fmin(a, b);
        *high = fmax(a, b);
    }
}

void gsn_canvas_line(struct gsn_image *image, double x0, double y0, double x1, double y1,
                     double width, struct gsn_colour colour)
{
    const double reach = 0.5 * width + 1.0;
    const int top = clamp_px(floor(fmin(y0, y1) - reach), image->height);
    const int bottom = clamp_px(ceil(fmax(y0, y1) + reach), image->height);

    for (int y = top; y < bottom; y++) {
        double low, high;

        row_span(x0, y0, x1, y1, reach, y, &low, &high);
        for (int x = clamp_px(floor(low - reach), image->width);
             x < clamp_px(ceil(high + reach), image->width); x++) {
            /* Coverage of a pixel by the edge at half the width, to first order. */
            const double cover = 0.5 * width + 0.5 - distance(x + 0.5, y + 0.5, x0, y0, x1, y1);

            if (cover > 0.0)
                gsn_canvas_mix(image, x, y, colour, fmin(cover, width));
        }
    }
}

void gsn_canvas_paste(struct gsn_image *image, const struct gsn_image *picture, int x, int y)
{
    assert(picture->channels == 3 && picture->bits == 8);
    for (uint32_t j = 0; j < picture->height; j++) {
        for (uint32_t i = 0; i < picture->width; i++) {
            const uint8_t *from = pixel(picture, (int)i, (int)j);

            gsn_canvas_put(image, x + (int)i, y + (int)j,
                           (struct gsn_colour){ from[0], from[1], from[2] });
        }
    }
}

void gsn_canvas_text(struct gsn_image *image, int x, int y, int scale, const char *text,
                     struct gsn_colour colour)
{
    struct gsn_font_bits bits;

    for (; gsn_font_next(&text, &bits); x += GSN_CANVAS_CELL_WIDTH * scale) {
        for (int j = 0; j < GSN_FONT_ROWS; j++) {
            for (int i = 0; i < GSN_FONT_WIDTH; i++) {
                if (bits.row[j] >> (GSN_FONT_WIDTH - 1 - i) & 1)
                    gsn_canvas_box(image, x + i * scale, y + j * scale, scale, scale, colour);
            }
        }
    }
}

int gsn_canvas_text_width(const char *text, int scale)
{
    struct gsn_font_bits bits;
    int cells = 0;

    while (gsn_font_next(&text, &bits))
        cells++;
    return cells * GSN_CANVAS_CELL_WIDTH * scale;
}

void gsn_canvas_scale_bar(struct gsn_image *image, int x, int y, double um_per_px, int most_px,
                          struct gsn_colour colour)
{
    const double most_um = um_per_px * most_px, power = pow(10.0, floor(log10(most_um)));
    const double digit = most_um / power;
    const double um = power * (digit >= 5.0 ? 5.0 : digit >= 2.0 ? 2.0 : 1.0);
    const int px = (int)(um / um_per_px + 0.5);
    char label[32];

    if (um >= 1000.0)
        (void)snprintf(label, sizeof label, "%g mm", um / 1000.0);
    else
        (void)snprintf(label, sizeof label, "%g \xc2\xb5m", um);
    gsn_canvas_box(image, x, y - 3, px, 3, colour);
    gsn_canvas_text(image, x, y - 4 - GSN_CANVAS_CELL_HEIGHT, 1, label, colour);
}

/* 1, 2 or 5 times a power of ten: the smallest that is not below. */
static double round_step(double least)
{
    const double power = pow(10.0, floor(log10(least)));
    const double digit = least / power;

    return power * (digit <= 1.0 ? 1.0 : digit <= 2.0 ? 2.0 : digit <= 5.0 ? 5.0 : 10.0);
}

/* Just the digits that multiples of the step have. */
static void number(char *text, size_t size, double value, double step)
{
    const int digits = (int)fmax(0.0, ceil(-log10(step) - 1e-9));

    if (fabs(value) >= 1e6 || digits > 5)
        (void)snprintf(text, size, "%.3g", value);
    else
        (void)snprintf(text, size, "%.*f", digits, value);
}

void gsn_canvas_colour_bar(struct gsn_image *image, int x, int y, int width, int height,
                           enum gsn_colour_map map, double low, double high, const char *unit,
                           struct gsn_colour ink)
{
    const double step = round_step((high - low) / 6.0);
    const double first = ceil(low / step - 1e-9);

    assert(low < high);
    for (int j = 0; j < height; j++)
        gsn_canvas_box(image, x, y + j, width, 1,
                       gsn_colour_of(map, 1.0 - (j + 0.5) / (double)height));
    gsn_canvas_frame(image, x, y, width, height, ink);
    for (int k = 0; (first + k) * step <= high + 1e-9 * step; k++) {
        /* + 0.0 makes a zero of a minus zero. */
        const double value = (first + k) * step + 0.0;
        const int at = y + (int)((height - 1) * (high - value) / (high - low) + 0.5);
        char text[32];

        number(text, sizeof text, value, step);
        gsn_canvas_box(image, x + width + 1, at, 3, 1, ink);
        gsn_canvas_text(image, x + width + 7, at - 3, 1, text, ink);
    }
    if (unit)
        gsn_canvas_text(image, x, y - 2 * GSN_CANVAS_CELL_HEIGHT, 1, unit, ink);
}
