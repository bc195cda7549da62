/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the last run of a specimen left: its report and the files beside it, each held against the
 * hash that was written down of it before anything of it is used. Nothing is changed. */
#ifndef GSN_SYSTEMD_WORKER_KEPT_RUN_H
#define GSN_SYSTEMD_WORKER_KEPT_RUN_H

#include "pipeline/model/model_file.h"
#include "storage/result.h"

#include <jansson.h>

struct gsn_kept_run {
    struct gsn_run_row *run;
    json_t *report; /* as report.json */
};

/* gives: the last run with a report. Fails with GSN_E_NOTFOUND when there is no such specimen or no
 * report yet, GSN_E_INPUT when the report is not what the run wrote, and as the store does. */
int gsn_kept_run_open(struct gsn_store *store, const char *specimen, struct gsn_kept_run **ret_kept,
                      struct gsn_error *err);
void gsn_kept_run_free(struct gsn_kept_run *kept);
GSN_DEFINE_AUTO(gsn_kept_run);

/* gives: the bytes of a file beside the report. Fails with GSN_E_NOTFOUND when the run kept none of
 * that name, saying why and what to do; GSN_E_INPUT when the file is not what the run wrote. */
int gsn_kept_run_file(struct gsn_store *store, const struct gsn_kept_run *kept, const char *name,
                      uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err);

/* gives: the fitted model. Fails as gsn_kept_run_file() and gsn_model_file_read() do. */
int gsn_kept_run_model(struct gsn_store *store, const struct gsn_kept_run *kept,
                       struct gsn_model **ret_model, struct gsn_error *err);

#endif
