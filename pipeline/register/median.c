/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/median.h"

#include <assert.h>
#include <stdlib.h>

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

/* So few are sorted before qsort() has begun. */
enum { FEW = 64 };

static void insert(double *value, size_t count)
{
    for (size_t i = 1; i < count; i++) {
        const double own = value[i];
        size_t at = i;

        for (; at > 0 && value[at - 1] > own; at--)
            value[at] = value[at - 1];
        value[at] = own;
    }
}

double gsn_median(double *value, size_t count)
{
    assert(value && count > 0);

    if (count <= FEW)
        insert(value, count);
    else
        qsort(value, count, sizeof *value, ascending);
    return 0.5 * (value[(count - 1) / 2] + value[count / 2]);
}
