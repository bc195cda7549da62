/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/serve_source.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "acquire/spool.h"
#include "storage/bench.h"
#include "systemd/serving.h"

enum {
    TRY_AGAIN_MS = 2000, /* a disk below its reserve, a store that refuses */
    MOST_STORE_FAILURES = 5,
};

/* Nothing can be taken now: says so, and comes back soon. Too often, and the process is better
 * begun anew. */
static int pause_intake(struct gsn_serving *serving, int code, const struct gsn_error *why)
{
    const bool no_room = code == GSN_E_LIMIT;
    const struct gsn_log_about what = gsn_serving_about(serving, no_room ? GSN_LOG_PAUSED : NULL);

    if (strcmp(serving->row.state, no_room ? "paused" : "failed") != 0)
        gsn_log(no_room ? LOG_WARNING : LOG_ERR, &what, "%s%s",
                no_room ? "paused: " : "nothing can be taken in: ", why->text);
    gsn_source_row_say(&serving->row, no_room ? "paused" : "failed", why->text);
    serving->next_look_ms = gsn_now_ms() + TRY_AGAIN_MS;
    return serving->store_failures > MOST_STORE_FAILURES ? code : GSN_OK;
}

/* The device or the folder does not answer. A folder may be a mount that comes back. */
static int lose_source(struct gsn_serving *serving, int code, const struct gsn_error *why,
                       struct gsn_error *err)
{
    const struct gsn_log_about what = gsn_serving_about(serving, GSN_LOG_AWAY);

    serving->blamed[0] = '\0';
    if (serving->is_device)
        return gsn_fail(err, code == GSN_E_IO ? GSN_E_NOTFOUND : code, "%s", why->text);
    if (strcmp(serving->row.state, "away") != 0)
        gsn_log(LOG_WARNING, &what, "%s", why->text);
    gsn_source_row_say(&serving->row, "away", why->text);
    return GSN_OK;
}

static void note_device(struct gsn_serving *serving)
{
    (void)snprintf(serving->row.device, sizeof serving->row.device, "%s",
                   gsn_source_device(serving->source));
}

/* Looks once and takes what is there. */
static int look(struct gsn_serving *serving, int *ret_ended, struct gsn_error *err)
{
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error why = { 0 };
    int r;

    serving->next_look_ms = gsn_now_ms() + serving->config->sweep_s * 1000;
    r = gsn_source_poll(serving->source, gsn_now_ms(), &events, ret_ended, &why);
    if (r < 0)
        return lose_source(serving, r, &why, err);
    gsn_lifeline_breathe(serving->line, GSN_READY);
    note_device(serving);
    r = gsn_serving_settle_blame(serving, &why);
    if (r >= 0)
        r = gsn_serving_take_all(serving, events, &why);
    if (r >= 0)
        r = gsn_serving_import_all(serving, &why);
    if (r >= 0)
        r = gsn_serving_answer(serving, &why);
    if (r < 0) {
        if (pause_intake(serving, r, &why) < 0)
            return gsn_fail(err, r, "%s", why.text);
        return GSN_OK;
    }
    if (serving->blamed[0])
        serving->next_look_ms = 0; /* is the device still there? */
    else
        gsn_source_row_say(&serving->row, "ready", "");
    if (serving->folders && gsn_specimen_folders_is_busy(serving->folders)) {
        const int64_t soon = gsn_now_ms() + gsn_serving_settle_ms(serving) + 50;

        serving->next_look_ms = serving->next_look_ms < soon ? serving->next_look_ms : soon;
    }
    return GSN_OK;
}

static int serve(struct gsn_serving *serving, struct gsn_error *err)
{
    int ended = 0, r = GSN_OK;

    while (r >= 0 && !gsn_lifeline_is_over(serving->line)) {
        r = look(serving, &ended, err);
        if (r >= 0 && ended && !serving->blamed[0]) {
            gsn_source_row_say(&serving->row, "ready", "everything in it is taken in");
            return GSN_OK;
        }
        if (r >= 0)
            r = gsn_serving_wait(serving, err);
    }
    if (r >= 0)
        gsn_source_row_say(&serving->row, "off", "the service was stopped");
    return r;
}

