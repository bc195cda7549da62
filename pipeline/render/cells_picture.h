/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The cells of a model drawn apart, each in the colour of its density. */
#ifndef GSN_RENDER_CELLS_PICTURE_H
#define GSN_RENDER_CELLS_PICTURE_H

#include "pipeline/model/tets.h"
#include "pipeline/render/ray_cast.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: tetrahedra drawn to share (above 0, to 1) of their size towards their own middle, those
 * that face the light lighter. density: of each; NaN, or less than low, leaves it out. Of clip the
 * box and the planes are used: a cell whose middle they leave is drawn, whole. Of style low, high,
 * map and across. threads 0: all; the same bytes on any number. Fails with GSN_E_INPUT on a share,
 * window or across that cannot be drawn, GSN_E_NOMEM. */
int gsn_cells_picture(const struct gsn_tets *mesh, const double *density, double share,
                      const struct gsn_camera *camera, const struct gsn_ray_clip *clip,
                      const struct gsn_ray_style *style, unsigned threads,
                      struct gsn_ray_picture **ret_picture, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
