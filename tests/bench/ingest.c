/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What it costs to keep a picture. All of it happens in a folder below the one the program was
 * started in, because the disk is what is measured: start it where the store will be. */
#include "tests/bench/bench.h"

#include <fcntl.h>
#include <ftw.h>
#include <math.h>
#include <openssl/evp.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "acquire/spool.h"
#include "acquire/spool_copy.h"
#include "storage/catalog.h"
#include "storage/scan.h"
#include "storage/store.h"

static void need(int holds, const char *what)
{
    if (!holds) {
        perror(what);
        exit(gsn_code_exit(GSN_E_IO));
    }
}

static int remove_one(const char *path, const struct stat *st, int what, struct FTW *walk)
{
    (void)st;
    (void)what;
    (void)walk;
    return remove(path);
}

struct folder {
    char path[64];
};

static struct folder folder_new(void)
{
    struct folder folder = { "gieson-bench-XXXXXX" };

    need(mkdtemp(folder.path) != NULL, folder.path);
    return folder;
}

static void folder_done(struct folder *folder)
{
    need(nftw(folder->path, remove_one, 32, FTW_DEPTH | FTW_PHYS) == 0, folder->path);
}

static double seconds(clockid_t clock)
{
    struct timespec now;

    need(clock_gettime(clock, &now) == 0, "clock");
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

static double mean(const double *at, size_t count)
{
    double sum = 0;

    for (size_t i = 0; i < count; i++)
        sum += at[i];
    return sum / (double)count;
}

static double median(double *at, size_t count)
{
    qsort(at, count, sizeof *at, by_value);
    return at[count / 2];
}

/* ---- one scan's rows, against one row ---- */

enum { SCANS = 400, QUICK_SCANS = 8, PANELS = 20 };

/* S1, S2, ...: as many as the scans need when each has so many panels. */
static void put_specimen(struct gsn_store *store, size_t number)
{
    char name[20];
    const struct gsn_specimen_row specimen = { .name = name,
                                               .study = "study",
                                               .group = "group",
                                               .animal = "animal",
                                               .week = 1,
                                               .kind = "sections",
                                               .baseline = "",
                                               .job_json = "{}",
                                               .job_sha256 = "" };
    struct gsn_error err = { 0 };
    int64_t id = 0;

    (void)snprintf(name, sizeof name, "S%zu", number);
    bench_need(gsn_specimen_put(store, &specimen, GSN_SPECIMEN_REFUSE, "bench", 1, &id, &err), &err,
               "specimen");
}

/* One table without an index, in one prepared statement: as bare as it goes. The last column holds
 * what else our transaction writes: the texts of panel, job and diary. */
static sqlite3_stmt *open_bare(const struct folder *folder, sqlite3 **ret_db)
{
    char path[100];
    sqlite3_stmt *insert = NULL;

    (void)snprintf(path, sizeof path, "%s/bare.db", folder->path);
    need(sqlite3_open(path, ret_db) == SQLITE_OK &&
             sqlite3_exec(*ret_db,
                          "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; CREATE TABLE scan "
                          "(id INTEGER PRIMARY KEY, source, device, name, key, subject, sha256, "
                          "size, facts, state, reason, panel_id, arrived, rest)",
                          NULL, NULL, NULL) == SQLITE_OK &&
             sqlite3_prepare_v2(*ret_db,
                                "INSERT INTO scan (source, device, name, key, subject, sha256, "
                                "size, facts, state, reason, panel_id, arrived, rest) VALUES "
                                "(?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13)",
                                -1, &insert, NULL) == SQLITE_OK,
         "bare SQLite");
    return insert;
}

static void insert_bare(sqlite3_stmt *insert, const struct gsn_scan_row *scan)
{
    const char *const texts[] = { scan->source, scan->device,  scan->name,
                                  scan->key,    scan->subject, scan->sha256,
                                  scan->facts,  "filed",       "by its name" };
    static const int columns[] = { 1, 2, 3, 4, 5, 6, 8, 9, 10 };
    char rest[500];

    (void)snprintf(rest, sizeof rest,
                   "%s %s waiting panel waiting gieson-intake scan %s %s, from %s, filed: by its "
                   "name %s",
                   scan->name, scan->sha256, scan->name, scan->sha256, scan->source, scan->sha256);

    for (size_t i = 0; i < sizeof columns / sizeof *columns; i++)
        need(sqlite3_bind_text(insert, columns[i], texts[i], -1, SQLITE_STATIC) == SQLITE_OK,
             "bind");
    need(sqlite3_bind_int64(insert, 7, scan->size) == SQLITE_OK &&
             sqlite3_bind_int64(insert, 11, 1) == SQLITE_OK &&
             sqlite3_bind_int64(insert, 12, 1) == SQLITE_OK &&
             sqlite3_bind_text(insert, 13, rest, -1, SQLITE_STATIC) == SQLITE_OK &&
             sqlite3_step(insert) == SQLITE_DONE && sqlite3_reset(insert) == SQLITE_OK,
         "bare SQLite");
}

static double time_ours(struct gsn_store *store, const struct gsn_scan_row *scan, double *cpu_s)
{
    const double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID), start = seconds(CLOCK_MONOTONIC);
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = 0;

    bench_need(gsn_scan_take(store, scan, 0, 1, &id, &again, &err), &err, "scan");
    *cpu_s += seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu;
    return seconds(CLOCK_MONOTONIC) - start;
}

