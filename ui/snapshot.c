/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The store at one moment, read in a few queries: specimens, jobs, sources, troubles, scans.
 *
 * Steps. The overview's rows first (storage/result.h), then jobs are put to their specimens, then
 * the state in a word: failed, working, waiting, withheld or reported; the next action is a command
 * where a person can do something. Who serves the store is asked of its lock.
 *
 * How it fails: as the store does; nothing is given then. */
#include "ui/snapshot.h"

#include <math.h>
#include <string.h>

#include "storage/advice.h"
#include "storage/bench.h"
#include "ui/text.h"

/* Takes text, which is NULL when memory ran out. */
static int replace_text(char **old, char *text, struct gsn_error *err)
{
    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    gsn_free(*old);
    *old = text;
    return GSN_OK;
}

static int take_result(struct gsn_store *store, const struct gsn_overview_row *from,
                       struct gsn_snapshot_row *row, struct gsn_error *err)
{
    int r;

    if (!from->report_path[0])
        return GSN_OK;
    row->run = from->run;
    row->state = strcmp(from->run_state, "withheld") == 0 ? "withheld" : "reported";
    r = from->run_message[0] ? replace_text(&row->detail, gsn_strdup(from->run_message), err)
                             : GSN_OK;
    if (r < 0)
        return r;
    return replace_text(&row->report, gsn_format("%s/%s", gsn_store_dir(store), from->report_path),
                        err);
}

static int tell_progress(const struct gsn_overview_job *job, const char *panel,
                         struct gsn_snapshot_row *row, struct gsn_error *err)
{
    const char *between = panel[0] ? ": " : "";

    row->state = "working";
    if (!job->stage[0])
        return replace_text(&row->detail, gsn_format("%s%sstarting", panel, between), err);
    return replace_text(&row->detail,
                        gsn_format("%s%s%s %lld/%lld", panel, between, job->stage,
                                   (long long)job->done, (long long)job->total),
                        err);
}

/* Jobs speak louder than an older result, and failures louder than other jobs. */
static int take_job(const struct gsn_overview_job *job, const char *panel,
                    struct gsn_snapshot_row *row, struct gsn_error *err)
{
    if (strcmp(row->state, "failed") == 0)
        return GSN_OK;
    if (strcmp(job->state, "failed") == 0) {
        row->state = "failed";
        return replace_text(&row->detail, gsn_strdup(job->message), err);
    }
    if (strcmp(job->state, "running") == 0)
        return tell_progress(job, panel, row, err);
    if (strcmp(job->state, "waiting") == 0 && strcmp(row->state, "working") != 0) {
        row->state = "waiting";
        gsn_free(row->detail);
        row->detail = NULL;
    }
    return GSN_OK;
}

/* What waits is worked by itself where somebody works the queue. */
static int advise_action(const struct gsn_snapshot *snapshot, int has_work,
                         struct gsn_snapshot_row *row, struct gsn_error *err)
{
    gsn_auto_mem(char) name = gsn_advice_word(row->name);
    const char *verb = NULL;

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (strcmp(row->state, "waiting") == 0 && !has_work && row->panels == 0)
        return replace_text(&row->detail, gsn_strdup("no panel yet"), err);
    if (strcmp(row->state, "waiting") == 0)
        return has_work && !snapshot->queue
                   ? replace_text(&row->action, gsn_strdup("gieson run"), err)
                   : GSN_OK;
    if (strcmp(row->state, "failed") == 0)
        verb = "retry";
    else if (row->panels_refused > 0 || strcmp(row->state, "withheld") == 0)
        verb = "show";
    else if (row->run)
        verb = "report";
    return verb ? replace_text(&row->action, gsn_format("gieson %s %s", verb, name), err) : GSN_OK;
}

static int take_words(const struct gsn_overview_row *from, struct gsn_snapshot_row *row,
                      struct gsn_error *err)
{
    const struct gsn_overview_job *job = &from->job;
    int r = replace_text(&row->name, gsn_strdup(from->name), err);

    if (r >= 0)
        r = replace_text(&row->group, gsn_strdup(from->group), err);
    if (r >= 0 && strcmp(job->state, "running") == 0)
        r = replace_text(&row->progress,
                         gsn_look_progress(job->stage, job->done, job->total, job->eta_s), err);
    return r;
}

static void take_counts(const struct gsn_overview_row *from, struct gsn_snapshot_row *row)
{
    row->id = from->id;
    row->state = "waiting";
    row->panels = (unsigned)from->panels;
    row->panels_registered = (unsigned)from->registered;
    row->panels_refused = (unsigned)from->refused;
    row->sections = (unsigned)from->sections;
    row->sections_found = (unsigned)from->found;
    row->loss_percent = from->loss;
    row->loss_lower = from->loss_lower;
    row->loss_upper = from->loss_upper;
    row->mean_density = from->mean_density;
    row->changed = from->changed;
}

