/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Copies that their source broke off, and how they go on. */
#include "acquire/spool.h"

#include <dirent.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statfs.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/storage/scratch.h"

enum { SIZE = 1000003, TAIL = 1 << 16 };

/* A device in place of the table of sources: the spool only reads from it. */
struct gsn_source {
    uint8_t *bytes;
    uint64_t fails_from; /* reads that reach this byte fail */
    int failure;
    uint64_t bytes_read, first_read;
};

int gsn_source_read(struct gsn_source *source, uint64_t item, uint64_t offset, void *buffer,
                    size_t size, size_t *ret_got, struct gsn_error *err)
{
    const uint64_t left = SIZE - offset;

    (void)item;
    *ret_got = left < size ? (size_t)left : size;
    if (offset + *ret_got > source->fails_from)
        return gsn_fail(err, source->failure, "the cable was pulled");
    memcpy(buffer, source->bytes + offset, *ret_got);
    if (source->bytes_read == 0)
        source->first_read = offset;
    source->bytes_read += *ret_got;
    return GSN_OK;
}

/* UINT64_MAX: the truth. */
static uint64_t free_bytes = UINT64_MAX;

int statvfs(const char *path, struct statvfs *fs)
{
    struct statfs truth;

    if (syscall(SYS_statfs, path, &truth) < 0)
        return -1;
    memset(fs, 0, sizeof *fs);
    fs->f_frsize = 1;
    fs->f_bavail = free_bytes == UINT64_MAX ? (uint64_t)truth.f_bavail * 1024 : free_bytes;
    return 0;
}

/* A spool, and a device whose picture breaks off in the middle. */
struct bench {
    struct gsn_scratch scratch;
    struct gsn_spool *spool;
    struct gsn_source device;
    struct gsn_digest digest;
    char key[32];
};

static void reopen(struct bench *bench)
{
    struct gsn_error err = { 0 };

    gsn_spool_free(gsn_steal(&bench->spool));
    CHECK_OK(gsn_spool_open(bench->scratch.dir, 0, &bench->spool, &err), err);
}

static struct bench bench_new(void)
{
    struct bench bench = { .scratch = gsn_scratch_new(),
                           .device = { .fails_from = UINT64_MAX, .failure = GSN_E_IO },
                           .key = "SN1/0001/P1.jpg" };
    struct gsn_error err = { 0 };

    bench.device.bytes = gsn_alloc(SIZE);
    for (size_t i = 0; i < SIZE; i++)
        bench.device.bytes[i] = (uint8_t)(i * i % 251 + i / 4096);
    CHECK_OK(gsn_sha256(bench.device.bytes, SIZE, &bench.digest, &err), err);
    reopen(&bench);
    return bench;
}

static void bench_done(struct bench *bench)
{
    free_bytes = UINT64_MAX;
    gsn_spool_free(bench->spool);
    gsn_free(bench->device.bytes);
    gsn_scratch_remove(&bench->scratch);
}
#define auto_bench __attribute__((cleanup(bench_done))) struct bench

static int take_item(struct bench *bench, uint64_t size, struct gsn_spooled *ret,
                     struct gsn_error *err)
{
    const struct gsn_source_event ready = { .what = GSN_SOURCE_READY,
                                            .item = 1,
                                            .name = "P1.jpg",
                                            .reason = "",
                                            .size = size,
                                            .key = bench->key };

    bench->device.bytes_read = 0;
    return gsn_spool_take_item(bench->spool, &bench->device, &ready, ret, err);
}

static void break_off(struct bench *bench, uint64_t at)
{
    struct gsn_spooled got = { .size = 77 };
    struct gsn_error err = { 0 };

    bench->device.fails_from = at;
    CHECK(take_item(bench, SIZE, &got, &err) == bench->device.failure);
    CHECK(got.size == 77 && strcmp(err.text, "the cable was pulled") == 0);
    bench->device.fails_from = UINT64_MAX;
}

/* The whole picture comes, and is the right one; returns how many bytes were read for it. */
static uint64_t arrives(struct bench *bench)
{
    struct gsn_spooled got = { .size = 77 };
    struct gsn_error err = { 0 };

    CHECK_OK(take_item(bench, SIZE, &got, &err), err);
    CHECK(got.size == SIZE && strcmp(got.digest.hex, bench->digest.hex) == 0);
    CHECK_OK(gsn_spool_verify(bench->spool, &bench->digest, &err), err);
    return bench->device.bytes_read;
}

