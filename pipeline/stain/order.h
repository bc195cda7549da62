/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Order statistics without sorting everything. */
#ifndef GSN_STAIN_ORDER_H
#define GSN_STAIN_ORDER_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The value that would stand at `rank` (0-based, < count) if the values were sorted. Reorders the
 * values; none may be NaN. */
double gsn_order_pick(double *values, size_t count, size_t rank);

#ifdef __cplusplus
}
#endif
#endif
