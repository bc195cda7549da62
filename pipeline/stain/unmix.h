/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Three dyes out of one density, prepared once for many pixels. */
#ifndef GSN_STAIN_UNMIX_H
#define GSN_STAIN_UNMIX_H

#include "pipeline/stain/redness.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_unmixer {
    double dye[3][3];
    double inverse[8][3]
                  [3]; /* of the Gram matrix of each subset; rows and columns of the others 0 */
};

/* Fails with GSN_E_STAIN as gsn_unmix() does. */
int gsn_unmixer_init(struct gsn_unmixer *mix, const struct gsn_dyes *dyes, struct gsn_error *err);
/* Amounts of red, yellow and dark as lengths in optical density, none below 0. */
void gsn_unmixer_apply(const struct gsn_unmixer *mix, const double od[3], double ret_amount[3]);

/* The length of what no such amounts explain. */
double gsn_unmixer_left(const struct gsn_unmixer *mix, const double od[3]);

#ifdef __cplusplus
}
#endif
#endif
