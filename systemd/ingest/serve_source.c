/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Serving one source: look, take what is ready, wait; until it is asked to stop.
 *
 * Steps of a round.
 * 1. Poll the source. A device that is away ends the process (giesond starts it again when udev
 * tells of something).
 * 2. Take each item (intake.h). Rows lie in the staging table and are committed at the end of the
 * round or when it is full; only then is each told in the log.
 * 3. Below the reserve of disk the source pauses, and goes on by itself.
 * 4. Import each specimen's folder that is due (specimen_folders.h).
 * 5. Do what people asked for (a picture now), then wait: for the source's events, the store's
 * files (inotify), the end. Heartbeats go on meanwhile. An item that failed is blamed only once the
 * device has answered again: before that it may be the device's own trouble. The row that people
 * look at is written when it changes, and twice a second at most while bytes come.
 *
 * How it fails: six failures of the store in a row end the process, for it may be the one that is
 * ill. */
#include "systemd/ingest/serve_source.h"

#include <errno.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "acquire/folder_source.h"
#include "acquire/source.h"
#include "acquire/spool.h"
#include "pipeline/core/calendar.h"
#include "pipeline/core/process.h"
#include "storage/bench.h"
#include "storage/catalog.h"
#include "storage/scan.h"
#include "storage/store.h"
#include "systemd/ingest/intake.h"
#include "systemd/ingest/specimen_folders.h"
#include "systemd/service/config.h"
#include "systemd/service/heartbeat.h"
#include "systemd/service/log.h"

/* The row in which a source says how it is. Rows are for eyes: what changes fast is written twice a
 * second at most. keeps: store, name and address. */
struct source_row {
    struct gsn_store *store;
    const char *name, *address;
    char device[160];
    /* what was written last */
    char state[16], message[400];
    int64_t written_ms;
};

/* The address of a folder that specimens' folders may lie in begins so. */
#define HOT_PREFIX "hot:"

/* One source while it is served. */
struct serving {
    struct gsn_store *store;
    const struct gsn_config_source *config;
    struct gsn_heartbeat *heartbeat;
    struct gsn_intake intake;
    struct gsn_spool *spool;
    struct gsn_source *source;
    struct gsn_specimen_folders *folders; /* NULL: no hot folder */
    struct gsn_specimen_ear ear;
    struct gsn_failing failing;
    struct source_row row;
    bool is_device; /* it can go away by itself */
    int wake;       /* readable: time to stop, or somebody wrote to the store; an epoll */
    int changes;    /* an inotify on the store's files; -1: none */
    /* the copy that goes on */
    const char *item;
    uint64_t item_size;
    int64_t item_began_ms;
    /* what this round found */
    char blame[480], blamed[300]; /* an item that failed and why, until the source answers again */
    unsigned store_failures;
    int64_t next_look_ms;
};

/* Who speaks, in the log. id: of the message, or NULL. */
static struct gsn_log_about log_about(const struct serving *serving, const char *id)
{
    return (struct gsn_log_about){ .id = id, .source = serving->config->name };
}

enum { EVERY_MS = 500, SHORT_COPY_MS = 300 };

/* The row of the source. */

static void write_row(struct source_row *row, const struct gsn_bench_source *source)
{
    struct gsn_error quiet = { 0 };

    row->written_ms = gsn_now_ms();
    if (gsn_bench_put(row->store, source, time(NULL), &quiet) < 0)
        return;
    (void)snprintf(row->state, sizeof row->state, "%s", source->state);
    (void)snprintf(row->message, sizeof row->message, "%s", source->message);
}

/* A store that cannot take it now gets the next one. */
static void write_state(struct source_row *row, const char *state, const char *message)
{
    const struct gsn_bench_source source = { .name = row->name,
                                             .address = row->address,
                                             .device = row->device,
                                             .state = state,
                                             .message = message,
                                             .item = "" };

    if (strcmp(row->state, state) == 0 && strcmp(row->message, message) == 0)
        return;
    write_row(row, &source);
}

