/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/serving.h"

#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

#include "acquire/folder_source.h"
#include "acquire/spool.h"
#include "pipeline/core/process.h"
#include "storage/bench.h"
#include "storage/catalog.h"
#include "storage/scan.h"
#include "systemd/import_child.h"

struct gsn_log_about gsn_serving_about(const struct gsn_serving *serving, const char *id)
{
    return (struct gsn_log_about){ .id = id, .source = serving->config->name };
}

int64_t gsn_serving_settle_ms(const struct gsn_serving *serving)
{
    const char *const folder = strchr(serving->config->address, ':');

    return serving->is_device || !folder
               ? serving->config->settle_ms
               : gsn_folder_settle_ms(folder + 1, serving->config->settle_ms);
}

int gsn_serving_on_copy(void *context, uint64_t offset)
{
    struct gsn_serving *const serving = context;

    gsn_lifeline_breathe(serving->line, serving->item ? GSN_READY : GSN_BREATH);
    if (serving->item)
        gsn_source_row_progress(&serving->row, serving->item, serving->item_began_ms, offset,
                                serving->item_size);
    return gsn_lifeline_is_over(serving->line);
}

void gsn_serving_on_piece(void *context)
{
    const struct gsn_serving *const serving = context;

    gsn_lifeline_breathe(serving->line, GSN_READY);
}

/* What this round has taken in and not settled. Its names are the round's events'. */
enum { MOST_ARRIVED = 64, SETTLE_EVERY_MS = 500 };

struct arrived {
    size_t count;
    int64_t settled_ms;
    struct {
        int64_t scan;
        const struct gsn_source_event *event;
    } at[MOST_ARRIVED];
};

static void tell_taken(const struct gsn_serving *serving, int64_t id,
                       const struct gsn_source_event *ready)
{
    gsn_auto(gsn_scan_row) scan = NULL;
    struct gsn_log_about what = gsn_serving_about(serving, GSN_LOG_ARRIVED);
    struct gsn_error quiet = { 0 };

    if (gsn_scan_get(serving->store, id, &scan, &quiet) < 0)
        return;
    what.scan = id;
    what.specimen = scan->specimen;
    gsn_log(ready->incomplete ? LOG_WARNING : LOG_INFO, &what, "%s is scan %lld, %s: %s%s%s",
            ready->name, (long long)id, scan->state, scan->reason, ready->incomplete ? "; " : "",
            ready->incomplete ? ready->reason : "");
}

static int settle(struct gsn_serving *serving, struct arrived *arrived, struct gsn_error *err)
{
    const int r = gsn_scan_settle(serving->store, err);

    serving->store_failures += r < 0;
    for (size_t i = 0; r >= 0 && i < arrived->count; i++)
        tell_taken(serving, arrived->at[i].scan, arrived->at[i].event);
    arrived->count = 0;
    arrived->settled_ms = gsn_now_ms();
    return r;
}

/* A picture that comes alone is settled at once, those of a burst together. */
static int note_taken(struct gsn_serving *serving, struct arrived *arrived,
                      const struct gsn_source_event *ready, const struct gsn_intake_taken *taken,
                      struct gsn_error *err)
{
    if (!taken->again) {
        arrived->at[arrived->count].scan = taken->scan;
        arrived->at[arrived->count++].event = ready;
    }
    if (arrived->count < MOST_ARRIVED && gsn_now_ms() - arrived->settled_ms < SETTLE_EVERY_MS)
        return GSN_OK;
    return settle(serving, arrived, err);
}

static int put_trouble(struct gsn_serving *serving, const char *name, const char *reason,
                       const char *action, struct gsn_error *err)
{
    const struct gsn_log_about what = gsn_serving_about(serving, GSN_LOG_TROUBLE);
    int is_new = 0;
    const int r =
        gsn_failing_add(&serving->failing, name, reason, action, gsn_now_ms(), &is_new, err);

    if (is_new)
        gsn_log(LOG_WARNING, &what, "%s could not be taken in: %s", name, reason);
    return r;
}

/* The first device to fail is asked again before the item is blamed: it may be gone. */
static int blame_item(struct gsn_serving *serving, const char *name, const char *reason,
                      struct gsn_error *err)
{
    if (!serving->is_device)
        return put_trouble(serving, name, reason, "look at the file, or copy it again", err);
    (void)snprintf(serving->blamed, sizeof serving->blamed, "%s", name);
    (void)snprintf(serving->blame, sizeof serving->blame, "%s", reason);
    return GSN_OK;
}

int gsn_serving_bar(void *context, const char *name, const char *reason, const char *action,
                    struct gsn_error *err)
{
    struct gsn_serving *const serving = context;

    if (gsn_failing_rests_for(&serving->failing, name, reason, gsn_now_ms()))
        return GSN_OK;
    return put_trouble(serving, name, reason, action, err);
}

