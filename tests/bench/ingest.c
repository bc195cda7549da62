/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What it costs to keep a picture. All of it happens in a folder below the one the program was
 * started in, because the disk is what is measured: start it where the store will be. */
#include <fcntl.h>
#include <math.h>
#include <openssl/evp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "acquire/spool.h"
#include "tests/bench/folder.h"

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

static void take_whole(struct picture *picture)
{
    const double start = seconds(CLOCK_MONOTONIC);
    struct gsn_spooled spooled;
    struct gsn_error err = { 0 };
    char path[200];

    hash_cpu = 0;
    bench_need(gsn_spool_take_fd(picture->spool, picture->fd, "picture", &spooled, &err), &err,
               "take");
    picture->pass_cpu = hash_cpu;
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
