/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One plane out of the channels around a mark, about 0 on tissue and 1 on the mark.
 *
 * The weights are Fisher's: the inverse of the covariance of what the tissue changes over the width
 * of an edge, times the difference of mark and tissue. The blur of the optics mixes transmitted
 * light, not density, so the plane is linear in the codes. */
#ifndef GSN_REGISTER_MARK_COLOUR_H
#define GSN_REGISTER_MARK_COLOUR_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* borrows: window, with the mark about at centre. gives: ret_plane, of the window's size.
 * ret_contrast: by how much the mark is darker in the first channel, log10. Fails with
 * GSN_E_NOMEM. */
int gsn_mark_mix(const struct gsn_image *window, struct gsn_point centre, double radius_px,
                 struct gsn_plane **ret_plane, double *ret_contrast, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
