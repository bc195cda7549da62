/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A hot folder: files that another program writes, taken when they are whole.
 *
 * Steps.
 * 1. Each look lists the folder (readdir, fstatat without following links) into a table in natural
 *    order of names. Size, inode, mtime and ctime together are the stamp of a file.
 * 2. A file whose stamp stayed the same for settle_ms is opened once more, by the one way that
 * follows no link (gsn_file_open_in), and its container is walked to its end (acquire/container.h).
 * So a file that is still copied waits, whatever its writer does with the times.
 * 3. What can never be taken as it is becomes barred, with what a person must do; it is tried again
 * at every look. Names that programs give to unfinished copies stay hidden until they keep still.
 * 4. inotify only shortens the wait for the next look; the looks are the truth (NFS and SMB tell of
 *    nothing).
 * 5. A file is read by its descriptor; a stamp that changed meanwhile ends the read as busy.
 *
 * "replay:" is the same with one look: the files that were there, then the end.
 * How it fails: a folder that cannot be listed fails the poll; one file never fails the others.
 * File systems of servers get at least 6 s to settle, for their times may lag behind. */
#include "acquire/folder_source.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/vfs.h>
#include <time.h>
#include <unistd.h>

#include "acquire/container.h"
#include "acquire/source.h"
#include "pipeline/core/file.h"

/* What must not change while a file settles. */
struct stamp {
    dev_t device;
    ino_t inode;
    off_t size;
    struct timespec modified, changed;
};

enum file_state {
    FILE_WAITING,
    FILE_READY,
    FILE_DONE,    /* acknowledged */
    FILE_SKIPPED, /* not for us, as long as it does not change */
    FILE_BARRED,  /* cannot be had as it is; tried again at every look */
    FILE_HIDDEN,  /* the name of a transfer, until it has kept still for long */
};

struct file {
    char *name;
    uint64_t item;
    struct stamp stamp;
    char key[128];  /* the stamp as a text; empty for what is no regular file or has no date */
    bool unsettled; /* the stamp is worth nothing: the file changed under a reader */
    int64_t since_ms;
    enum file_state state;
    bool incomplete, present;
    bool told;                     /* what the reason says was told, or need not be */
    char reason[480], action[480]; /* action: where a person has to do something, else empty */
};

struct folder {
    char *dir;
    struct gsn_source_options options;
    int64_t settle_ms;   /* of the options, or what the file system needs */
    int inotify, watch;  /* -1: nobody tells us of changes */
    bool replay, listed; /* listed: the first look is over */
    uint64_t last_item;
    size_t count, room;
    struct file *at; /* in natural order of names */
};

/* A look. */

static struct stamp stamp_of(const struct stat *st)
{
    return (struct stamp){ st->st_dev, st->st_ino, st->st_size, st->st_mtim, st->st_ctim };
}

static bool same_time(struct timespec a, struct timespec b)
{
    return a.tv_sec == b.tv_sec && a.tv_nsec == b.tv_nsec;
}

static bool same_stamp(const struct stamp *a, const struct stamp *b)
{
    return a->device == b->device && a->inode == b->inode && a->size == b->size &&
           same_time(a->modified, b->modified) && same_time(a->changed, b->changed);
}

/* Whether the open file is still the one that was told. */
static bool is_as_told(int fd, const struct file *file)
{
    struct stat st;
    struct stamp stamp;

    if (fstat(fd, &st) < 0)
        return false;
    stamp = stamp_of(&st);
    return same_stamp(&stamp, &file->stamp);
}

/* A reason is told once, and again when it becomes another. */
static void set_state(struct file *file, enum file_state state, const char *reason)
{
    if (file->state != state || strcmp(file->reason, reason) != 0)
        file->told = false;
    file->state = state;
    file->action[0] = '\0';
    (void)snprintf(file->reason, sizeof file->reason, "%s", reason);
}

static void bar_file(struct file *file, const char *reason, const char *action)
{
    set_state(file, FILE_BARRED, reason);
    (void)snprintf(file->action, sizeof file->action, "%s", action);
}

