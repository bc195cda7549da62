/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inputs of a specimen's job: its rows, the objects they rest on, its baseline and what
 * operators decided, loaded and hashed into the key of the run. */
#ifndef GSN_SYSTEMD_WORKER_JOB_INPUTS_H
#define GSN_SYSTEMD_WORKER_JOB_INPUTS_H

#include "pipeline/core/hash.h"
#include "pipeline/decode/apart.h"
#include "pipeline/specimen/specimen.h"
#include "storage/result.h"
#include "storage/store.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Everything a run rests on, loaded and hashed. Opaque; made by gsn_job_inputs_load(). */
struct gsn_job_inputs;

/* gives. Of panels of one number that show one glass one is used and the other kept as a spare; of
 * others all are held, with the reason in their rows. decoder: as for gsn_decode_apart(). Fails
 * with GSN_E_NOTFOUND, GSN_E_IO (a damaged object), GSN_E_INPUT (a mask or volume that cannot be
 * read, a panel that an older gieson looked at), GSN_E_NOMEM. keeps: store. */
int gsn_job_inputs_load(struct gsn_store *store, int64_t specimen_id, struct gsn_decoder *decoder,
                        struct gsn_job_inputs **ret_inputs, struct gsn_error *err);
void gsn_job_inputs_free(struct gsn_job_inputs *inputs);
GSN_DEFINE_AUTO(gsn_job_inputs);

/* The key that a run of the specimen would have now; reads no object. Fails as above. */
int gsn_job_inputs_key_now(struct gsn_store *store, int64_t specimen_id, struct gsn_digest *ret_key,
                           struct gsn_error *err);

/* borrowed: what the pipeline asks for; SHA-256 of inputs, parameters and version; the inputs as
 * JSON; the hash of this specimen's own inputs alone, without its baseline's. */
const struct gsn_specimen *gsn_job_inputs_specimen(const struct gsn_job_inputs *inputs);
const char *gsn_job_inputs_key(const struct gsn_job_inputs *inputs);
const char *gsn_job_inputs_json(const struct gsn_job_inputs *inputs);
const char *gsn_job_inputs_own_key(const struct gsn_job_inputs *inputs);

#ifdef __cplusplus
}
#endif
#endif
