/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One job of the queue, from claim to commit: rows and objects go into the pipeline, its results
 * come back as rows and files. A worker that dies anywhere leaves a job that another one redoes. */
#ifndef GSN_SYSTEMD_WORKER_JOB_H
#define GSN_SYSTEMD_WORKER_JOB_H

#include "storage/store.h"
#include "systemd/worker/panel_job.h"

#include <stdint.h>

/* Claims the next job and does it. A job whose inputs are bad is done with a refusal in its rows:
 * that is success here. One that needs a program that is not there fails at once with that
 * sentence, and the next job is not kept waiting by it. Fails with GSN_E_NOTFOUND (the queue is
 * empty), GSN_E_BUSY (only running jobs are left, or this one was taken away), and otherwise with
 * what made the job itself fail, which its row says too. */
int gsn_job_next(struct gsn_store *store, const struct gsn_job_options *options,
                 struct gsn_error *err);

/* Whether the programs are there that a job needs. Asked before the work begins: a specimen would
 * come to its mesher after hours. */
int gsn_job_check_programs(const struct gsn_job_options *options, int meshes,
                           struct gsn_error *err);

/* Which specimens changed since their last report: other panels, other settings, another baseline,
 * another version. */

/* Asks for the job of every specimen whose key (gsn_job_inputs_key()) is not that of its last
 * report. Those that wait, run or failed are left as they are: what failed would fail again as long
 * as nobody changed anything, and who changes something asks for the job. ret_count: how many were
 * asked for. A specimen whose job text cannot be read is left to its own job to say so. */
int gsn_job_ask_changed(struct gsn_store *store, size_t *ret_count, struct gsn_error *err);

#endif
