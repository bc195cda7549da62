/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/spool.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "pipeline/core/file.h"

enum { PIECE = 1 << 20 };

struct gsn_spool {
    char *objects, *temporaries; /* directories */
    uint64_t reserve;
    DIR *lock; /* the directory of temporaries, locked (shared) while the spool is open */
};

/* Where the bytes come from: fills up to size bytes from offset, 0 at the end. */
struct feed {
    int (*read)(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                struct gsn_error *err);
    void *context;
    uint64_t size; /* announced */
};

static int refused(const char *what, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_IO, "%s: %s", what, strerror(errno));
}

static int sweep(const struct gsn_spool *spool, struct gsn_error *err)
{
    const struct dirent *entry;

    rewinddir(spool->lock);
    while ((entry = readdir(spool->lock))) {
        if (entry->d_name[0] != '.' && unlinkat(dirfd(spool->lock), entry->d_name, 0) < 0)
            return refused(entry->d_name, err);
    }
    return GSN_OK;
}

/* Who gets the lock alone knows that every temporary was left by a crash. */
static int lock_and_sweep(struct gsn_spool *spool, struct gsn_error *err)
{
    int r = GSN_OK;

    spool->lock = opendir(spool->temporaries);
    if (!spool->lock)
        return refused(spool->temporaries, err);
    if (flock(dirfd(spool->lock), LOCK_EX | LOCK_NB) == 0)
        r = sweep(spool, err);
    else if (errno != EWOULDBLOCK)
        return refused(spool->temporaries, err);
    if (r >= 0 && flock(dirfd(spool->lock), LOCK_SH) < 0)
        return refused(spool->temporaries, err);
    return r;
}

int gsn_spool_open(const char *dir, uint64_t reserve_bytes, struct gsn_spool **ret_spool,
                   struct gsn_error *err)
{
    gsn_auto(gsn_spool) spool = gsn_alloc_array(1, sizeof *spool);
    int r;

    if (spool) {
        spool->objects = gsn_format("%s/objects", dir);
        spool->temporaries = gsn_format("%s/objects/tmp", dir);
        spool->reserve = reserve_bytes;
    }
    if (!spool || !spool->objects || !spool->temporaries)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a spool");
    r = gsn_file_mkdir(spool->temporaries, err);
    if (r >= 0)
        r = gsn_file_sync_dir(spool->objects, err);
    if (r >= 0)
        r = gsn_file_sync_dir(dir, err);
    if (r >= 0)
        r = lock_and_sweep(spool, err);
    if (r < 0)
        return r;
    *ret_spool = gsn_steal(&spool);
    return GSN_OK;
}

void gsn_spool_free(struct gsn_spool *spool)
{
    if (!spool)
        return;
    if (spool->lock)
        (void)closedir(spool->lock);
    gsn_free(spool->temporaries);
    gsn_free(spool->objects);
    gsn_free(spool);
}

static int check_reserve(const struct gsn_spool *spool, uint64_t size, const char *name,
                         struct gsn_error *err)
{
    const double MiB = 1024.0 * 1024.0;
    struct statvfs fs;
    uint64_t free_bytes;

    if (statvfs(spool->objects, &fs) < 0)
        return refused(spool->objects, err);
    free_bytes = (uint64_t)fs.f_bavail * fs.f_frsize;
    if (free_bytes >= size && free_bytes - size >= spool->reserve)
        return GSN_OK;
    return gsn_fail(err, GSN_E_LIMIT,
                    "%.200s: with its %.1f MiB the disk is below its reserve of %.1f MiB (%.1f MiB "
                    "are free)",
                    name, (double)size / MiB, (double)spool->reserve / MiB,
                    (double)free_bytes / MiB);
}

