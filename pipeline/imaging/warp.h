/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures laid another way. */
#ifndef GSN_IMAGING_WARP_H
#define GSN_IMAGING_WARP_H

#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Mirrors the picture left to right, if so, and then turns it clockwise by so many quarters (0 to
 * 3); with an odd number width and height change places. The picture is as before on failure. */
int gsn_turn_image(struct gsn_image *image, int mirrored, unsigned quarters,
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
