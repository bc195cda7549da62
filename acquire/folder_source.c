/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/folder_source.h"

#include <errno.h>
#include <poll.h>
#include <stdbool.h>
#include <string.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <unistd.h>

#include "acquire/folder_look.h"

static bool has_news(const struct gsn_folder_file *file, struct gsn_source_event *ret_event)
{
    *ret_event = (struct gsn_source_event){
        .item = file->item, .name = file->name, .reason = file->reason, .action = file->action
    };
    /* job.json describes the panels; whoever imports reads it himself. */
    if (strcmp(file->name, "job.json") == 0)
        return false;
    if (!file->present) {
        ret_event->what = GSN_SOURCE_GONE;
        ret_event->reason = "vanished before it was taken";
        return file->state == GSN_FILE_WAITING || file->state == GSN_FILE_READY ||
               file->state == GSN_FILE_BARRED;
    }
    switch (file->state) {
    case GSN_FILE_READY:
        ret_event->what = GSN_SOURCE_READY;
        ret_event->size = (uint64_t)file->stamp.size;
        ret_event->incomplete = file->incomplete;
        ret_event->key = file->key;
        return true;
    case GSN_FILE_WAITING:
        ret_event->what = GSN_SOURCE_WAITING;
        return !file->told;
    case GSN_FILE_SKIPPED:
        ret_event->what = GSN_SOURCE_NOTICE;
        return !file->told;
    case GSN_FILE_BARRED:
        ret_event->what = GSN_SOURCE_BARRED;
        return true;
    default:
        return false;
    }
}