int gsn_serving_unbar(void *context, const char *name, struct gsn_error *err)
{
    struct gsn_serving *const serving = context;

    return gsn_failing_over(&serving->failing, name, err);
}

int gsn_serving_settle_blame(struct gsn_serving *serving, struct gsn_error *err)
{
    int r = GSN_OK;

    if (serving->blamed[0])
        r = put_trouble(serving, serving->blamed, serving->blame,
                        "look at the picture on the device; it is tried again by itself", err);
    serving->blamed[0] = '\0';
    return r;
}

static int tell_kept(struct gsn_serving *serving, const char *name, const char *reason,
                     struct gsn_error *err)
{
    const struct gsn_log_about what = gsn_serving_about(serving, GSN_LOG_TROUBLE);
    int is_new = 0;
    const int r =
        gsn_failing_add(&serving->failing, name, reason,
                        "look whether the device has finished it: what changes there comes "
                        "in again by itself; what is whole there is deleted by hand",
                        gsn_now_ms(), &is_new, err);

    if (is_new)
        gsn_log(LOG_WARNING, &what, "%s %s", name, reason);
    return r;
}

#define MAKE_ROOM                                                                                  \
    "take it out of there, or make room on the disk of the store; it is tried again by itself"

/* Takes one. Fails only where nothing more can be taken in this round. */
static int take(struct gsn_serving *serving, const struct gsn_source_event *ready,
                struct arrived *arrived, struct gsn_error *err)
{
    struct gsn_intake_taken taken;
    enum gsn_intake_fault fault;
    struct gsn_error why = { 0 };
    int r;

    serving->item = ready->name;
    serving->item_size = ready->size;
    serving->item_began_ms = gsn_now_ms();
    r = gsn_intake_take(&serving->intake, ready, time(NULL), &taken, &fault, &why);
    serving->item = NULL;
    if (r >= 0) {
        serving->store_failures = 0;
        r = note_taken(serving, arrived, ready, &taken, err);
        if (r < 0)
            return r;
        if (taken.kept[0])
            return tell_kept(serving, ready->name, taken.kept, err);
        return gsn_failing_over(&serving->failing, ready->name, err);
    }
    if (fault == GSN_FAULT_ITEM)
        return blame_item(serving, ready->name, why.text, err);
    if (fault == GSN_FAULT_SIZE)
        return put_trouble(serving, ready->name, why.text, MAKE_ROOM, err);
    if (fault == GSN_FAULT_LATER)
        return GSN_OK;
    serving->store_failures += fault == GSN_FAULT_STORE;
    return gsn_fail(err, fault == GSN_FAULT_ROOM ? GSN_E_LIMIT : r, "%s", why.text);
}

/* What the configuration expects counts while nobody said otherwise. */
static void ensure_expected(struct gsn_serving *serving)
{
    gsn_auto(gsn_bench_sources) rows = NULL;
    const struct gsn_log_about what = gsn_serving_about(serving, NULL);
    struct gsn_error err = { 0 };
    bool is_said = false;

    if (!serving->config->specimen[0] || gsn_bench_list(serving->store, &rows, &err) < 0)
        return;
    for (size_t i = 0; i < rows->count; i++)
        if (strcmp(rows->at[i].name, serving->config->name) == 0 && rows->at[i].expects[0])
            is_said = true;
    if (!is_said && gsn_scan_expect(serving->store, serving->config->name,
                                    serving->config->specimen, "gieson.conf", time(NULL), &err) < 0)
        gsn_log(LOG_WARNING, &what, "Specimen=%s: %s", serving->config->specimen, err.text);
}

/* Folders in a hot folder are looked into, once they say whose panels they hold. */
static bool is_specimen_folder(const struct gsn_serving *serving, const char *name)
{
    gsn_auto_mem(char) path = NULL;
    struct stat st;

    if (!serving->folders)
        return false;
    path = gsn_format("%s/%s", serving->config->address + strlen(GSN_SERVING_HOT), name);
    return path && lstat(path, &st) == 0 && S_ISDIR(st.st_mode);
}

/* What is told without being delivered. Something that still changes is looked at again soon. */
static int tell_news(struct gsn_serving *serving, const struct gsn_source_event *event,
                     struct gsn_error *err)
{
    const struct gsn_log_about what = gsn_serving_about(serving, NULL);
    const int64_t soon = gsn_now_ms() + gsn_serving_settle_ms(serving) + 50;

    if (event->what == GSN_SOURCE_BARRED)
        return gsn_serving_bar(serving, event->name, event->reason, event->action, err);

