/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where a mark of several pixels' radius lies, from its edge, sector by sector.
 *
 * The rim is cut into sectors of some pixels' width. In sector k, under the angle t, the model is
 *
 *     f = (B + b_k) q + M (1 - q),   q = Phi((r - R(t)) / s),
 *     R(t) = R + sum over m = 2.. of (c_m cos mt + s_m sin mt),
 *
 * with r from the centre wanted, the same M and s all round, a plane B, and what the tissue of this
 * sector differs from it, b_k, a random number whose spread is estimated. The sectors' own edges
 * are independent witnesses of one outline: those that debris, a scratch or a hole in the tissue
 * moved are outvoted (a circle through the majority first, then Tukey's weights). The lobes take
 * what is ragged but not the centre. On a clean disc this reaches the Cramer-Rao bound.
 *
 * All lengths are in pixels, pixel centres at +0.5; a mark is higher than what is around it. */
#ifndef GSN_REGISTER_FIDUCIAL_CONTOUR_H
#define GSN_REGISTER_FIDUCIAL_CONTOUR_H

#include "pipeline/core/error.h"
#include "pipeline/core/image.h"
#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Fits the mark near start, whose radius is about radius_px (within a factor of 1.6, at least 4).
 *
 * borrows: plane; NaN pixels are left out. The covariance is the model's, larger by how much more
 * than it says the sectors' edges disagree and the disc's level differs from sector to sector; what
 * the descriptor may do where the rim is missing is in it as it is believed. ret_mark.found is 0
 * when too few sectors agree on a round edge, or the fit runs away: that is no error. Fails with
 * GSN_E_NOMEM. */
int gsn_contour_fit(const struct gsn_plane *plane, struct gsn_point start, double radius_px,
                    struct gsn_fiducial *ret_mark, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
