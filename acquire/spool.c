/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Bytes made durable once, under the name of their SHA-256.
 *
 * Steps.
 * 1. One pass: a piece of 256 KiB goes from its feed into the hash and into a temporary file, which
 * is locked (flock) as long as somebody writes it. The disk is told to begin every 8 MiB.
 * 2. fsync of the file, rename to objects/ab/cdef... (a fan-out of 256 directories, all made and
 * synced when the spool is opened), fsync of that directory. Only then is the picture said to be
 * there.
 * 3. The same bytes again are read back and compared; damaged ones are replaced.
 * 4. A copy that its source broke off stays as partial-KEY-LENGTH-DIGEST. The next copy of that key
 *    hashes the part, compares its last 64 KiB with the source and goes on behind it.
 * 5. A sweep removes what nobody holds a lock on, but for the 8 newest parts of the last 7 days.
 *
 * How it fails: below the reserve of disk nothing is written (GSN_E_LIMIT), after parts were given
 * up for it. A crash anywhere leaves a temporary that the next sweep takes, never half an object
 * (tests/power cuts the power between all of these calls). Cost: tests/bench/ingest.c. */
#include "acquire/spool.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/error.h"
#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"

/* Where the bytes come from: fills up to size bytes from offset, 0 at the end. */
struct feed {
    int (*read)(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                struct gsn_error *err);
    void *context;
    uint64_t size; /* announced */
};

/* A piece stays in the cache between reading, hashing and writing. The disk is told to begin every
 * WINDOW, so that the last sync finds most of the work done. */
enum { PIECE = 1 << 18, WINDOW = 1 << 23, TAIL = 1 << 16 };

/* How far it is. */
struct copy_pass {
    struct gsn_hash *hash; /* of the first done bytes */
    uint64_t done;
    int broken_off;               /* the feed failed, not the disk */
    void (*alive)(void *context); /* told after every piece; NULL: nobody is */
    void *alive_context;
    uint8_t *piece;
    uint8_t tail[TAIL]; /* room to compare a part's end */
};

/* The files in DIR/objects/tmp.
 *
 * Whoever writes one holds a lock (flock) on it; so a sweep, by any process and at any time, tells
 * what a crash left from what is being written. A part that is kept is named
 * partial-KEY-LENGTH-DIGEST: KEY says of what, and the first LENGTH bytes are good when their
 * SHA-256 is DIGEST, whatever a crash did to the file meanwhile. */

enum {
    MOST_PARTS = 8, /* the newest that are kept */
    PART_DAYS = 7,  /* and not longer than this */
};

/* One that is open for writing and locked. */
struct temporary {
    int fd; /* -1: none */
    char *path;
};

struct part {
    uint64_t length;
    struct gsn_digest digest;
};

/* Removes its name, unless the path is NULL by now, and closes it. Nothing for an empty struct. */
static void drop_temp(struct temporary *temp)
{
    if (temp->path)
        (void)unlink(temp->path);
    if (temp->fd >= 0)
        (void)close(temp->fd);
    gsn_free(temp->path);
    *temp = (struct temporary){ .fd = -1 };
}

#define auto_temp __attribute__((cleanup(drop_temp))) struct temporary

/* The pass. */

/* A descriptor as a feed of this size; context is its address. */
static int read_fd(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                   struct gsn_error *err)
{
    ssize_t got;

    do
        got = pread(*(const int *)context, buffer, size, (off_t)offset);
    while (got < 0 && errno == EINTR);
    if (got < 0)
        return gsn_fail(err, GSN_E_IO, "reading: %s", strerror(errno));
    *ret_got = (size_t)got;
    return GSN_OK;
}

static void copy_pass_free(struct copy_pass *copy)
{
    if (!copy)
        return;
    gsn_hash_free(copy->hash);
    gsn_free(copy->piece);
    gsn_free(copy);
}

GSN_DEFINE_AUTO(copy_pass);