static int tell(const struct gsn_folder *folder, struct gsn_source_events *events,
                struct gsn_error *err)
{
    for (size_t i = 0; i < folder->count; i++) {
        struct gsn_source_event event;
        int r = GSN_OK;

        if (has_news(&folder->at[i], &event))
            r = gsn_source_tell(events, &event, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

/* Only now that every event is in the caller's list: a poll that fails has told nothing. */
static void forget_news(struct gsn_folder *folder)
{
    size_t kept = 0;

    for (size_t i = 0; i < folder->count; i++) {
        struct gsn_folder_file *const file = &folder->at[i];

        file->told = true;
        if (file->present)
            folder->at[kept++] = *file;
        else
            gsn_free(file->name);
    }
    folder->count = kept;
}

static bool is_over(const struct gsn_folder *folder)
{
    for (size_t i = 0; i < folder->count; i++) {
        const enum gsn_folder_state state = folder->at[i].state;

        if (state == GSN_FILE_WAITING || state == GSN_FILE_READY || state == GSN_FILE_HIDDEN)
            return false;
    }
    return folder->replay;
}

/* A file that was closed or moved here may be whole by now; one that begins wants a first look. */
static const uint32_t hints = IN_CREATE | IN_CLOSE_WRITE | IN_MOVED_TO;

/* The folder may be another one by now (a medium was mounted there), so the watch is set again
 * before each look. Shares of a network and full tables tell nothing: then time alone wakes us. */
static void watch(struct gsn_folder *folder)
{
    int wd;

    if (folder->inotify < 0)
        return;
    wd = inotify_add_watch(folder->inotify, folder->dir, hints);
    if (folder->watch >= 0 && wd != folder->watch)
        (void)inotify_rm_watch(folder->inotify, folder->watch);
    folder->watch = wd;
}

static void drain(int inotify)
{
    char events[4096];
    ssize_t got;

    do
        got = read(inotify, events, sizeof events);
    while (got > 0 || (got < 0 && errno == EINTR));
}

static int folder_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    const struct gsn_folder *const folder = self;
    struct pollfd at[] = { { .fd = stop_fd, .events = POLLIN },
                           { .fd = folder->inotify, .events = POLLIN } };

    if (poll(at, sizeof at / sizeof *at, timeout_ms) < 0 && errno != EINTR)
        return gsn_fail(err, GSN_E_IO, "%s: waiting: %s", folder->dir, strerror(errno));
    if (at[1].revents)
        drain(folder->inotify);
    return GSN_OK;
}

static int folder_poll(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                       struct gsn_error *err)
{
    struct gsn_folder *const folder = self;
    int r;

    watch(folder);
    r = gsn_folder_look(folder, now_ms, err);
    if (r >= 0)
        r = tell(folder, events, err);
    if (r < 0)
        return r;
    folder->listed = true;
    forget_news(folder);
    *ret_ended = is_over(folder);
    return GSN_OK;
}

static struct gsn_folder_file *find_ready(struct gsn_folder *folder, uint64_t item)
{
    for (size_t i = 0; i < folder->count; i++) {
        if (folder->at[i].item == item && folder->at[i].state == GSN_FILE_READY)
            return &folder->at[i];
    }
    return NULL;
}

static int no_item(uint64_t item, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "item %llu is not ready", (unsigned long long)item);
}

static int folder_read(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                       size_t *ret_got, struct gsn_error *err)
{
    struct gsn_folder *const folder = self;
    struct gsn_folder_file *const file = find_ready(folder, item);
    ssize_t got = 0;
    int fd = -1, failure = 0, r;
    bool same;

    if (!file)
        return no_item(item, err);
    r = gsn_folder_open_file(folder, file, &fd, err);
    if (r < 0)
        return r;
    do
        got = pread(fd, buffer, size, (off_t)offset);
    while (got < 0 && errno == EINTR);
    failure = got < 0 ? errno : 0;
    same = gsn_folder_is_as_told(fd, file);
    (void)close(fd);
    if (!same) {
        file->unsettled = true;
        gsn_folder_set_state(file, GSN_FILE_WAITING, "changed while it was read");
        return gsn_fail(err, GSN_E_BUSY, "%s changed while it was read", file->name);
    }
    if (failure)
        return gsn_fail(err, GSN_E_IO, "%s: %s", file->name, strerror(failure));
    *ret_got = (size_t)got;
    return GSN_OK;
}

static int folder_acknowledge(void *self, uint64_t item, struct gsn_error *err)
{
    struct gsn_folder_file *const file = find_ready(self, item);

    if (!file)
        return no_item(item, err);
    file->state = GSN_FILE_DONE;
    return GSN_OK;
}

static void folder_free(struct gsn_folder *folder)
{
    if (!folder)
        return;
    for (size_t i = 0; i < folder->count; i++)
        gsn_free(folder->at[i].name);
    if (folder->inotify >= 0)
        (void)close(folder->inotify);
    gsn_free(folder->at);
    gsn_free(folder->dir);
    gsn_free(folder);
}

static void folder_close(void *self)
{
    folder_free(self);
}

static int check_folder(const char *dir, struct gsn_error *err)
{
    struct stat st;

    if (stat(dir, &st) < 0)
        return gsn_fail(err, errno == ENOENT ? GSN_E_NOTFOUND : GSN_E_IO, "%s: %s", dir,
                        strerror(errno));
    if (!S_ISDIR(st.st_mode))
        return gsn_fail(err, GSN_E_NOTFOUND, "%s is not a folder", dir);
    return GSN_OK;
}

static int folder_open(const char *dir, const struct gsn_source_options *options, bool replay,
                       void **ret_self, struct gsn_error *err)
{
    struct gsn_folder *folder;
    const int r = check_folder(dir, err);

    if (r < 0)
        return r;
    folder = gsn_alloc_array(1, sizeof *folder);
    if (folder) {
        folder->dir = gsn_strdup(dir);
        folder->watch = -1;
        /* A folder that is replayed does not change. */
        folder->inotify = replay ? -1 : inotify_init1(IN_NONBLOCK | IN_CLOEXEC);
    }
    if (!folder || !folder->dir) {
        folder_free(folder);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a folder");
    }
    folder->options = *options;
    folder->replay = replay;
    *ret_self = folder;
    return GSN_OK;
}

static int hot_open(const char *rest, const struct gsn_source_options *options, void **ret_self,
                    struct gsn_error *err)
{
    return folder_open(rest, options, false, ret_self, err);
}

static int replay_open(const char *rest, const struct gsn_source_options *options, void **ret_self,
                       struct gsn_error *err)
{
    return folder_open(rest, options, true, ret_self, err);
}

const struct gsn_source_ops gsn_hot_folder_ops = {
    .kind = "hot",
    .open = hot_open,
    .poll = folder_poll,
    .read = folder_read,
    .acknowledge = folder_acknowledge,
    .wait = folder_wait,
    .close = folder_close,
};

const struct gsn_source_ops gsn_replay_folder_ops = {
    .kind = "replay",
    .open = replay_open,
    .poll = folder_poll,
    .read = folder_read,
    .acknowledge = folder_acknowledge,
    .wait = folder_wait,
    .close = folder_close,
};
