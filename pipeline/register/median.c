/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/median.h"

#include <assert.h>
#include <stdlib.h>

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

double gsn_median(double *value, size_t count)
{
    assert(value && count > 0);

    qsort(value, count, sizeof *value, ascending);
    return 0.5 * (value[(count - 1) / 2] + value[count / 2]);
}
