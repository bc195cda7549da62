/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Optical density only where it is wanted: glass between the sections of a panel is most of it. */
#ifndef GSN_STAIN_ABSORB_H
#define GSN_STAIN_ABSORB_H

#include "pipeline/stain/redness.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: R + G + B optical density in one plane, for pictures that were made small.
 * Fails as gsn_optical_density(). */
int gsn_absorb_total(const struct gsn_image *image, const struct gsn_glass *glass,
                     struct gsn_plane **ret_total, struct gsn_error *err);

/* A part of a picture, in its pixels. */
struct gsn_pixel_box {
    int x, y, width, height;
};

/* gives: optical density of the first planes channels (1 to 3) inside the box, planes of its size;
 * ret_od beyond them is untouched. A sample of 0 is read as half a code. The box lies in the
 * picture. Fails as gsn_optical_density(). */
int gsn_absorb_box(const struct gsn_image *image, const struct gsn_glass *glass,
                   const struct gsn_pixel_box *box, unsigned planes, struct gsn_plane *ret_od[3],
                   struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
