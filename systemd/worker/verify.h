/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A finished run, looked at from the original bytes on: are its report, its figures and everything
 * they rest on what the originals give? */
#ifndef GSN_SYSTEMD_WORKER_VERIFY_H
#define GSN_SYSTEMD_WORKER_VERIFY_H

#include "systemd/worker/audit.h"
#include "systemd/worker/panel_job.h"

struct gsn_verify {
    struct gsn_store *store;
    int64_t run;
    const struct gsn_job_options *options;
    struct gsn_audit_heads *heads; /* where the audit log ended, by others; NULL: nobody knows */
    /* Told of each finding: what is damaged, and the sentence. May be NULL. */
    gsn_audit_found *found;
    void *context;
};

/* What gsn_verify_run() found. */
struct gsn_verdict {
    int64_t run, events;
    size_t findings;          /* 0: everything is as it was */
    int same_inputs;          /* rows, objects, parameters and version are those of the run */
    int same_json, same_html; /* re-made byte for byte */
    int whole_log;
    char was[65], is[65]; /* SHA-256 of report.json then and now */
};

/* Changes nothing. A difference is a finding, not a failure. Fails with GSN_E_NOTFOUND, GSN_E_INPUT
 * for a run that has no report, GSN_E_IO for an original that is damaged, and as the pipeline does;
 * what was found until then has been told. */
int gsn_verify_run(const struct gsn_verify *verify, struct gsn_verdict *ret_verdict,
                   struct gsn_error *err);

#endif