static int make_pass(struct copy_pass **ret_copy, struct gsn_error *err)
{
    gsn_auto(copy_pass) copy = gsn_alloc_array(1, sizeof *copy);
    int r;

    if (copy)
        copy->piece = gsn_alloc(PIECE);
    if (!copy || !copy->piece)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a copy");
    r = gsn_hash_new(&copy->hash, err);
    if (r >= 0)
        *ret_copy = gsn_steal(&copy);
    return r;
}

/* Back to the first byte. */
static int rewind_pass(struct copy_pass *copy, struct gsn_error *err)
{
    gsn_hash_free(gsn_steal(&copy->hash));
    copy->done = 0;
    return gsn_hash_new(&copy->hash, err);
}

static int write_all(int fd, uint64_t offset, const uint8_t *bytes, size_t size, const char *name,
                     struct gsn_error *err)
{
    for (size_t done = 0; done < size;) {
        const ssize_t put = pwrite(fd, bytes + done, size - done, (off_t)(offset + done));

        if (put < 0 && errno == EINTR)
            continue;
        if (put < 0)
            return gsn_fail(err, GSN_E_IO, "%s: %s", name, strerror(errno));
        done += (size_t)put;
    }
    return GSN_OK;
}

/* Only a hint: what goes wrong shows at the sync. */
static void start_writing(int fd, uint64_t before, uint64_t now)
{
    if (before / WINDOW != now / WINDOW)
        (void)sync_file_range(fd, (off_t)(before / WINDOW * WINDOW), WINDOW, SYNC_FILE_RANGE_WRITE);
}

/* One piece; ret_got is 0 at the end. */
static int copy_piece(struct copy_pass *copy, const struct feed *feed, int fd, const char *name,
                      size_t *ret_got, struct gsn_error *err)
{
    int r = feed->read(feed->context, copy->done, copy->piece, PIECE, ret_got, err);

    if (r < 0) {
        copy->broken_off = 1;
        return r;
    }
    if (fd >= 0)
        r = write_all(fd, copy->done, copy->piece, *ret_got, name, err);
    if (r >= 0)
        r = gsn_hash_add(copy->hash, copy->piece, *ret_got, err);
    if (r < 0)
        return r;
    if (fd >= 0)
        start_writing(fd, copy->done, copy->done + *ret_got);
    copy->done += *ret_got;
    if (copy->alive)
        copy->alive(copy->alive_context);
    return GSN_OK;
}

/* Goes on to the end of the feed, which must come where it was announced. fd -1: hashes only.
 * Fails with the feed's error, GSN_E_IO. */
static int run_pass(struct copy_pass *copy, const struct feed *feed, int fd, const char *name,
                    struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t got = 1; r >= 0 && got > 0 && copy->done <= feed->size;)
        r = copy_piece(copy, feed, fd, name, &got, err);
    if (r >= 0 && copy->done != feed->size)
        r = gsn_fail(err, GSN_E_IO, "%s: %llu bytes came where %llu were announced", name,
                     (unsigned long long)copy->done, (unsigned long long)feed->size);
    return r;
}

static int read_all(const struct feed *feed, uint64_t offset, uint8_t *to, size_t size,
                    size_t *ret_got, struct gsn_error *err)
{
    size_t got = 1;

    for (*ret_got = 0; *ret_got < size && got > 0; *ret_got += got) {
        const int r =
            feed->read(feed->context, offset + *ret_got, to + *ret_got, size - *ret_got, &got, err);

        if (r < 0)
            return r;
    }
    return GSN_OK;
}

/* Whether the bytes before copy->done are in the feed as they are in fd, by the last of them. */
static int check_fits(struct copy_pass *copy, const struct feed *feed, int fd, int *ret_fits,
                      struct gsn_error *err)
{
    const struct feed ours = { read_fd, &fd, copy->done };
    const size_t size = copy->done < TAIL ? (size_t)copy->done : TAIL;
    size_t there = 0, here = 0;
    int r = read_all(feed, copy->done - size, copy->piece, size, &there, err);

    if (r < 0) {
        copy->broken_off = 1;
        return r;
    }
    r = read_all(&ours, copy->done - size, copy->tail, size, &here, err);
    if (r >= 0)
        *ret_fits = there == size && here == size && memcmp(copy->piece, copy->tail, size) == 0;
    return r;
}