/* What a sentence of gsn_file_open_in() asks for. The name stands beside it already. */
static void bar_unreadable(const struct folder *folder, struct file *file,
                           const struct gsn_error *why)
{
    const size_t length = strlen(file->name);
    const char *reason = why->text;
    char action[sizeof file->action];

    if (strncmp(reason, file->name, length) == 0)
        reason += length + strspn(reason + length, ": ");
    if (why->code == GSN_E_DENIED)
        (void)snprintf(action, sizeof action, "let it be read: chmod a+r '%s/%s'", folder->dir,
                       file->name);
    else if (why->code == GSN_E_INPUT)
        (void)snprintf(action, sizeof action, "put the file itself in its place");
    else
        (void)snprintf(action, sizeof action,
                       "look at the disk or the network folder, or copy the file again");
    bar_file(file, reason, action);
}

static int open_file(const struct folder *folder, const struct file *file, int *ret_fd,
                     struct gsn_error *err)
{
    return gsn_file_open_in(folder->dir, file->name, ret_fd, err);
}

/* Opening asks a server for the file as it is now, where a look may have been told what it was. */
static int judge_file(const struct folder *folder, const struct file *file,
                      struct gsn_container *ret_container, bool *ret_same, struct gsn_error *err)
{
    int fd = -1, r = open_file(folder, file, &fd, err);

    if (r < 0)
        return r;
    *ret_same = is_as_told(fd, file);
    r = gsn_container_check_fd(fd, ret_container, err);
    (void)close(fd);
    return r;
}

/* The file kept still for long enough: is it whole, and is it for us at all? */
static int judge_settled(const struct folder *folder, struct file *file, bool patient,
                         struct gsn_error *err)
{
    struct gsn_container container;
    struct gsn_error why = { 0 };
    bool same = true;
    const int r = judge_file(folder, file, &container, &same, &why);

    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    /* The next look will find that it is gone. */
    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r < 0) {
        bar_unreadable(folder, file, &why);
        return GSN_OK;
    }
    if (!same) {
        file->unsettled = true;
        set_state(file, FILE_WAITING, "changed while it was looked at");
        return GSN_OK;
    }
    if (container.kind == GSN_CONTAINER_UNKNOWN && !gsn_name_is_picture(file->name)) {
        set_state(file, FILE_SKIPPED, "is no picture and is left alone");
        return GSN_OK;
    }
    set_state(file, container.complete || !patient ? FILE_READY : FILE_WAITING, container.reason);
    file->incomplete = !container.complete;
    return GSN_OK;
}

/* What programs call a file that they still write: rsync, browsers, WinSCP and editors. */
static bool is_transfer(const char *name)
{
    static const char *const endings[] = { ".part",       ".partial",  ".filepart",
                                           ".crdownload", ".download", ".tmp" };
    const size_t length = strlen(name);

    for (size_t i = 0; i < sizeof endings / sizeof endings[0]; i++) {
        const size_t tail = strlen(endings[i]);

        if (length > tail && strcasecmp(name + length - tail, endings[i]) == 0)
            return true;
    }
    return name[0] == '.';
}

/* Most hidden files are none of ours, and not a word is lost about them. */
static int judge_hidden(const struct folder *folder, struct file *file, struct gsn_error *err)
{
    struct gsn_container container = { .kind = GSN_CONTAINER_UNKNOWN };
    struct gsn_error why = { 0 };
    bool same = true;
    const int r = judge_file(folder, file, &container, &same, &why);

    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    if (r >= 0 && container.kind != GSN_CONTAINER_UNKNOWN)
        bar_file(file,
                 file->name[0] == '.'
                     ? "is a picture whose name begins with a dot, as those of unfinished copies do"
                     : "is a picture whose name ends as those of unfinished copies do",
                 file->name[0] == '.'
                     ? "rename it without the dot when it is a panel, else remove it"
                     : "rename it without that when it is a panel, else remove it");
    else
        file->state = FILE_SKIPPED;
    return GSN_OK;
}

/* Cards and sticks have no numbers of files, only sizes and times; and of a clock that was never
 * set each card has the same times, so that another scan of the same size would pass for the one
 * that was taken. Such a file is read again, and recognised by its bytes. */
