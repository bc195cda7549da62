/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/spool.h"

#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statfs.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <dirent.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/audit_log.h"
#include "storage/store.h"
#include "tests/check.h"
#include "tests/storage/scratch.h"

/* printf abc | sha256sum */
#define ABC_SHELF "ba"
#define ABC_REST "7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"

/* What was synced and renamed, in order: f a file, d a directory, r a rename. */
static char diary[64];

static void note(char what)
{
    const size_t length = strlen(diary);

    if (length + 1 < sizeof diary)
        diary[length] = what;
}

int fsync(int fd)
{
    struct stat st;

    note(fstat(fd, &st) == 0 && S_ISDIR(st.st_mode) ? 'd' : 'f');
    return (int)syscall(SYS_fsync, fd);
}

int rename(const char *from, const char *to)
{
    note('r');
    return (int)syscall(SYS_rename, from, to);
}

/* What the disk says is free; UINT64_MAX: the truth. */
static uint64_t free_bytes = UINT64_MAX;

int statvfs(const char *path, struct statvfs *fs)
{
    struct statfs truth;

    if (syscall(SYS_statfs, path, &truth) < 0)
        return -1;
    memset(fs, 0, sizeof *fs);
    fs->f_frsize = free_bytes == UINT64_MAX ? (unsigned long)truth.f_frsize : 1;
    fs->f_bavail = free_bytes == UINT64_MAX ? truth.f_bavail : free_bytes;
    return 0;
}

static struct gsn_spool *open_spool(const struct gsn_scratch *scratch)
{
    struct gsn_spool *spool = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spool_open(scratch->dir, 0, &spool, &err), err);
    return spool;
}

static struct gsn_spooled take(struct gsn_spool *spool, const char *text)
{
    struct gsn_spooled spooled = { .size = 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spool_take(spool, text, strlen(text), "name", &spooled, &err), err);
    return spooled;
}

static size_t count_in(const struct gsn_scratch *scratch, const char *name)
{
    DIR *const dir = opendir(gsn_scratch_path(scratch, name));
    const struct dirent *entry;
    size_t count = 0;

    CHECK(dir != NULL);
    while ((entry = readdir(dir)))
        count += entry->d_name[0] != '.';
    (void)closedir(dir);
    return count;
}

static void holds(const struct gsn_scratch *scratch, const char *name, const char *text)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_file_read(gsn_scratch_path(scratch, name), 1 << 24, &bytes, &size, &err), err);
    CHECK(size == strlen(text) && memcmp(bytes, text, size) == 0);
}

TEST(bytes_lie_under_their_hash_and_are_read_only)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    const struct gsn_spooled got = take(spool, "abc");
    struct stat st;

    CHECK(strcmp(got.digest.hex, ABC_SHELF ABC_REST) == 0);
    CHECK(got.size == 3 && got.found == GSN_SPOOL_NEW);
    holds(&scratch, "objects/" ABC_SHELF "/" ABC_REST, "abc");
    CHECK(stat(gsn_scratch_path(&scratch, "objects/" ABC_SHELF "/" ABC_REST), &st) == 0);
    CHECK((st.st_mode & 07777) == 0444);
    CHECK(count_in(&scratch, "objects/tmp") == 0);
}

TEST(the_store_looks_for_objects_where_the_spool_puts_them)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    gsn_auto_mem(char) path = NULL;
    const struct gsn_spooled got = take(spool, "any bytes");
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_store_open(scratch.dir, GSN_STORE_CREATE, &store, &err), err);
    CHECK_OK(gsn_store_object_path(store, got.digest.hex, &path, &err), err);
    CHECK(access(path, R_OK) == 0);
}

TEST(the_order_is_sync_rename_sync_of_the_directory)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);

    memset(diary, 0, sizeof diary);
    (void)take(spool, "abc");
    CHECK(strcmp(diary, "frd") == 0);
    memset(diary, 0, sizeof diary);
    (void)take(spool, "abc");
    CHECK(strcmp(diary, "ffd") == 0);
}

TEST(the_same_bytes_again_are_compared_and_not_rewritten)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    struct stat before, after;
    const char *const path = gsn_scratch_path(&scratch, "objects/" ABC_SHELF "/" ABC_REST);

    (void)take(spool, "abc");
    CHECK(stat(path, &before) == 0);
    CHECK(take(spool, "abc").found == GSN_SPOOL_SAME);
    CHECK(stat(path, &after) == 0 && after.st_ino == before.st_ino);
    CHECK(count_in(&scratch, "objects/tmp") == 0);
}

