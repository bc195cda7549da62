/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inner loops of the search for spots, for whole rows of cells, one version per instruction
 * set. Cells do not depend on each other and nothing is fused, so all versions give the same bits.
 * Private to pipeline/register. */
#ifndef GSN_REGISTER_MARK_ROWS_H
#define GSN_REGISTER_MARK_ROWS_H

#include <stddef.h>
#include <stdint.h>

struct gsn_mark_rows {
    /* The kernel 1 4 6 4 1 over five rows. */
    void (*blend)(const float *const from[5], size_t count, float *onto);
    /* One row less another. */
    void (*less)(const float *from, const float *what, size_t count, float *to);
    /* 1 where a cell of the middle one of three rows is neither below least nor below any of the
     * four cells beside it, else 0. Of each row one cell before at and one after count is read. */
    void (*peaks)(const float *const at[3], size_t count, float least, uint8_t *to);
};

enum gsn_mark_rows_isa { GSN_MARK_ROWS_PLAIN, GSN_MARK_ROWS_AVX2, GSN_MARK_ROWS_ISAS };

/* NULL where this processor cannot run it. */
const struct gsn_mark_rows *gsn_mark_rows_for(enum gsn_mark_rows_isa isa);
const struct gsn_mark_rows *gsn_mark_rows_best(void);

#endif