/* Temporaries and parts. */

static const char part_prefix[] = "partial-";

static int fail_errno(const char *what, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_IO, "%s: %s", what, strerror(errno));
}

/* Between opening and locking somebody may have removed or renamed it: then the lock is worth
 * nothing. */
static bool is_named(int fd, const char *path)
{
    struct stat there, here;

    return fstat(fd, &here) == 0 && lstat(path, &there) == 0 && here.st_ino == there.st_ino &&
           here.st_dev == there.st_dev;
}

static bool lock_file(int fd, const char *path, int how)
{
    int r;

    do
        r = flock(fd, LOCK_EX | how);
    while (r < 0 && errno == EINTR);
    return r == 0 && is_named(fd, path);
}

/* gives: a new, empty one. */
static int make_temp(const char *dir, struct temporary *ret_temp, struct gsn_error *err)
{
    enum { TRIES = 100 };

    /* A sweep may take the file for a dead one before it is locked. */
    for (int i = 0; i < TRIES; i++) {
        auto_temp temp = { -1, gsn_format("%s/XXXXXX", dir) };

        if (!temp.path)
            return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
        temp.fd = mkostemp(temp.path, O_CLOEXEC);
        if (temp.fd < 0)
            return fail_errno(dir, err);
        if (lock_file(temp.fd, temp.path, 0)) {
            *ret_temp = temp;
            temp = (struct temporary){ .fd = -1 };
            return GSN_OK;
        }
    }
    return gsn_fail(err, GSN_E_IO, "%s: temporaries cannot be locked", dir);
}

/* Whether the name is that of a part; of this key, unless that is NULL. */
static bool read_name(const char *name, const struct gsn_digest *key, struct part *part)
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
static bool is_unfinished(int fd, const struct part *part)
{
    struct stat st;

    return fstat(fd, &st) == 0 && S_ISREG(st.st_mode) && st.st_nlink == 1 &&
           (st.st_mode & S_IWUSR) && st.st_size >= 0 && (uint64_t)st.st_size >= part->length;
}

/* takes path. */
static int open_part(char *path, const struct part *part, struct temporary *ret_temp,
                     struct gsn_error *err)
{
    auto_temp temp = { -1, path };
    int r = gsn_file_reopen(path, &temp.fd, err);

    if (r < 0 || !lock_file(temp.fd, path, LOCK_NB)) {
        gsn_free(gsn_steal(&temp.path));
        return r < 0 ? r : gsn_fail(err, GSN_E_NOTFOUND, "another process writes this part");
    }
    if (!is_unfinished(temp.fd, part) || ftruncate(temp.fd, (off_t)part->length) < 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "this part is of no use");
    *ret_temp = temp;
    temp = (struct temporary){ .fd = -1 };
    return GSN_OK;
}

/* What is in the directory of temporaries. */
struct entry {
    char *path;
    struct part part;
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
                    const struct part *part, struct gsn_error *err)
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
        return errno == ENOENT ? GSN_OK : fail_errno(path, err);
    listing->at[listing->count++] = (struct entry){ .path = gsn_steal(&path),
                                                    .is_part = part != NULL,
                                                    .part = part ? *part : (struct part){ 0 },
                                                    .bytes = (uint64_t)st.st_blocks * 512,
                                                    .changed = st.st_mtim };
    return GSN_OK;
}

static int list_all(DIR *open, const char *dir, const struct gsn_digest *key,
                    struct listing *listing, struct gsn_error *err)
{
    for (;;) {
        const struct dirent *entry;
        struct part part;
        bool is_part;
        int r = GSN_OK;

        errno = 0;
        entry = readdir(open);
        if (!entry)
            return errno == 0 ? GSN_OK : fail_errno(dir, err);
        is_part = read_name(entry->d_name, key, &part);
        if (entry->d_name[0] != '.' && (is_part || !key))
            r = list_add(listing, dir, entry->d_name, is_part ? &part : NULL, err);
        if (r < 0)
            return r;
    }
}