static int write_all(int fd, const uint8_t *bytes, size_t size, const char *name,
                     struct gsn_error *err)
{
    for (size_t done = 0; done < size;) {
        const ssize_t put = write(fd, bytes + done, size - done);

        if (put < 0 && errno == EINTR)
            continue;
        if (put < 0)
            return refused(name, err);
        done += (size_t)put;
    }
    return GSN_OK;
}

/* Passes the feed through the hash, and into fd unless that is -1. */
static int copy(const struct feed *feed, int fd, const char *name, struct gsn_spooled *ret_spooled,
                struct gsn_error *err)
{
    gsn_auto(gsn_hash) hash = NULL;
    gsn_auto_mem(uint8_t) piece = gsn_alloc(PIECE);
    uint64_t size = 0;
    int r = gsn_hash_new(&hash, err);

    if (!piece)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", name);
    for (size_t got = 1; r >= 0 && got > 0 && size <= feed->size; size += got) {
        r = feed->read(feed->context, size, piece, PIECE, &got, err);
        if (r >= 0)
            r = gsn_hash_add(hash, piece, got, err);
        if (r >= 0 && fd >= 0)
            r = write_all(fd, piece, got, name, err);
        if (r < 0)
            return r;
    }
    if (r >= 0 && size != feed->size)
        r = gsn_fail(err, GSN_E_IO, "%s: %llu bytes came where %llu were announced", name,
                     (unsigned long long)size, (unsigned long long)feed->size);
    if (r >= 0)
        r = gsn_hash_end(hash, &ret_spooled->digest, err);
    ret_spooled->size = size;
    return r;
}

/* fd is closed. */
static int fill_temporary(int fd, const struct feed *feed, const char *name,
                          struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    int r = copy(feed, fd, name, ret_spooled, err);

    if (r >= 0 && (fchmod(fd, 0444) < 0 || fsync(fd) < 0))
        r = refused(name, err);
    if (close(fd) < 0 && r >= 0)
        r = refused(name, err);
    return r;
}

struct bytes {
    const uint8_t *at;
    uint64_t size;
};

static int read_bytes(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                      struct gsn_error *err)
{
    const struct bytes *const bytes = context;
    const uint64_t left = bytes->size - offset;

    (void)err;
    *ret_got = left < size ? (size_t)left : size;
    memcpy(buffer, bytes->at + offset, *ret_got);
    return GSN_OK;
}

static int read_fd(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                   struct gsn_error *err)
{
    ssize_t got;

    do
        got = pread(*(const int *)context, buffer, size, (off_t)offset);
    while (got < 0 && errno == EINTR);
    if (got < 0)
        return refused("reading", err);
    *ret_got = (size_t)got;
    return GSN_OK;
}

static int size_of(int fd, const char *name, uint64_t *ret_size, struct gsn_error *err)
{
    struct stat st;

    if (fstat(fd, &st) < 0)
        return refused(name, err);
    *ret_size = (uint64_t)st.st_size;
    return GSN_OK;
}

/* Reads what lies under the name of these bytes. It is synced too: whoever wrote it may have died
 * before he came to that. */
static int compare(int fd, const char *path, const struct gsn_spooled *spooled, bool *ret_same,
                   struct gsn_error *err)
{
    struct feed feed = { .read = read_fd, .context = &fd };
    struct gsn_spooled there = { 0 };
    int r = size_of(fd, path, &feed.size, err);

    if (r < 0)
        return r;
    if (feed.size != spooled->size) {
        *ret_same = false;
        return GSN_OK;
    }
    r = copy(&feed, -1, path, &there, err);
    if (r >= 0 && fsync(fd) < 0)
        r = refused(path, err);
    if (r >= 0)
        *ret_same = strcmp(there.digest.hex, spooled->digest.hex) == 0;
    return r;
}

static int look_for(const char *path, const struct gsn_spooled *spooled,
                    enum gsn_spool_found *ret_found, struct gsn_error *err)
{
    bool same = false;
    int fd = -1, r = gsn_file_open(path, &fd, err);

