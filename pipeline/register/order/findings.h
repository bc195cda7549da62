/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The searches behind gsn_sequence_examine(): swapped sections (swap.c), sections that were mounted
 * twice (duplicate.c), and what remains of both where they touch (sequence.c). */
#ifndef GSN_REGISTER_ORDER_FINDINGS_H
#define GSN_REGISTER_ORDER_FINDINGS_H

#include "pipeline/register/order/align.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Swaps, duplicates, those of which one is held; the surest first within each kind. */
void gsn_sequence_sort(struct gsn_sequence *sequence);

/* Fails with GSN_E_NOMEM. */
int gsn_sequence_find_duplicates(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                                 size_t rows, struct gsn_sequence *found, struct gsn_error *err);
/* Of the stack's tissue; sections that are out are in no swap. Fails with GSN_E_NOMEM. */
int gsn_sequence_find_swaps(struct gsn_sequence_tissue *tissue,
                            const struct gsn_sequence_plane *planes, const char *out,
                            struct gsn_sequence *found, struct gsn_error *err);

/* Of every section that was found there twice the first mount, or the second. */
void gsn_sequence_leave_out(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found, int second, char *ret_out, size_t n);
/* Whether both mounts of every such section lie side by side, and in none of the swaps found with
 * one of them left out. Else either may be the one that lies wrong. */
int gsn_sequence_is_settled(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found);
/* Of the swaps found with the one mount and those with the other left out those stand that bring
 * the two together, and those found both ways that do not part them. room: of as many findings as
 * both have. */
void gsn_sequence_agree(const struct gsn_sequence_plane *planes, const struct gsn_sequence *other,
                        struct gsn_sequence *found, char *room);

#ifdef __cplusplus
}
#endif
#endif
