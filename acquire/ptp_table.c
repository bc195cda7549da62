/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_table.h"

#include "acquire/ptp_table_parts.h"

enum {
    EMPTY_MS = 5 * 1000, /* an object that is empty for so long may have been measured too early */
    MOST_DOUBTS = 16,
};

void gsn_ptp_table_done(struct gsn_ptp_table *table)
{
    for (size_t i = 0; i < table->count; i++)
        gsn_ptp_object_free_texts(&table->at[i]);
    gsn_free(table->at);
    table->at = NULL;
    table->count = table->room = 0;
}

struct gsn_ptp_object *gsn_ptp_table_find(struct gsn_ptp_table *table, uint64_t item)
{
    for (size_t i = 0; i < table->count; i++) {
        if (table->at[i].item == item && table->at[i].state == GSN_PTP_READY && !table->at[i].gone)
            return &table->at[i];
    }
    return NULL;
}

size_t gsn_ptp_table_place(const struct gsn_ptp_table *table, unsigned session, uint32_t handle,
                           bool *ret_found)
{
    size_t low = 0, high = table->count;

    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        const struct gsn_ptp_object *const there = &table->at[middle];

        if (there->session < session || (there->session == session && there->handle < handle))
            low = middle + 1;
        else
            high = middle;
    }
    *ret_found =
        low < table->count && table->at[low].session == session && table->at[low].handle == handle;
    return low;
}

struct gsn_ptp_object *gsn_ptp_table_handle(struct gsn_ptp_table *table, unsigned session,
                                            uint32_t handle)
{
    bool found;
    const size_t place = gsn_ptp_table_place(table, session, handle, &found);

    return found ? &table->at[place] : NULL;
}

/* It is empty, for twice as long as when it was doubted last. */
static bool is_long_empty(const struct gsn_ptp_object *object, int64_t now_ms)
{
    return object->state == GSN_PTP_WAITING && object->name && object->size == 0 &&
           object->doubts < MOST_DOUBTS &&
           now_ms - object->since_ms >= (int64_t)EMPTY_MS << object->doubts;
}

bool gsn_ptp_table_doubt(struct gsn_ptp_table *table, int64_t now_ms)
{
    bool any = false;

    for (size_t i = 0; i < table->count; i++) {
        struct gsn_ptp_object *const object = &table->at[i];

        if (!object->key || !object->key[0] || object->gone)
            continue;
        if (is_long_empty(object, now_ms)) {
            object->doubtful = true;
            object->doubts++;
        }
        any |= object->doubtful &&
               (object->state == GSN_PTP_READY || object->state == GSN_PTP_WAITING);
    }
    return any;
}

void gsn_ptp_table_sweep(struct gsn_ptp_table *table)
{
    size_t kept = 0;

    for (size_t i = 0; i < table->count; i++) {
        if (table->at[i].gone)
            gsn_ptp_object_free_texts(&table->at[i]);
        else
            table->at[kept++] = table->at[i];
    }
    table->count = kept;
}
