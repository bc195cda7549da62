/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Orthogonal cuts through the fitted spline and through the data it was fitted to.
 *
 * A cut is a picture in the block frame (micrometres) across one axis. The picture's right and down
 * are x and y for a z cut, x and z for a y cut, y and z for an x cut. Where there is no data the
 * picture is hatched grey, never shown as zero. */
#ifndef GSN_RENDER_CUT_H
#define GSN_RENDER_CUT_H

#include "pipeline/core/colour_grid.h"
#include "pipeline/core/grid.h"
#include "pipeline/model/spline.h"
#include "pipeline/render/canvas.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_axis { GSN_AXIS_X, GSN_AXIS_Y, GSN_AXIS_Z };

/* Which piece of which plane. (left_um, top_um) is the outer corner of the upper left pixel. */
struct gsn_cut_frame {
    enum gsn_axis axis;
    double at_um; /* coordinate along the axis */
    double left_um, top_um, um_per_px;
    uint32_t width, height;
};

struct gsn_cut_style {
    const char *title; /* NULL: none */
    const char *unit;  /* above the colour scale; NULL: none */
    double low, high;  /* ends of the colour scale; both equal: the extremes of the values */
    enum gsn_colour_map map;
};

/* The centre of the region's voxel that is nearest to the mean of all of them, so that all three
 * cuts through it meet the region. Fails with GSN_E_INPUT on an empty region. */
int gsn_cut_centre(const struct gsn_mask *region, struct gsn_vec3 *ret_centre_um,
                   struct gsn_error *err);

/* The frame that shows the whole region with a margin of 3 % on the plane through a point; the
 * longer side becomes longest_px. Fails with GSN_E_INPUT on an empty region. */
int gsn_cut_frame(const struct gsn_mask *region, enum gsn_axis axis, struct gsn_vec3 through_um,
                  uint32_t longest_px, struct gsn_cut_frame *ret_frame, struct gsn_error *err);

/* The centre of pixel i to the right and j down, which may lie beyond the frame. Whatever a cut
 * shows is asked at these very coordinates. */
struct gsn_vec3 gsn_cut_pixel(const struct gsn_cut_frame *frame, size_t i, size_t j);

/* give: values at the pixel centres; NaN outside the domain, the lattice or the data. threads 0:
 * all; the same bytes on any number. The grid is shown by its nearest voxel, as it is. Fail with
 * GSN_E_NOMEM, the spline's also with GSN_E_INPUT on a frame that is not finite or has no pixels.
 */
int gsn_cut_spline(const struct gsn_spline *spline, const struct gsn_cut_frame *frame,
                   unsigned threads, struct gsn_plane **ret_plane, struct gsn_error *err);
int gsn_cut_grid(const struct gsn_grid *grid, const struct gsn_cut_frame *frame,
                 struct gsn_plane **ret_plane, struct gsn_error *err);

/* Ends of a colour scale, low < high: smallest and largest value at the voxels of the region that
 * have data; 0 and 1 when none has, and from the value v up to v + max(1, |v|) when all have
 * one. */
void gsn_cut_range(const struct gsn_grid *grid, const struct gsn_mask *region, double *ret_low,
                   double *ret_high);

/* gives: the picture: colours, outline of the region (may be NULL), scale bar, colour scale,
 * title. Fails with GSN_E_NOMEM. */
int gsn_cut_paint(const struct gsn_plane *plane, const struct gsn_cut_frame *frame,
                  const struct gsn_mask *region, const struct gsn_cut_style *style,
                  struct gsn_image **ret_image, struct gsn_error *err);

/* gives: the true colours on the frame, nearest voxels as they are, with outline and scale bar; no
 * data is hatched. title and region may be NULL. Fails with GSN_E_NOMEM. */
int gsn_cut_colour(const struct gsn_colour_grid *grid, const struct gsn_cut_frame *frame,
                   const struct gsn_mask *region, const char *title, struct gsn_image **ret_image,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
