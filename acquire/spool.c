/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/spool.h"

#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "acquire/spool_copy.h"
#include "acquire/spool_temp.h"
#include "pipeline/core/file.h"

struct gsn_spool {
    char *objects, *temporaries; /* directories */
    uint64_t reserve;
    void (*alive)(void *context);
    void *alive_context;
};

static int refused(const char *what, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_IO, "%s: %s", what, strerror(errno));
}

/* All at once, so that no panel has to wait for its shelf to be durable. */
static int make_shelves(const struct gsn_spool *spool, struct gsn_error *err)
{
    enum { SHELVES = 256 };

    for (unsigned i = 0; i < SHELVES; i++) {
        gsn_auto_mem(char) shelf = gsn_format("%s/%02x", spool->objects, i);

        if (!shelf)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
        if (mkdir(shelf, 0755) < 0 && errno != EEXIST)
            return refused(shelf, err);
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
        r = make_shelves(spool, err);
    /* Also when nothing had to be made: whoever made it may have died before this. */
    if (r >= 0)
        r = gsn_file_sync_dir(spool->objects, err);
    if (r >= 0)
        r = gsn_file_sync_dir(dir, err);
    if (r >= 0)
        r = gsn_spool_temp_sweep(spool->temporaries, GSN_SPOOL_PARTS, err);
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

static int new_copy(const struct gsn_spool *spool, struct gsn_spool_copy **ret_copy,
                    struct gsn_error *err)
{
    const int r = gsn_spool_copy_new(ret_copy, err);

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
        return refused(spool->objects, err);
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
        r = gsn_spool_temp_sweep(spool->temporaries, 0, err);
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

int gsn_spool_has_room(struct gsn_spool *spool, uint64_t size, struct gsn_error *err)
{
    uint64_t parts = 0;
    int r = check_reserve(spool, size, 0, "the next picture", err);

    if (r != GSN_E_LIMIT)
        return r;
    r = gsn_spool_temp_parts(spool->temporaries, &parts, err);
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
        return refused(name, err);
    *ret_size = (uint64_t)st.st_size;
    return GSN_OK;
}

/* Whether what lies in the file has this digest. */
static int compare(const struct gsn_spool *spool, int fd, const char *path,
                   const struct gsn_digest *digest, bool *ret_same, struct gsn_error *err)
{
    gsn_auto(gsn_spool_copy) copy = NULL;
    struct gsn_spool_feed feed = { .read = gsn_spool_read_fd, .context = &fd };
    struct gsn_digest there;
    int r = size_of(fd, path, &feed.size, err);

    if (r >= 0)
        r = new_copy(spool, &copy, err);
    if (r >= 0)
        r = gsn_spool_copy_run(copy, &feed, -1, path, err);
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
    r = compare(spool, fd, path, &spooled->digest, &same, err);
    if (r >= 0)
        r = gsn_file_sync(fd, path, err);
    (void)close(fd);
    if (r >= 0)
        *ret_found = same ? GSN_SPOOL_SAME : GSN_SPOOL_MENDED;
    return r;
}

/* Gives the temporary its name. That the old name is gone need not be durable: it would be swept.
 */
static int shelve(const struct gsn_spool *spool, struct gsn_spool_temp *temp,
                  struct gsn_spooled *spooled, struct gsn_error *err)
{
    gsn_auto_mem(char) shelf = gsn_format("%s/%.2s", spool->objects, spooled->digest.hex);
    gsn_auto_mem(char) path =
        gsn_format("%s/%.2s/%s", spool->objects, spooled->digest.hex, spooled->digest.hex + 2);
    int r;

    if (!shelf || !path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    r = look_for(spool, path, spooled, &spooled->found, err);
    if (r < 0)
        return r;
    if (spooled->found != GSN_SPOOL_SAME) {
        if (rename(temp->path, path) < 0)
            return refused(path, err);
        gsn_free(gsn_steal(&temp->path));
    }
    return gsn_file_sync_dir(shelf, err);
}

/* The rest of the way for a temporary that holds all bytes. */
static int finish(const struct gsn_spool *spool, struct gsn_spool_temp *temp,
                  struct gsn_spool_copy *copy, const char *name, struct gsn_spooled *ret_spooled,
                  struct gsn_error *err)
{
    struct gsn_spooled spooled = { .size = copy->done };
    int r = gsn_hash_end(copy->hash, &spooled.digest, err);

    if (r >= 0 && fchmod(temp->fd, 0444) < 0)
        r = refused(name, err);
    if (r >= 0)
        r = gsn_file_sync(temp->fd, name, err);
    if (r >= 0)
        r = shelve(spool, temp, &spooled, err);
    if (r >= 0)
        *ret_spooled = spooled;
    return r;
}

/* Goes on from a part, where one of this key is there and fits. */
static int resume(const struct gsn_spool *spool, const struct gsn_spool_feed *feed,
                  const struct gsn_digest *key, struct gsn_spool_copy *copy,
                  struct gsn_spool_temp *temp, struct gsn_error *err)
{
    struct gsn_spool_feed ours = { gsn_spool_read_fd, &temp->fd, 0 };
    struct gsn_spool_part part;
    struct gsn_digest digest;
    int fits = 0, r = gsn_spool_temp_find(spool->temporaries, key, temp, &part, err);

    if (r < 0)
        return r == GSN_E_NOTFOUND ? GSN_OK : r;
    ours.size = part.length;
    r = gsn_spool_copy_run(copy, &ours, -1, temp->path, err);
    copy->broken_off = 0;
    if (r >= 0)
        r = gsn_hash_peek(copy->hash, &digest, err);
    if (r == GSN_E_NOMEM)
        return r;
    if (r >= 0 && strcmp(digest.hex, part.digest.hex) == 0) {
        r = gsn_spool_copy_fits(copy, feed, temp->fd, &fits, err);
        if (r < 0 || fits)
            return r;
    }
    gsn_spool_temp_drop(temp);
    return gsn_spool_copy_rewind(copy, err);
}

/* What the source broke off, or the disk has no room for now, is worth keeping; what changed under
 * the reader is not. */
static int keep(const struct gsn_spool *spool, const struct gsn_digest *key,
                const struct gsn_spool_copy *copy, struct gsn_spool_temp *temp, int why,
                struct gsn_error *err)
{
    struct gsn_spool_part part = { .length = copy->done };
    struct gsn_error ignored = { 0 };
    int r;

    if (!key || temp->fd < 0 || part.length == 0 || why == GSN_E_BUSY ||
        (!copy->broken_off && why != GSN_E_LIMIT))
        return why;
    r = gsn_hash_peek(copy->hash, &part.digest, &ignored);
    if (r >= 0)
        r = gsn_spool_temp_keep(spool->temporaries, key, &part, temp, &ignored);
    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", ignored.text) : why;
}

/* key NULL: there is none. */
static int take(struct gsn_spool *spool, const struct gsn_spool_feed *feed,
                const struct gsn_digest *key, const char *name, struct gsn_spooled *ret_spooled,
                struct gsn_error *err)
{
    gsn_auto(gsn_spool_copy) copy = NULL;
    auto_temp temp = { .fd = -1 };
    int r;

    if (feed->size == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s is empty", name);
    r = new_copy(spool, &copy, err);
    if (r < 0)
        return r;
    if (key)
        r = resume(spool, feed, key, copy, &temp, err);
    if (r >= 0)
        r = make_room(spool, feed->size - copy->done, name, err);
    if (r >= 0 && temp.fd < 0)
        r = gsn_spool_temp_make(spool->temporaries, &temp, err);
    if (r >= 0)
        r = gsn_spool_copy_run(copy, feed, temp.fd, name, err);
    if (r < 0)
        return keep(spool, key, copy, &temp, r, err);
    r = finish(spool, &temp, copy, name, ret_spooled, err);
    /* Another copy of it may have been broken off meanwhile; a sweep will find what stays. */
    if (r >= 0 && key)
        (void)gsn_spool_temp_forget(spool->temporaries, key, NULL);
    return r;
}

int gsn_spool_take(struct gsn_spool *spool, const void *bytes, uint64_t size, const char *name,
                   struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    struct bytes all = { bytes, size };
    const struct gsn_spool_feed feed = { read_bytes, &all, size };

    return take(spool, &feed, NULL, name, ret_spooled, err);
}

int gsn_spool_take_fd(struct gsn_spool *spool, int fd, const char *name,
                      struct gsn_spooled *ret_spooled, struct gsn_error *err)
{
    struct gsn_spool_feed feed = { gsn_spool_read_fd, &fd, 0 };
    const int r = size_of(fd, name, &feed.size, err);

    return r < 0 ? r : take(spool, &feed, NULL, name, ret_spooled, err);
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
    const struct gsn_spool_feed feed = { read_item, &item, ready->size };
    const bool has_key = ready->key && ready->key[0] != '\0';
    struct gsn_digest key;
    int r = GSN_OK;

    if (has_key)
        r = digest_of_key(ready, &key, err);
    return r < 0 ? r : take(spool, &feed, has_key ? &key : NULL, ready->name, ret_spooled, err);
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
    r = compare(spool, fd, path, digest, &same, err);
    (void)close(fd);
    if (r >= 0 && !same)
        r = gsn_fail(err, GSN_E_INPUT, "%s: its bytes are not those of its name any more", path);
    return r;
}