    if (r == GSN_E_NOTFOUND) {
        *ret_found = GSN_SPOOL_NEW;
        return GSN_OK;
    }
    if (r < 0)
        return r;
    r = compare(fd, path, spooled, &same, err);
    (void)close(fd);
    if (r >= 0)
        *ret_found = same ? GSN_SPOOL_SAME : GSN_SPOOL_MENDED;
    return r;
}

static int make_shelf(const struct gsn_spool *spool, const char *shelf, struct gsn_error *err)
{
    if (mkdir(shelf, 0755) == 0)
        return gsn_file_sync_dir(spool->objects, err);
    return errno == EEXIST ? GSN_OK : refused(shelf, err);
}

/* Afterwards the temporary's name is free, whatever happened. */
static int shelve(const struct gsn_spool *spool, const char *temporary, struct gsn_spooled *spooled,
                  struct gsn_error *err)
{
    gsn_auto_mem(char) shelf = gsn_format("%s/%.2s", spool->objects, spooled->digest.hex);
    gsn_auto_mem(char) path =
        gsn_format("%s/%.2s/%s", spool->objects, spooled->digest.hex, spooled->digest.hex + 2);
    int r = GSN_OK;

    if (!shelf || !path)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    if (r >= 0)
        r = make_shelf(spool, shelf, err);
    if (r >= 0)
        r = look_for(path, spooled, &spooled->found, err);
    if (r >= 0 && spooled->found != GSN_SPOOL_SAME && rename(temporary, path) < 0)
        r = refused(path, err);
    if (r < 0 || spooled->found == GSN_SPOOL_SAME)
        (void)unlink(temporary);
    if (r >= 0)
        r = gsn_file_sync_dir(shelf, err);
    return r >= 0 ? gsn_file_sync_dir(spool->temporaries, err) : r;
}

static int take(struct gsn_spool *spool, const struct feed *feed, const char *name,
                struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    gsn_auto_mem(char) temporary = gsn_format("%s/XXXXXX", spool->temporaries);
    struct gsn_spooled spooled = { 0 };
    int fd, r;

    if (!temporary)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", name);
    if (feed->size == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s is empty", name);
    r = check_reserve(spool, feed->size, name, err);
    if (r < 0)
        return r;
    fd = mkostemp(temporary, O_CLOEXEC);
    if (fd < 0)
        return refused(spool->temporaries, err);
    r = fill_temporary(fd, feed, name, &spooled, err);
    if (r < 0) {
        (void)unlink(temporary);
        return r;
    }
    r = shelve(spool, temporary, &spooled, err);
    if (r < 0)
        return r;
    *ret_spooled = spooled;
    return GSN_OK;
}

int gsn_spool_take(struct gsn_spool *spool, const void *bytes, uint64_t size, const char *name,
                   struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    struct bytes all = { bytes, size };
    const struct feed feed = { read_bytes, &all, size };

    return take(spool, &feed, name, ret_spooled, err);
}

int gsn_spool_take_fd(struct gsn_spool *spool, int fd, const char *name,
                      struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    struct feed feed = { read_fd, &fd, 0 };
    const int r = size_of(fd, name, &feed.size, err);

    return r < 0 ? r : take(spool, &feed, name, ret_spooled, err);
}

struct item {
    struct gsn_source *source;
    uint64_t number;
};

static int read_item(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                     struct gsn_error *err)
{
    const struct item *const item = context;

    return gsn_source_read(item->source, item->number, offset, buffer, size, ret_got, err);
}

int gsn_spool_take_item(struct gsn_spool *spool, struct gsn_source *source,
                        const struct gsn_source_event *ready, struct gsn_spooled *ret_spooled,
                        struct gsn_error *err)
{
    struct item item = { source, ready->item };
    const struct feed feed = { read_item, &item, ready->size };

    return take(spool, &feed, ready->name, ret_spooled, err);
}
