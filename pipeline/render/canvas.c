/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Drawing on a picture in memory: rectangles, lines, colour maps.
 *
 * Method: rectangles are set pixel by pixel; lines are stroked by cairo all at once as weights of 8
 * bits, by which their colour is mixed in. The colour map is viridis (S. van der Walt, N. Smith
 * 2015, CC0) at 17 even places, linear between; values that are NaN are hatched.
 *
 * Failure: GSN_E_NOMEM; drawing outside of a picture is cut.
 * Cost: linear in the pixels that are set. */
#include "pipeline/render/canvas.h"

#include <assert.h>
#include <cairo/cairo.h>
#include <math.h>

#include "pipeline/core/mem.h"

static const struct gsn_colour no_data_light = { 214, 214, 216 };
static const struct gsn_colour no_data_dark = { 186, 186, 190 };

/* Viridis at 17 even places (matplotlib's map, in the public domain as CC0), linear between. */
static const struct gsn_colour viridis[17] = {
    { 68, 1, 84 },    { 72, 24, 106 },  { 71, 45, 123 },  { 66, 64, 134 },  { 59, 82, 139 },
    { 51, 99, 141 },  { 44, 114, 142 }, { 38, 130, 142 }, { 33, 145, 140 }, { 31, 160, 136 },
    { 40, 174, 128 }, { 63, 188, 115 }, { 94, 201, 98 },  { 132, 212, 75 }, { 173, 220, 48 },
    { 216, 226, 25 }, { 253, 231, 37 },
};

static uint8_t blend_sample(uint8_t from, uint8_t to, double t)
{
    return (uint8_t)(from + (to - from) * t + 0.5);
}

static struct gsn_colour mix_colours(struct gsn_colour a, struct gsn_colour b, double t)
{
    return (struct gsn_colour){ blend_sample(a.r, b.r, t), blend_sample(a.g, b.g, t),
                                blend_sample(a.b, b.b, t) };
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
    return mix_colours(viridis[below], viridis[below + 1], place - (double)below);
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
static uint8_t *pixel_at(const struct gsn_image *image, int x, int y)
{
    if (x < 0 || y < 0 || (uint32_t)x >= image->width || (uint32_t)y >= image->height)
        return NULL;
    return (uint8_t *)image->samples + 3 * ((size_t)y * image->width + (size_t)x);
}

void gsn_canvas_put(struct gsn_image *image, int x, int y, struct gsn_colour colour)
{
    uint8_t *to = pixel_at(image, x, y);

    assert(image->channels == 3 && image->bits == 8);
    if (!to)
        return;
    to[0] = colour.r;
    to[1] = colour.g;
    to[2] = colour.b;
}

void gsn_canvas_mix(struct gsn_image *image, int x, int y, struct gsn_colour colour, double weight)
{
    const uint8_t *at = pixel_at(image, x, y);

    weight = fmin(1.0, fmax(0.0, weight));
    if (at)
        gsn_canvas_put(image, x, y,
                       mix_colours((struct gsn_colour){ at[0], at[1], at[2] }, colour, weight));
}

void gsn_canvas_box(struct gsn_image *image, int x, int y, int width, int height,
                    struct gsn_colour colour)
{
    for (int j = y; j < y + height; j++) {
        for (int i = x; i < x + width; i++)
            gsn_canvas_put(image, i, j, colour);
    }
}

void gsn_canvas_no_data(struct gsn_image *image, int x, int y)
{
    /* Stripes of 2 pixels in 8, rising to the right. */
    const int stripe = ((x + y) % 8 + 8) % 8;

    gsn_canvas_put(image, x, y, stripe < 2 ? no_data_dark : no_data_light);
}

int gsn_canvas_ink(struct gsn_image *image, int x, int y, cairo_surface_t *weights,
                   struct gsn_colour colour, struct gsn_error *err)
{
    const unsigned char *bytes;
    int stride;

    cairo_surface_flush(weights);
    if (cairo_surface_status(weights) != CAIRO_STATUS_SUCCESS)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while drawing");
    bytes = cairo_image_surface_get_data(weights);
    stride = cairo_image_surface_get_stride(weights);
    for (int j = 0; j < cairo_image_surface_get_height(weights); j++) {
        for (int i = 0; i < cairo_image_surface_get_width(weights); i++) {
            if (bytes[j * stride + i])
                gsn_canvas_mix(image, x + i, y + j, colour, bytes[j * stride + i] / 255.0);
        }
    }
    return GSN_OK;
}

struct gsn_pen {
    cairo_surface_t *weights;
    cairo_t *cairo;
};

int gsn_pen_new(const struct gsn_image *image, struct gsn_pen **ret_pen, struct gsn_error *err)
{
    gsn_auto(gsn_pen) pen = gsn_alloc_array(1, sizeof *pen);

    if (!pen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for lines");
    pen->weights =
        cairo_image_surface_create(CAIRO_FORMAT_A8, (int)image->width, (int)image->height);
    pen->cairo = cairo_create(pen->weights);
    *ret_pen = gsn_steal(&pen);
    return GSN_OK;
}

void gsn_pen_free(struct gsn_pen *pen)
{
    if (!pen)
        return;
    cairo_destroy(pen->cairo);
    cairo_surface_destroy(pen->weights);
    gsn_free(pen);
}

void gsn_pen_line(struct gsn_pen *pen, double x0, double y0, double x1, double y1)
{
    cairo_move_to(pen->cairo, x0, y0);
    cairo_line_to(pen->cairo, x1, y1);
}

int gsn_pen_ink(struct gsn_pen *pen, struct gsn_image *image, double width,
                struct gsn_colour colour, struct gsn_error *err)
{
    cairo_set_line_width(pen->cairo, width);
    cairo_set_line_cap(pen->cairo, CAIRO_LINE_CAP_ROUND);
    cairo_stroke(pen->cairo);
    if (cairo_status(pen->cairo) != CAIRO_STATUS_SUCCESS)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while drawing lines");
    return gsn_canvas_ink(image, 0, 0, pen->weights, colour, err);
}

void gsn_canvas_paste(struct gsn_image *image, const struct gsn_image *picture, int x, int y)
{
    assert(picture->channels == 3 && picture->bits == 8);
    for (uint32_t j = 0; j < picture->height; j++) {
        for (uint32_t i = 0; i < picture->width; i++) {
            const uint8_t *from = pixel_at(picture, (int)i, (int)j);

            gsn_canvas_put(image, x + (int)i, y + (int)j,
                           (struct gsn_colour){ from[0], from[1], from[2] });
        }
    }
}
