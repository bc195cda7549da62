/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/folder_source.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "acquire/container.h"
#include "pipeline/core/file.h"

/* What must not change while a file settles. */
struct stamp {
    dev_t device;
    ino_t inode;
    off_t size;
    struct timespec modified, changed;
};

enum state {
    STATE_WAITING,
    STATE_READY,
    STATE_DONE,    /* acknowledged */
    STATE_SKIPPED, /* not for us, as long as it does not change */
};

struct file {
    char *name;
    uint64_t item;
    struct stamp stamp;
    bool unsettled; /* the stamp is worth nothing: the file changed under a reader */
    int64_t since_ms;
    enum state state;
    bool incomplete, present;
    bool told; /* what the reason says was told, or need not be */
    char reason[160];
};

struct folder {
    char *dir;
    struct gsn_source_options options;
    bool replay, listed; /* listed: the first look is over */
    uint64_t last_item;
    size_t count, room;
    struct file *at; /* in natural order of names */
};

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

/* Compares the numbers both begin with, and moves behind them. */
static int compare_numbers(const char **a, const char **b)
{
    size_t la, lb;
    int order;

    *a += strspn(*a, "0");
    *b += strspn(*b, "0");
    la = strspn(*a, "0123456789");
    lb = strspn(*b, "0123456789");
    order = la != lb ? (la < lb ? -1 : 1) : memcmp(*a, *b, la);
    *a += la;
    *b += lb;
    return order;
}

int gsn_natural_compare(const char *a, const char *b)
{
    const char *x = a, *y = b;

    while (*x && *y) {
        int order = (unsigned char)*x - (unsigned char)*y;

        if (is_digit(*x) && is_digit(*y)) {
            order = compare_numbers(&x, &y);
        } else {
            x++;
            y++;
        }
        if (order != 0)
            return order;
    }
    if (*x || *y)
        return *x ? 1 : -1;
    return strcmp(a, b);
}

int gsn_name_is_picture(const char *name)
{
    static const char *const endings[] = { "jpg", "jpeg", "png", "tif", "tiff", "btf",  "tf8",
                                           "svs", "ndpi", "scn", "bmp", "gif",  "webp", "jp2",
                                           "pam", "pnm",  "ppm", "pgm", "heic" };
    const char *const dot = strrchr(name, '.');

    for (size_t i = 0; dot && i < sizeof endings / sizeof endings[0]; i++) {
        if (strcasecmp(dot + 1, endings[i]) == 0)
            return 1;
    }
    return 0;
}

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

/* A reason is told once, and again when it becomes another. */
static void set_state(struct file *file, enum state state, const char *reason)
{
    if (file->state != state || strcmp(file->reason, reason) != 0)
        file->told = false;
    file->state = state;
    (void)snprintf(file->reason, sizeof file->reason, "%s", reason);
}

static int open_file(const struct folder *folder, const struct file *file, int *ret_fd,
                     struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folder->dir, file->name);

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    return gsn_file_open(path, ret_fd, err);
}

static int judge(const struct folder *folder, const struct file *file,
                 struct gsn_container *ret_container, struct gsn_error *err)
{
    int fd = -1, r = open_file(folder, file, &fd, err);

    if (r < 0)
        return r;
    r = gsn_container_check_fd(fd, ret_container, err);
    (void)close(fd);
    return r;
}

/* The file kept still for long enough: is it whole, and is it for us at all? */
static int settle(const struct folder *folder, struct file *file, bool patient,
                  struct gsn_error *err)
{
    struct gsn_container container;
    struct gsn_error why = { 0 };
    char reason[160];
    const int r = judge(folder, file, &container, &why);

    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    if (r < 0) {
        (void)snprintf(reason, sizeof reason, "cannot be read: %.140s", why.text);
        set_state(file, folder->replay && !patient ? STATE_SKIPPED : STATE_WAITING, reason);
        return GSN_OK;
    }
    if (container.kind == GSN_CONTAINER_UNKNOWN && !gsn_name_is_picture(file->name)) {
        set_state(file, STATE_SKIPPED, "is no picture and is left alone");
        /* job.json describes the panels; whoever imports reads it himself. */
        file->told = file->told || strcmp(file->name, "job.json") == 0;
        return GSN_OK;
    }
    set_state(file, container.complete || !patient ? STATE_READY : STATE_WAITING, container.reason);
    file->incomplete = !container.complete;
    return GSN_OK;
}

static void start_waiting(struct folder *folder, struct file *file, const struct stat *st,
                          int64_t now_ms)
{
    /* Another content under a known name is another item. */
    if (file->state == STATE_DONE)
        file->item = ++folder->last_item;
    set_state(file, STATE_WAITING, "a second look has yet to find it unchanged");
    file->stamp = stamp_of(st);
    file->unsettled = false;
    file->since_ms = now_ms;
    if (S_ISDIR(st->st_mode))
        set_state(file, STATE_SKIPPED, "is a folder and is not looked into");
    else if (!S_ISREG(st->st_mode))
        set_state(file, STATE_SKIPPED, "is no regular file and is left alone");
}

