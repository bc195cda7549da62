/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/spool_temp.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/file.h"

static const char part_prefix[] = "partial-";

static int refused(const char *what, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_IO, "%s: %s", what, strerror(errno));
}

void gsn_spool_temp_drop(struct gsn_spool_temp *temp)
{
    if (temp->path)
        (void)unlink(temp->path);
    if (temp->fd >= 0)
        (void)close(temp->fd);
    gsn_free(temp->path);
    *temp = (struct gsn_spool_temp){ .fd = -1 };
}

/* Between opening and locking somebody may have removed or renamed it: then the lock is worth
 * nothing. */
static bool is_named(int fd, const char *path)
{
    struct stat there, here;

    return fstat(fd, &here) == 0 && lstat(path, &there) == 0 && here.st_ino == there.st_ino &&
           here.st_dev == there.st_dev;
}

static bool lock(int fd, const char *path, int how)
{
    int r;

    do
        r = flock(fd, LOCK_EX | how);
    while (r < 0 && errno == EINTR);
    return r == 0 && is_named(fd, path);
}

int gsn_spool_temp_make(const char *dir, struct gsn_spool_temp *ret_temp, struct gsn_error *err)
{
    enum { TRIES = 100 };

    /* A sweep may take the file for a dead one before it is locked. */
    for (int i = 0; i < TRIES; i++) {
        auto_temp temp = { -1, gsn_format("%s/XXXXXX", dir) };

        if (!temp.path)
            return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
        temp.fd = mkostemp(temp.path, O_CLOEXEC);
        if (temp.fd < 0)
            return refused(dir, err);
        if (lock(temp.fd, temp.path, 0)) {
            *ret_temp = temp;
            temp = (struct gsn_spool_temp){ .fd = -1 };
            return GSN_OK;
        }
    }
    return gsn_fail(err, GSN_E_IO, "%s: temporaries cannot be locked", dir);
}

/* Whether the name is that of a part; of this key, unless that is NULL. */
static bool read_name(const char *name, const struct gsn_digest *key, struct gsn_spool_part *part)
{
    const size_t prefix = sizeof part_prefix - 1;
    struct gsn_digest of;
    int end = 0;

    if (strncmp(name, part_prefix, prefix) != 0)
        return false;
    if (sscanf(name + prefix, "%64[0-9a-f]-%" SCNu64 "-%64[0-9a-f]%n", of.hex, &part->length,
               part->digest.hex, &end) != 3 ||
        name[prefix + (size_t)end] != '\0')
        return false;
    return !key || strcmp(of.hex, key->hex) == 0;
}

/* Whether this is a file that is still to be written: not a finished one (those are read-only), and
 * not one that has another name too. */
static bool is_unfinished(int fd, const struct gsn_spool_part *part)
{
    struct stat st;

    return fstat(fd, &st) == 0 && S_ISREG(st.st_mode) && st.st_nlink == 1 &&
           (st.st_mode & S_IWUSR) && st.st_size >= 0 && (uint64_t)st.st_size >= part->length;
}

/* takes path. */
static int open_part(char *path, const struct gsn_spool_part *part, struct gsn_spool_temp *ret_temp,
                     struct gsn_error *err)
{
    auto_temp temp = { -1, path };
    int r = gsn_file_reopen(path, &temp.fd, err);

    if (r < 0 || !lock(temp.fd, path, LOCK_NB)) {
        gsn_free(gsn_steal(&temp.path));
        return r < 0 ? r : gsn_fail(err, GSN_E_NOTFOUND, "another process writes this part");
    }
    if (!is_unfinished(temp.fd, part) || ftruncate(temp.fd, (off_t)part->length) < 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "this part is of no use");
    *ret_temp = temp;
    temp = (struct gsn_spool_temp){ .fd = -1 };
    return GSN_OK;
}

/* What is in the directory. */
struct entry {
    char *path;
    struct gsn_spool_part part;
    bool is_part;
    uint64_t bytes; /* of disk */
    struct timespec changed;
};

struct listing {
    size_t count, room;
    struct entry *at;
};

static void listing_done(struct listing *listing)
{
    for (size_t i = 0; i < listing->count; i++)
        gsn_free(listing->at[i].path);
    gsn_free(listing->at);
}
#define auto_listing __attribute__((cleanup(listing_done))) struct listing

static int list_add(struct listing *listing, const char *dir, const char *name,
                    const struct gsn_spool_part *part, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", dir, name);
    struct stat st;

    if (path && listing->count == listing->room) {
        const size_t room = listing->room ? 2 * listing->room : 16;
        struct entry *at = gsn_realloc_array(listing->at, room, sizeof *at);

        if (!at)
            return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
        listing->at = at;
        listing->room = room;
    }
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
    if (lstat(path, &st) < 0)
        return errno == ENOENT ? GSN_OK : refused(path, err);
    listing->at[listing->count++] =
        (struct entry){ .path = gsn_steal(&path),
                        .is_part = part != NULL,
                        .part = part ? *part : (struct gsn_spool_part){ 0 },
                        .bytes = (uint64_t)st.st_blocks * 512,
                        .changed = st.st_mtim };
    return GSN_OK;
}

