/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/queue_order.h"

#include <stdbool.h>
#include <string.h>

#include "pipeline/core/mem.h"

static bool waits_for(const struct gsn_queue_node *a, const struct gsn_queue_node *b)
{
    if (a == b)
        return false;
    return (a->base_specimen && a->base_specimen == b->specimen_id) ||
           (a->base_group && a->base_group == b->group_id);
}

struct walk {
    const struct gsn_queue_node *nodes;
    size_t count;
    size_t *stack;
    bool *ahead, *behind; /* whom the start waits for, through others too; who waits for it */
};

/* Marks in seen what is reached from start. Returns false as soon as it meets a node that is not
 * ready. */
static bool reach(const struct walk *walk, size_t start, bool forward, bool *seen)
{
    size_t depth = 0;

    memset(seen, 0, walk->count * sizeof *seen);
    walk->stack[depth++] = start;
    while (depth > 0) {
        const struct gsn_queue_node *const at = &walk->nodes[walk->stack[--depth]];

        for (size_t i = 0; i < walk->count; i++) {
            const struct gsn_queue_node *const next = &walk->nodes[i];

            if (seen[i] || i == start || !(forward ? waits_for(at, next) : waits_for(next, at)))
                continue;
            if (forward && !next->ready_job)
                return false;
            seen[i] = true;
            walk->stack[depth++] = i;
        }
    }
    return true;
}

static bool may_go(const struct walk *walk, size_t start)
{
    if (!walk->nodes[start].ready_job || !reach(walk, start, true, walk->ahead))
        return false;
    (void)reach(walk, start, false, walk->behind);
    for (size_t i = 0; i < walk->count; i++) {
        if (walk->ahead[i] && !walk->behind[i])
            return false;
    }
    return true;
}

int gsn_queue_next_specimen_job(const struct gsn_queue_node *nodes, size_t count, int64_t *ret_job,
                                struct gsn_error *err)
{
    gsn_auto_mem(size_t) stack = gsn_alloc_array(count, sizeof *stack);
    gsn_auto_mem(bool) seen = gsn_alloc_array(count, 2 * sizeof *seen);
    const struct walk walk = { nodes, count, stack, seen, seen ? seen + count : NULL };
    int64_t job = 0;

    if (!stack || !seen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a queue of %zu specimens", count);
    for (size_t i = 0; i < count; i++) {
        if ((!job || nodes[i].ready_job < job) && may_go(&walk, i))
            job = nodes[i].ready_job;
    }
    *ret_job = job;
    return GSN_OK;
}
