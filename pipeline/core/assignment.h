/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The assignment problem: a column of its own for each row, at the least total cost. */
#ifndef GSN_CORE_ASSIGNMENT_H
#define GSN_CORE_ASSIGNMENT_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Gives each of count rows a column of its own such that the costs sum to the least (Kuhn's
 * Hungarian method by shortest augmenting paths, count^2 x columns steps). cost: count x columns,
 * finite. The caller guarantees columns >= count. ret_column: one for each row. Fails with
 * GSN_E_NOMEM. */
int gsn_assign(const double *cost, size_t count, size_t columns, int *ret_column,
               struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