static int open_folders(struct gsn_serving *serving, struct gsn_error *err)
{
    const char *const address = serving->config->address;

    if (strncmp(address, GSN_SERVING_HOT, strlen(GSN_SERVING_HOT)) != 0)
        return GSN_OK;
    serving->ear = (struct gsn_specimen_ear){ .barred = gsn_serving_bar,
                                              .over = gsn_serving_unbar,
                                              .context = serving };
    return gsn_specimen_folders_new(address + strlen(GSN_SERVING_HOT), serving->config->settle_ms,
                                    serving->config->patience_s * 1000, &serving->ear,
                                    &serving->folders, err);
}

static int open_all(struct gsn_serving *serving, uint64_t reserve_bytes, struct gsn_error *err)
{
    const struct gsn_config_source *const config = serving->config;
    __attribute__((cleanup(gsn_intake_past_done))) struct gsn_intake_past past = { { NULL } };
    struct gsn_source_options options = { .settle_ms = config->settle_ms,
                                          .patience_ms = config->patience_s * 1000,
                                          .delete_there = config->delete_after_copy,
                                          .is_known = gsn_intake_is_known,
                                          .on_read = gsn_intake_on_read,
                                          .context = &serving->intake,
                                          .setting_count = config->setting_count,
                                          .setting = config->setting };
    int r = gsn_spool_open(gsn_store_dir(serving->store), reserve_bytes, &serving->spool, err);

    if (r >= 0)
        gsn_spool_watch(serving->spool, gsn_serving_on_piece, serving);
    if (r >= 0)
        r = gsn_failing_load(&serving->failing, err);
    if (r >= 0)
        r = gsn_serving_open_wake(serving, err);
    if (r >= 0)
        r = open_folders(serving, err);
    serving->intake = (struct gsn_intake){ .name = config->name,
                                           .store = serving->store,
                                           .spool = serving->spool,
                                           .delete_there = config->delete_after_copy,
                                           .patience_s = config->patience_s,
                                           .on_copy = gsn_serving_on_copy,
                                           .context = serving };
    if (r >= 0)
        r = gsn_intake_recall(serving->store, config->name, &past, &options, err);
    if (r >= 0)
        r = gsn_source_open(config->address, &options, &serving->source, err);
    serving->intake.source = serving->source;
    return r;
}

static void serving_done(struct gsn_serving *serving)
{
    gsn_source_free(serving->source);
    gsn_specimen_folders_free(serving->folders);
    gsn_failing_done(&serving->failing);
    gsn_intake_done(&serving->intake);
    gsn_spool_free(serving->spool);
    if (serving->changes >= 0)
        (void)close(serving->changes);
    if (serving->wake >= 0)
        (void)close(serving->wake);
}

/* Says in the row why the source is not served; and in the log, unless an earlier process has said
 * the same. */
static void say_why_not(struct gsn_serving *serving, int code, const char *why)
{
    const bool is_away = code == GSN_E_NOTFOUND;
    const struct gsn_log_about what = gsn_serving_about(serving, GSN_LOG_AWAY);
    gsn_auto(gsn_bench_sources) rows = NULL;
    struct gsn_error quiet = { 0 };
    bool is_said = false;

    if (is_away && gsn_bench_list(serving->store, &rows, &quiet) >= 0)
        for (size_t i = 0; i < rows->count; i++)
            is_said = is_said || (strcmp(rows->at[i].name, serving->config->name) == 0 &&
                                  strcmp(rows->at[i].state, "away") == 0 &&
                                  strcmp(rows->at[i].message, why) == 0);
    if (is_away && !is_said)
        gsn_log(LOG_NOTICE, &what, "%s", why);
    gsn_source_row_say(&serving->row, is_away ? "away" : "failed", why);
}

int gsn_serve_source(struct gsn_store *store, const struct gsn_config *config,
                     const struct gsn_config_source *source, struct gsn_lifeline *line,
                     struct gsn_error *err)
{
    __attribute__((cleanup(serving_done))) struct gsn_serving serving = {
        .store = store,
        .config = source,
        .line = line,
        .failing = { .store = store, .source = source->name },
        .row = { .store = store, .name = source->name, .address = source->address },
        .is_device = gsn_source_subsystem(source->address) != NULL,
        .wake = -1,
        .changes = -1,
    };
    int r = open_all(&serving, config->reserve_bytes, err);

    if (r >= 0)
        r = serve(&serving, err);
    if (r < 0)
        say_why_not(&serving, r, err->text);
    return r;
}
