/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The dye vectors of a batch of slides, from their own stained pixels, with an honest error.
 *
 * Where tissue holds a pure dye its vector can be read off; where every pixel is a mixture, as in
 * most tissue, the extreme pixels lie inside of the cone that the dyes span and point at vectors
 * that are too alike. So the vectors are not read off but inferred: they are those that make the
 * pixels most probable when amounts of dye are positive, vary by factors rather than by sums (a
 * mixture of log-normal classes, correlated in any way) and are seen through the noise of the scan,
 * and when the vectors lie about where the protocol says. Pixels that fit no class (pigment, ink)
 * count as strays and do not pull. No tissue is truly log-normal, and what that leads astray no
 * number of pixels mends: so they count by how well they fit, and the worse they do, the nearer the
 * vectors and their error stay to the protocol's. */
#ifndef GSN_STAIN_VECTOR_ESTIMATION_H
#define GSN_STAIN_VECTOR_ESTIMATION_H

#include "pipeline/stain/stain_sample.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Whether it is this stain at all is gsn_stain_look()'s question, not asked here.
 *
 * Fails with GSN_E_STAIN when the sample holds fewer than 1000 pixels or two dyes come out nearly
 * alike; GSN_E_NOMEM. */
int gsn_dyes_estimate(const struct gsn_stain_sample *sample, const struct gsn_dyes_prior *prior,
                      struct gsn_dyes_fit *ret_fit, struct gsn_error *err);

#ifdef __cplusplus
}
#endif

#endif
