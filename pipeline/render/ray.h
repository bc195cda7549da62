/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The shadow of a tetrahedron's functions: the convex hull of its projected knots. Outside of it
 * every whole-line integral of those functions is 0. */
#ifndef GSN_RENDER_RAY_H
#define GSN_RENDER_RAY_H

#include "pipeline/model/dms.h"
#include "pipeline/render/view.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_SHADOW_MOST = 4 * (GSN_DMS_MAX_DEGREE + 1) };

/* Corners in pixels, in order around; top and bottom are the least and largest y. */
struct gsn_shadow {
    unsigned count;
    double corner[GSN_SHADOW_MOST][2];
    double top, bottom;
};

/* The pixels [*ret_first, *ret_end) of a row whose centres the shadow covers, generous by rounding;
 * none: first = end. */
void gsn_shadow_span(const struct gsn_shadow *shadow, uint32_t row, uint32_t width,
                     uint32_t *ret_first, uint32_t *ret_end);

/* The point of the picture plane behind a pixel's centre, um. */
void gsn_ray_start(const struct gsn_camera *camera, double x_px, double y_px, double ret_point[3]);

#ifdef __cplusplus
}
#endif
#endif