static double time_bare(sqlite3_stmt *insert, const struct gsn_scan_row *scan, double *cpu_s)
{
    const double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID), start = seconds(CLOCK_MONOTONIC);

    insert_bare(insert, scan);
    *cpu_s += seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu;
    return seconds(CLOCK_MONOTONIC) - start;
}

struct log_times {
    double ours[SCANS], bare[SCANS], ours_cpu, bare_cpu;
};

/* In turns, scan by scan, so that both meet the same disk. */
static void race_logs(struct gsn_store *store, sqlite3_stmt *insert, size_t count,
                      struct log_times *times)
{
    for (size_t i = 0; i < count; i++) {
        struct gsn_error err = { 0 };
        struct gsn_digest digest;
        char name[40], key[100];
        struct gsn_scan_row scan = { .source = "scanner",
                                     .device = "04a9:31c0 SN0001",
                                     .name = name,
                                     .key = key,
                                     .subject = "panel",
                                     .size = 12345678,
                                     .facts =
                                         "{\"Format\":\"JPEG\",\"Date\":\"20260101T120000\"}" };

        (void)snprintf(name, sizeof name, "S%zu-P%02zu.jpg", i / PANELS + 1, i % PANELS + 1);
        (void)snprintf(key, sizeof key, "SN0001/00010001/%s/12345678/20260101T120000", name);
        bench_need(gsn_sha256(name, strlen(name), &digest, &err), &err, "digest");
        scan.sha256 = digest.hex;
        if (i % 2)
            times->bare[i] = time_bare(insert, &scan, &times->bare_cpu);
        times->ours[i] = time_ours(store, &scan, &times->ours_cpu);
        if (i % 2 == 0)
            times->bare[i] = time_bare(insert, &scan, &times->bare_cpu);
    }
}

/* One scan's row, panel, job and line in the diary, committed. */
void bench_log(void)
{
    const size_t count = bench_quick ? QUICK_SCANS : SCANS;
    struct folder folder = folder_new();
    struct log_times *const times = bench_alloc(1, sizeof *times);
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    char dir[100];
    sqlite3 *db = NULL;
    sqlite3_stmt *insert;
    double ours, bare;

    (void)snprintf(dir, sizeof dir, "%s/store", folder.path);
    bench_need(gsn_store_open(dir, GSN_STORE_CREATE, &store, &err), &err, "store");
    for (size_t i = 0; i <= (count - 1) / PANELS; i++)
        put_specimen(store, i + 1);
    insert = open_bare(&folder, &db);
    race_logs(store, insert, count, times);
    /* Means: checkpoints belong to it. */
    ours = mean(times->ours, count);
    bare = mean(times->bare, count);
    bench_say("ingest_log", ours * 1e3, "ms/scan", "one INSERT", bare / ours,
              json_pack("{s:f, s:f, s:f, s:f, s:f, s:I}", "ratio_of_medians",
                        median(times->bare, count) / median(times->ours, count), "bare_median_ms",
                        median(times->bare, count) * 1e3, "bare_ms", bare * 1e3, "cpu_ms",
                        times->ours_cpu * 1e3 / (double)count, "bare_cpu_ms",
                        times->bare_cpu * 1e3 / (double)count, "scans", (json_int_t)count));
    (void)sqlite3_finalize(insert);
    (void)sqlite3_close(db);
    gsn_store_free(gsn_steal(&store));
    gsn_free(times);
    folder_done(&folder);
}

