/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The jumps of a face: D_g(u) = side (c_g^I(u) - c_g^J(u)) as polynomials (seam.h). */
#ifndef GSN_MODEL_SEAM_JUMP_H
#define GSN_MODEL_SEAM_JUMP_H

#include "pipeline/model/seam.h"

#ifdef __cplusplus
extern "C" {
#endif

/* All of them for 1 <= |g| <= top, g in the order of gsn_seam_weights(), each by its monomials
 * 1, x, y, z, xx, xy, xz, yy, yz, zz in the axes of the face, as far as its degree n - |g| goes. */
void gsn_seam_jumps(const struct gsn_dms *space, const struct gsn_prism *prism,
                    const double *control, double *ret_poly);

#ifdef __cplusplus
}
#endif
#endif
