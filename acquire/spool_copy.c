/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/spool_copy.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <unistd.h>

/* A piece stays in the cache between reading, hashing and writing. The disk is told to begin every
 * WINDOW, so that the last sync finds most of the work done. */
enum { PIECE = 1 << 18, WINDOW = 1 << 23 };

int gsn_spool_read_fd(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
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

int gsn_spool_copy_new(struct gsn_spool_copy **ret_copy, struct gsn_error *err)
{
    gsn_auto(gsn_spool_copy) copy = gsn_alloc_array(1, sizeof *copy);
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

void gsn_spool_copy_free(struct gsn_spool_copy *copy)
{
    if (!copy)
        return;
    gsn_hash_free(copy->hash);
    gsn_free(copy->piece);
    gsn_free(copy);
}

int gsn_spool_copy_rewind(struct gsn_spool_copy *copy, struct gsn_error *err)
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
static int step(struct gsn_spool_copy *copy, const struct gsn_spool_feed *feed, int fd,
                const char *name, size_t *ret_got, struct gsn_error *err)
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

int gsn_spool_copy_run(struct gsn_spool_copy *copy, const struct gsn_spool_feed *feed, int fd,
                       const char *name, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t got = 1; r >= 0 && got > 0 && copy->done <= feed->size;)
        r = step(copy, feed, fd, name, &got, err);
    if (r >= 0 && copy->done != feed->size)
        r = gsn_fail(err, GSN_E_IO, "%s: %llu bytes came where %llu were announced", name,
                     (unsigned long long)copy->done, (unsigned long long)feed->size);
    return r;
}

static int read_all(const struct gsn_spool_feed *feed, uint64_t offset, uint8_t *to, size_t size,
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

int gsn_spool_copy_fits(struct gsn_spool_copy *copy, const struct gsn_spool_feed *feed, int fd,
                        int *ret_fits, struct gsn_error *err)
{
    const struct gsn_spool_feed ours = { gsn_spool_read_fd, &fd, copy->done };
    const size_t size = copy->done < GSN_SPOOL_TAIL ? (size_t)copy->done : GSN_SPOOL_TAIL;
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
