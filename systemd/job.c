/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/job.h"

#include "pipeline/core/hash.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "systemd/panel_job.h"
#include "systemd/specimen_job.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

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

static int64_t milliseconds(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void tell(void *context, const char *stage, size_t done, size_t total)
{
    struct teller *teller = context;
    const int64_t now = milliseconds();
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
    const struct gsn_progress progress = { .report = tell, .context = &teller };
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