static bool is_trusted_time(const struct timespec *time)
{
    static const time_t year_2001 = 978307200;

    return time->tv_sec >= year_2001;
}

/* A file that is as it was when it was taken need not be read again, whatever it is called now. On
 * file systems that give a file another number after each mount it is, and is recognised then. */
static void make_key(struct file *file)
{
    const struct stamp *const stamp = &file->stamp;

    (void)snprintf(file->key, sizeof file->key, "file %llx:%llx %llu %lld.%09ld %lld.%09ld",
                   (unsigned long long)stamp->device, (unsigned long long)stamp->inode,
                   (unsigned long long)stamp->size, (long long)stamp->modified.tv_sec,
                   stamp->modified.tv_nsec, (long long)stamp->changed.tv_sec,
                   stamp->changed.tv_nsec);
}

static bool is_known(const struct folder *folder, const struct file *file)
{
    return file->key[0] && folder->options.is_known &&
           folder->options.is_known(folder->options.context, file->key);
}

static void start_waiting(struct folder *folder, struct file *file, const struct stat *st,
                          int64_t now_ms)
{
    /* Another content under a known name is another item. */
    if (file->state == FILE_DONE)
        file->item = ++folder->last_item;
    set_state(file, FILE_WAITING, "a second look has yet to find it unchanged");
    file->stamp = stamp_of(st);
    file->unsettled = false;
    file->since_ms = now_ms;
    file->key[0] = '\0';
    if (S_ISREG(st->st_mode) && is_trusted_time(&st->st_mtim))
        make_key(file);
    if (S_ISREG(st->st_mode) && is_known(folder, file))
        set_state(file, FILE_DONE, "");
    if (S_ISREG(st->st_mode) && is_transfer(file->name)) {
        set_state(file, FILE_HIDDEN, "");
        file->told = true;
    } else if (S_ISDIR(st->st_mode)) {
        set_state(file, FILE_SKIPPED, "is a folder and is not looked into");
    } else if (!S_ISREG(st->st_mode) && !S_ISLNK(st->st_mode)) {
        set_state(file, FILE_SKIPPED, "is no regular file and is left alone");
    }
}

static int look_at(struct folder *folder, struct file *file, const struct stat *st, int64_t now_ms,
                   struct gsn_error *err)
{
    const struct stamp stamp = stamp_of(st);
    /* A folder changes whenever something in it does; once told is enough. */
    const bool same =
        (same_stamp(&stamp, &file->stamp) && !file->unsettled) || S_ISDIR(st->st_mode);
    const int64_t still_ms = now_ms - file->since_ms;

    file->present = true;
    if (!same) {
        start_waiting(folder, file, st, now_ms);
        return GSN_OK;
    }
    if (file->state == FILE_HIDDEN)
        return still_ms < folder->options.patience_ms ? GSN_OK : judge_hidden(folder, file, err);
    if (file->state == FILE_BARRED && is_transfer(file->name))
        return GSN_OK;
    if (file->state != FILE_BARRED && (file->state != FILE_WAITING || still_ms < folder->settle_ms))
        return GSN_OK;
    return judge_settled(folder, file, still_ms < folder->options.patience_ms, err);
}

