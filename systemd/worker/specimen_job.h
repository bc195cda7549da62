/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The job that takes a specimen from its rows and objects to its report. */
#ifndef GSN_SYSTEMD_WORKER_SPECIMEN_JOB_H
#define GSN_SYSTEMD_WORKER_SPECIMEN_JOB_H

#include "pipeline/core/hash.h"
#include "pipeline/core/progress.h"
#include "pipeline/specimen/specimen.h"
#include "storage/audit.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "systemd/worker/panel_job.h"

/* Works the specimen of a claimed job, writes its report and ends run and job in one transaction;
 * then asks for the specimens whose baseline this is. Where an older gieson looked at its panels,
 * the job waits again until they were looked at anew. Fails as gsn_specimen_process() does. */
int gsn_specimen_job(struct gsn_store *store, const struct gsn_job_row *job,
                     const struct gsn_job_options *options, const struct gsn_progress *progress,
                     struct gsn_error *err);

/* As a row keeps it: the same bytes, or both no number. */
int gsn_same_number(double a, double b);

/* Tells which rows of a finished run are not those of this result. panels: as the result was made
 * from. */
int gsn_specimen_compare_rows(struct gsn_store *store, int64_t run,
                              const struct gsn_panel_rows *panels,
                              const struct gsn_specimen_result *result, gsn_audit_found *found,
                              void *context, struct gsn_error *err);

#endif
