/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inner loop of unmixing, for whole rows of pixels, one version per instruction set. Pixels do
 * not depend on each other and nothing is fused, so all versions give the same bits. Private to
 * pipeline/stain.
 *
 * What is told is red alone. The amounts may come out negative: the other two by up to GSN_HONEST
 * of the pixel's density, red by up to twice that. For a dye that is a few degrees off its vector
 * leaves negative amounts in honest tissue; cutting them off at 0 pulls the mean of red towards
 * whichever dye is nearest, and differently in pale and in dense tissue. Left in, a turned vector
 * multiplies red and adds to it alike everywhere, which can be taken out again (stain/level.h). A
 * pixel further off is no mixture of these dyes and is unmixed as gsn_unmixer_apply() does. */
#ifndef GSN_STAIN_ROWS_H
#define GSN_STAIN_ROWS_H

#include "pipeline/stain/unmix.h"

#include <stddef.h>

/* Red and dark are 18 degrees apart: a vector that is 5 degrees off leaves a negative amount of
 * sin 5 / sin 18, a quarter, of the other. Red pays for the yellow as well: twice that. */
#define GSN_HONEST 0.25F

enum gsn_rows_isa { GSN_ROWS_PLAIN, GSN_ROWS_AVX512, GSN_ROWS_ISAS };

/* The unmixer in single precision: what each solution takes of R, G and B. Straight from the
 * densities, for a Gram matrix squares the error that similar dyes make of rounding. */
struct gsn_red_weights {
    float dye[3][3];
    float all[3][3];     /* amounts where all three dyes are used */
    float pair[3][2][3]; /* where two of them are: (0, 1), (0, 2), (1, 2) */
    float per_red;       /* 1 over the length that counts as density 1 */
};

typedef void gsn_red_row(const struct gsn_red_weights *weights, const float *red,
                         const float *green, const float *blue, size_t count, float *to);

struct gsn_red_weights gsn_red_weights_of(const struct gsn_unmixer *mix, double full_red_od);
/* NULL where this processor cannot run it. */
gsn_red_row *gsn_red_row_for(enum gsn_rows_isa isa);
gsn_red_row *gsn_red_row_best(void);

#endif
