/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which way a picture looks into the block, and where things lie in it: a cube turned as the block
 * is, and axes with places in um along the edges of what is shown. */
#ifndef GSN_RENDER_BLOCK_AXES_H
#define GSN_RENDER_BLOCK_AXES_H

#include "pipeline/render/canvas.h"
#include "pipeline/render/view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A box of the block, um. */
struct gsn_block_box_um {
    double low[3], high[3];
};

/* How much of a picture a scene may take, so that the numbers of its axes have room beside it. */
#define GSN_BLOCK_AXES_SHARE 0.84

/* The edge of the box along which an axis (0, 1, 2) is drawn: of those on the outline of the box as
 * it is seen the lowest in the picture, or leftmost where they are upright. From the lower end to
 * the upper. 0: there is none, for the axis points at the eye. */
int gsn_block_axes_edge(const struct gsn_camera *camera, const struct gsn_block_box_um *box,
                        int axis, double ret_from[3], double ret_to[3]);

/* Draws the cube into the upper right corner of the picture, whose own upper left corner is at
 * (x, y) of the sheet, and, unless box is NULL or the picture too small for numbers, the axes of
 * the box. Fails with GSN_E_NOMEM, and with GSN_E_NOTFOUND without the fonts (lettering.h). */
int gsn_block_axes_paint(struct gsn_image *sheet, int x, int y, const struct gsn_camera *camera,
                         const struct gsn_block_box_um *box, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
