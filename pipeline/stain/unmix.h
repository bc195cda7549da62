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

/* Red alone, as a length. The amounts may come out negative: the other two by up to GSN_HONEST of
 * the pixel's density, red by up to twice that. For a dye that is a few degrees off its vector
 * leaves negative amounts in honest tissue; cutting them off at 0 pulls the mean of red towards
 * whichever dye is nearest, and differently in pale and in dense tissue. Left in, a turned vector
 * multiplies red and adds to it alike everywhere, which can be taken out again (stain/level.h). A
 * pixel further off is no mixture of these dyes and is unmixed as gsn_unmixer_apply() does. */
double gsn_unmixer_red(const struct gsn_unmixer *mix, const double od[3]);

/* Red and dark are 18 degrees apart: a vector that is 5 degrees off leaves a negative amount of
 * sin 5 / sin 18, a quarter, of the other. Red pays for the yellow as well: twice that. */
#define GSN_HONEST 0.25F

#ifdef __cplusplus
}
#endif
#endif
