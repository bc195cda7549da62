/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Compiled once per instruction set, as GSN_ROWS_RED, without a branch: of the solutions that use
 * one dye, two or all, the allowed one with the largest a.b wins, and that of all three wins
 * wherever its amounts are honest. */
#include "pipeline/stain/rows.h"

gsn_red_row GSN_ROWS_RED;

void GSN_ROWS_RED(const struct gsn_red_weights *weights, const float *restrict red,
                  const float *restrict green, const float *restrict blue, size_t count,
                  float *restrict to)
{
    const struct gsn_red_weights w = *weights;

    for (size_t i = 0; i < count; i++) {
        const float r = red[i], g = green[i], b = blue[i];
        const float b0 = w.dye[0][0] * r + w.dye[0][1] * g + w.dye[0][2] * b;
        const float b1 = w.dye[1][0] * r + w.dye[1][1] * g + w.dye[1][2] * b;
        const float b2 = w.dye[2][0] * r + w.dye[2][1] * g + w.dye[2][2] * b;
        const float p0 = w.pair[0][0][0] * r + w.pair[0][0][1] * g + w.pair[0][0][2] * b;
        const float p1 = w.pair[0][1][0] * r + w.pair[0][1][1] * g + w.pair[0][1][2] * b;
        const float q0 = w.pair[1][0][0] * r + w.pair[1][0][1] * g + w.pair[1][0][2] * b;
        const float q2 = w.pair[1][1][0] * r + w.pair[1][1][1] * g + w.pair[1][1][2] * b;
        const float s1 = w.pair[2][0][0] * r + w.pair[2][0][1] * g + w.pair[2][0][2] * b;
        const float s2 = w.pair[2][1][0] * r + w.pair[2][1][1] * g + w.pair[2][1][2] * b;
        const float a0 = w.all[0][0] * r + w.all[0][1] * g + w.all[0][2] * b;
        const float a1 = w.all[1][0] * r + w.all[1][1] * g + w.all[1][2] * b;
        const float a2 = w.all[2][0] * r + w.all[2][1] * g + w.all[2][2] * b;
        const float pp = (p0 >= 0) & (p1 >= 0) ? p0 * b0 + p1 * b1 : 0;
        const float qq = (q0 >= 0) & (q2 >= 0) ? q0 * b0 + q2 * b2 : 0;
        const float ss = (s1 >= 0) & (s2 >= 0) ? s1 * b1 + s2 * b2 : 0;
        const float one = b0 > 0 ? b0 * b0 : 0;
        const float two = b1 > 0 ? b1 * b1 : 0;
        const float three = b2 > 0 ? b2 * b2 : 0;
        const float n0 = a0 < 0 ? a0 : 0, n1 = a1 < 0 ? a1 : 0, n2 = a2 < 0 ? a2 : 0;
        const float least = GSN_HONEST * GSN_HONEST * (r * r + g * g + b * b);
        float most = one, amount = b0 > 0 ? b0 : 0;

        amount = pp > most ? p0 : amount;
        most = pp > most ? pp : most;
        amount = qq > most ? q0 : amount;
        most = qq > most ? qq : most;
        amount = ss > most ? 0 : amount;
        most = ss > most ? ss : most;
        amount = (two > most) | (three > most) ? 0 : amount;
        amount = (n0 * n0 <= 4 * least) & (n1 * n1 <= least) & (n2 * n2 <= least) ? a0 : amount;
        to[i] = w.per_red * amount;
    }
}