/* How far the item is that is being received; not written in the first moments of a copy. */
static void write_progress(struct source_row *row, const char *item, int64_t began_ms,
                           uint64_t done, uint64_t total)
{
    const struct gsn_bench_source source = { .name = row->name,
                                             .address = row->address,
                                             .device = row->device,
                                             .state = "receiving",
                                             .message = "",
                                             .item = item,
                                             .done = (int64_t)done,
                                             .total = (int64_t)total };
    const int64_t now = gsn_now_ms();

    if (now - began_ms >= SHORT_COPY_MS && now - row->written_ms >= EVERY_MS)
        write_row(row, &source);
}

enum {
    BEAT_MS = 10000, /* while nothing comes; a third of the patience when that is shorter */
    HURRY_MS = 1000, /* between two looks while something keeps changing in the store */
};

/* Waiting. */

static int answer_request(struct serving *serving, const struct gsn_request_row *request,
                          struct gsn_error *err)
{
    static const struct {
        const char *kind;
        enum gsn_source_subject subject;
    } kinds[] = { { "capture-panel", GSN_SUBJECT_PANEL },
                  { "capture-blank", GSN_SUBJECT_BLANK },
                  { "capture-dark", GSN_SUBJECT_DARK } };
    const struct gsn_log_about what = log_about(serving, NULL);
    struct gsn_error why = { 0 };
    size_t i = 0;
    int r;

    while (i + 1 < sizeof kinds / sizeof kinds[0] && strcmp(kinds[i].kind, request->kind) != 0)
        i++;
    r = gsn_source_capture(serving->source, kinds[i].subject, &why);
    gsn_log(r < 0 ? LOG_WARNING : LOG_INFO, &what, "%s, asked for by %s: %s", request->kind,
            request->actor, r < 0 ? why.text : "done");
    serving->next_look_ms = 0;
    return gsn_request_answer(serving->store, request->id, r < 0 ? why.text : NULL, time(NULL),
                              err);
}

/* Does what people asked of the source, such as to take a picture now. */
static int answer_requests(struct serving *serving, struct gsn_error *err)
{
    for (;;) {
        gsn_auto(gsn_request_row) request = NULL;
        int r = gsn_request_next(serving->store, serving->config->name, &request, err);

        if (r == GSN_E_NOTFOUND || gsn_heartbeat_is_over(serving->heartbeat))
            return GSN_OK;
        if (r >= 0)
            r = answer_request(serving, request, err);
        if (r < 0)
            return r;
    }
}

/* What wakes the process: the end, and for devices also somebody who writes to the store. */
static int open_wake(struct serving *serving, struct gsn_error *err)
{
    struct epoll_event event = { .events = EPOLLIN };
    const char *const dir = gsn_store_dir(serving->store);

    serving->wake = epoll_create1(EPOLL_CLOEXEC);
    if (serving->wake < 0 ||
        epoll_ctl(serving->wake, EPOLL_CTL_ADD, gsn_heartbeat_fd(serving->heartbeat), &event) < 0)
        return gsn_fail(err, GSN_E_IO, "epoll: %s", strerror(errno));
    /* Only who can be asked for a picture must hear of it at once. */
    if (!serving->is_device)
        return GSN_OK;
    serving->changes = inotify_init1(IN_CLOEXEC | IN_NONBLOCK);
    if (serving->changes < 0 || inotify_add_watch(serving->changes, dir, IN_MODIFY) < 0 ||
        epoll_ctl(serving->wake, EPOLL_CTL_ADD, serving->changes, &event) < 0)
        return gsn_fail(err, GSN_E_IO, "%s cannot be watched: %s", dir, strerror(errno));
    return GSN_OK;
}

/* True when somebody wrote to the store since. */
static bool drain_changes(const struct serving *serving)
{
    _Alignas(struct inotify_event) char events[4096];
    bool any = false;

    while (serving->changes >= 0 && read(serving->changes, events, sizeof events) > 0)
        any = true;
    return any;
}

static int beat_pause_ms(const struct serving *serving)
{
    const int64_t third = serving->config->patience_s * 1000 / 3;

    return (int)(third < BEAT_MS ? third : BEAT_MS);
}