static int look_at(struct folder *folder, struct file *file, const struct stat *st, int64_t now_ms,
                   struct gsn_error *err)
{
    const struct stamp stamp = stamp_of(st);
    /* A folder changes whenever something in it does; once told is enough. */
    const bool same =
        (same_stamp(&stamp, &file->stamp) && !file->unsettled) || S_ISDIR(st->st_mode);

    file->present = true;
    if (!same) {
        start_waiting(folder, file, st, now_ms);
        return GSN_OK;
    }
    if (file->state != STATE_WAITING || now_ms - file->since_ms < folder->options.settle_ms)
        return GSN_OK;
    return settle(folder, file, now_ms - file->since_ms < folder->options.patience_ms, err);
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

static int insert(struct folder *folder, size_t place, const char *name, const struct stat *st,
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

    if (name[0] == '.')
        return GSN_OK;
    /* A link to nothing is told as what it is; a file that has just vanished is none. */
    if (fstatat(dir_fd, name, &st, 0) < 0 && fstatat(dir_fd, name, &st, AT_SYMLINK_NOFOLLOW) < 0)
        return GSN_OK;
    place = find_place(folder, name, &found);
    if (found)
        return look_at(folder, &folder->at[place], &st, now_ms, err);
    if (folder->replay && folder->listed)
        return GSN_OK;
    return insert(folder, place, name, &st, now_ms, err);
}

static int list(struct folder *folder, DIR *dir, int64_t now_ms, struct gsn_error *err)
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

static int scan(struct folder *folder, int64_t now_ms, struct gsn_error *err)
{
    DIR *const dir = opendir(folder->dir);
    int r;

    if (!dir)
        return gsn_fail(err, GSN_E_IO, "%s: %s", folder->dir, strerror(errno));
    for (size_t i = 0; i < folder->count; i++)
        folder->at[i].present = false;
    r = list(folder, dir, now_ms, err);
    (void)closedir(dir);
    return r;
}

static bool has_news(const struct file *file, struct gsn_source_event *ret_event)
{
    *ret_event =
        (struct gsn_source_event){ .item = file->item, .name = file->name, .reason = file->reason };
    if (!file->present) {
        ret_event->what = GSN_SOURCE_GONE;
        ret_event->reason = "vanished before it was taken";
        return file->state == STATE_WAITING || file->state == STATE_READY;
    }
    switch (file->state) {
    case STATE_READY:
        ret_event->what = GSN_SOURCE_READY;
        ret_event->size = (uint64_t)file->stamp.size;
        ret_event->incomplete = file->incomplete;
        return true;
    case STATE_WAITING:
        ret_event->what = GSN_SOURCE_WAITING;
        return !file->told;
    case STATE_SKIPPED:
        ret_event->what = GSN_SOURCE_NOTICE;
        ret_event->item = 0;
        return !file->told;
    default:
        return false;
    }
}

static int tell(const struct folder *folder, struct gsn_source_events *events,
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
static void forget_news(struct folder *folder)
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
        if (folder->at[i].state == STATE_WAITING || folder->at[i].state == STATE_READY)
            return false;
    }
    return folder->replay;
}

static int folder_poll(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                       struct gsn_error *err)
{
    struct folder *const folder = self;
    int r = scan(folder, now_ms, err);

    if (r >= 0)
        r = tell(folder, events, err);
    if (r < 0)
        return r;
    folder->listed = true;
    forget_news(folder);
    *ret_ended = is_over(folder);
    return GSN_OK;
}

static struct file *find_ready(struct folder *folder, uint64_t item)
{
    for (size_t i = 0; i < folder->count; i++) {
        if (folder->at[i].item == item && folder->at[i].state == STATE_READY)
            return &folder->at[i];
    }
    return NULL;
}

static bool is_as_told(int fd, const struct file *file)
{
    struct stat st;
    struct stamp stamp;

    if (fstat(fd, &st) < 0)
        return false;
    stamp = stamp_of(&st);
    return same_stamp(&stamp, &file->stamp);
}

static int no_item(uint64_t item, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "item %llu is not ready", (unsigned long long)item);
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
        return no_item(item, err);
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
        set_state(file, STATE_WAITING, "changed while it was read");
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
        return no_item(item, err);
    file->state = STATE_DONE;
    return GSN_OK;
}

static void folder_free(struct folder *folder)
{
    if (!folder)
        return;
    for (size_t i = 0; i < folder->count; i++)
        gsn_free(folder->at[i].name);
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
    if (folder)
        folder->dir = gsn_strdup(dir);
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
    .close = folder_close,
};

const struct gsn_source_ops gsn_replay_folder_ops = {
    .kind = "replay",
    .open = replay_open,
    .poll = folder_poll,
    .read = folder_read,
    .acknowledge = folder_acknowledge,
    .close = folder_close,
};
