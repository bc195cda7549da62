/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The smallest items of a search in ascending order: an insertion sort in a fixed array, from which
 * the greatest falls out when it is full; the least that ever fell out is where the next search
 * begins. Cost: a search for every 512 items. */
#include "pipeline/model/sorted_batch.h"

void gsn_sorted_batch_begin(struct gsn_sorted_batch *ascent)
{
    ascent->from = 0;
    ascent->limit = UINT32_MAX;
    ascent->count = 0;
}

int gsn_sorted_batch_add(void *context, uint32_t item)
{
    struct gsn_sorted_batch *ascent = context;
    size_t at;

    if (item < ascent->from || item >= ascent->limit)
        return 0;
    if (ascent->count == GSN_SORTED_BATCH_ROOM) {
        /* The greatest waits for the next search. */
        const uint32_t last = ascent->item[ascent->count - 1];

        ascent->limit = item > last ? item : last;
        if (item > last)
            return 0;
        ascent->count--;
    }
    for (at = ascent->count++; at > 0 && ascent->item[at - 1] > item; at--)
        ascent->item[at] = ascent->item[at - 1];
    ascent->item[at] = item;
    return 0;
}

int gsn_sorted_batch_next(struct gsn_sorted_batch *ascent)
{
    if (ascent->limit == UINT32_MAX)
        return 0;
    ascent->from = ascent->limit;
    ascent->limit = UINT32_MAX;
    ascent->count = 0;
    return 1;
}