/* Until it is time for another look; the heart beats meanwhile. */
static int wait_for_events(struct serving *serving, struct gsn_error *err)
{
    while (!gsn_heartbeat_is_over(serving->heartbeat)) {
        const int64_t began = gsn_now_ms();
        const int64_t left = serving->next_look_ms - began;
        int64_t pause = beat_pause_ms(serving);
        int r;

        gsn_heartbeat_beat(serving->heartbeat, GSN_HEARTBEAT_READY);
        if (left <= 0)
            return GSN_OK;
        pause = left < pause ? left : pause;
        r = gsn_source_wait(serving->source, (int)pause, serving->wake, err);
        if (r < 0)
            return r;
        if (drain_changes(serving)) {
            r = answer_requests(serving, err);
            if (r < 0)
                return r;
            /* The same moment may have brought a hint of the source. */
            if (serving->next_look_ms > began + HURRY_MS)
                serving->next_look_ms = began + HURRY_MS;
        } else if (gsn_now_ms() - began + 5 < pause) {
            return GSN_OK;
        }
    }
    return GSN_OK;
}

/* Taking items. */

/* How long what comes must keep still: as configured, or what its file system needs. */
static int64_t settle_time_ms(const struct serving *serving)
{
    const char *const folder = strchr(serving->config->address, ':');

    return serving->is_device || !folder
               ? serving->config->settle_ms
               : gsn_folder_settle_ms(folder + 1, serving->config->settle_ms);
}

/* Called by the spool and the intake while bytes come: the process lives, and how far it is. */
static int on_copy(void *context, uint64_t offset)
{
    struct serving *const serving = context;

    gsn_heartbeat_beat(serving->heartbeat,
                       serving->item ? GSN_HEARTBEAT_READY : GSN_HEARTBEAT_ALIVE);
    if (serving->item)
        write_progress(&serving->row, serving->item, serving->item_began_ms, offset,
                       serving->item_size);
    return gsn_heartbeat_is_over(serving->heartbeat);
}

static void on_piece(void *context)
{
    const struct serving *const serving = context;

    gsn_heartbeat_beat(serving->heartbeat, GSN_HEARTBEAT_READY);
}

/* What this round has taken in and not committed. Its names are the round's events'. */
enum { MOST_ARRIVED = 64, COMMIT_EVERY_MS = 500 };

struct arrived {
    size_t count;
    int64_t committed_ms;
    struct {
        int64_t scan;
        const struct gsn_source_event *event;
    } at[MOST_ARRIVED];
};

static void log_taken(const struct serving *serving, int64_t id,
                      const struct gsn_source_event *ready)
{
    gsn_auto(gsn_scan_row) scan = NULL;
    struct gsn_log_about what = log_about(serving, GSN_LOG_ARRIVED);
    struct gsn_error quiet = { 0 };

    if (gsn_scan_get(serving->store, id, &scan, &quiet) < 0)
        return;
    what.scan = id;
    what.specimen = scan->specimen;
    gsn_log(ready->incomplete ? LOG_WARNING : LOG_INFO, &what, "%s is scan %lld, %s: %s%s%s",
            ready->name, (long long)id, scan->state, scan->reason, ready->incomplete ? "; " : "",
            ready->incomplete ? ready->reason : "");
}

static int commit_staged(struct serving *serving, struct arrived *arrived, struct gsn_error *err)
{
    const int r = gsn_scan_commit_staged(serving->store, err);

    serving->store_failures += r < 0;
    for (size_t i = 0; r >= 0 && i < arrived->count; i++)
        log_taken(serving, arrived->at[i].scan, arrived->at[i].event);
    arrived->count = 0;
    arrived->committed_ms = gsn_now_ms();
    return r;
}

/* A picture that comes alone is committed at once, those of a burst together. */
static int note_taken(struct serving *serving, struct arrived *arrived,
                      const struct gsn_source_event *ready, const struct gsn_intake_taken *taken,
                      struct gsn_error *err)
{
    if (!taken->again) {
        arrived->at[arrived->count].scan = taken->scan;
        arrived->at[arrived->count++].event = ready;
    }
    if (arrived->count < MOST_ARRIVED && gsn_now_ms() - arrived->committed_ms < COMMIT_EVERY_MS)
        return GSN_OK;
    return commit_staged(serving, arrived, err);
}

static int put_trouble(struct serving *serving, const char *name, const char *reason,
                       const char *action, struct gsn_error *err)
{
    const struct gsn_log_about what = log_about(serving, GSN_LOG_TROUBLE);
    int is_new = 0;
    const int r =
        gsn_failing_add(&serving->failing, name, reason, action, gsn_now_ms(), &is_new, err);

    if (is_new)
        gsn_log(LOG_WARNING, &what, "%s could not be taken in: %s", name, reason);
    return r;
}

