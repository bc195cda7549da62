/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The job that looks at one panel, and the rows that its findings are. */
#ifndef GSN_SYSTEMD_WORKER_PANEL_JOB_H
#define GSN_SYSTEMD_WORKER_PANEL_JOB_H

#include "pipeline/specimen/candidates.h"
#include "pipeline/core/progress.h"
#include "pipeline/specimen/panel_analysis.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "storage/decision.h"
#include "storage/panel_log.h"
#include "storage/queue.h"

/* What every job is given. */
struct gsn_job_options {
    const char *mesher;  /* path of gieson-mesh */
    const char *decoder; /* path of gieson-decode; NULL: pictures are decoded in this process */
    /* What is missing, where it was looked for and what to do, of a program that is not there;
     * NULL: it is there. */
    const char *lacks_mesher, *lacks_decoder;
    const char *owner; /* who works, for people */
    unsigned threads;  /* 0: all */
};

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

/* A row read back as what gsn_panel_analyse() found. */
struct gsn_panel_section gsn_panel_section_of_row(const struct gsn_section_row *row);

/* Whether it was registered before it was kept how its picture was set upright: then it must be
 * examined again, for its sections may lie on a picture that was turned. */
int gsn_panel_lacks_turn(const struct gsn_panel_row *row);

/* A section's marks, between the pipeline's record and the store's rows. */

void gsn_fiducials_to_rows(const struct gsn_fiducial mark[GSN_FIDUCIALS],
                           struct gsn_fiducial_row ret_rows[GSN_ROW_MARKS]);

/* One that was not found comes back as nothing but that; its contrast is not kept. */
void gsn_fiducials_from_rows(const struct gsn_fiducial_row rows[GSN_ROW_MARKS],
                             struct gsn_fiducial ret_mark[GSN_FIDUCIALS]);

/* The poses that a doubtful section may have, between the pipeline's record and the store's rows.
 */

/* Fills a row for each candidate of the section in this slot (from 1); their number. The rows
 * borrow the list's texts. */
size_t gsn_candidates_to_rows(const struct gsn_candidates *list, int64_t slot,
                              struct gsn_candidate_row ret_rows[GSN_CANDIDATES]);

/* Those of one section, found among all rows of the specimen; none are laid. */
void gsn_candidates_from_rows(const struct gsn_candidate_rows *rows, int64_t panel_id, int64_t slot,
                              struct gsn_candidates *ret_list);

/* What people decided, as the jobs need it. */

/* The number of the pose that an answer chooses, from 1; 0: it chooses none. */
unsigned gsn_decisions_pose(const char *answer);

#endif
