/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the eye stands: a direction of view, framed so that a box in space fills the picture. */
#ifndef GSN_RENDER_VIEW_H
#define GSN_RENDER_VIEW_H

#include "pipeline/core/error.h"
#include "pipeline/model/tets.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_view {
    double direction[3]; /* from the eye into the scene; need not have length 1, not 0 */
    double up[3];        /* what points up in the picture; not parallel to direction */
    double eye_distance; /* perspective: distance of the eye from the centre, in radii of the scene
                            (e.g. 4); 0: orthographic */
    uint32_t width, height; /* px */
};

/* The view worked out for one mesh: right, down, into are orthonormal in the block frame. */
struct gsn_camera {
    double right[3], down[3], into[3];
    double centre[3]; /* um; seen in the middle of the picture */
    double px_per_um; /* in the plane through the centre */
    double eye_um;    /* distance of the eye from the centre; 0: orthographic */
    uint32_t width, height;
};

/* The camera that shows all vertices of the mesh with a margin. Fails with GSN_E_INPUT when the
 * view has a zero or parallel direction, or a size of 0 or above 16384 px. */
int gsn_camera_frame(const struct gsn_view *view, const struct gsn_tets *mesh,
                     struct gsn_camera *ret_camera, struct gsn_error *err);

/* Picture coordinates (pixel centres at +0.5) and depth in um behind the plane through the centre.
 */
void gsn_camera_project(const struct gsn_camera *camera, const double point[3], double ret_pixel[2],
                        double *ret_depth);

/* The point of the plane through the centre that is seen at (x_px, y_px), um. */
void gsn_ray_start(const struct gsn_camera *camera, double x_px, double y_px, double ret_point[3]);

#ifdef __cplusplus
}
#endif
#endif