/* ---- a picture's bytes ---- */

enum { PIECE = 1 << 20, ROUNDS = 15, QUICK_ROUNDS = 1 };

struct picture {
    struct folder folder;
    struct gsn_spool *spool;
    uint8_t *bytes;
    size_t size;
    int fd;
    double hash_s, copy_s, sync_s, total_s; /* of one round */
    double hash_cpu, pass_cpu;              /* the hash alone, and within the pass */
};

static void hash_alone(struct picture *picture)
{
    const double cpu = seconds(CLOCK_THREAD_CPUTIME_ID), start = seconds(CLOCK_MONOTONIC);
    EVP_MD_CTX *const evp = EVP_MD_CTX_new();
    unsigned char digest[32];

    need(evp && EVP_DigestInit_ex(evp, EVP_sha256(), NULL) == 1 &&
             EVP_DigestUpdate(evp, picture->bytes, picture->size) == 1 &&
             EVP_DigestFinal_ex(evp, digest, NULL) == 1,
         "OpenSSL");
    EVP_MD_CTX_free(evp);
    picture->hash_s = seconds(CLOCK_MONOTONIC) - start;
    picture->hash_cpu = seconds(CLOCK_THREAD_CPUTIME_ID) - cpu;
}

static int new_file(const struct picture *picture, char path[static 100])
{
    int fd;

    (void)snprintf(path, 100, "%s/copy", picture->folder.path);
    fd = open(path, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    need(fd >= 0, path);
    return fd;
}

/* What cp does; then one sync. */
static void copy_alone(struct picture *picture, uint8_t *piece)
{
    char path[100];
    const int fd = new_file(picture, path);
    const double start = seconds(CLOCK_MONOTONIC);
    double copied;

    for (size_t at = 0; at < picture->size;) {
        const ssize_t got = pread(picture->fd, piece, PIECE, (off_t)at);

        need(got > 0 && write(fd, piece, (size_t)got) == got, path);
        at += (size_t)got;
    }
    copied = seconds(CLOCK_MONOTONIC);
    need(fsync(fd) == 0, path);
    picture->copy_s = copied - start;
    picture->sync_s = seconds(CLOCK_MONOTONIC) - copied;
    need(close(fd) == 0 && unlink(path) == 0, path);
}

/* The hash within the spool's pass is timed where the linker lets us in between. */
static double hash_cpu;

int __real_gsn_hash_add(struct gsn_hash *hash, const void *bytes, size_t size,
                        struct gsn_error *err);
int __wrap_gsn_hash_add(struct gsn_hash *hash, const void *bytes, size_t size,
                        struct gsn_error *err);

int __wrap_gsn_hash_add(struct gsn_hash *hash, const void *bytes, size_t size,
                        struct gsn_error *err)
{
    const double start = seconds(CLOCK_THREAD_CPUTIME_ID);
    const int r = __real_gsn_hash_add(hash, bytes, size, err);

    hash_cpu += seconds(CLOCK_THREAD_CPUTIME_ID) - start;
    return r;
}

/* The spool's pass into a file, without the sync. */
static void pass_alone(struct picture *picture)
{
    char path[100];
    const int fd = new_file(picture, path);
    const struct gsn_spool_feed feed = { gsn_spool_read_fd, &picture->fd, picture->size };
    gsn_auto(gsn_spool_copy) copy = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_spool_copy_new(&copy, &err), &err, "copy");
    hash_cpu = 0;
    bench_need(gsn_spool_copy_run(copy, &feed, fd, path, &err), &err, "copy");
    picture->pass_cpu = hash_cpu;
    need(close(fd) == 0 && unlink(path) == 0, path);
}

