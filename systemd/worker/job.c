/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One job of the queue from claim to end, and the specimens that need a new one.
 *
 * Steps. Claim under a lease; look whether the programs are there that it needs; run the panel's or
 * specimen's job with a progress that goes into the row twice a second at most, with an estimate of
 * the end; a failure ends the job with its sentence. At night: a specimen whose key (job_inputs.h)
 * is not that of its last report is asked for; those that wait, run or failed are left as they are.
 *
 * How it fails: GSN_E_NOTFOUND for an empty queue, GSN_E_BUSY while others work; a worker that dies
 * leaves a lease that the next claim finds dead. */
#include "systemd/worker/job.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/calendar.h"
#include "pipeline/core/hash.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "systemd/worker/job_inputs.h"
#include "systemd/worker/panel_job.h"
#include "systemd/worker/specimen_job.h"

enum {
    LEASE_S = 600,       /* a stage that says nothing for so long has hung */
    TELL_EVERY_MS = 400, /* rows are for eyes, not for profiling */
};

/* Progress as rows, not too often. */
struct teller {
    struct gsn_store *store;
    const struct gsn_job_row *job;
    int64_t told_ms, stage_began_ms;
    char stage[48];
};

/* A job. */

static void note_progress(void *context, const char *stage, size_t done, size_t total)
{
    struct teller *teller = context;
    const int64_t now = gsn_now_ms();
    struct gsn_error quiet = { 0 };
    double eta = NAN;

    if (strcmp(stage, teller->stage) != 0) {
        (void)snprintf(teller->stage, sizeof teller->stage, "%s", stage);
        teller->stage_began_ms = now;
    } else if (now - teller->told_ms < TELL_EVERY_MS) {
        return;
    }
    if (done > 0 && total >= done)
        eta = 1e-3 * (double)(now - teller->stage_began_ms) * (double)(total - done) / (double)done;
    teller->told_ms = now;
    /* A job that was taken away is noticed when its end is written; a busy store is no reason to
     * stop working. */
    (void)gsn_queue_progress(teller->store, teller->job, stage, (int64_t)done, (int64_t)total, eta,
                             gsn_queue_clock(), &quiet);
}

int gsn_job_check_programs(const struct gsn_job_options *options, int meshes, struct gsn_error *err)
{
    if (options->lacks_decoder)
        return gsn_fail(err, GSN_E_PROCESS, "%s", options->lacks_decoder);
    if (meshes && options->lacks_mesher)
        return gsn_fail(err, GSN_E_PROCESS, "%s", options->lacks_mesher);
    return GSN_OK;
}

static int do_job(struct gsn_store *store, const struct gsn_job_row *job,
                  const struct gsn_job_options *options, const struct gsn_progress *progress,
                  struct gsn_error *err)
{
    const bool is_panel = strcmp(job->kind, "panel") == 0;
    const int r = gsn_job_check_programs(options, !is_panel, err);

    if (r < 0)
        return r;
    return is_panel ? gsn_panel_job(store, job, options, progress, err)
                    : gsn_specimen_job(store, job, options, progress, err);
}

int gsn_job_next(struct gsn_store *store, const struct gsn_job_options *options,
                 struct gsn_error *err)
{
    gsn_auto(gsn_job_row) job = NULL;
    struct teller teller = { .store = store };
    const struct gsn_progress progress = { .report = note_progress, .context = &teller };
    struct gsn_error why = { 0 };
    int r = gsn_queue_claim(store, options->owner, getpid(), LEASE_S, gsn_queue_clock(), &job, err);

    if (r < 0)
        return r;
    teller.job = job;
    r = do_job(store, job, options, &progress, &why);
    if (r >= 0)
        return GSN_OK;
    if (err)
        *err = why;
    if (r != GSN_E_BUSY) {
        struct gsn_error quiet = { 0 };

        (void)gsn_queue_fail(store, job, r, why.text, &quiet);
    }
    return gsn_fail_at(err, "%s %s%s%s", job->kind, job->specimen, job->panel[0] ? ", " : "",
                       job->panel);
}

/* What changed. */

/* The key of the last run that left a report; untouched when there is none. */
static int last_key(struct gsn_store *store, int64_t specimen, struct gsn_digest *ret_key,
                    struct gsn_error *err)
{
    gsn_auto(gsn_run_rows) runs = NULL;
    const int r = gsn_run_list(store, specimen, &runs, err);

    for (size_t i = 0; r >= 0 && i < runs->count; i++)
        if (runs->at[i].json_path[0])
            (void)snprintf(ret_key->hex, sizeof ret_key->hex, "%s", runs->at[i].key);
    return r;
}

static int has_changed(struct gsn_store *store, int64_t specimen, int *ret_changed,
                       struct gsn_error *err)
{
    struct gsn_digest was = { "" }, is = { "" };
    struct gsn_error quiet = { 0 };
    int r = last_key(store, specimen, &was, err);

    if (r < 0)
        return r;
    r = gsn_job_inputs_key_now(store, specimen, &is, &quiet);
    if (r == GSN_E_NOMEM || r == GSN_E_BUSY || r == GSN_E_STORE)
        return gsn_fail(err, r, "%s", quiet.text);
    *ret_changed = strcmp(was.hex, is.hex) != 0;
    return GSN_OK;
}

int gsn_job_ask_changed(struct gsn_store *store, size_t *ret_count, struct gsn_error *err)
{
    gsn_auto(gsn_overview_rows) specimens = NULL;
    size_t count = 0;
    int r = gsn_overview_list(store, &specimens, err);

    for (size_t i = 0; r >= 0 && i < specimens->count; i++) {
        const struct gsn_overview_row *row = &specimens->at[i];
        int64_t job;
        int changed = 0;

        if (row->job.state[0] || (row->run == 0 && row->panels == 0))
            continue;
        r = has_changed(store, row->id, &changed, err);
        if (r >= 0 && changed) {
            r = gsn_queue_add(store, row->id, 0, &job, err);
            count++;
        }
    }
    if (r >= 0)
        *ret_count = count;
    return r;
}
