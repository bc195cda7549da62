/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The baseline of a specimen's job: the mean over its controls, region by region, and what the runs
 * of a control keep for those that compare with it. */
#ifndef GSN_SYSTEMD_WORKER_BASELINE_H
#define GSN_SYSTEMD_WORKER_BASELINE_H

#include "pipeline/specimen/specimen.h"
#include "storage/catalog.h"
#include "storage/store.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What is taken of the controls. Opaque; made by gsn_baseline_load(). */
struct gsn_baseline;

struct json_t; /* jansson's */

/* gives. Of a row that names no baseline, or one that nobody has been given yet: nothing in it.
 * Fails with GSN_E_IO, GSN_E_NOMEM. keeps: row, protocol. */
int gsn_baseline_load(struct gsn_store *store, const struct gsn_specimen_row *row,
                      const struct gsn_protocol *protocol, struct gsn_baseline **ret_baseline,
                      struct gsn_error *err);
void gsn_baseline_free(struct gsn_baseline *baseline);
GSN_DEFINE_AUTO(gsn_baseline);

/* Reads the models of the main region's controls; one that is not at hand leaves its reason. Fails
 * with GSN_E_IO, GSN_E_NOMEM. */
int gsn_baseline_take_models(struct gsn_baseline *baseline, struct gsn_store *store,
                             struct gsn_error *err);

/* borrowed. region 0: the main one; 1 and on: the named ones, in the protocol's order. */
const struct gsn_specimen_baseline *gsn_baseline_of_region(const struct gsn_baseline *baseline,
                                                           size_t region);

/* borrowed: an array of the hashes of the controls' own inputs, which the run's key rests on. */
struct json_t *gsn_baseline_keys(const struct gsn_baseline *baseline);

/* What the figures of a run mean, kept beside them as JSON for the runs that compare with it later.
 * gives; NULL: out of memory. */
char *gsn_run_parameters(const char *own_key, const struct gsn_specimen_result *result);

#ifdef __cplusplus
}
#endif
#endif
