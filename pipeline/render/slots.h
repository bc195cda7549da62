/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A hash table from 64-bit hashes to numbers that the caller hands out, for finding again what was
 * met before. Open addressing; the caller compares keys, and items are numbered in the order in
 * which they came, so that results do not depend on the table. */
#ifndef GSN_RENDER_SLOTS_H
#define GSN_RENDER_SLOTS_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_slots {
    uint64_t *hash;
    uint32_t *number;  /* UINT32_MAX: free */
    size_t size, used; /* size is a power of two */
};

/* Whether item number has the key. */
typedef int gsn_slots_same(uint32_t number, const void *key, const void *context);

/* Finds the item with this key, or gives it the number next. *ret_number == next says it is new.
 * Fails with GSN_E_NOMEM. Start with all zero; done releases. */
int gsn_slots_find(struct gsn_slots *slots, uint64_t hash, const void *key, gsn_slots_same *same,
                   const void *context, uint32_t next, uint32_t *ret_number, struct gsn_error *err);
void gsn_slots_done(struct gsn_slots *slots);

/* A well mixed hash of two numbers. */
uint64_t gsn_slots_mix(uint64_t a, uint64_t b);

#ifdef __cplusplus
}
#endif
#endif