/* The parts of this key; without a key everything. */
static int list_parts(const char *dir, const struct gsn_digest *key, struct listing *listing,
                      struct gsn_error *err)
{
    DIR *const open = opendir(dir);
    int r;

    if (!open)
        return fail_errno(dir, err);
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

/* gives: the longest part of this key that nobody else writes, cut to its length.
 * Fails with GSN_E_NOTFOUND. */
static int find_part(const char *dir, const struct gsn_digest *key, struct temporary *ret_temp,
                     struct part *ret_part, struct gsn_error *err)
{
    auto_listing listing = { 0 };
    const int r = list_parts(dir, key, &listing, err);

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

/* One that cannot be opened (another user's, or gone by now) is left alone: no picture has to wait
 * for it. */
static int remove_dead(const char *path, struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };
    int fd = -1, r = gsn_file_open(path, &fd, &quiet);

    if (r < 0)
        return GSN_OK;
    if (lock_file(fd, path, LOCK_NB) && unlink(path) < 0 && errno != ENOENT)
        r = fail_errno(path, err);
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

/* Removes what nobody writes any more: everything but the parts newest parts younger than
 * PART_DAYS. */
static int sweep_temps(const char *dir, size_t parts, struct gsn_error *err)
{
    const time_t oldest = time(NULL) - (time_t)PART_DAYS * 24 * 60 * 60;
    auto_listing listing = { 0 };
    int r = list_parts(dir, NULL, &listing, err);

    if (r >= 0 && listing.count > 0)
        qsort(listing.at, listing.count, sizeof *listing.at, by_age);
    for (size_t i = 0; r >= 0 && i < listing.count; i++) {
        const struct entry *const entry = &listing.at[i];

        if (!entry->is_part || i >= parts || entry->changed.tv_sec < oldest)
            r = remove_dead(entry->path, err);
    }
    return r;
}

/* Lets it stay as this part; takes temp, whose struct is empty afterwards. */
static int keep_temp(const char *dir, const struct gsn_digest *key, const struct part *part,
                     struct temporary *temp, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s%s-%" PRIu64 "-%s", dir, part_prefix, key->hex,
                                         part->length, part->digest.hex);
    int r = GSN_OK;

    if (!path)
        r = gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
    else if (rename(temp->path, path) < 0)
        r = fail_errno(path, err);
    else
        gsn_free(gsn_steal(&temp->path));
    drop_temp(temp);
    return r >= 0 ? sweep_temps(dir, MOST_PARTS, err) : r;
}

/* How many bytes of disk all parts take. */
static int measure_parts(const char *dir, uint64_t *ret_bytes, struct gsn_error *err)
{
    auto_listing listing = { 0 };
    const int r = list_parts(dir, NULL, &listing, err);
    uint64_t bytes = 0;

    for (size_t i = 0; r >= 0 && i < listing.count; i++)
        bytes += listing.at[i].is_part ? listing.at[i].bytes : 0;
    if (r >= 0)
        *ret_bytes = bytes;
    return r;
}

/* Removes the parts of this key. */
static int forget_parts(const char *dir, const struct gsn_digest *key, struct gsn_error *err)
{
    auto_listing listing = { 0 };
    int r = list_parts(dir, key, &listing, err);

    for (size_t i = 0; r >= 0 && i < listing.count; i++)
        r = remove_dead(listing.at[i].path, err);
    return r;
}

struct gsn_spool {
    char *objects, *temporaries; /* directories */
    uint64_t reserve;
    void (*alive)(void *context);
    void *alive_context;
};

/* The spool. */

/* All at once, so that no panel has to wait for its directory to be durable. */
static int make_fan_out(const struct gsn_spool *spool, struct gsn_error *err)
{
    enum { FAN_OUT = 256 };

    for (unsigned i = 0; i < FAN_OUT; i++) {
        gsn_auto_mem(char) fan = gsn_format("%s/%02x", spool->objects, i);

        if (!fan)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
        if (mkdir(fan, 0755) < 0 && errno != EEXIST)
            return fail_errno(fan, err);
    }
    return GSN_OK;
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
        r = make_fan_out(spool, err);
    /* Also when nothing had to be made: whoever made it may have died before this. */
    if (r >= 0)
        r = gsn_file_sync_dir(spool->objects, err);
    if (r >= 0)
        r = gsn_file_sync_dir(dir, err);
    if (r >= 0)
        r = sweep_temps(spool->temporaries, MOST_PARTS, err);
    if (r < 0)
        return r;
    *ret_spool = gsn_steal(&spool);
    return GSN_OK;
}

void gsn_spool_free(struct gsn_spool *spool)
{
    if (!spool)
        return;
    gsn_free(spool->temporaries);
    gsn_free(spool->objects);
    gsn_free(spool);
}

void gsn_spool_watch(struct gsn_spool *spool, void (*alive)(void *context), void *context)
{
    spool->alive = alive;
    spool->alive_context = context;
}

static int start_pass(const struct gsn_spool *spool, struct copy_pass **ret_copy,
                      struct gsn_error *err)
{
    const int r = make_pass(ret_copy, err);

