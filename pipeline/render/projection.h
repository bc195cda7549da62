/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The X-ray picture: the integral of the spline along the line of view through every pixel, exact,
 * without steps (docs/MATH.md, equations (7) and (8): the projection formula).
 *
 * Values are in density times um. The view is orthographic. */
#ifndef GSN_RENDER_PROJECTION_H
#define GSN_RENDER_PROJECTION_H

#include "pipeline/core/progress.h"
#include "pipeline/model/spline.h"
#include "pipeline/render/canvas.h"
#include "pipeline/render/view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: one integral per pixel centre; NaN where the line meets no tetrahedron's support.
 * view->eye_distance must be 0. threads 0: all; the same bytes on any number. progress may be NULL.
 * Fails with GSN_E_INPUT on an unusable view, GSN_E_NOMEM. */
int gsn_projection(const struct gsn_spline *spline, const struct gsn_view *view, unsigned threads,
                   const struct gsn_progress *progress, struct gsn_plane **ret_plane,
                   struct gsn_camera *ret_camera, struct gsn_error *err);

/* Draws the axes of the block as the camera sees them into the lower left corner of a picture, which
 * is at (x, y); an axis that points at the eye is a dot. Fails with GSN_E_NOMEM, and with
 * GSN_E_NOTFOUND without the fonts (lettering.h). */
int gsn_axes_paint(struct gsn_image *sheet, int x, int y, const struct gsn_camera *camera,
                   struct gsn_error *err);

/* gives: the picture with colour scale ("density x um" unless unit is given), scale bar and title
 * (may be NULL). low == high: 0 to the largest value. Fails with GSN_E_NOMEM. */
int gsn_projection_paint(const struct gsn_plane *plane, const struct gsn_camera *camera,
                         const char *title, const char *unit, double low, double high,
                         enum gsn_colour_map map, struct gsn_image **ret_image,
                         struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
