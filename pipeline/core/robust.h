/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Order statistics: estimates that a few wrong values do not move. */
#ifndef GSN_CORE_ROBUST_H
#define GSN_CORE_ROBUST_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The value that would stand at `rank` (0-based, < count) if the values were sorted. Reorders the
 * values so that none before rank is larger and none behind it smaller; none may be NaN. */
double gsn_order_pick(double *value, size_t count, size_t rank);

/* The median of count > 0 numbers, none of them NaN; the mean of the middle two when even. Reorders
 * them: none of the first half is larger than any of the second. */
double gsn_median(double *value, size_t count);

/* Sorts, the smallest first; none may be NaN. */
void gsn_sort(double *value, size_t count);

#ifdef __cplusplus
}
#endif
#endif