/* The first device to fail is asked again before the item is blamed: it may be gone. */
static int blame_item(struct serving *serving, const char *name, const char *reason,
                      struct gsn_error *err)
{
    if (!serving->is_device)
        return put_trouble(serving, name, reason, "look at the file, or copy it again", err);
    (void)snprintf(serving->blamed, sizeof serving->blamed, "%s", name);
    (void)snprintf(serving->blame, sizeof serving->blame, "%s", reason);
    return GSN_OK;
}

/* For the ear: what a person must change is a row of trouble until it is over. */
static int bar_name(void *context, const char *name, const char *reason, const char *action,
                    struct gsn_error *err)
{
    struct serving *const serving = context;

    if (gsn_failing_is_early_for(&serving->failing, name, reason, gsn_now_ms()))
        return GSN_OK;
    return put_trouble(serving, name, reason, action, err);
}

static int unbar_name(void *context, const char *name, struct gsn_error *err)
{
    struct serving *const serving = context;

    return gsn_failing_over(&serving->failing, name, err);
}

/* The device still answers: what failed before is the item's own trouble, and becomes a row. */
static int charge_item(struct serving *serving, struct gsn_error *err)
{
    int r = GSN_OK;

    if (serving->blamed[0])
        r = put_trouble(serving, serving->blamed, serving->blame,
                        "look at the picture on the device; it is tried again by itself", err);
    serving->blamed[0] = '\0';
    return r;
}

