/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures of a spline cell by cell, for a quick look: the tetrahedra are projected, and each adds
 * to the pixels that it covers what it would if the density in it were linear.
 *
 * That linear density is the best one for the polynomial of the cell in least squares and has its
 * mean, so that a cell weighs in the picture what it weighs in the model. A spline of degree 1 with
 * shared control points is linear in its cells, and its X-ray and opacity are exact but for floats.
 * What faces add to higher degrees near them is not drawn. */
#ifndef GSN_RENDER_PROJECTED_TETS_H
#define GSN_RENDER_PROJECTED_TETS_H

#include "pipeline/render/ray_cast.h"

#ifdef __cplusplus
extern "C" {
#endif

/* As gsn_ray_xray(): the same rays, clips, units, failures. */
int gsn_projected_xray(const struct gsn_spline *spline, const struct gsn_camera *camera,
                       const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                       unsigned threads, const struct gsn_progress *progress,
                       struct gsn_plane **ret_plane, struct gsn_error *err);

/* As gsn_ray_volume(), but for colour and shading: the light of a cell along a ray has one colour,
 * that of its mean share of the window weighted by what it emits, and the shade of the cell's
 * gradient. Opacity is exact for the linear density. */
int gsn_projected_volume(const struct gsn_spline *spline, const struct gsn_camera *camera,
                         const struct gsn_ray_clip *clip, const struct gsn_ray_style *style,
                         unsigned threads, const struct gsn_progress *progress,
                         struct gsn_ray_picture **ret_picture, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