static void count(void *context)
{
    ++*(unsigned *)context;
}

TEST(what_is_only_read_again_gives_signs_of_life)
{
    enum { SIZE = 1 << 20 };
    gsn_auto_mem(uint8_t) bytes = gsn_alloc_array(SIZE, 1);
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    struct gsn_spooled spooled;
    struct gsn_error err = { 0 };
    unsigned signs = 0, once;

    gsn_spool_watch(spool, count, &signs);
    CHECK_OK(gsn_spool_take(spool, bytes, SIZE, "x", &spooled, &err), err);
    once = signs;
    CHECK(once >= 4);
    CHECK_OK(gsn_spool_take(spool, bytes, SIZE, "x", &spooled, &err), err);
    CHECK(spooled.found == GSN_SPOOL_SAME && signs == 3 * once);
    CHECK_OK(gsn_spool_verify(spool, &spooled.digest, &err), err);
    CHECK(signs == 4 * once);
}

TEST(a_damaged_object_is_mended_and_that_is_told)
{
    static const char *const damages[] = { "abd", "abcd", "" };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    const char *const path = gsn_scratch_path(&scratch, "objects/" ABC_SHELF "/" ABC_REST);

    (void)take(spool, "abc");
    for (size_t i = 0; i < 3; i++) {
        CHECK(unlink(path) == 0);
        gsn_scratch_append(path, damages[i], strlen(damages[i]));
        CHECK(take(spool, "abc").found == GSN_SPOOL_MENDED);
        holds(&scratch, "objects/" ABC_SHELF "/" ABC_REST, "abc");
    }
}

TEST(a_descriptor_is_taken_from_its_start_whatever_its_position)
{
    enum { SIZE = 3000001 };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    gsn_auto_mem(char) bytes = gsn_alloc_array(SIZE + 1, 1);
    const char *const path = gsn_scratch_path(&scratch, "file");
    struct gsn_spooled got = { .size = 0 };
    struct gsn_digest digest;
    struct gsn_error err = { 0 };
    int fd = -1;

    for (size_t i = 0; i < SIZE; i++)
        bytes[i] = (char)('a' + i * i % 23);
    gsn_scratch_append(path, bytes, SIZE);
    CHECK_OK(gsn_file_open(path, &fd, &err), err);
    CHECK(lseek(fd, 17, SEEK_SET) == 17);
    CHECK_OK(gsn_spool_take_fd(spool, fd, "file", &got, &err), err);
    CHECK(close(fd) == 0);
    CHECK_OK(gsn_sha256(bytes, SIZE, &digest, &err), err);
    CHECK(got.size == SIZE && strcmp(got.digest.hex, digest.hex) == 0);
}

TEST(nothing_is_no_object)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    struct gsn_spooled got = { .size = 77 };
    struct gsn_error err = { 0 };

    CHECK(gsn_spool_take(spool, "", 0, "P1.tif", &got, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "P1.tif is empty") == 0);
    CHECK(got.size == 77);
}

TEST(what_a_crash_left_is_swept_but_not_under_a_living_writer)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) first = open_spool(&scratch);
    const char *const rest = gsn_scratch_path(&scratch, "objects/tmp/Abc123");
    struct gsn_error err = { 0 };
    int writer = -1;

    (void)take(first, "abc");
    gsn_scratch_append(rest, "half", 4);
    CHECK_OK(gsn_file_open(rest, &writer, &err), err);
    CHECK(flock(writer, LOCK_EX) == 0);
    gsn_spool_free(open_spool(&scratch));
    CHECK(access(rest, F_OK) == 0);
    CHECK(close(writer) == 0);
    gsn_spool_free(open_spool(&scratch));
    CHECK(access(rest, F_OK) < 0);
    holds(&scratch, "objects/" ABC_SHELF "/" ABC_REST, "abc");
}