/* Where the name is, or belongs. */
static size_t find_place(const struct folder *folder, const char *name, bool *ret_found)
{
    size_t low = 0, high = folder->count;

    *ret_found = false;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        const int order = gsn_natural_compare(folder->at[middle].name, name);

        if (order == 0) {
            *ret_found = true;
            return middle;
        }
        if (order < 0)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static int insert_file(struct folder *folder, size_t place, const char *name, const struct stat *st,
                       int64_t now_ms, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(name);
    struct file *file;

    if (copy && folder->count == folder->room) {
        const size_t room = folder->room ? 2 * folder->room : 16;
        struct file *at = gsn_realloc_array(folder->at, room, sizeof *at);

        if (!at)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu files", room);
        folder->at = at;
        folder->room = room;
    }
    if (!copy)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a file name");
    file = &folder->at[place];
    memmove(file + 1, file, (folder->count - place) * sizeof *file);
    folder->count++;
    *file = (struct file){ .name = gsn_steal(&copy), .item = ++folder->last_item, .present = true };
    start_waiting(folder, file, st, now_ms);
    return GSN_OK;
}

static int look_at_name(struct folder *folder, int dir_fd, const char *name, int64_t now_ms,
                        struct gsn_error *err)
{
    struct stat st;
    bool found;
    size_t place;

    /* One that has just vanished is none. */
    if (fstatat(dir_fd, name, &st, AT_SYMLINK_NOFOLLOW) < 0)
        return GSN_OK;
    if (name[0] == '.' && !S_ISREG(st.st_mode))
        return GSN_OK;
    place = find_place(folder, name, &found);
    if (found)
        return look_at(folder, &folder->at[place], &st, now_ms, err);
    if (folder->replay && folder->listed)
        return GSN_OK;
    return insert_file(folder, place, name, &st, now_ms, err);
}

static int list_files(struct folder *folder, DIR *dir, int64_t now_ms, struct gsn_error *err)
{
    for (;;) {
        const struct dirent *entry;
        int r;

        errno = 0;
        entry = readdir(dir);
        if (!entry)
            return errno == 0 ? GSN_OK
                              : gsn_fail(err, GSN_E_IO, "%s: %s", folder->dir, strerror(errno));
        r = look_at_name(folder, dirfd(dir), entry->d_name, now_ms, err);
        if (r < 0)
            return r;
    }
}

int64_t gsn_folder_settle_on(long type, int64_t settle_ms)
{
    /* statfs(2); that of SMB is a 32-bit number, which some machines' types make negative. */
    static const uint32_t remote[] = { 0x6969, 0x517b, 0xfe534d42, 0xff534d42, 0x65735546 };
    static const int64_t least_ms = 6000;

    for (size_t i = 0; i < sizeof remote / sizeof remote[0]; i++)
        if ((uint32_t)type == remote[i] && settle_ms < least_ms)
            return least_ms;
    return settle_ms;
}

int64_t gsn_folder_settle_ms(const char *dir, int64_t settle_ms)
{
    struct statfs fs;

    return statfs(dir, &fs) < 0 ? settle_ms : gsn_folder_settle_on((long)fs.f_type, settle_ms);
}

/* Looks at everything once: what is new, what changed, what kept still and is whole. */
static int look_at_folder(struct folder *folder, int64_t now_ms, struct gsn_error *err)
{
    DIR *const dir = opendir(folder->dir);
    int r;

    if (!dir)
        return gsn_fail(err, GSN_E_IO, "%s: %s", folder->dir, strerror(errno));
    folder->settle_ms = gsn_folder_settle_ms(folder->dir, folder->options.settle_ms);
    for (size_t i = 0; i < folder->count; i++)
        folder->at[i].present = false;
    r = list_files(folder, dir, now_ms, err);
    (void)closedir(dir);
    return r;
}

/* Pending events, and the source. */

static bool has_pending_event(const struct file *file, struct gsn_source_event *ret_event)
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
        return file->state == FILE_WAITING || file->state == FILE_READY ||
               file->state == FILE_BARRED;
    }
    switch (file->state) {
    case FILE_READY:
        ret_event->what = GSN_SOURCE_READY;
        ret_event->size = (uint64_t)file->stamp.size;
        ret_event->incomplete = file->incomplete;
        ret_event->key = file->key;
        return true;
    case FILE_WAITING:
        ret_event->what = GSN_SOURCE_WAITING;
        return !file->told;
    case FILE_SKIPPED:
        ret_event->what = GSN_SOURCE_NOTICE;
        return !file->told;
    case FILE_BARRED:
        ret_event->what = GSN_SOURCE_BARRED;
        return true;
    default:
        return false;
    }
}

