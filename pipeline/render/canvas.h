/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A small canvas on RGB pictures of 8 bits: boxes, lines, colour maps, and lettered sheets.
 *
 * Every function takes a struct gsn_image with 3 channels and 8 bits (the caller guarantees it),
 * in pixels from the upper left corner; what falls outside is clipped. */
#ifndef GSN_RENDER_CANVAS_H
#define GSN_RENDER_CANVAS_H

#include "pipeline/core/image.h"
#include "pipeline/render/lettering.h"

#ifdef __cplusplus
extern "C" {
#endif

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

/* The sheet a picture is mounted on: title above, colour scale to the right, scale bar and a note
 * below. */

struct gsn_plate {
    const char *title, *note; /* NULL: none */
    double um_per_px;         /* for the scale bar; 0: none */
    int has_scale;            /* whether the four below are shown */
    const char *unit;
    double low, high;
    enum gsn_colour_map map;
};

/* gives: a white sheet for a picture of this size; the picture's upper left corner goes to
 * (*ret_x, *ret_y) and is framed already. low < high where has_scale. Fails with GSN_E_NOMEM, and
 * with GSN_E_NOTFOUND where the fonts are missing (lettering.h). */
int gsn_plate_new(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                  struct gsn_image **ret_sheet, int *ret_x, int *ret_y, struct gsn_error *err);

/* Colours of a plane of values at (x, y); NaN is hatched. low < high. */
void gsn_plate_fill(struct gsn_image *sheet, int x, int y, const struct gsn_plane *plane,
                    enum gsn_colour_map map, double low, double high);

/* Ends for the colour scale: low and high as given when they differ; otherwise the extremes of the
 * values, made different when they are not. */
void gsn_plate_range(const struct gsn_plane *plane, double *low, double *high);

#ifdef __cplusplus
}
#endif
#endif
