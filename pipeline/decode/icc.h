/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Embedded ICC profiles, by Little CMS: how the samples of a picture relate to light.
 *
 * A profile of three curves and a matrix gives its curves, channel by channel, so that the
 * scanner's own primaries stay what the dyes were seen through; a profile of tables gives linear
 * light in the primaries of sRGB. A profile is data from outside like the picture around it, so it
 * is read where the picture is: in the sandbox. Internal to decoding. */
#ifndef GSN_DECODE_ICC_H
#define GSN_DECODE_ICC_H

#include "pipeline/decode/raster.h"

/* Profiles of scanners and cameras have some kilobytes, those of tables up to a megabyte. */
#define GSN_ICC_MOST_BYTES ((size_t)4 << 20)

/* Where light was asked for, keeps a copy of the profile in the picture for gsn_icc_apply(), which
 * says so where there was no memory for it (bytes NULL, or the copy); one that is empty or too
 * large is refused. */
void gsn_icc_keep(struct gsn_picture *picture, const void *bytes, size_t size);

/* Turns the samples into 16-bit linear light as the kept profile says: transfer is then
 * GSN_TRANSFER_PROFILE. Where the profile's curves are those of sRGB or straight, the samples stay
 * and transfer says which. A profile that cannot be used leaves everything and transfer at
 * GSN_TRANSFER_ICC. picture->profile names the profile or says why it was refused. Nothing without
 * a profile. limits has no member 0. Fails with GSN_E_NOMEM. */
int gsn_icc_apply(struct gsn_picture *picture, const struct gsn_decode_limits *limits,
                  struct gsn_error *err);

#endif