static int emit_events(const struct folder *folder, struct gsn_source_events *events,
                       struct gsn_error *err)
{
    for (size_t i = 0; i < folder->count; i++) {
        struct gsn_source_event event;
        int r = GSN_OK;

        if (has_pending_event(&folder->at[i], &event))
            r = gsn_source_emit(events, &event, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

/* Only now that every event is in the caller's list: a poll that fails has told nothing. */
static void forget_pending_events(struct folder *folder)
{
    size_t kept = 0;

    for (size_t i = 0; i < folder->count; i++) {
        struct file *const file = &folder->at[i];

        file->told = true;
        if (file->present)
            folder->at[kept++] = *file;
        else
            gsn_free(file->name);
    }
    folder->count = kept;
}

static bool is_over(const struct folder *folder)
{
    for (size_t i = 0; i < folder->count; i++) {
        const enum file_state state = folder->at[i].state;

        if (state == FILE_WAITING || state == FILE_READY || state == FILE_HIDDEN)
            return false;
    }
    return folder->replay;
}

/* A file that was closed or moved here may be whole by now; one that begins wants a first look. */
static const uint32_t hints = IN_CREATE | IN_CLOSE_WRITE | IN_MOVED_TO;

/* The folder may be another one by now (a medium was mounted there), so the watch is set again
 * before each look. Shares of a network and full tables tell nothing: then time alone wakes us. */
static void watch_folder(struct folder *folder)
{
    int wd;

    if (folder->inotify < 0)
        return;
    wd = inotify_add_watch(folder->inotify, folder->dir, hints);
    if (folder->watch >= 0 && wd != folder->watch)
        (void)inotify_rm_watch(folder->inotify, folder->watch);
    folder->watch = wd;
}

static void drain_watch(int inotify)
{
    char events[4096];
    ssize_t got;

    do
        got = read(inotify, events, sizeof events);
    while (got > 0 || (got < 0 && errno == EINTR));
}

static int folder_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    const struct folder *const folder = self;
    struct pollfd at[] = { { .fd = stop_fd, .events = POLLIN },
                           { .fd = folder->inotify, .events = POLLIN } };

    if (poll(at, sizeof at / sizeof *at, timeout_ms) < 0 && errno != EINTR)
        return gsn_fail(err, GSN_E_IO, "%s: waiting: %s", folder->dir, strerror(errno));
    if (at[1].revents)
        drain_watch(folder->inotify);
    return GSN_OK;
}

static int folder_poll(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                       struct gsn_error *err)
{
    struct folder *const folder = self;
    int r;

    watch_folder(folder);
    r = look_at_folder(folder, now_ms, err);
    if (r >= 0)
        r = emit_events(folder, events, err);
    if (r < 0)
        return r;
    folder->listed = true;
    forget_pending_events(folder);
    *ret_ended = is_over(folder);
    return GSN_OK;
}

static struct file *find_ready(struct folder *folder, uint64_t item)
{
    for (size_t i = 0; i < folder->count; i++) {
        if (folder->at[i].item == item && folder->at[i].state == FILE_READY)
            return &folder->at[i];
    }
    return NULL;
}

static int folder_read(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                       size_t *ret_got, struct gsn_error *err)
{
    struct folder *const folder = self;
    struct file *const file = find_ready(folder, item);
    ssize_t got = 0;
    int fd = -1, failure = 0, r;
    bool same;

    if (!file)
        return gsn_source_no_item(item, err);
    r = open_file(folder, file, &fd, err);
    if (r < 0)
        return r;
    do
        got = pread(fd, buffer, size, (off_t)offset);
    while (got < 0 && errno == EINTR);
    failure = got < 0 ? errno : 0;
    same = is_as_told(fd, file);
    (void)close(fd);
    if (!same) {
        file->unsettled = true;
        set_state(file, FILE_WAITING, "changed while it was read");
        return gsn_fail(err, GSN_E_BUSY, "%s changed while it was read", file->name);
    }
    if (failure)
        return gsn_fail(err, GSN_E_IO, "%s: %s", file->name, strerror(failure));
    *ret_got = (size_t)got;
    return GSN_OK;
}

static int folder_acknowledge(void *self, uint64_t item, struct gsn_error *err)
{
    struct file *const file = find_ready(self, item);

    if (!file)
        return gsn_source_no_item(item, err);
    file->state = FILE_DONE;
    return GSN_OK;
}

static void folder_free(struct folder *folder)
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
    struct folder *folder;
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
