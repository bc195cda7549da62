/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/folder_look.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include "acquire/container.h"
#include "acquire/folder_source.h"
#include "acquire/natural.h"
#include "pipeline/core/file.h"

static struct gsn_folder_stamp stamp_of(const struct stat *st)
{
    return (struct gsn_folder_stamp){ st->st_dev, st->st_ino, st->st_size, st->st_mtim,
                                      st->st_ctim };
}

static bool same_time(struct timespec a, struct timespec b)
{
    return a.tv_sec == b.tv_sec && a.tv_nsec == b.tv_nsec;
}

static bool same_stamp(const struct gsn_folder_stamp *a, const struct gsn_folder_stamp *b)
{
    return a->device == b->device && a->inode == b->inode && a->size == b->size &&
           same_time(a->modified, b->modified) && same_time(a->changed, b->changed);
}

void gsn_folder_set_state(struct gsn_folder_file *file, enum gsn_folder_state state,
                          const char *reason)
{
    if (file->state != state || strcmp(file->reason, reason) != 0)
        file->told = false;
    file->state = state;
    file->action[0] = '\0';
    (void)snprintf(file->reason, sizeof file->reason, "%s", reason);
}

static void bar(struct gsn_folder_file *file, const char *reason, const char *action)
{
    gsn_folder_set_state(file, GSN_FILE_BARRED, reason);
    (void)snprintf(file->action, sizeof file->action, "%s", action);
}

/* What a sentence of gsn_file_open_in() asks for. The name stands beside it already. */
static void bar_unreadable(const struct gsn_folder *folder, struct gsn_folder_file *file,
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
    bar(file, reason, action);
}

int gsn_folder_open_file(const struct gsn_folder *folder, const struct gsn_folder_file *file,
                         int *ret_fd, struct gsn_error *err)
{
    return gsn_file_open_in(folder->dir, file->name, ret_fd, err);
}

/* Opening asks a server for the file as it is now, where a look may have been told what it was. */
static int judge(const struct gsn_folder *folder, const struct gsn_folder_file *file,
                 struct gsn_container *ret_container, bool *ret_same, struct gsn_error *err)
{
    int fd = -1, r = gsn_folder_open_file(folder, file, &fd, err);

    if (r < 0)
        return r;
    *ret_same = gsn_folder_is_as_told(fd, file);
    r = gsn_container_check_fd(fd, ret_container, err);
    (void)close(fd);
    return r;
}

