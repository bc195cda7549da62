/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/ascent.h"

void gsn_ascent_begin(struct gsn_ascent *ascent)
{
    ascent->from = 0;
    ascent->limit = UINT32_MAX;
    ascent->count = 0;
}

int gsn_ascent_add(void *context, uint32_t item)
{
    struct gsn_ascent *ascent = context;
    size_t at;

    if (item < ascent->from || item >= ascent->limit)
        return 0;
    if (ascent->count == GSN_ASCENT_ROOM) {
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

int gsn_ascent_next(struct gsn_ascent *ascent)
{
    if (ascent->limit == UINT32_MAX)
        return 0;
    ascent->from = ascent->limit;
    ascent->limit = UINT32_MAX;
    ascent->count = 0;
    return 1;
}