/* How many files are among the temporaries; ret_path: one of them. */
static size_t temporaries(const struct bench *bench, char *ret_path, size_t room)
{
    const char *const path = gsn_scratch_path(&bench->scratch, "objects/tmp");
    DIR *const dir = opendir(path);
    const struct dirent *entry;
    size_t count = 0;

    CHECK(dir != NULL);
    while ((entry = readdir(dir))) {
        if (entry->d_name[0] == '.')
            continue;
        count++;
        if (ret_path)
            CHECK(snprintf(ret_path, room, "%s/%s", path, entry->d_name) < (int)room);
    }
    (void)closedir(dir);
    return count;
}

TEST(a_copy_that_was_broken_off_goes_on_where_it_was)
{
    auto_bench bench = bench_new();
    char path[400];
    struct stat st;

    break_off(&bench, 600000);
    CHECK(temporaries(&bench, path, sizeof path) == 1 && strstr(path, "/partial-") != NULL);
    CHECK(stat(path, &st) == 0);
    reopen(&bench);
    CHECK(arrives(&bench) == SIZE - (uint64_t)st.st_size + TAIL);
    CHECK(bench.device.first_read == (uint64_t)st.st_size - TAIL);
    CHECK(temporaries(&bench, NULL, 0) == 0);
}

TEST(it_may_be_broken_off_again_and_again)
{
    auto_bench bench = bench_new();

    for (uint64_t at = 0; at < SIZE; at += 90001) {
        break_off(&bench, at);
        reopen(&bench);
        CHECK(temporaries(&bench, NULL, 0) <= 1);
    }
    CHECK(arrives(&bench) < SIZE / 2);
    CHECK(temporaries(&bench, NULL, 0) == 0);
}

TEST(a_source_that_cannot_tell_two_apart_starts_over)
{
    auto_bench bench = bench_new();

    bench.key[0] = '\0';
    break_off(&bench, 600000);
    CHECK(temporaries(&bench, NULL, 0) == 0);
    CHECK(arrives(&bench) == SIZE);
}

TEST(another_key_or_size_is_another_copy)
{
    auto_bench bench = bench_new();
    struct gsn_spooled got;
    struct gsn_error err = { 0 };

    break_off(&bench, 600000);
    bench.key[0] = 's';
    CHECK(arrives(&bench) == SIZE);
    bench.key[0] = 'S';
    CHECK(take_item(&bench, SIZE + 1, &got, &err) == GSN_E_IO);
    CHECK(bench.device.bytes_read == SIZE);
    CHECK(arrives(&bench) < SIZE);
}

TEST(what_changed_under_the_reader_is_not_kept)
{
    auto_bench bench = bench_new();

    bench.device.failure = GSN_E_BUSY;
    break_off(&bench, 600000);
    CHECK(temporaries(&bench, NULL, 0) == 0);
}

/* What a power cut or a bad disk makes of a part. */
static void flip(const char *path)
{
    gsn_scratch_overwrite(path, 1234, "?", 1);
}

static void shorten(const char *path)
{
    CHECK(truncate(path, 4096) == 0);
}

static void empty(const char *path)
{
    CHECK(truncate(path, 0) == 0);
}

static void lose(const char *path)
{
    struct stat st;

    CHECK(stat(path, &st) == 0 && truncate(path, 0) == 0 && truncate(path, st.st_size) == 0);
}

TEST(a_part_that_is_damaged_is_not_gone_on_with)
{
    static void (*const damages[])(const char *path) = { flip, shorten, empty, lose };

    for (size_t i = 0; i < sizeof damages / sizeof *damages; i++) {
        auto_bench bench = bench_new();
        char path[400];

        break_off(&bench, 600000);
        CHECK(temporaries(&bench, path, sizeof path) == 1);
        damages[i](path);
        CHECK(arrives(&bench) >= SIZE);
        CHECK(temporaries(&bench, NULL, 0) == 0);
    }
}

TEST(a_part_that_became_longer_is_cut_to_what_is_known_good)
{
    auto_bench bench = bench_new();
    char path[400];

    break_off(&bench, 600000);
    CHECK(temporaries(&bench, path, sizeof path) == 1);
    gsn_scratch_append(path, "of a writer that was killed", 27);
    CHECK(arrives(&bench) < SIZE);
}

TEST(a_device_that_now_has_other_bytes_under_the_key_is_copied_anew)
{
    auto_bench bench = bench_new();
    struct gsn_error err = { 0 };

    break_off(&bench, 600000);
    bench.device.bytes[520000] ^= 1;
    CHECK_OK(gsn_sha256(bench.device.bytes, SIZE, &bench.digest, &err), err);
    CHECK(arrives(&bench) > SIZE);
}