    if (r >= 0) {
        (*ret_copy)->alive = spool->alive;
        (*ret_copy)->alive_context = spool->alive_context;
    }
    return r;
}

/* spare: bytes that could be freed. */
static int check_reserve(const struct gsn_spool *spool, uint64_t size, uint64_t spare,
                         const char *name, struct gsn_error *err)
{
    const double MiB = 1024.0 * 1024.0;
    struct statvfs fs;
    uint64_t free_bytes;

    if (statvfs(spool->objects, &fs) < 0)
        return fail_errno(spool->objects, err);
    free_bytes = (uint64_t)fs.f_bavail * fs.f_frsize + spare;
    if (free_bytes >= size && free_bytes - size >= spool->reserve)
        return GSN_OK;
    return gsn_fail(err, GSN_E_LIMIT,
                    "%.200s: with its %.1f MiB the disk is below its reserve of %.1f MiB (%.1f MiB "
                    "are free)",
                    name, (double)size / MiB, (double)spool->reserve / MiB,
                    (double)free_bytes / MiB);
}

/* Parts of other pictures are worth less than a whole one. */
static int make_room(const struct gsn_spool *spool, uint64_t size, const char *name,
                     struct gsn_error *err)
{
    int r = check_reserve(spool, size, 0, name, err);