    if (event->what == GSN_SOURCE_WAITING && soon < serving->next_look_ms)
        serving->next_look_ms = soon;
    if (event->what == GSN_SOURCE_WAITING)
        return GSN_OK;
    if (event->what == GSN_SOURCE_NOTICE && is_specimen_folder(serving, event->name)) {
        gsn_log(LOG_INFO, &what, "%s: is taken in as a specimen once it holds a job.json",
                event->name);
        return GSN_OK;
    }
    gsn_log(LOG_NOTICE, &what, "%s%s%s", event->name, event->name[0] ? ": " : "", event->reason);
    return serving->is_device ? GSN_OK : gsn_serving_unbar(serving, event->name, err);
}

static int take_each(struct gsn_serving *serving, const struct gsn_source_events *events,
                     struct arrived *arrived, struct gsn_error *err)
{
    bool expected = false;

    for (size_t i = 0; i < events->count; i++) {
        const struct gsn_source_event *const event = &events->at[i];
        int r;

        if (event->what != GSN_SOURCE_READY) {
            r = tell_news(serving, event, err);
            if (r < 0)
                return r;
            continue;
        }
        if (gsn_failing_rests(&serving->failing, event->name, gsn_now_ms()) ||
            gsn_lifeline_is_over(serving->line) || serving->blamed[0])
            continue;
        if (!expected)
            ensure_expected(serving);
        expected = true;
        r = take(serving, event, arrived, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

int gsn_serving_take_all(struct gsn_serving *serving, const struct gsn_source_events *events,
                         struct gsn_error *err)
{
    struct arrived arrived = { .settled_ms = gsn_now_ms() - SETTLE_EVERY_MS };
    struct gsn_error quiet = { 0 };
    const int r = take_each(serving, events, &arrived, err);

    /* What was taken in before a failure is told, too. */
    return r < 0 ? ((void)settle(serving, &arrived, &quiet), r) : settle(serving, &arrived, err);
}

static int run_import(const struct gsn_serving *serving, const char *folder, bool again,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) worker = NULL;
    const int r = gsn_process_sibling("gieson-work", &worker, err);
    const struct gsn_import_child child = { .worker = worker,
                                            .store_dir = gsn_store_dir(serving->store),
                                            .source = serving->config->name,
                                            .folder = folder,
                                            .again = again,
                                            .line = serving->line,
                                            .patience_ms = serving->config->patience_s * 1000 };

    return r < 0 ? r : gsn_import_child_run(&child, err);
}

/* What a person does about a folder that an import failed on. gives. */
static char *mend_import(const struct gsn_specimen_due *due, int code)
{
    switch (code) {
    case GSN_E_DENIED:
        return gsn_format("let it be read: chmod -R a+rX '%s'; it is tried again by itself",
                          due->path);
    case GSN_E_IO:
        return gsn_strdup("look at the disk or the network folder, and at the store's; it is tried "
                          "again by itself");
    case GSN_E_PROCESS:
        return gsn_strdup("look at the journal, and whether the disk or the network folder "
                          "answers; it is tried again by itself");
    default:
        return gsn_strdup("correct the folder; it is tried again by itself");
    }
}

static int import(struct gsn_serving *serving, const struct gsn_specimen_due *due,
                  struct gsn_error *err)
{
    gsn_auto_mem(char) action = NULL;
    struct gsn_error why = { 0 };
    int r = gsn_spool_has_room(serving->spool, due->bytes, &why);

    if (r == GSN_E_LIMIT && gsn_spool_has_room(serving->spool, 0, err) == GSN_OK) {
        gsn_specimen_folders_failed(serving->folders, due->index, gsn_now_ms());
        return put_trouble(serving, due->name, why.text, MAKE_ROOM, err);
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    gsn_source_row_progress(&serving->row, due->name, 0, 0, due->bytes);
    r = run_import(serving, due->path, due->again, &why);
    if (r >= 0) {
        gsn_specimen_folders_done(serving->folders, due->index);
        return gsn_failing_over(&serving->failing, due->name, err);
    }
    gsn_specimen_folders_failed(serving->folders, due->index, gsn_now_ms());
    if (r == GSN_E_BUSY)
        return GSN_OK;
    action = mend_import(due, r);
    return action ? put_trouble(serving, due->name, why.text, action, err)
                  : gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", due->name);
}

int gsn_serving_import_all(struct gsn_serving *serving, struct gsn_error *err)
{
    struct gsn_specimen_due due = { .path = NULL };
    long after = -1;

    const char *const root = serving->config->address + strlen(GSN_SERVING_HOT);

    if (!serving->folders)
        return GSN_OK;
    for (;;) {
        int r = gsn_specimen_folders_next(serving->folders, gsn_now_ms(), after, &due, err);

        if (r >= 0 && !due.path)
            return gsn_failing_forget_gone(&serving->failing, root, err);
        if (r < 0 || gsn_lifeline_is_over(serving->line))
            return r;
        after = (long)due.index;
        r = import(serving, &due, err);
        if (r < 0)
            return r;
    }
}
