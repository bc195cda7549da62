/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <stdlib.h>
#include <string.h>

#include "pipeline/stain/order.h"

enum { MOST = 200 };

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

TEST(picks_what_sorting_would_put_there)
{
    uint32_t seed = 7;

    for (size_t count = 1; count <= MOST; count++) {
        /* Few different values (ties), many, sorted and reversed. */
        for (uint32_t kind = 0; kind < 4; kind++) {
            double values[MOST], sorted[MOST], work[MOST];

            for (size_t i = 0; i < count; i++) {
                seed = seed * 1664525u + 1013904223u;
                values[i] = kind == 0   ? (double)(seed >> 30)
                            : kind == 1 ? (double)(seed >> 8)
                            : kind == 2 ? (double)i
                                        : -(double)i;
            }
            memcpy(sorted, values, sizeof sorted);
            qsort(sorted, count, sizeof *sorted, ascending);
            for (size_t rank = 0; rank < count; rank += 1 + count / 9) {
                memcpy(work, values, sizeof work);
                CHECK_NEAR(gsn_order_pick(work, count, rank), sorted[rank], 0);
            }
        }
    }
}
