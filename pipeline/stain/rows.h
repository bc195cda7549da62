/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inner loop of unmixing, for whole rows of pixels, one version per instruction set. Pixels do
 * not depend on each other and nothing is fused, so all versions give the same bits. Private to
 * pipeline/stain. */
#ifndef GSN_STAIN_ROWS_H
#define GSN_STAIN_ROWS_H

#include "pipeline/stain/unmix.h"

#include <stddef.h>

enum gsn_rows_isa { GSN_ROWS_PLAIN, GSN_ROWS_AVX2, GSN_ROWS_AVX512, GSN_ROWS_ISAS };

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
