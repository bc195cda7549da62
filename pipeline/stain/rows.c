/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/rows.h"

gsn_red_row gsn_red_row_plain, gsn_red_row_avx512;

/* Amount i of the solution that uses these dyes, of R, G and B. */
static void amount_of(const struct gsn_unmixer *mix, unsigned subset, int i, float ret[3])
{
    for (int c = 0; c < 3; c++) {
        double sum = 0;

        for (int k = 0; k < 3; k++)
            sum += mix->inverse[subset][i][k] * mix->dye[k][c];
        ret[c] = (float)sum;
    }
}

struct gsn_red_weights gsn_red_weights_of(const struct gsn_unmixer *mix, double full_red_od)
{
    static const int pairs[3][2] = { { 0, 1 }, { 0, 2 }, { 1, 2 } };
    struct gsn_red_weights w = { .per_red = (float)(1 / full_red_od) };

    for (int i = 0; i < 3; i++) {
        const unsigned both = 1u << pairs[i][0] | 1u << pairs[i][1];

        amount_of(mix, 7, i, w.all[i]);
        amount_of(mix, both, pairs[i][0], w.pair[i][0]);
        amount_of(mix, both, pairs[i][1], w.pair[i][1]);
        for (int c = 0; c < 3; c++)
            w.dye[i][c] = (float)mix->dye[i][c];
    }
    return w;
}

gsn_red_row *gsn_red_row_for(enum gsn_rows_isa isa)
{
    switch (isa) {
    case GSN_ROWS_PLAIN:
        return gsn_red_row_plain;
#ifdef __x86_64__
    case GSN_ROWS_AVX512:
        return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq")
                   ? gsn_red_row_avx512
                   : NULL;
#endif
    default:
        return NULL;
    }
}

gsn_red_row *gsn_red_row_best(void)
{
    gsn_red_row *best = NULL;

    for (int isa = GSN_ROWS_ISAS - 1; !best; isa--)
        best = gsn_red_row_for((enum gsn_rows_isa)isa);
    return best;
}
