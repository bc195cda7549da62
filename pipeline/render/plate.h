/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sheet a picture is mounted on: title above, colour scale to the right, scale bar and a note
 * below. */
#ifndef GSN_RENDER_PLATE_H
#define GSN_RENDER_PLATE_H

#include "pipeline/render/canvas.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_plate {
    const char *title, *note; /* NULL: none */
    double um_per_px;         /* for the scale bar; 0: none */
    int has_scale;            /* whether the four below are shown */
    const char *unit;
    double low, high;
    enum gsn_colour_map map;
};

/* gives: a white sheet for a picture of this size; the picture's upper left corner goes to
 * (*ret_x, *ret_y) and is framed already. Fails with GSN_E_NOMEM. */
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
