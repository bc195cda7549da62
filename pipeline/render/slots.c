/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/slots.h"

uint64_t gsn_slots_mix(uint64_t a, uint64_t b)
{
    /* The finaliser of splitmix64. */
    uint64_t h = a * 0x9e3779b97f4a7c15U + b;

    h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9U;
    h = (h ^ (h >> 27)) * 0x94d049bb133111ebU;
    return h ^ (h >> 31);
}

static int grow(struct gsn_slots *slots, struct gsn_error *err)
{
    const size_t size = slots->size ? 2 * slots->size : 1024;
    uint64_t *hash = gsn_alloc_array(size, sizeof *hash);
    uint32_t *number = gsn_alloc_array(size, sizeof *number);

    if (!hash || !number) {
        gsn_free(hash);
        gsn_free(number);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %zu", size);
    }
    for (size_t i = 0; i < size; i++)
        number[i] = UINT32_MAX;
    for (size_t i = 0; i < slots->size; i++) {
        size_t at = slots->hash[i] & (size - 1);

        if (slots->number[i] == UINT32_MAX)
            continue;
        while (number[at] != UINT32_MAX)
            at = (at + 1) & (size - 1);
        number[at] = slots->number[i];
        hash[at] = slots->hash[i];
    }
    gsn_slots_done(slots);
    slots->hash = hash;
    slots->number = number;
    slots->size = size;
    return GSN_OK;
}

int gsn_slots_find(struct gsn_slots *slots, uint64_t hash, const void *key, gsn_slots_same *same,
                   const void *context, uint32_t next, uint32_t *ret_number, struct gsn_error *err)
{
    size_t at;

    if (2 * (slots->used + 1) > slots->size) {
        const int r = grow(slots, err);

        if (r < 0)
            return r;
    }
    for (at = hash & (slots->size - 1); slots->number[at] != UINT32_MAX;
         at = (at + 1) & (slots->size - 1)) {
        if (slots->hash[at] == hash && same(slots->number[at], key, context)) {
            *ret_number = slots->number[at];
            return GSN_OK;
        }
    }
    slots->hash[at] = hash;
    slots->number[at] = next;
    slots->used++;
    *ret_number = next;
    return GSN_OK;
}

void gsn_slots_done(struct gsn_slots *slots)
{
    gsn_free(slots->hash);
    gsn_free(slots->number);
    slots->hash = NULL;
    slots->number = NULL;
    slots->size = 0;
}
