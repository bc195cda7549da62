/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The job that takes a specimen from its rows and objects to its report. */
#ifndef GSN_SYSTEMD_SPECIMEN_JOB_H
#define GSN_SYSTEMD_SPECIMEN_JOB_H

#include "pipeline/core/hash.h"
#include "pipeline/core/progress.h"
#include "pipeline/specimen.h"
#include "storage/audit.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "systemd/job.h"

/* Everything a run rests on, loaded and hashed. Opaque; made by gsn_material_load(). */
struct gsn_material;

/* gives. Of panels of one number that show one glass one is used and the other kept as a spare; of
 * others all are held, with the reason in their rows. decoder: as for gsn_decode_apart(). Fails with GSN_E_NOTFOUND, GSN_E_IO (a damaged object), GSN_E_INPUT (a mask or volume that
 * cannot be read, a panel that an older gieson looked at), GSN_E_NOMEM. keeps: store. */
int gsn_material_load(struct gsn_store *store, int64_t specimen_id, struct gsn_decoder *decoder,
                      struct gsn_material **ret_material, struct gsn_error *err);
void gsn_material_free(struct gsn_material *material);
GSN_DEFINE_AUTO(gsn_material);

/* The key that a run of the specimen would have now; reads no object. Fails as above. */
int gsn_material_key_now(struct gsn_store *store, int64_t specimen_id, struct gsn_digest *ret_key,
                         struct gsn_error *err);

/* borrowed: what the pipeline asks for; SHA-256 of inputs, parameters and version; the inputs as
 * JSON; the hash of this specimen's own inputs alone, without its baseline's. */
const struct gsn_specimen *gsn_material_specimen(const struct gsn_material *material);
const char *gsn_material_key(const struct gsn_material *material);
const char *gsn_material_inputs(const struct gsn_material *material);
const char *gsn_material_own_key(const struct gsn_material *material);

/* Works the specimen of a claimed job, writes its report and ends run and job in one transaction;
 * then asks for the specimens whose baseline this is. Where an older gieson looked at its panels,
 * the job waits again until they were looked at anew. Fails as gsn_specimen_work() does. */
int gsn_specimen_job(struct gsn_store *store, const struct gsn_job_row *job,
                     const struct gsn_job_options *options, const struct gsn_progress *progress,
                     struct gsn_error *err);

/* Tells which rows of a finished run are not those of this result. panels: as the result was made
 * from. */
int gsn_specimen_compare_rows(struct gsn_store *store, int64_t run,
                              const struct gsn_panel_rows *panels,
                              const struct gsn_specimen_result *result, gsn_audit_found *found,
                              void *context, struct gsn_error *err);

#endif
