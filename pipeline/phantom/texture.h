/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The grain of the tissue: quilts sewn from two tiles of a real picrosirius photograph.
 *
 * A quilt has mean 0 over 33 texels and a standard deviation of about 1, so the mean amount of dye
 * stays proportional to the density. One texel is 16 um. */
#ifndef GSN_PHANTOM_TEXTURE_H
#define GSN_PHANTOM_TEXTURE_H

#include "pipeline/core/image.h"
#include "pipeline/phantom/random.h"

#ifdef __cplusplus
extern "C" {
#endif

#define GSN_PHANTOM_TEXEL_UM 16.0
/* The photograph the tiles were cut from, and its SHA-256. */
#define GSN_PHANTOM_TEXTURE_FILE "psr_left.jpg"
#define GSN_PHANTOM_TEXTURE_SHA256                                                                 \
    "330d946976f0678b00595427459d82e224d235efce40b1bc764991c22b1dc0e5"

enum gsn_phantom_tile { GSN_PHANTOM_T1, GSN_PHANTOM_T2, GSN_PHANTOM_TILES };

/* gives: a quilt of width x height texels. Fails with GSN_E_NOMEM. */
int gsn_phantom_quilt(enum gsn_phantom_tile tile, uint32_t width, uint32_t height,
                      struct gsn_phantom_random *random, struct gsn_plane **ret_quilt,
                      struct gsn_error *err);

/* Bilinear at a place in texels (texel centres at +0.5), held at the border. */
double gsn_phantom_texture_at(const struct gsn_plane *quilt, double x, double y);

#ifdef __cplusplus
}
#endif
#endif
