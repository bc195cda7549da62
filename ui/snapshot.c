/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/snapshot.h"

#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/result.h"
#include "ui/text.h"

#include <math.h>
#include <string.h>

/* Takes text, which is NULL when memory ran out. */
static int replace(char **old, char *text, struct gsn_error *err)
{
    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    gsn_free(*old);
    *old = text;
    return GSN_OK;
}

static int count_panels(struct gsn_store *store, int64_t specimen, struct gsn_snapshot_row *row,
                        struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    const int r = gsn_panel_list(store, specimen, &panels, err);

    for (size_t i = 0; r >= 0 && i < panels->count; i++) {
        row->panels++;
        row->panels_registered += strcmp(panels->at[i].state, "registered") == 0;
        row->panels_refused +=
            strcmp(panels->at[i].state, "refused") == 0 || strcmp(panels->at[i].state, "held") == 0;
    }
    return r;
}

static int count_sections(struct gsn_store *store, int64_t specimen, struct gsn_snapshot_row *row,
                          struct gsn_error *err)
{
    gsn_auto(gsn_section_rows) sections = NULL;
    const int r = gsn_section_list(store, specimen, &sections, err);

    for (size_t i = 0; r >= 0 && i < sections->count; i++) {
        row->sections += strcmp(sections->at[i].state, "empty") != 0;
        row->sections_found += strcmp(sections->at[i].state, "found") == 0;
    }
    return r;
}

static int take_result(struct gsn_store *store, int64_t specimen, struct gsn_snapshot_row *row,
                       struct gsn_error *err)
{
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) measures = NULL;
    struct gsn_error quiet = { 0 };
    int r = gsn_run_latest(store, specimen, NULL, &run, &quiet);

    row->loss_percent = row->mean_density = NAN;
    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r >= 0)
        r = gsn_measure_list(store, run->id, &measures, &quiet);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    for (size_t i = 0; i < measures->count; i++) {
        if (strcmp(measures->at[i].name, "loss") == 0)
            row->loss_percent = measures->at[i].value;
        if (strcmp(measures->at[i].name, "mean_density") == 0)
            row->mean_density = measures->at[i].value;
    }
    if (!run->report_path[0])
        return GSN_OK;
    row->run = run->id;
    row->state = strcmp(run->state, "withheld") == 0 ? "withheld" : "reported";
    r = run->message[0] ? replace(&row->detail, gsn_strdup(run->message), err) : GSN_OK;
    if (r < 0)
        return r;
    return replace(&row->report, gsn_format("%s/%s", gsn_store_dir(store), run->report_path), err);
}

static int tell_progress(const struct gsn_job_row *job, struct gsn_snapshot_row *row,
                         struct gsn_error *err)
{
    const char *who = job->panel, *between = job->panel[0] ? ": " : "";

    row->state = "working";
    if (!job->stage[0])
        return replace(&row->detail, gsn_format("%s%sstarting", who, between), err);
    return replace(&row->detail,
                   gsn_format("%s%s%s %lld/%lld", who, between, job->stage, (long long)job->done,
                              (long long)job->total),
                   err);
}

/* Jobs speak louder than an older result, and failures louder than other jobs. */
static int take_jobs(const struct gsn_job_rows *jobs, int64_t specimen,
                     struct gsn_snapshot_row *row, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < jobs->count; i++) {
        const struct gsn_job_row *job = &jobs->at[i];

        if (job->specimen_id != specimen || strcmp(row->state, "failed") == 0)
            continue;
        if (strcmp(job->state, "failed") == 0) {
            row->state = "failed";
            r = replace(&row->detail, gsn_strdup(job->message), err);
        } else if (strcmp(job->state, "running") == 0) {
            r = tell_progress(job, row, err);
        } else if (strcmp(job->state, "waiting") == 0 && strcmp(row->state, "working") != 0) {
            row->state = "waiting";
            gsn_free(row->detail);
            row->detail = NULL;
        }
    }
    return r;
}

static int advise(struct gsn_snapshot_row *row, struct gsn_error *err)
{
    gsn_auto_mem(char) name = gsn_text_word(row->name);
    const char *verb = NULL;

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (strcmp(row->state, "waiting") == 0)
        return replace(&row->action, gsn_strdup("gieson run"), err);
    if (strcmp(row->state, "failed") == 0)
        verb = "retry";
    else if (row->panels_refused > 0 || strcmp(row->state, "withheld") == 0)
        verb = "show";
    else if (row->run)
        verb = "report";
    return verb ? replace(&row->action, gsn_format("gieson %s %s", verb, name), err) : GSN_OK;
}

static int take_row(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                    const struct gsn_job_rows *jobs, struct gsn_snapshot_row *row,
                    struct gsn_error *err)
{
    int r;

    row->state = "waiting";
    row->name = gsn_strdup(specimen->name);
    row->group = gsn_strdup(specimen->group);
    if (!row->name || !row->group)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = count_panels(store, specimen->id, row, err);
    if (r >= 0)
        r = count_sections(store, specimen->id, row, err);
    if (r >= 0)
        r = take_result(store, specimen->id, row, err);
    if (r >= 0)
        r = take_jobs(jobs, specimen->id, row, err);
    return r >= 0 ? advise(row, err) : r;
}

int gsn_snapshot_take(struct gsn_store *store, struct gsn_snapshot **ret_snapshot,
                      struct gsn_error *err)
{
    gsn_auto(gsn_snapshot) snapshot = gsn_alloc_array(1, sizeof *snapshot);
    gsn_auto(gsn_specimen_rows) specimens = NULL;
    gsn_auto(gsn_job_rows) jobs = NULL;
    int r = snapshot ? gsn_specimen_list(store, &specimens, err)
                     : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = gsn_queue_list(store, &jobs, err);
    if (r >= 0)
        r = gsn_queue_counts(store, &snapshot->jobs, err);
    if (r < 0)
        return r;
    snapshot->at = gsn_alloc_array(specimens->count, sizeof *snapshot->at);
    if (!snapshot->at)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    for (size_t i = 0; i < specimens->count; i++) {
        snapshot->count = i + 1;
        r = take_row(store, &specimens->at[i], jobs, &snapshot->at[i], err);
        if (r < 0)
            return r;
    }
    *ret_snapshot = gsn_steal(&snapshot);
    return GSN_OK;
}

void gsn_snapshot_free(struct gsn_snapshot *snapshot)
{
    if (!snapshot)
        return;
    for (size_t i = 0; i < snapshot->count; i++) {
        gsn_free(snapshot->at[i].name);
        gsn_free(snapshot->at[i].group);
        gsn_free(snapshot->at[i].detail);
        gsn_free(snapshot->at[i].action);
        gsn_free(snapshot->at[i].report);
    }
    gsn_free(snapshot->at);
    gsn_free(snapshot);
}
