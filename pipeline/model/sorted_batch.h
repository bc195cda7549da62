/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Brings what searches find into ascending order without memory of its own for any number of
 * items: it holds the least ones from `from` on, and when there are more, the search is made again
 * for the next.
 *
 *     struct gsn_sorted_batch ascent;
 *
 *     gsn_sorted_batch_begin(&ascent);
 *     do {
 *         (search, with gsn_sorted_batch_add() for each item found)
 *         (use item[0] .. item[count - 1])
 *     } while (gsn_sorted_batch_next(&ascent));
 */
#ifndef GSN_MODEL_SORTED_BATCH_H
#define GSN_MODEL_SORTED_BATCH_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_SORTED_BATCH_ROOM = 512 };

struct gsn_sorted_batch {
    uint32_t from, limit; /* what it takes: from <= item < limit */
    size_t count;
    uint32_t item[GSN_SORTED_BATCH_ROOM];
};

void gsn_sorted_batch_begin(struct gsn_sorted_batch *ascent);
/* A gsn_bvh_visit; returns 0. An item is added once in a search. */
int gsn_sorted_batch_add(void *ascent, uint32_t item);
/* Empties it for the items after those it had; 0 when there are none. */
int gsn_sorted_batch_next(struct gsn_sorted_batch *ascent);

#ifdef __cplusplus
}
#endif
#endif
