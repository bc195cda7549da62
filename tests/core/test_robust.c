/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/robust.h"

#include "tests/check.h"

#include <stdlib.h>
#include <string.h>

enum { MOST = 200, KINDS = 4 };

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

/* Few different values (ties), many, sorted and reversed. */
static void draw(double *value, size_t count, uint32_t kind, uint32_t *seed)
{
    for (size_t i = 0; i < count; i++) {
        *seed = *seed * 1664525u + 1013904223u;
        value[i] = kind == 0   ? (double)(*seed >> 30)
                   : kind == 1 ? (double)(*seed >> 8)
                   : kind == 2 ? (double)i
                               : -(double)i;
    }
}

TEST(picks_and_medians_are_what_sorting_would_give)
{
    uint32_t seed = 7;

    for (size_t count = 1; count <= MOST; count++)
        for (uint32_t kind = 0; kind < KINDS; kind++) {
            double value[MOST], sorted[MOST], work[MOST];

            draw(value, count, kind, &seed);
            memcpy(sorted, value, sizeof sorted);
            qsort(sorted, count, sizeof *sorted, ascending);
            memcpy(work, value, sizeof work);
            CHECK_NEAR(gsn_median(work, count), 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]),
                       0);
            memcpy(work, value, sizeof work);
            gsn_sort(work, count);
            CHECK(memcmp(work, sorted, count * sizeof *work) == 0);
            for (size_t rank = 0; rank < count; rank += 1 + count / 9) {
                memcpy(work, value, sizeof work);
                CHECK_NEAR(gsn_order_pick(work, count, rank), sorted[rank], 0);
                for (size_t i = 0; i < count; i++)
                    CHECK(i < rank ? work[i] <= sorted[rank] : work[i] >= sorted[rank]);
            }
        }
}

/* Half of the values may lie anywhere. */
TEST(a_median_does_not_follow_strays)
{
    double value[101];

    for (size_t i = 0; i < 101; i++)
        value[i] = i < 50 ? 1e9 * (double)(i + 1) : (double)i / 100;
    CHECK_NEAR(gsn_median(value, 101), 1.0, 0);
}