TEST(a_device_that_fails_before_it_goes_on_costs_nothing)
{
    auto_bench bench = bench_new();

    break_off(&bench, 600000);
    break_off(&bench, 0);
    break_off(&bench, 500000);
    CHECK(temporaries(&bench, NULL, 0) == 1);
    CHECK(arrives(&bench) < SIZE);
}

TEST(a_part_that_another_process_writes_is_left_alone)
{
    auto_bench bench = bench_new();
    struct gsn_error err = { 0 };
    char path[400];
    int other = -1;

    break_off(&bench, 600000);
    CHECK(temporaries(&bench, path, sizeof path) == 1);
    CHECK_OK(gsn_file_open(path, &other, &err), err);
    CHECK(flock(other, LOCK_EX) == 0);
    CHECK(arrives(&bench) == SIZE);
    reopen(&bench);
    CHECK(access(path, F_OK) == 0);
    CHECK(close(other) == 0);
    CHECK(arrives(&bench) < SIZE);
}

/* A disk may keep both names of a rename, then the part is the object; or the old name alone, then
 * it is a whole picture. */
TEST(a_finished_file_is_never_written_through_the_name_of_its_part)
{
    for (int both = 0; both < 2; both++) {
        auto_bench bench = bench_new();
        struct gsn_error err = { 0 };
        char path[400], object[400];

        break_off(&bench, 600000);
        CHECK(temporaries(&bench, path, sizeof path) == 1);
        (void)arrives(&bench);
        CHECK(snprintf(object, sizeof object, "%s/objects/%.2s/%s", bench.scratch.dir,
                       bench.digest.hex, bench.digest.hex + 2) < (int)sizeof object);
        CHECK(both ? link(object, path) == 0 && chmod(path, 0644) == 0 : rename(object, path) == 0);
        CHECK(arrives(&bench) == SIZE);
        CHECK_OK(gsn_spool_verify(bench.spool, &bench.digest, &err), err);
        CHECK(temporaries(&bench, NULL, 0) == 0);
    }
}

TEST(parts_are_swept_after_a_week)
{
    const struct timespec old[2] = { { time(NULL) - 8 * 86400, 0 }, { time(NULL) - 8 * 86400, 0 } };
    auto_bench bench = bench_new();
    char path[400];

    break_off(&bench, 600000);
    CHECK(temporaries(&bench, path, sizeof path) == 1);
    CHECK(utimensat(AT_FDCWD, path, old, 0) == 0);
    reopen(&bench);
    CHECK(temporaries(&bench, NULL, 0) == 0);
}

TEST(only_the_newest_eight_parts_stay)
{
    auto_bench bench = bench_new();

    for (char i = 0; i < 12; i++) {
        bench.key[0] = (char)('a' + i);
        break_off(&bench, 600000);
    }
    CHECK(temporaries(&bench, NULL, 0) == 8);
    CHECK(arrives(&bench) < SIZE);
}

TEST(parts_give_way_when_a_picture_needs_the_room)
{
    auto_bench bench = bench_new();
    struct gsn_spooled got;
    struct gsn_error err = { 0 };

    break_off(&bench, 600000);
    free_bytes = 10;
    CHECK_OK(gsn_spool_has_space(bench.spool, 400000, &err), err);
    CHECK(gsn_spool_has_space(bench.spool, SIZE, &err) == GSN_E_LIMIT);
    CHECK(temporaries(&bench, NULL, 0) == 1);
    /* Its own part stays: it is what the room is wanted for. */
    CHECK(take_item(&bench, SIZE, &got, &err) == GSN_E_LIMIT);
    CHECK(temporaries(&bench, NULL, 0) == 1);
    CHECK(gsn_spool_take(bench.spool, "other bytes", 11, "P2.jpg", &got, &err) == GSN_E_LIMIT);
    CHECK(temporaries(&bench, NULL, 0) == 0);
}

static int break_and_go_on(struct bench *bench, struct gsn_error *err)
{
    struct gsn_spooled got;
    int r;

    bench->device.fails_from = 600000;
    r = take_item(bench, SIZE, &got, err);
    bench->device.fails_from = UINT64_MAX;
    if (r != GSN_E_IO)
        return r;
    return take_item(bench, SIZE, &got, err);
}

TEST(running_out_of_memory_loses_no_picture)
{
    auto_bench bench = bench_new();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(break_and_go_on(&bench, &err), err);
    (void)arrives(&bench);
    reopen(&bench);
    CHECK(temporaries(&bench, NULL, 0) == 0);
}
