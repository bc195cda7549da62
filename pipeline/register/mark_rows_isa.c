/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Compiled once per instruction set, as GSN_MARK_ROWS. */
#include "pipeline/register/mark_rows.h"

static void blend(const float *const from[5], size_t count, float *restrict onto)
{
    const float *restrict a = from[0], *restrict b = from[1], *restrict c = from[2];
    const float *restrict d = from[3], *restrict e = from[4];

    for (size_t i = 0; i < count; i++)
        onto[i] = 0.0625f * (a[i] + e[i]) + 0.25f * (b[i] + d[i]) + 0.375f * c[i];
}

static void less(const float *restrict from, const float *restrict what, size_t count,
                 float *restrict to)
{
    for (size_t i = 0; i < count; i++)
        to[i] = from[i] - what[i];
}

static inline float larger(float a, float b)
{
    return a > b ? a : b;
}

static void peaks(const float *const at[3], size_t count, float least, uint8_t *restrict to)
{
    const float *restrict above = at[0], *restrict below = at[2];
    const float *before = at[1] - 1, *own = at[1], *after = at[1] + 1;

    for (size_t i = 0; i < count; i++) {
        const float most =
            larger(larger(larger(above[i], below[i]), larger(before[i], after[i])), least);

        to[i] = own[i] >= most;
    }
}

extern const struct gsn_mark_rows GSN_MARK_ROWS;
const struct gsn_mark_rows GSN_MARK_ROWS = { blend, less, peaks };
