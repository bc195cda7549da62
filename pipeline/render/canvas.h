/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A small canvas on RGB pictures of 8 bits: boxes, lines and colour maps.
 *
 * Every function takes a struct gsn_image with 3 channels and 8 bits (the caller guarantees it),
 * in pixels from the upper left corner; what falls outside is clipped. */
#ifndef GSN_RENDER_CANVAS_H
#define GSN_RENDER_CANVAS_H

#include "pipeline/core/image.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_colour {
    uint8_t r, g, b;
};

/* Maps that rise evenly in lightness, so that they survive grey printing. */
enum gsn_colour_map { GSN_MAP_VIRIDIS, GSN_MAP_GREY };

/* share 0..1; beyond is clamped. NaN gives the grey of "no data". */
struct gsn_colour gsn_colour_of(enum gsn_colour_map map, double share);

/* gives: a picture filled with one colour. Fails with GSN_E_NOMEM. */
int gsn_canvas_new(uint32_t width, uint32_t height, struct gsn_colour background,
                   struct gsn_image **ret_image, struct gsn_error *err);

void gsn_canvas_put(struct gsn_image *image, int x, int y, struct gsn_colour colour);
/* Mixes the colour in with this weight, 0..1. */
void gsn_canvas_mix(struct gsn_image *image, int x, int y, struct gsn_colour colour, double weight);
void gsn_canvas_box(struct gsn_image *image, int x, int y, int width, int height,
                    struct gsn_colour colour);
/* Diagonal hatching that says "no data", never to be taken for a value. */
void gsn_canvas_no_data(struct gsn_image *image, int x, int y);
/* Mixes the colour in by the weights of cairo's surface A8 whose upper left corner lies at (x, y).
 * Fails with GSN_E_NOMEM when cairo ran out of memory on the way. */
typedef struct _cairo_surface cairo_surface_t; /* as cairo itself declares it */
int gsn_canvas_ink(struct gsn_image *image, int x, int y, cairo_surface_t *weights,
                   struct gsn_colour colour, struct gsn_error *err);
/* Copies a picture of the same kind to (x, y). */
void gsn_canvas_paste(struct gsn_image *image, const struct gsn_image *picture, int x, int y);

/* Anti-aliased lines with round ends; coordinates have pixel centres at +0.5. Lines are collected
 * and drawn together, so that where they meet ink is laid once. A pen draws once.
 * gives: a pen for pictures of this size. Both fail with GSN_E_NOMEM. */
struct gsn_pen;
int gsn_pen_new(const struct gsn_image *image, struct gsn_pen **ret_pen, struct gsn_error *err);
void gsn_pen_free(struct gsn_pen *pen);
GSN_DEFINE_AUTO(gsn_pen);
void gsn_pen_line(struct gsn_pen *pen, double x0, double y0, double x1, double y1);
int gsn_pen_ink(struct gsn_pen *pen, struct gsn_image *image, double width,
                struct gsn_colour colour, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
