/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/order.h"

#include <assert.h>

static void swap(double *a, double *b)
{
    const double kept = *a;

    *a = *b;
    *b = kept;
}

/* Hoare's quickselect; the middle of three as the pivot keeps sorted input fast. */
double gsn_order_pick(double *values, size_t count, size_t rank)
{
    size_t low = 0, high = count - 1;

    assert(rank < count);
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        size_t i = low, j = high;

        if (values[middle] < values[low])
            swap(&values[middle], &values[low]);
        if (values[high] < values[low])
            swap(&values[high], &values[low]);
        if (values[high] < values[middle])
            swap(&values[high], &values[middle]);

        const double pivot = values[middle];

        for (;;) {
            while (values[i] < pivot)
                i++;
            while (values[j] > pivot)
                j--;
            if (i >= j)
                break;
            swap(&values[i++], &values[j--]);
        }
        if (rank <= j)
            high = j;
        else
            low = j + 1;
    }
    return values[rank];
}
