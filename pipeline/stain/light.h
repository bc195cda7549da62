/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Samples to the logarithm of light, and the glass along one row: what the parts of this folder
 * share with each other. Logarithms are to base 10. */
#ifndef GSN_STAIN_LIGHT_H
#define GSN_STAIN_LIGHT_H

#include "pipeline/stain/redness.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Length of the optical density below which a hue is noise (Macenko's beta). */
#define GSN_PALE_OD 0.15

/* gives: log10 of linear light of each of the 2^bits samples; 0 is read as half a code.
 * Fails with GSN_E_NOMEM. */
int gsn_light_table(enum gsn_light light, unsigned bits, double **ret_table, struct gsn_error *err);

/* log10 of the glass's light along row y is ret[0] + ret[1] u + ret[2] u^2. */
void gsn_glass_row(const struct gsn_glass *glass, uint32_t y, unsigned channel, double ret[3]);

#ifdef __cplusplus
}
#endif
#endif
