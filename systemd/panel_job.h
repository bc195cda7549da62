/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The job that looks at one panel, and the rows that its findings are. */
#ifndef GSN_SYSTEMD_PANEL_JOB_H
#define GSN_SYSTEMD_PANEL_JOB_H

#include "pipeline/core/progress.h"
#include "pipeline/examine.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "systemd/job.h"

/* Examines the panel of a claimed job and ends the job in the same transaction as its rows.
 * Fails when the job itself cannot be done (memory, disk, store); a panel that is refused or held
 * is a row, not a failure. */
int gsn_panel_job(struct gsn_store *store, const struct gsn_job_row *job,
                  const struct gsn_job_options *options, const struct gsn_progress *progress,
                  struct gsn_error *err);

/* The same without a job: rows alone, in a transaction of the caller's. For a copy of the store, in
 * which it is to be seen whether the picture still says what the rows say. */
int gsn_panel_look_again(struct gsn_store *store, int64_t specimen_id, int64_t panel_id,
                         const struct gsn_job_options *options, struct gsn_error *err);

/* A row read back as what gsn_panel_examine() found. */
struct gsn_panel_section gsn_panel_section_of_row(const struct gsn_section_row *row);

/* Whether it was registered before it was kept how its picture was set upright: then it must be
 * examined again, for its sections may lie on a picture that was turned. */
int gsn_panel_lacks_turn(const struct gsn_panel_row *row);

/* gives: the bytes of an object, after its hash was compared with its name.
 * Fails with GSN_E_NOTFOUND, GSN_E_INPUT "... is damaged", GSN_E_IO. */
/* gives: a descriptor to close(), of an object whose bytes were just found to have this hash. */
int gsn_object_open(struct gsn_store *store, const char *sha256, int *ret_fd,
                    struct gsn_error *err);
int gsn_object_read(struct gsn_store *store, const char *sha256, uint8_t **ret_bytes,
                    size_t *ret_size, struct gsn_error *err);

/* Refuses what no run of the same job could change: bad bytes, unsupported kinds, limits. */
int gsn_is_refusal(int code);

#endif