/* The file kept still for long enough: is it whole, and is it for us at all? */
static int settle(const struct gsn_folder *folder, struct gsn_folder_file *file, bool patient,
                  struct gsn_error *err)
{
    struct gsn_container container;
    struct gsn_error why = { 0 };
    bool same = true;
    const int r = judge(folder, file, &container, &same, &why);

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
        gsn_folder_set_state(file, GSN_FILE_WAITING, "changed while it was looked at");
        return GSN_OK;
    }
    if (container.kind == GSN_CONTAINER_UNKNOWN && !gsn_name_is_picture(file->name)) {
        gsn_folder_set_state(file, GSN_FILE_SKIPPED, "is no picture and is left alone");
        return GSN_OK;
    }
    gsn_folder_set_state(file, container.complete || !patient ? GSN_FILE_READY : GSN_FILE_WAITING,
                         container.reason);
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
static int settle_hidden(const struct gsn_folder *folder, struct gsn_folder_file *file,
                         struct gsn_error *err)
{
    struct gsn_container container = { .kind = GSN_CONTAINER_UNKNOWN };
    struct gsn_error why = { 0 };
    bool same = true;
    const int r = judge(folder, file, &container, &same, &why);

    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    if (r >= 0 && container.kind != GSN_CONTAINER_UNKNOWN)
        bar(file,
            file->name[0] == '.'
                ? "is a picture whose name begins with a dot, as those of unfinished copies do"
                : "is a picture whose name ends as those of unfinished copies do",
            file->name[0] == '.' ? "rename it without the dot when it is a panel, else remove it"
                                 : "rename it without that when it is a panel, else remove it");
    else
        file->state = GSN_FILE_SKIPPED;
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
static void make_key(struct gsn_folder_file *file)
{
    const struct gsn_folder_stamp *const stamp = &file->stamp;

    (void)snprintf(file->key, sizeof file->key, "file %llx:%llx %llu %lld.%09ld %lld.%09ld",
                   (unsigned long long)stamp->device, (unsigned long long)stamp->inode,
                   (unsigned long long)stamp->size, (long long)stamp->modified.tv_sec,
                   stamp->modified.tv_nsec, (long long)stamp->changed.tv_sec,
                   stamp->changed.tv_nsec);
}

static bool is_known(const struct gsn_folder *folder, const struct gsn_folder_file *file)
{
    return file->key[0] && folder->options.is_known &&
           folder->options.is_known(folder->options.context, file->key);
}

static void start_waiting(struct gsn_folder *folder, struct gsn_folder_file *file,
                          const struct stat *st, int64_t now_ms)
{
    /* Another content under a known name is another item. */
    if (file->state == GSN_FILE_DONE)
        file->item = ++folder->last_item;
    gsn_folder_set_state(file, GSN_FILE_WAITING, "a second look has yet to find it unchanged");
    file->stamp = stamp_of(st);
    file->unsettled = false;
    file->since_ms = now_ms;
    file->key[0] = '\0';
    if (S_ISREG(st->st_mode) && is_trusted_time(&st->st_mtim))
        make_key(file);
    if (S_ISREG(st->st_mode) && is_known(folder, file))
        gsn_folder_set_state(file, GSN_FILE_DONE, "");
    if (S_ISREG(st->st_mode) && is_transfer(file->name)) {
        gsn_folder_set_state(file, GSN_FILE_HIDDEN, "");
        file->told = true;
    } else if (S_ISDIR(st->st_mode)) {
        gsn_folder_set_state(file, GSN_FILE_SKIPPED, "is a folder and is not looked into");
    } else if (!S_ISREG(st->st_mode) && !S_ISLNK(st->st_mode)) {
        gsn_folder_set_state(file, GSN_FILE_SKIPPED, "is no regular file and is left alone");
    }
}

static int look_at(struct gsn_folder *folder, struct gsn_folder_file *file, const struct stat *st,
                   int64_t now_ms, struct gsn_error *err)
{
    const struct gsn_folder_stamp stamp = stamp_of(st);
    /* A folder changes whenever something in it does; once told is enough. */
    const bool same =
        (same_stamp(&stamp, &file->stamp) && !file->unsettled) || S_ISDIR(st->st_mode);
    const int64_t still_ms = now_ms - file->since_ms;

    file->present = true;
    if (!same) {
        start_waiting(folder, file, st, now_ms);
        return GSN_OK;
    }
    if (file->state == GSN_FILE_HIDDEN)
        return still_ms < folder->options.patience_ms ? GSN_OK : settle_hidden(folder, file, err);
    if (file->state == GSN_FILE_BARRED && is_transfer(file->name))
        return GSN_OK;
    if (file->state != GSN_FILE_BARRED &&
        (file->state != GSN_FILE_WAITING || still_ms < folder->settle_ms))
        return GSN_OK;
    return settle(folder, file, still_ms < folder->options.patience_ms, err);
}

/* Where the name is, or belongs. */
static size_t find_place(const struct gsn_folder *folder, const char *name, bool *ret_found)
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

static int insert(struct gsn_folder *folder, size_t place, const char *name, const struct stat *st,
                  int64_t now_ms, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(name);
    struct gsn_folder_file *file;

    if (copy && folder->count == folder->room) {
        const size_t room = folder->room ? 2 * folder->room : 16;
        struct gsn_folder_file *at = gsn_realloc_array(folder->at, room, sizeof *at);

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
    *file = (struct gsn_folder_file){ .name = gsn_steal(&copy),
                                      .item = ++folder->last_item,
                                      .present = true };
    start_waiting(folder, file, st, now_ms);
    return GSN_OK;
}

static int look_at_name(struct gsn_folder *folder, int dir_fd, const char *name, int64_t now_ms,
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
    return insert(folder, place, name, &st, now_ms, err);
}

static int list(struct gsn_folder *folder, DIR *dir, int64_t now_ms, struct gsn_error *err)
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

int gsn_folder_look(struct gsn_folder *folder, int64_t now_ms, struct gsn_error *err)
{
    DIR *const dir = opendir(folder->dir);
    int r;

    if (!dir)
        return gsn_fail(err, GSN_E_IO, "%s: %s", folder->dir, strerror(errno));
    folder->settle_ms = gsn_folder_settle_ms(folder->dir, folder->options.settle_ms);
    for (size_t i = 0; i < folder->count; i++)
        folder->at[i].present = false;
    r = list(folder, dir, now_ms, err);
    (void)closedir(dir);
    return r;
}

bool gsn_folder_is_as_told(int fd, const struct gsn_folder_file *file)
{
    struct stat st;
    struct gsn_folder_stamp stamp;

    if (fstat(fd, &st) < 0)
        return false;
    stamp = stamp_of(&st);
    return same_stamp(&stamp, &file->stamp);
}
