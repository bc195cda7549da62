/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The searches behind gsn_sequence_examine() and gsn_sequence_examine_excluded(): swapped sections
 * (swap.c) and sections that were mounted twice (duplicate.c). */
#ifndef GSN_REGISTER_ORDER_FINDINGS_H
#define GSN_REGISTER_ORDER_FINDINGS_H

#include "pipeline/register/order/sequence.h"

#ifdef __cplusplus
extern "C" {
#endif

/* All three add to what was found, in no order. Fails with GSN_E_NOMEM. */
int gsn_sequence_find_duplicates(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                                 size_t rows, struct gsn_sequence *found, struct gsn_error *err);
/* Two mounts of which one is not registered, or both are not: held_count > 0 of them. Fails with
 * GSN_E_NOMEM. */
int gsn_sequence_find_excluded(const struct gsn_sequence_plane *planes, size_t count,
                               size_t columns, size_t rows,
                               const struct gsn_sequence_excluded *held, size_t held_count,
                               struct gsn_sequence *sequence, struct gsn_error *err);
/* out: n; planes for which it is 1 are in no swap, and those of the swaps found become 1. Fails
 * with GSN_E_NOMEM. */
int gsn_sequence_find_swaps(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                            size_t rows, char *out, struct gsn_sequence *found,
                            struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