static int log_kept(struct serving *serving, const char *name, const char *reason,
                    struct gsn_error *err)
{
    const struct gsn_log_about what = log_about(serving, GSN_LOG_TROUBLE);
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
static int take_item(struct serving *serving, const struct gsn_source_event *ready,
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
            return log_kept(serving, ready->name, taken.kept, err);
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
static void ensure_expected(struct serving *serving)
{
    gsn_auto(gsn_bench_sources) rows = NULL;
    const struct gsn_log_about what = log_about(serving, NULL);
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
static bool is_specimen_folder(const struct serving *serving, const char *name)
{
    gsn_auto_mem(char) path = NULL;
    struct stat st;

    if (!serving->folders)
        return false;
    path = gsn_format("%s/%s", serving->config->address + strlen(HOT_PREFIX), name);
    return path && lstat(path, &st) == 0 && S_ISDIR(st.st_mode);
}

/* What is told without being delivered. Something that still changes is looked at again soon. */
static int log_event(struct serving *serving, const struct gsn_source_event *event,
                     struct gsn_error *err)
{
    const struct gsn_log_about what = log_about(serving, NULL);
    const int64_t soon = gsn_now_ms() + settle_time_ms(serving) + 50;

    if (event->what == GSN_SOURCE_BARRED)
        return bar_name(serving, event->name, event->reason, event->action, err);

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
    return serving->is_device ? GSN_OK : unbar_name(serving, event->name, err);
}

static int take_each(struct serving *serving, const struct gsn_source_events *events,
                     struct arrived *arrived, struct gsn_error *err)
{
    bool expected = false;

    for (size_t i = 0; i < events->count; i++) {
        const struct gsn_source_event *const event = &events->at[i];
        int r;

        if (event->what != GSN_SOURCE_READY) {
            r = log_event(serving, event, err);
            if (r < 0)
                return r;
            continue;
        }
        if (gsn_failing_is_early(&serving->failing, event->name, gsn_now_ms()) ||
            gsn_heartbeat_is_over(serving->heartbeat) || serving->blamed[0])
            continue;
        if (!expected)
            ensure_expected(serving);
        expected = true;
        r = take_item(serving, event, arrived, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

/* Takes everything that is ready, until something stops it. Fails only where nothing more can be
 * taken in this round. */
static int take_items(struct serving *serving, const struct gsn_source_events *events,
                      struct gsn_error *err)
{
    struct arrived arrived = { .committed_ms = gsn_now_ms() - COMMIT_EVERY_MS };
    struct gsn_error quiet = { 0 };
    const int r = take_each(serving, events, &arrived, err);

    /* What was taken in before a failure is told, too. */
    return r < 0 ? ((void)commit_staged(serving, &arrived, &quiet), r)
                 : commit_staged(serving, &arrived, err);
}

static int run_import(const struct serving *serving, const char *folder, bool again,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) worker = NULL;
    const int r = gsn_process_sibling("gieson-work", &worker, err);
    const struct gsn_import_child child = { .worker = worker,
                                            .store_dir = gsn_store_dir(serving->store),
                                            .source = serving->config->name,
                                            .folder = folder,
                                            .again = again,
                                            .heartbeat = serving->heartbeat,
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

static int import_folder(struct serving *serving, const struct gsn_specimen_due *due,
                         struct gsn_error *err)
{
    gsn_auto_mem(char) action = NULL;
    struct gsn_error why = { 0 };
    int r = gsn_spool_has_space(serving->spool, due->bytes, &why);

    if (r == GSN_E_LIMIT && gsn_spool_has_space(serving->spool, 0, err) == GSN_OK) {
        gsn_specimen_folders_failed(serving->folders, due->index, gsn_now_ms());
        return put_trouble(serving, due->name, why.text, MAKE_ROOM, err);
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    write_progress(&serving->row, due->name, 0, 0, due->bytes);
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

/* Has every folder of a specimen that is due taken in by gieson-work. */
static int import_folders(struct serving *serving, struct gsn_error *err)
{
    struct gsn_specimen_due due = { .path = NULL };
    long after = -1;

    const char *const root = serving->config->address + strlen(HOT_PREFIX);

    if (!serving->folders)
        return GSN_OK;
    for (;;) {
        int r = gsn_specimen_folders_next(serving->folders, gsn_now_ms(), after, &due, err);

        if (r >= 0 && !due.path)
            return gsn_failing_forget_gone(&serving->failing, root, err);
        if (r < 0 || gsn_heartbeat_is_over(serving->heartbeat))
            return r;
        after = (long)due.index;
        r = import_folder(serving, &due, err);
        if (r < 0)
            return r;
    }
}

enum {
    TRY_AGAIN_MS = 2000, /* a disk below its reserve, a store that refuses */
    MOST_STORE_FAILURES = 5,
};

/* The loop. */

/* Nothing can be taken now: says so, and comes back soon. Too often, and the process is better
 * begun anew. */
static int pause_intake(struct serving *serving, int code, const struct gsn_error *why)
{
    const bool no_room = code == GSN_E_LIMIT;
    const struct gsn_log_about what = log_about(serving, no_room ? GSN_LOG_PAUSED : NULL);

    if (strcmp(serving->row.state, no_room ? "paused" : "failed") != 0)
        gsn_log(no_room ? LOG_WARNING : LOG_ERR, &what, "%s%s",
                no_room ? "paused: " : "nothing can be taken in: ", why->text);
    write_state(&serving->row, no_room ? "paused" : "failed", why->text);
    serving->next_look_ms = gsn_now_ms() + TRY_AGAIN_MS;
    return serving->store_failures > MOST_STORE_FAILURES ? code : GSN_OK;
}

/* The device or the folder does not answer. A folder may be a mount that comes back. */
static int lose_source(struct serving *serving, int code, const struct gsn_error *why,
                       struct gsn_error *err)
{
    const struct gsn_log_about what = log_about(serving, GSN_LOG_AWAY);

    serving->blamed[0] = '\0';
    if (serving->is_device)
        return gsn_fail(err, code == GSN_E_IO ? GSN_E_NOTFOUND : code, "%s", why->text);
    if (strcmp(serving->row.state, "away") != 0)
        gsn_log(LOG_WARNING, &what, "%s", why->text);
    write_state(&serving->row, "away", why->text);
    return GSN_OK;
}

static void note_device(struct serving *serving)
{
    (void)snprintf(serving->row.device, sizeof serving->row.device, "%s",
                   gsn_source_device(serving->source));
}

/* Looks once and takes what is there. */
static int look_once(struct serving *serving, int *ret_ended, struct gsn_error *err)
{
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error why = { 0 };
    int r;

    serving->next_look_ms = gsn_now_ms() + serving->config->sweep_s * 1000;
    r = gsn_source_poll(serving->source, gsn_now_ms(), &events, ret_ended, &why);
    if (r < 0)
        return lose_source(serving, r, &why, err);
    gsn_heartbeat_beat(serving->heartbeat, GSN_HEARTBEAT_READY);
    note_device(serving);
    r = charge_item(serving, &why);
    if (r >= 0)
        r = take_items(serving, events, &why);
    if (r >= 0)
        r = import_folders(serving, &why);
    if (r >= 0)
        r = answer_requests(serving, &why);
    if (r < 0) {
        if (pause_intake(serving, r, &why) < 0)
            return gsn_fail(err, r, "%s", why.text);
        return GSN_OK;
    }
    if (serving->blamed[0])
        serving->next_look_ms = 0; /* is the device still there? */
    else
        write_state(&serving->row, "ready", "");
    if (serving->folders && gsn_specimen_folders_is_busy(serving->folders)) {
        const int64_t soon = gsn_now_ms() + settle_time_ms(serving) + 50;

        serving->next_look_ms = serving->next_look_ms < soon ? serving->next_look_ms : soon;
    }
    return GSN_OK;
}

static int serve_until_end(struct serving *serving, struct gsn_error *err)
{
    int ended = 0, r = GSN_OK;

    while (r >= 0 && !gsn_heartbeat_is_over(serving->heartbeat)) {
        r = look_once(serving, &ended, err);
        if (r >= 0 && ended && !serving->blamed[0]) {
            write_state(&serving->row, "ready", "everything in it is taken in");
            return GSN_OK;
        }
        if (r >= 0)
            r = wait_for_events(serving, err);
    }
    if (r >= 0)
        write_state(&serving->row, "off", "the service was stopped");
    return r;
}

static int open_folders(struct serving *serving, struct gsn_error *err)
{
    const char *const address = serving->config->address;

    if (strncmp(address, HOT_PREFIX, strlen(HOT_PREFIX)) != 0)
        return GSN_OK;
    serving->ear =
        (struct gsn_specimen_ear){ .barred = bar_name, .over = unbar_name, .context = serving };
    return gsn_specimen_folders_new(address + strlen(HOT_PREFIX), serving->config->settle_ms,
                                    serving->config->patience_s * 1000, &serving->ear,
                                    &serving->folders, err);
}

static int open_all(struct serving *serving, uint64_t reserve_bytes, struct gsn_error *err)
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
        gsn_spool_watch(serving->spool, on_piece, serving);
    if (r >= 0)
        r = gsn_failing_load(&serving->failing, err);
    if (r >= 0)
        r = open_wake(serving, err);
    if (r >= 0)
        r = open_folders(serving, err);
    serving->intake = (struct gsn_intake){ .name = config->name,
                                           .store = serving->store,
                                           .spool = serving->spool,
                                           .delete_there = config->delete_after_copy,
                                           .patience_s = config->patience_s,
                                           .on_copy = on_copy,
                                           .context = serving };
    if (r >= 0)
        r = gsn_intake_recall(serving->store, config->name, &past, &options, err);
    if (r >= 0)
        r = gsn_source_open(config->address, &options, &serving->source, err);
    serving->intake.source = serving->source;
    return r;
}

static void serving_done(struct serving *serving)
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
static void say_why_not(struct serving *serving, int code, const char *why)
{
    const bool is_away = code == GSN_E_NOTFOUND;
    const struct gsn_log_about what = log_about(serving, GSN_LOG_AWAY);
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
    write_state(&serving->row, is_away ? "away" : "failed", why);
}

int gsn_serve_source(struct gsn_store *store, const struct gsn_config *config,
                     const struct gsn_config_source *source, struct gsn_heartbeat *heartbeat,
                     struct gsn_error *err)
{
    __attribute__((cleanup(serving_done))) struct serving serving = {
        .store = store,
        .config = source,
        .heartbeat = heartbeat,
        .failing = { .store = store, .source = source->name },
        .row = { .store = store, .name = source->name, .address = source->address },
        .is_device = gsn_source_subsystem(source->address) != NULL,
        .wake = -1,
        .changes = -1,
    };
    int r = open_all(&serving, config->reserve_bytes, err);

    if (r >= 0)
        r = serve_until_end(&serving, err);
    if (r < 0)
        say_why_not(&serving, r, err->text);
    return r;
}
