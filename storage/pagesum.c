/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Page checksums, in the format of SQLite's own checksum VFS (https://sqlite.org/cksumvfs.html,
 * ext/misc/cksumvfs.c), which Debian's SQLite is built without: a database made here is one for it.
 * `PRAGMA integrity_check` sees that pages fit together, not that a figure in them has changed.
 *
 * Each page keeps its last eight bytes free (byte 20 of the file's header says so); they hold the
 * sum that the write-ahead log of SQLite has for its frames, over the bytes before them:
 * s1 += x[i] + s2, s2 += x[i+1] + s1 over 32-bit words. A changed word shifts s1 and s2 by
 * multiples by two neighbours of Fibonacci's sequence, which have no common divisor, so that no
 * single bit can change without the sum changing.
 *
 * 1. Where the system's VFS writes a page of the main file, the sum is put in on the way. Pages of
 *    the log are left alone: they have sums of their own.
 * 2. Where a page is read, its sum is blanked, so that the page goes into the log without one.
 * 3. So a page that is written with something in these bytes was read past this file, by another
 *    program: it stays as that program wrote it and is found. One that another program only copied
 *    out of the log has none, which is no damage.
 *
 * A failing disk (EIO) is told as one: SQLite takes it for a damaged file, "malformed".
 *
 * Reading does not compare: gsn_pagesum_check() does, over the file as it lies on the disk, unused
 * pages included. It costs one pass over the file; writing costs a microsecond a page. */
#include "storage/pagesum.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sqlite3.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"

enum {
    HEADER = 100, /* of an SQLite file */
    AT_PAGE_SIZE = 16,
    AT_RESERVED = 20,
    SMALLEST = 512,
    LARGEST = 65536,
    TRIES = 5, /* for a page that somebody is just writing */
    NAP_MS = 20,
};

static const uint8_t no_sum[GSN_PAGESUM_BYTES];

static uint32_t read_word(const uint8_t *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static void put_word(uint8_t *at, uint32_t word)
{
    for (int i = 0; i < 4; i++)
        at[i] = (uint8_t)(word >> 8 * i);
}

void gsn_pagesum(const uint8_t *page, size_t size, uint8_t ret_sum[GSN_PAGESUM_BYTES])
{
    uint32_t s1 = 0, s2 = 0;

    for (size_t i = 0; i + 8 <= size; i += 8) {
        s1 += read_word(page + i) + s2;
        s2 += read_word(page + i + 4) + s1;
    }
    put_word(ret_sum, s1);
    put_word(ret_sum + 4, s2);
    /* An empty page has one, too. */
    if (s1 == 0 && s2 == 0)
        memset(ret_sum, 0xff, GSN_PAGESUM_BYTES);
}

/* ---- on the way to the file and back ------------------------------------------------------ */

/* The file of the system's VFS lies behind it. */
struct summed {
    sqlite3_file base;
    int64_t has_sums;
};

static sqlite3_file *file_of(sqlite3_file *file)
{
    return (sqlite3_file *)((struct summed *)file + 1);
}

static int is_page(int size, sqlite3_int64 at)
{
    return size >= SMALLEST && size <= LARGEST && (size & (size - 1)) == 0 && at % size == 0;
}

/* Every writing of the first page says it anew: VACUUM may have changed it. */
static void look_at_header(struct summed *summed, const uint8_t *bytes, int size, sqlite3_int64 at)
{
    if (at == 0 && size >= HEADER && memcmp(bytes, "SQLite format 3", 16) == 0)
        summed->has_sums = bytes[AT_RESERVED] == GSN_PAGESUM_BYTES;
}

static int read_page(sqlite3_file *file, void *bytes, int size, sqlite3_int64 at)
{
    struct summed *const summed = (struct summed *)file;
    sqlite3_file *const to = file_of(file);
    const int r = to->pMethods->xRead(to, bytes, size, at);

    if (r == SQLITE_IOERR_CORRUPTFS)
        return SQLITE_IOERR_READ;
    if (r != SQLITE_OK)
        return r;
    look_at_header(summed, bytes, size, at);
    if (summed->has_sums && is_page(size, at))
        memset((uint8_t *)bytes + size - GSN_PAGESUM_BYTES, 0, GSN_PAGESUM_BYTES);
    return r;
}

static int write_page(sqlite3_file *file, const void *bytes, int size, sqlite3_int64 at)
{
    struct summed *const summed = (struct summed *)file;
    sqlite3_file *const to = file_of(file);
    const uint8_t *const sum = (const uint8_t *)bytes + size - GSN_PAGESUM_BYTES;
    uint8_t page[LARGEST];

    look_at_header(summed, bytes, size, at);
    if (!summed->has_sums || !is_page(size, at) || memcmp(sum, no_sum, sizeof no_sum) != 0)
        return to->pMethods->xWrite(to, bytes, size, at);
    memcpy(page, bytes, (size_t)size);
    gsn_pagesum(page, (size_t)size - GSN_PAGESUM_BYTES, page + size - GSN_PAGESUM_BYTES);
    return to->pMethods->xWrite(to, page, size, at);
}

/* All else is the system's. */
#define PASS(name, parameters, arguments)                                                          \
    static int name parameters                                                                     \
    {                                                                                              \
        sqlite3_file *const to = file_of(file);                                                    \
        return to->pMethods->arguments;                                                            \
    }                                                                                              \
    struct name##_needs_a_semicolon
PASS(close_file, (sqlite3_file * file), xClose(to));
PASS(truncate_file, (sqlite3_file * file, sqlite3_int64 size), xTruncate(to, size));
PASS(sync_file, (sqlite3_file * file, int flags), xSync(to, flags));
PASS(size_of_file, (sqlite3_file * file, sqlite3_int64 *ret_size), xFileSize(to, ret_size));
PASS(lock_file, (sqlite3_file * file, int level), xLock(to, level));
PASS(unlock_file, (sqlite3_file * file, int level), xUnlock(to, level));
PASS(is_reserved, (sqlite3_file * file, int *ret_is), xCheckReservedLock(to, ret_is));
PASS(control_file, (sqlite3_file * file, int what, void *value), xFileControl(to, what, value));
PASS(sector_size, (sqlite3_file * file), xSectorSize(to));
PASS(characteristics, (sqlite3_file * file), xDeviceCharacteristics(to));
PASS(map_shared, (sqlite3_file * file, int page, int size, int extend, void volatile **ret_at),
     xShmMap(to, page, size, extend, ret_at));
PASS(lock_shared, (sqlite3_file * file, int first, int count, int flags),
     xShmLock(to, first, count, flags));
PASS(unmap_shared, (sqlite3_file * file, int delete), xShmUnmap(to, delete));

static void order_shared(sqlite3_file *file)
{
    sqlite3_file *const to = file_of(file);

    to->pMethods->xShmBarrier(to);
}

/* Version 2: without xFetch(), which would hand out the file's pages past read_page(). */
static const sqlite3_io_methods methods = {
    .iVersion = 2,
    .xClose = close_file,
    .xRead = read_page,
    .xWrite = write_page,
    .xTruncate = truncate_file,
    .xSync = sync_file,
    .xFileSize = size_of_file,
    .xLock = lock_file,
    .xUnlock = unlock_file,
    .xCheckReservedLock = is_reserved,
    .xFileControl = control_file,
    .xSectorSize = sector_size,
    .xDeviceCharacteristics = characteristics,
    .xShmMap = map_shared,
    .xShmLock = lock_shared,
    .xShmBarrier = order_shared,
    .xShmUnmap = unmap_shared,
};

static int open_file(sqlite3_vfs *vfs, const char *name, sqlite3_file *file, int flags,
                     int *ret_flags)
{
    sqlite3_vfs *const system = sqlite3_vfs_find(NULL);
    struct summed *const summed = (struct summed *)file;
    sqlite3_file *const to = file_of(file);
    uint8_t header[HEADER];
    int r;

    (void)vfs;
    r = system->xOpen(system, name, to, flags, ret_flags);
    summed->base.pMethods = to->pMethods ? &methods : NULL;
    if (r != SQLITE_OK)
        return r;
    /* A file that is empty is going to be a new one. All others are here for their errors alone. */
    summed->has_sums = (flags & SQLITE_OPEN_MAIN_DB) != 0;
    if (summed->has_sums && to->pMethods->xRead(to, header, HEADER, 0) == SQLITE_OK)
        look_at_header(summed, header, HEADER, 0);
    return SQLITE_OK;
}

/* SQLite keeps the list of VFSs in one place for the whole process, and so does this. */
static sqlite3_vfs summing;

static void add_vfs(void)
{
    const sqlite3_vfs *const system = sqlite3_vfs_find(NULL);

    if (!system)
        return;
    summing = *system;
    summing.zName = "gieson";
    summing.szOsFile += (int)sizeof(struct summed);
    summing.xOpen = open_file;
    (void)sqlite3_vfs_register(&summing, 0);
}

const char *gsn_pagesum_vfs(void)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;

    (void)pthread_once(&once, add_vfs);
    return summing.zName;
}

/* ---- the file as it lies ------------------------------------------------------------------ */

static int read_at(int fd, const char *path, uint8_t *bytes, size_t size, int64_t at,
                   struct gsn_error *err)
{
    for (size_t done = 0; done < size;) {
        const ssize_t got = pread(fd, bytes + done, size - done, at + (int64_t)done);

        if (got < 0 && errno == EINTR)
            continue;
        if (got < 0)
            return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
        if (got == 0)
            return gsn_fail(err, GSN_E_STORE, "%s: ends within a page", path);
        done += (size_t)got;
    }
    return GSN_OK;
}

/* 1: as it was written; 0: not; -1: it has no sum. */
static int judge_page(const uint8_t *page, size_t size)
{
    const uint8_t *const sum = page + size - GSN_PAGESUM_BYTES;
    uint8_t right[GSN_PAGESUM_BYTES];

    if (memcmp(sum, no_sum, sizeof no_sum) == 0)
        return -1;
    gsn_pagesum(page, size - GSN_PAGESUM_BYTES, right);
    return memcmp(sum, right, sizeof right) == 0;
}

int gsn_pagesum_check(const char *path, void (*damaged)(void *context, int64_t page), void *context,
                      struct gsn_pagesum_verdict *ret_verdict, struct gsn_error *err)
{
    const struct timespec nap = { .tv_nsec = NAP_MS * 1000000L };
    gsn_auto_mem(uint8_t) page = gsn_alloc(LARGEST);
    struct gsn_pagesum_verdict verdict = { 0 };
    gsn_auto_fd fd = -1;
    size_t size;
    off_t end;
    int r = page ? gsn_file_open(path, &fd, err) : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = read_at(fd, path, page, HEADER, 0, err);
    if (r < 0)
        return r;
    (void)posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED); /* from the disk and not from memory */
    size = (size_t)page[AT_PAGE_SIZE] << 8 | page[AT_PAGE_SIZE + 1];
    size = size == 1 ? LARGEST : size;
    end = lseek(fd, 0, SEEK_END);
    if (memcmp(page, "SQLite format 3", 16) != 0 || page[AT_RESERVED] != GSN_PAGESUM_BYTES ||
        !is_page((int)size, 0) || end % (off_t)size != 0)
        return gsn_fail(err, GSN_E_STORE,
                        "%s: its first page is damaged: it does not say what the file is", path);
    for (off_t at = 0; r >= 0 && at < end; at += (off_t)size) {
        int is = 0;

        for (int i = 0; r >= 0 && is == 0 && i < TRIES; i++) {
            if (i > 0)
                (void)nanosleep(&nap, NULL);
            r = read_at(fd, path, page, size, at, err);
            is = r >= 0 ? judge_page(page, size) : 0;
        }
        verdict.pages++;
        verdict.damaged += r >= 0 && is == 0;
        verdict.without += is < 0;
        if (r >= 0 && is == 0)
            damaged(context, verdict.pages);
    }
    if (r >= 0)
        *ret_verdict = verdict;
    return r;
}
