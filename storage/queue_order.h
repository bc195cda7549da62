/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which specimen job may go next. Private to this folder. */
#ifndef GSN_STORAGE_QUEUE_ORDER_H
#define GSN_STORAGE_QUEUE_ORDER_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

/* A specimen with a waiting or running job. */
struct gsn_queue_node {
    int64_t specimen_id, group_id;
    int64_t ready_job; /* its specimen job, when only that is left and waits; else 0 */
    int64_t base_specimen, base_group; /* what its baseline stands for; 0: nothing */
};

/* The lowest ready job that waits for nobody, or only for such as wait for it in turn, all of them
 * ready: without the second a circle of baselines would stand still for ever. ret_job is 0 when
 * there is none, and then something else is running or runs before. Fails with GSN_E_NOMEM. */
int gsn_queue_next_specimen_job(const struct gsn_queue_node *nodes, size_t count, int64_t *ret_job,
                                struct gsn_error *err);

#endif
