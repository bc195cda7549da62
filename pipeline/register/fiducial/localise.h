/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where one mark lies, to a few hundredths of a pixel.
 *
 * The model is a dark disc of constant density M with a blurred edge, in a ring that lets only part
 * of the tissue's density through, on a plane B(x, y):
 *
 *     f = B (q - p e q^2) + M (1 - q),   q = Phi((r - R) / s),   e = 1 - Phi((r - Rr) / s)
 *
 * (p: how far the ring is bleached, 0 for none; s: the blur). Fitted by Levenberg-Marquardt; this
 * reaches 1.0x of the Cramer-Rao bound where a thresholded centroid reaches 2-5x. All lengths are
 * in pixels, pixel centres at +0.5. */
#ifndef GSN_REGISTER_FIDUCIAL_LOCALISE_H
#define GSN_REGISTER_FIDUCIAL_LOCALISE_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"
#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How wrong a starting radius may be, and how far from the start, in starting radii, pixels are
 * looked at: far enough for the ring and some tissue around it. */
#define GSN_LOCALISE_FACTOR 1.6
#define GSN_LOCALISE_REACH 2.3

/* Fits the mark near start, whose radius is about radius_px (within GSN_LOCALISE_FACTOR).
 *
 * borrows: plane; NaN pixels are left out. The covariance takes the texture of the tissue into
 * account, as far as the ring lets it through and as far as it is correlated from pixel to pixel.
 * ret_mark.found is 0 when the fit runs away, does not settle, explains
 * too little, or less than half of the disc is
 * inside the plane and unmasked: that is no error. Fails with GSN_E_NOMEM. */
int gsn_fiducial_localise(const struct gsn_plane *plane, struct gsn_point start, double radius_px,
                          struct gsn_fiducial *ret_mark, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