/* *panel goes on to the first panel that is not this specimen's. */
static int take_row(struct gsn_store *store, const struct gsn_snapshot *snapshot,
                    const struct gsn_overview_row *from, size_t *panel,
                    struct gsn_snapshot_row *row, struct gsn_error *err)
{
    const struct gsn_open_panel_rows *panels = snapshot->panels;
    int has_work = from->job.state[0] != '\0';
    int r;

    take_counts(from, row);
    r = take_words(from, row, err);
    if (r >= 0)
        r = take_result(store, from, row, err);
    for (; r >= 0 && *panel < panels->count && panels->at[*panel].specimen_id == from->id;
         ++*panel) {
        has_work |= panels->at[*panel].job.state[0] != '\0';
        r = take_job(&panels->at[*panel].job, panels->at[*panel].file_name, row, err);
    }
    if (r >= 0)
        r = take_job(&from->job, "", row, err);
    return r >= 0 ? advise_action(snapshot, has_work, row, err) : r;
}

/* A lock that we may not read says nothing, and is no reason to show nothing. */
static int ask_service(const char *dir, enum gsn_service service, int *ret_there,
                       struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };
    const int r = gsn_service_is_there(dir, service, ret_there, &quiet);

    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", quiet.text) : GSN_OK;
}

int gsn_snapshot_services(const char *dir, int *ret_intake, int *ret_queue, struct gsn_error *err)
{
    int intake = 0, queue = 0;
    int r = ask_service(dir, GSN_SERVICE_INTAKE, &intake, err);

    if (r >= 0)
        r = ask_service(dir, GSN_SERVICE_QUEUE, &queue, err);
    if (r < 0)
        return r;
    *ret_intake = intake;
    *ret_queue = queue;
    return GSN_OK;
}

static int take_bench(struct gsn_store *store, struct gsn_snapshot *snapshot, struct gsn_error *err)
{
    const char *dir = gsn_store_dir(store);
    int r = gsn_bench_list(store, &snapshot->sources, err);

    if (r >= 0)
        r = gsn_trouble_list(store, &snapshot->troubles, err);
    if (r >= 0)
        r = gsn_scan_list(store, "unfiled", 0, &snapshot->unfiled, err);
    if (r >= 0)
        r = gsn_scan_count_staged(store, &snapshot->unsettled, err);
    if (r >= 0)
        r = gsn_overview_panels(store, &snapshot->panels, err);
    if (r >= 0)
        r = gsn_overview_doubts(store, &snapshot->doubts, err);
    if (r >= 0)
        r = gsn_queue_counts(store, &snapshot->jobs, err);
    return r >= 0 ? gsn_snapshot_services(dir, &snapshot->intake, &snapshot->queue, err) : r;
}

int gsn_snapshot_take(struct gsn_store *store, struct gsn_snapshot **ret_snapshot,
                      struct gsn_error *err)
{
    gsn_auto(gsn_snapshot) snapshot = gsn_alloc_array(1, sizeof *snapshot);
    gsn_auto(gsn_overview_rows) specimens = NULL;
    size_t panel = 0;
    int r = snapshot ? gsn_overview_list(store, &specimens, err)
                     : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = take_bench(store, snapshot, err);
    if (r < 0)
        return r;
    snapshot->at = gsn_alloc_array(specimens->count, sizeof *snapshot->at);
    if (!snapshot->at)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    for (size_t i = 0; i < specimens->count; i++) {
        snapshot->count = i + 1;
        /* A specimen may have appeared between the two questions. */
        while (panel < snapshot->panels->count &&
               snapshot->panels->at[panel].specimen_id < specimens->at[i].id)
            panel++;
        r = take_row(store, snapshot, &specimens->at[i], &panel, &snapshot->at[i], err);
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
        gsn_free(snapshot->at[i].progress);
        gsn_free(snapshot->at[i].action);
        gsn_free(snapshot->at[i].report);
    }
    gsn_free(snapshot->at);
    gsn_open_panel_rows_free(snapshot->panels);
    gsn_doubt_rows_free(snapshot->doubts);
    gsn_bench_sources_free(snapshot->sources);
    gsn_trouble_rows_free(snapshot->troubles);
    gsn_scan_rows_free(snapshot->unfiled);
    gsn_free(snapshot);
}

char *gsn_snapshot_file_command(int64_t scan, const char *specimen)
{
    gsn_auto_mem(char) name = specimen ? gsn_advice_word(specimen) : gsn_strdup("SPECIMEN");

    return name ? gsn_format("gieson file %lld %s --panel N", (long long)scan, name) : NULL;
}