static int list_all(DIR *open, const char *dir, const struct gsn_digest *key,
                    struct listing *listing, struct gsn_error *err)
{
    for (;;) {
        const struct dirent *entry;
        struct gsn_spool_part part;
        bool is_part;
        int r = GSN_OK;

        errno = 0;
        entry = readdir(open);
        if (!entry)
            return errno == 0 ? GSN_OK : refused(dir, err);
        is_part = read_name(entry->d_name, key, &part);
        if (entry->d_name[0] != '.' && (is_part || !key))
            r = list_add(listing, dir, entry->d_name, is_part ? &part : NULL, err);
        if (r < 0)
            return r;
    }
}

/* The parts of this key; without a key everything. */
static int list(const char *dir, const struct gsn_digest *key, struct listing *listing,
                struct gsn_error *err)
{
    DIR *const open = opendir(dir);
    int r;

    if (!open)
        return refused(dir, err);
    r = list_all(open, dir, key, listing, err);
    (void)closedir(open);
    return r;
}

static int by_length(const void *a, const void *b)
{
    const uint64_t x = ((const struct entry *)a)->part.length;
    const uint64_t y = ((const struct entry *)b)->part.length;

    return (x < y) - (x > y);
}

int gsn_spool_temp_find(const char *dir, const struct gsn_digest *key,
                        struct gsn_spool_temp *ret_temp, struct gsn_spool_part *ret_part,
                        struct gsn_error *err)
{
    auto_listing listing = { 0 };
    const int r = list(dir, key, &listing, err);

    if (r < 0)
        return r;
    if (listing.count > 0)
        qsort(listing.at, listing.count, sizeof *listing.at, by_length);
    for (size_t i = 0; i < listing.count; i++) {
        if (open_part(gsn_steal(&listing.at[i].path), &listing.at[i].part, ret_temp, err) >= 0) {
            *ret_part = listing.at[i].part;
            return GSN_OK;
        }
    }
    return gsn_fail(err, GSN_E_NOTFOUND, "no part is there");
}

int gsn_spool_temp_keep(const char *dir, const struct gsn_digest *key,
                        const struct gsn_spool_part *part, struct gsn_spool_temp *temp,
                        struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s%s-%" PRIu64 "-%s", dir, part_prefix, key->hex,
                                         part->length, part->digest.hex);
    int r = GSN_OK;

    if (!path)
        r = gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
    else if (rename(temp->path, path) < 0)
        r = refused(path, err);
    else
        gsn_free(gsn_steal(&temp->path));
    gsn_spool_temp_drop(temp);
    return r >= 0 ? gsn_spool_temp_sweep(dir, GSN_SPOOL_PARTS, err) : r;
}

/* One that cannot be opened (another user's, or gone by now) is left alone: no picture has to wait
 * for it. */
static int remove_dead(const char *path, struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };
    int fd = -1, r = gsn_file_open(path, &fd, &quiet);

    if (r < 0)
        return GSN_OK;
    if (lock(fd, path, LOCK_NB) && unlink(path) < 0 && errno != ENOENT)
        r = refused(path, err);
    (void)close(fd);
    return r;
}

/* Parts first, the newest of them first. */
static int by_age(const void *a, const void *b)
{
    const struct entry *const x = a, *const y = b;

    if (x->is_part != y->is_part)
        return x->is_part ? -1 : 1;
    if (x->changed.tv_sec != y->changed.tv_sec)
        return x->changed.tv_sec > y->changed.tv_sec ? -1 : 1;
    if (x->changed.tv_nsec != y->changed.tv_nsec)
        return x->changed.tv_nsec > y->changed.tv_nsec ? -1 : 1;
    return strcmp(x->path, y->path);
}

int gsn_spool_temp_sweep(const char *dir, size_t parts, struct gsn_error *err)
{
    const time_t oldest = time(NULL) - (time_t)GSN_SPOOL_PART_DAYS * 24 * 60 * 60;
    auto_listing listing = { 0 };
    int r = list(dir, NULL, &listing, err);

    if (r >= 0 && listing.count > 0)
        qsort(listing.at, listing.count, sizeof *listing.at, by_age);
    for (size_t i = 0; r >= 0 && i < listing.count; i++) {
        const struct entry *const entry = &listing.at[i];

        if (!entry->is_part || i >= parts || entry->changed.tv_sec < oldest)
            r = remove_dead(entry->path, err);
    }
    return r;
}

int gsn_spool_temp_parts(const char *dir, uint64_t *ret_bytes, struct gsn_error *err)
{
    auto_listing listing = { 0 };
    const int r = list(dir, NULL, &listing, err);
    uint64_t bytes = 0;

    for (size_t i = 0; r >= 0 && i < listing.count; i++)
        bytes += listing.at[i].is_part ? listing.at[i].bytes : 0;
    if (r >= 0)
        *ret_bytes = bytes;
    return r;
}

int gsn_spool_temp_forget(const char *dir, const struct gsn_digest *key, struct gsn_error *err)
{
    auto_listing listing = { 0 };
    int r = list(dir, key, &listing, err);

    for (size_t i = 0; r >= 0 && i < listing.count; i++)
        r = remove_dead(listing.at[i].path, err);
    return r;
}
