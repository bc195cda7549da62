/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Selection and sorting by GSL (gsl_stats_select: Hoare's quickselect with the middle of three as
 * the pivot, linear in the mean; gsl_sort: heapsort, in place). Which value stands where among
 * equals, and so the order of the rest, follows from the order given alone. */
#include "pipeline/core/robust.h"

#include <assert.h>
#include <math.h>

#include <gsl/gsl_sort.h>
#include <gsl/gsl_statistics_double.h>

double gsn_order_pick(double *value, size_t count, size_t rank)
{
    assert(rank < count);
    return gsl_stats_select(value, 1, count, rank);
}

double gsn_median(double *value, size_t count)
{
    double upper, lower;

    assert(value && count > 0);

    lower = upper = gsn_order_pick(value, count, count / 2);
    if (count % 2 == 0) {
        /* The largest of the first half is the other of the middle two. */
        lower = value[0];
        for (size_t i = 1; i < count / 2; i++)
            lower = fmax(lower, value[i]);
    }
    return 0.5 * (lower + upper);
}

void gsn_sort(double *value, size_t count)
{
    gsl_sort(value, 1, count);
}