TEST(an_object_is_read_again_when_asked)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = open_spool(&scratch);
    const char *const path = gsn_scratch_path(&scratch, "objects/" ABC_SHELF "/" ABC_REST);
    struct gsn_digest abc = { ABC_SHELF ABC_REST };
    struct gsn_error err = { 0 };

    CHECK(gsn_spool_verify(spool, &abc, &err) == GSN_E_NOTFOUND);
    (void)take(spool, "abc");
    CHECK_OK(gsn_spool_verify(spool, &abc, &err), err);
    CHECK(unlink(path) == 0);
    gsn_scratch_append(path, "abd", 3);
    CHECK(gsn_spool_verify(spool, &abc, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "its bytes are not those of its name any more") != NULL);
}

TEST(the_reserve_is_kept_to_the_byte_before_one_is_written)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_spool) spool = NULL;
    struct gsn_spooled got = { .size = 77 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spool_open(scratch.dir, 512 << 20, &spool, &err), err);
    free_bytes = (512 << 20) + 2;
    memset(diary, 0, sizeof diary);
    CHECK(gsn_spool_take(spool, "abc", 3, "P1.tif", &got, &err) == GSN_E_LIMIT);
    CHECK(strcmp(err.text, "P1.tif: with its 0.0 MiB the disk is below its reserve of 512.0 MiB "
                           "(512.0 MiB are free)") == 0);
    CHECK(got.size == 77 && diary[0] == '\0' && count_in(&scratch, "objects/tmp") == 0);
    free_bytes = 2; /* less than the panel itself */
    CHECK(gsn_spool_take(spool, "abc", 3, "P1.tif", &got, &err) == GSN_E_LIMIT);
    CHECK(gsn_spool_has_space(spool, 3, &err) == GSN_E_LIMIT);
    free_bytes = (512 << 20) + 3;
    CHECK_OK(gsn_spool_has_space(spool, 3, &err), err);
    CHECK_OK(gsn_spool_take(spool, "abc", 3, "P1.tif", &got, &err), err);
    free_bytes = UINT64_MAX;
}

/* Taking 4 MiB must fail for want of space and leave what was there as it was. */
static int a_full_disk_leaves_no_trace(const char *dir)
{
    enum { SIZE = 4 << 20 };
    struct gsn_scratch scratch;
    gsn_auto(gsn_spool) spool = NULL;
    gsn_auto_mem(char) bytes = gsn_alloc_array(SIZE, 1);
    struct gsn_spooled got = { .size = 77 };
    struct gsn_error err = { 0 };

    (void)snprintf(scratch.dir, sizeof scratch.dir, "%s", dir);
    if (!bytes || gsn_spool_open(dir, 0, &spool, &err) < 0)
        return 1;
    (void)take(spool, "abc");
    if (gsn_spool_take(spool, bytes, SIZE, "P1.tif", &got, &err) != GSN_E_IO || got.size != 77)
        return 2;
    print_message("%s\n", err.text);
    if (!strstr(err.text, "P1.tif: ") || count_in(&scratch, "objects/tmp") != 0)
        return 3;
    return take(spool, "abc").found == GSN_SPOOL_SAME ? 0 : 4;
}

static int under_a_limit(void *context)
{
    const struct rlimit small = { 1 << 20, 1 << 20 };

    (void)signal(SIGXFSZ, SIG_IGN);
    return setrlimit(RLIMIT_FSIZE, &small) == 0 ? a_full_disk_leaves_no_trace(context) : 5;
}

TEST(a_file_that_may_not_grow_leaves_no_trace)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_scratch_child child = gsn_scratch_start(0, under_a_limit, scratch.dir);

    CHECK(gsn_scratch_wait(&child) == 0);
}

enum { NOT_ALLOWED = 77 };

/* The reserve cannot see everything coming: another writer may fill the disk meanwhile. The mount
 * is seen by this process alone and ends with it. */
static int on_a_small_disk(void *context)
{
    if (unshare(CLONE_NEWNS) < 0 || mount("none", "/", NULL, MS_REC | MS_PRIVATE, NULL) < 0 ||
        mount("gieson", context, "tmpfs", 0, "size=2m,mode=755") < 0)
        return NOT_ALLOWED;
    free_bytes = (uint64_t)1 << 40;
    return a_full_disk_leaves_no_trace(context);
}

TEST(a_disk_that_is_full_leaves_no_trace)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_scratch_child child = gsn_scratch_start(0, on_a_small_disk, scratch.dir);
    const int result = gsn_scratch_wait(&child);

    if (result == NOT_ALLOWED) {
        gsn_scratch_remove(&scratch);
        gsn_check_skip("no tmpfs may be mounted here");
    }
    CHECK(result == 0);
}

