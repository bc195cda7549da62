/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Keeps the queue worked: starts gieson-work, one process a job, never more at once than allowed,
 * each under limits of memory, processor and time.
 *
 * One that outlives its time is killed and its job fails with a sentence; one that dies leaves a
 * job that the next one redoes; one that is stopped with the service gives its job back. */
#ifndef GSN_SYSTEMD_SERVICE_QUEUE_RUNNER_H
#define GSN_SYSTEMD_SERVICE_QUEUE_RUNNER_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "storage/store.h"
#include "systemd/service/config.h"

#include <systemd/sd-event.h>

struct gsn_queue_runner;

/* keeps: loop and store. gives. Fails with GSN_E_NOTFOUND when gieson-work is not there. */
int gsn_queue_runner_new(sd_event *loop, struct gsn_store *store,
                         struct gsn_queue_runner **ret_runner, struct gsn_error *err);
/* Kills what is left. */
void gsn_queue_runner_free(struct gsn_queue_runner *runner);
GSN_DEFINE_AUTO(gsn_queue_runner);

/* For the workers that are started from now on. keeps nothing of config. */
void gsn_queue_runner_set(struct gsn_queue_runner *runner, const struct gsn_config *config);

/* Something changed in the store, or time has passed: starts what there is to start. */
void gsn_queue_runner_look(struct gsn_queue_runner *runner);

/* Ends all workers and starts none again. */
void gsn_queue_runner_stop(struct gsn_queue_runner *runner);

size_t gsn_queue_runner_running(const struct gsn_queue_runner *runner);

/* Whether jobs wait for room on the disk. */
int gsn_queue_runner_is_paused(const struct gsn_queue_runner *runner);

#endif
