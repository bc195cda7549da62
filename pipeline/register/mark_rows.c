/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_rows.h"

extern const struct gsn_mark_rows gsn_mark_rows_plain, gsn_mark_rows_avx2;

const struct gsn_mark_rows *gsn_mark_rows_for(enum gsn_mark_rows_isa isa)
{
    switch (isa) {
    case GSN_MARK_ROWS_PLAIN:
        return &gsn_mark_rows_plain;
#ifdef __x86_64__
    case GSN_MARK_ROWS_AVX2:
        return __builtin_cpu_supports("avx2") ? &gsn_mark_rows_avx2 : NULL;
#endif
    default:
        return NULL;
    }
}

const struct gsn_mark_rows *gsn_mark_rows_best(void)
{
    const struct gsn_mark_rows *best = NULL;

    for (int isa = GSN_MARK_ROWS_ISAS - 1; !best; isa--)
        best = gsn_mark_rows_for((enum gsn_mark_rows_isa)isa);
    return best;
}