TEST(a_folder_that_cannot_be_made_gives_a_sentence)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_spool *spool = NULL;
    struct gsn_error err = { 0 };

    gsn_scratch_append(gsn_scratch_path(&scratch, "objects"), "a file", 6);
    CHECK(gsn_spool_open(scratch.dir, 0, &spool, &err) == GSN_E_IO);
    CHECK(spool == NULL && strstr(err.text, "objects") != NULL);
}

static int take_once(const char *dir, struct gsn_error *err)
{
    gsn_auto(gsn_spool) spool = NULL;
    struct gsn_spooled got;
    int r = gsn_spool_open(dir, 0, &spool, err);

    if (r >= 0)
        r = gsn_spool_take(spool, "abc", 3, "name", &got, err);
    return r >= 0 ? gsn_spool_take(spool, "abc", 3, "name", &got, err) : r;
}

TEST(running_out_of_memory_leaves_no_temporary)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(take_once(scratch.dir, &err), err);
    CHECK(count_in(&scratch, "objects/tmp") == 0);
}

struct delivery {
    const char *dir;
    int acknowledge; /* a pipe: one number for each delivery that is safe */
    unsigned number;
};

/* Takes one picture after another: object, row, commit, acknowledge. Never returns of itself. */
static int deliver_for_ever(void *context)
{
    struct delivery *const next = context;
    gsn_auto(gsn_spool) spool = NULL;
    gsn_auto(gsn_store) store = NULL;
    struct gsn_spooled spooled;
    char text[64];

    if (gsn_spool_open(next->dir, 0, &spool, NULL) < 0 ||
        gsn_store_open(next->dir, GSN_STORE_CREATE, &store, NULL) < 0)
        return 1;
    for (;; next->number++) {
        (void)snprintf(text, sizeof text, "picture %u", next->number);
        if (gsn_spool_take(spool, text, strlen(text), text, &spooled, NULL) < 0 ||
            gsn_event_add(store, 0, "t", "taken", text, spooled.digest.hex, NULL) < 0 ||
            write(next->acknowledge, &next->number, sizeof next->number) < 0)
            return 2;
    }
}

/* What was acknowledged is there, row and object; rows whose object is missing are not. */
static unsigned check_deliveries(const struct gsn_scratch *scratch, unsigned acknowledged)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_event_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_store_open(scratch->dir, GSN_STORE_CREATE, &store, &err), err);
    CHECK_OK(gsn_event_list(store, 0, &rows, &err), err);
    CHECK(rows->count >= acknowledged);
    for (size_t i = 0; i < rows->count; i++) {
        char name[100];

        (void)snprintf(name, sizeof name, "objects/%.2s/%s", rows->at[i].text,
                       rows->at[i].text + 2);
        holds(scratch, name, rows->at[i].subject);
    }
    return (unsigned)rows->count;
}

TEST(a_killed_process_loses_nothing_that_it_acknowledged)
{
    enum { KILLS = 12 };
    scratch_auto scratch = gsn_scratch_new();
    struct delivery delivery = { .dir = scratch.dir };
    unsigned acknowledged = 0, number;

    for (unsigned i = 0; i < KILLS; i++) {
        struct gsn_scratch_child child;
        int pipes[2];

        CHECK(pipe(pipes) == 0);
        delivery.acknowledge = pipes[1];
        child = gsn_scratch_start(0, deliver_for_ever, &delivery);
        (void)close(pipes[1]);
        gsn_scratch_open_gate(&child);
        /* Half of them live long enough to acknowledge something, however busy the machine is. */
        if (i % 2 == 0 && read(pipes[0], &number, sizeof number) == sizeof number)
            acknowledged = number + 1;
        CHECK(usleep(20000 + 7919 * i % 60000) == 0);
        CHECK(kill(child.pid, SIGKILL) == 0);
        CHECK(gsn_scratch_wait(&child) == -1);
        while (read(pipes[0], &number, sizeof number) == sizeof number)
            acknowledged = number + 1;
        (void)close(pipes[0]);
        delivery.number = check_deliveries(&scratch, acknowledged);
    }
    print_message("%u deliveries acknowledged over %d kills\n", acknowledged, KILLS);
    CHECK(acknowledged > 0);
    gsn_spool_free(open_spool(&scratch));
    CHECK(count_in(&scratch, "objects/tmp") == 0);
}