static void take_whole(struct picture *picture)
{
    const double start = seconds(CLOCK_MONOTONIC);
    struct gsn_spooled spooled;
    struct gsn_error err = { 0 };
    char path[200];

    bench_need(gsn_spool_take_fd(picture->spool, picture->fd, "picture", &spooled, &err), &err,
               "take");
    picture->total_s = seconds(CLOCK_MONOTONIC) - start;
    need(spooled.found == GSN_SPOOL_NEW, "a new object");
    (void)snprintf(path, sizeof path, "%s/objects/%.2s/%s", picture->folder.path,
                   spooled.digest.hex, spooled.digest.hex + 2);
    need(unlink(path) == 0, path);
}

static struct picture picture_new(size_t size)
{
    struct picture picture = { .folder = folder_new(), .size = size };
    struct gsn_error err = { 0 };
    uint64_t seed = 1;
    char path[100];

    picture.bytes = bench_alloc(size, 1);
    for (size_t i = 0; i < size; i++)
        picture.bytes[i] = (uint8_t)(bench_draw(&seed) * 256);
    (void)snprintf(path, sizeof path, "%s/picture", picture.folder.path);
    picture.fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    need(picture.fd >= 0 && write(picture.fd, picture.bytes, size) == (ssize_t)size &&
             fsync(picture.fd) == 0,
         path);
    bench_need(gsn_spool_open(picture.folder.path, 0, &picture.spool, &err), &err, "spool");
    return picture;
}

static void picture_done(struct picture *picture)
{
    (void)close(picture->fd);
    gsn_spool_free(picture->spool);
    gsn_free(picture->bytes);
    folder_done(&picture->folder);
}

static void bench_picture(size_t size)
{
    enum { HASH, PASS, COPY, SYNC, TOTAL, TIMES };
    const size_t rounds = bench_quick ? QUICK_ROUNDS : ROUNDS;
    struct picture picture = picture_new(size);
    uint8_t *const piece = bench_alloc(PIECE, 1);
    double all[TIMES][ROUNDS], sum[ROUNDS], at[TIMES];
    const double MiB = (double)size / (1 << 20);

    for (size_t i = 0; i < rounds; i++) {
        hash_alone(&picture);
        copy_alone(&picture, piece);
        pass_alone(&picture);
        take_whole(&picture);
        all[HASH][i] = picture.hash_cpu;
        all[PASS][i] = picture.pass_cpu;
        all[COPY][i] = picture.copy_s;
        all[SYNC][i] = picture.sync_s;
        all[TOTAL][i] = picture.total_s;
        sum[i] = picture.copy_s + picture.hash_s + picture.sync_s;
    }
    for (int i = 0; i < TIMES; i++)
        at[i] = median(all[i], rounds);
    bench_say("ingest_hash", MiB / at[PASS], "MiB/s", "SHA-256 of OpenSSL alone",
              at[HASH] / at[PASS],
              json_pack("{s:f, s:f}", "MiB", MiB, "openssl_MiB_per_s", MiB / at[HASH]));
    bench_say("ingest_total", at[TOTAL] * 1e3, "ms", "copy + hash + one sync",
              median(sum, rounds) / at[TOTAL],
              json_pack("{s:f, s:f, s:f, s:f}", "MiB", MiB, "copy_ms", at[COPY] * 1e3, "sync_ms",
                        at[SYNC] * 1e3, "total_by_sum", at[TOTAL] / median(sum, rounds)));
    gsn_free(piece);
    picture_done(&picture);
}

/* A picture's bytes, made durable. */
void bench_spool(void)
{
    if (bench_quick) {
        bench_picture(1 << 20);
        return;
    }
    bench_picture((size_t)4 << 20);
    bench_picture((size_t)64 << 20);
    bench_picture((size_t)256 << 20);
}