    if (r == GSN_E_LIMIT) {
        r = sweep_temps(spool->temporaries, 0, err);
        if (r >= 0)
            r = check_reserve(spool, size, 0, name, err);
    }
    return r;
}

int gsn_spool_check_size(uint64_t size, const char *name, struct gsn_error *err)
{
    if (size <= GSN_SPOOL_MOST_BYTES)
        return GSN_OK;
    return gsn_fail(err, GSN_E_LIMIT,
                    "%.200s has %llu bytes, and no file may have more than %llu (1 GiB)", name,
                    (unsigned long long)size, (unsigned long long)GSN_SPOOL_MOST_BYTES);
}

int gsn_spool_has_space(struct gsn_spool *spool, uint64_t size, struct gsn_error *err)
{
    uint64_t parts = 0;
    int r = check_reserve(spool, size, 0, "the next picture", err);

    if (r != GSN_E_LIMIT)
        return r;
    r = measure_parts(spool->temporaries, &parts, err);
    return r >= 0 ? check_reserve(spool, size, parts, "the next picture", err) : r;
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

static int size_of(int fd, const char *name, uint64_t *ret_size, struct gsn_error *err)
{
    struct stat st;

    if (fstat(fd, &st) < 0)
        return fail_errno(name, err);
    *ret_size = (uint64_t)st.st_size;
    return GSN_OK;
}

/* Whether what lies in the file has this digest. */
static int compare_object(const struct gsn_spool *spool, int fd, const char *path,
                          const struct gsn_digest *digest, bool *ret_same, struct gsn_error *err)
{
    gsn_auto(copy_pass) copy = NULL;
    struct feed feed = { .read = read_fd, .context = &fd };
    struct gsn_digest there;
    int r = size_of(fd, path, &feed.size, err);

    if (r >= 0)
        r = start_pass(spool, &copy, err);
    if (r >= 0)
        r = run_pass(copy, &feed, -1, path, err);
    if (r >= 0)
        r = gsn_hash_end(copy->hash, &there, err);
    if (r >= 0)
        *ret_same = strcmp(there.hex, digest->hex) == 0;
    return r;
}

/* Reads what lies under the name of these bytes. It is synced too: whoever wrote it may have died
 * before he came to that. */
static int look_for(const struct gsn_spool *spool, const char *path,
                    const struct gsn_spooled *spooled, enum gsn_spool_found *ret_found,
                    struct gsn_error *err)
{
    bool same = false;
    int fd = -1, r = gsn_file_open(path, &fd, err);

    if (r == GSN_E_NOTFOUND) {
        *ret_found = GSN_SPOOL_NEW;
        return GSN_OK;
    }
    if (r < 0)
        return r;
    r = compare_object(spool, fd, path, &spooled->digest, &same, err);
    if (r >= 0)
        r = gsn_file_sync(fd, path, err);
    (void)close(fd);
    if (r >= 0)
        *ret_found = same ? GSN_SPOOL_SAME : GSN_SPOOL_MENDED;
    return r;
}

/* Gives the temporary its name. That the old name is gone need not be durable: it would be swept.
 */
static int name_object(const struct gsn_spool *spool, struct temporary *temp,
                       struct gsn_spooled *spooled, struct gsn_error *err)
{
    gsn_auto_mem(char) fan = gsn_format("%s/%.2s", spool->objects, spooled->digest.hex);
    gsn_auto_mem(char) path =
        gsn_format("%s/%.2s/%s", spool->objects, spooled->digest.hex, spooled->digest.hex + 2);
    int r;

    if (!fan || !path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    r = look_for(spool, path, spooled, &spooled->found, err);
    if (r < 0)
        return r;
    if (spooled->found != GSN_SPOOL_SAME) {
        if (rename(temp->path, path) < 0)
            return fail_errno(path, err);
        gsn_free(gsn_steal(&temp->path));
    }
    return gsn_file_sync_dir(fan, err);
}

/* The rest of the way for a temporary that holds all bytes. */
static int finish_object(const struct gsn_spool *spool, struct temporary *temp,
                         struct copy_pass *copy, const char *name, struct gsn_spooled *ret_spooled,
                         struct gsn_error *err)
{
    struct gsn_spooled spooled = { .size = copy->done };
    int r = gsn_hash_end(copy->hash, &spooled.digest, err);

    if (r >= 0 && fchmod(temp->fd, 0444) < 0)
        r = fail_errno(name, err);
    if (r >= 0)
        r = gsn_file_sync(temp->fd, name, err);
    if (r >= 0)
        r = name_object(spool, temp, &spooled, err);
    if (r >= 0)
        *ret_spooled = spooled;
    return r;
}

/* Goes on from a part, where one of this key is there and fits. */
static int resume_part(const struct gsn_spool *spool, const struct feed *feed,
                       const struct gsn_digest *key, struct copy_pass *copy, struct temporary *temp,
                       struct gsn_error *err)
{
    struct feed ours = { read_fd, &temp->fd, 0 };
    struct part part;
    struct gsn_digest digest;
    int fits = 0, r = find_part(spool->temporaries, key, temp, &part, err);

    if (r < 0)
        return r == GSN_E_NOTFOUND ? GSN_OK : r;
    ours.size = part.length;
    r = run_pass(copy, &ours, -1, temp->path, err);
    copy->broken_off = 0;
    if (r >= 0)
        r = gsn_hash_peek(copy->hash, &digest, err);
    if (r == GSN_E_NOMEM)
        return r;
    if (r >= 0 && strcmp(digest.hex, part.digest.hex) == 0) {
        r = check_fits(copy, feed, temp->fd, &fits, err);
        if (r < 0 || fits)
            return r;
    }
    drop_temp(temp);
    return rewind_pass(copy, err);
}

/* What the source broke off, or the disk has no room for now, is worth keeping; what changed under
 * the reader is not. */
static int keep_part(const struct gsn_spool *spool, const struct gsn_digest *key,
                     const struct copy_pass *copy, struct temporary *temp, int why,
                     struct gsn_error *err)
{
    struct part part = { .length = copy->done };
    struct gsn_error ignored = { 0 };
    int r;

    if (!key || temp->fd < 0 || part.length == 0 || why == GSN_E_BUSY ||
        (!copy->broken_off && why != GSN_E_LIMIT))
        return why;
    r = gsn_hash_peek(copy->hash, &part.digest, &ignored);
    if (r >= 0)
        r = keep_temp(spool->temporaries, key, &part, temp, &ignored);
    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", ignored.text) : why;
}

/* key NULL: there is none. */
static int take_feed(struct gsn_spool *spool, const struct feed *feed, const struct gsn_digest *key,
                     const char *name, struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    gsn_auto(copy_pass) copy = NULL;
    auto_temp temp = { .fd = -1 };
    int r;

    if (feed->size == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s is empty", name);
    r = start_pass(spool, &copy, err);
    if (r < 0)
        return r;
    if (key)
        r = resume_part(spool, feed, key, copy, &temp, err);
    if (r >= 0)
        r = make_room(spool, feed->size - copy->done, name, err);
    if (r >= 0 && temp.fd < 0)
        r = make_temp(spool->temporaries, &temp, err);
    if (r >= 0)
        r = run_pass(copy, feed, temp.fd, name, err);
    if (r < 0)
        return keep_part(spool, key, copy, &temp, r, err);
    r = finish_object(spool, &temp, copy, name, ret_spooled, err);
    /* Another copy of it may have been broken off meanwhile; a sweep will find what stays. */
    if (r >= 0 && key)
        (void)forget_parts(spool->temporaries, key, NULL);
    return r;
}

int gsn_spool_take(struct gsn_spool *spool, const void *bytes, uint64_t size, const char *name,
                   struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    struct bytes all = { bytes, size };
    const struct feed feed = { read_bytes, &all, size };

    return take_feed(spool, &feed, NULL, name, ret_spooled, err);
}

int gsn_spool_take_fd(struct gsn_spool *spool, int fd, const char *name,
                      struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    struct feed feed = { read_fd, &fd, 0 };
    const int r = size_of(fd, name, &feed.size, err);

    return r < 0 ? r : take_feed(spool, &feed, NULL, name, ret_spooled, err);
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

/* An object that became longer is another one. */
static int digest_of_key(const struct gsn_source_event *ready, struct gsn_digest *ret_key,
                         struct gsn_error *err)
{
    gsn_auto_mem(char) text = gsn_format("%llu %s", (unsigned long long)ready->size, ready->key);

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", ready->name);
    return gsn_sha256(text, strlen(text), ret_key, err);
}

int gsn_spool_take_item(struct gsn_spool *spool, struct gsn_source *source,
                        const struct gsn_source_event *ready, struct gsn_spooled *ret_spooled,
                        struct gsn_error *err)
{
    struct item item = { source, ready->item };
    const struct feed feed = { read_item, &item, ready->size };
    const bool has_key = ready->key && ready->key[0] != '\0';
    struct gsn_digest key;
    int r = GSN_OK;

    if (has_key)
        r = digest_of_key(ready, &key, err);
    return r < 0 ? r
                 : take_feed(spool, &feed, has_key ? &key : NULL, ready->name, ret_spooled, err);
}

int gsn_spool_verify(struct gsn_spool *spool, const struct gsn_digest *digest,
                     struct gsn_error *err)
{
    gsn_auto_mem(char) path =
        gsn_format("%s/%.2s/%s", spool->objects, digest->hex, digest->hex + 2);
    bool same = false;
    int fd = -1, r;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    r = gsn_file_open(path, &fd, err);
    if (r < 0)
        return r;
    r = compare_object(spool, fd, path, digest, &same, err);
    (void)close(fd);
    if (r >= 0 && !same)
        r = gsn_fail(err, GSN_E_INPUT, "%s: its bytes are not those of its name any more", path);
    return r;
}
