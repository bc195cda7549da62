/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/file.h"

#include "tests/check.h"

#include <dirent.h>
#include <fcntl.h>
#include <ftw.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

enum { ROOM = 512, NOBODY = 65534 };

/* A folder of its own for a test, gone at the end of its scope. */
struct folder {
    char path[64];
};

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *at)
{
    (void)st, (void)kind, (void)at;
    return remove(path);
}

static void folder_done(struct folder *folder)
{
    (void)nftw(folder->path, remove_one, 8, FTW_DEPTH | FTW_PHYS);
}

static struct folder folder_new(void)
{
    struct folder folder = { "/tmp/gieson-file-XXXXXX" };

    CHECK(mkdtemp(folder.path) != NULL);
    return folder;
}
#define IN_A_FOLDER(name) __attribute__((cleanup(folder_done))) struct folder name = folder_new()

/* The path of a name in the folder, in the caller's room. */
static const char *in(const struct folder *folder, const char *name, char room[ROOM])
{
    (void)snprintf(room, ROOM, "%s/%s", folder->path, name);
    return room;
}

static size_t entries(const char *path)
{
    DIR *directory = opendir(path);
    size_t count = 0;

    CHECK(directory != NULL);
    while (readdir(directory))
        count++;
    (void)closedir(directory);
    return count - 2; /* . and .. */
}

static void put(const char *path, const char *text)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_write(path, text, strlen(text), &err), err);
}

static int holds(const char *path, const char *text)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_read(path, 1 << 20, &bytes, &size, &err), err);
    return size == strlen(text) && memcmp(bytes, text, size) == 0;
}

/* The read is refused with this code, what it gives stays, and nothing was allocated. */
static void check_refused(const char *path, size_t limit, int code, struct gsn_error *err)
{
    uint8_t mark = 1, *bytes = &mark;
    size_t size = 77;

    gsn_check_fail_allocation(0);
    CHECK(gsn_file_read(path, limit, &bytes, &size, err) == code);
    CHECK(gsn_check_allocations() == 0);
    CHECK(bytes == &mark && size == 77 && err->code == code);
    CHECK(strncmp(err->text, path, strlen(path)) == 0);
}

TEST(what_is_written_is_read_back)
{
    static const size_t sizes[] = { 0, 1, 4095, 4096, 1000003 };
    IN_A_FOLDER(folder);
    char path[ROOM];

    in(&folder, "scan.tif", path);
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        gsn_auto_mem(uint8_t) bytes = gsn_alloc(sizes[i]);
        gsn_auto_mem(uint8_t) back = NULL;
        size_t size = 1;
        struct gsn_error err = { 0 };

        CHECK(bytes != NULL);
        for (size_t k = 0; k < sizes[i]; k++)
            bytes[k] = (uint8_t)(k * 131 >> 3);
        CHECK_OK(gsn_file_write(path, bytes, sizes[i], &err), err);
        CHECK_OK(gsn_file_read(path, sizes[i], &back, &size, &err), err);
        CHECK(size == sizes[i]);
        assert_memory_equal(back, bytes, size);
        CHECK(back[size] == 0);
        CHECK(entries(folder.path) == 1);
    }
}

TEST(an_existing_file_is_replaced_whole)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct stat before, after;

    put(in(&folder, "report.json", path), "{ \"a long old report\": 1 }");
    CHECK(stat(path, &before) == 0);
    put(path, "new");
    CHECK(stat(path, &after) == 0);
    CHECK(holds(path, "new"));
    CHECK(before.st_ino !=
          after.st_ino); /* another file took its name; it was never half written */
    CHECK((after.st_mode & 07777) == 0644);
    CHECK(entries(folder.path) == 1);
}

TEST(a_name_without_a_folder_is_in_the_current_one)
{
    IN_A_FOLDER(folder);
    char here[4096];

    CHECK(getcwd(here, sizeof here) != NULL);
    CHECK(chdir(folder.path) == 0);
    put("plain", "text");
    CHECK(holds("plain", "text"));
    CHECK(chdir(here) == 0);
    CHECK(entries(folder.path) == 1);
}

TEST(a_missing_file_is_not_found)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    check_refused(in(&folder, "P03.tif", path), 100, GSN_E_NOTFOUND, &err);
    CHECK(strstr(err.text, "No such file") != NULL);
    check_refused(in(&folder, "no/such/folder", path), 100, GSN_E_NOTFOUND, &err);
}

TEST(a_directory_is_refused)
{
    IN_A_FOLDER(folder);
    struct gsn_error err = { 0 };

    check_refused(folder.path, SIZE_MAX, GSN_E_INPUT, &err);
    CHECK(strstr(err.text, "not a regular file") != NULL);
}

TEST(a_fifo_is_refused_without_waiting_for_a_writer)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    CHECK(mkfifo(in(&folder, "pipe.tif", path), 0644) == 0);
    (void)alarm(20); /* this program ends when the call waits */
    check_refused(path, 100, GSN_E_INPUT, &err);
    check_refused("/dev/zero", 100, GSN_E_INPUT, &err);
    (void)alarm(0);
}

TEST(a_file_can_be_opened_to_be_read_in_pieces)
{
    IN_A_FOLDER(folder);
    char path[ROOM], piece[3];
    struct gsn_error err = { 0 };
    int fd = -1;

    put(in(&folder, "large.tif", path), "0123456789");
    CHECK_OK(gsn_file_open(path, &fd, &err), err);
    CHECK(pread(fd, piece, sizeof piece, 5) == 3 && memcmp(piece, "567", 3) == 0);
    CHECK(fcntl(fd, F_GETFD) & FD_CLOEXEC); /* no child inherits it */
    CHECK(close(fd) == 0);
    fd = 77;
    CHECK(gsn_file_open(in(&folder, "missing", path), &fd, &err) == GSN_E_NOTFOUND);
    CHECK(gsn_file_open(in(&folder, "large.tif/below", path), &fd, &err) == GSN_E_IO);
    CHECK(fd == 77);
}

TEST(a_file_can_be_gone_on_with_but_not_made_so)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;
    int fd = 77;

    CHECK(gsn_file_reopen(in(&folder, "file", path), &fd, &err) == GSN_E_NOTFOUND);
    CHECK(fd == 77);
    put(path, "abc");
    CHECK_OK(gsn_file_reopen(path, &fd, &err), err);
    CHECK(pwrite(fd, "d", 1, 3) == 1);
    CHECK_OK(gsn_file_sync(fd, path, &err), err);
    CHECK(close(fd) == 0);
    CHECK_OK(gsn_file_read(path, 10, &bytes, &size, &err), err);
    CHECK(size == 4 && memcmp(bytes, "abcd", 4) == 0);
    CHECK(gsn_file_sync(-1, "name", &err) == GSN_E_IO);
    CHECK(strcmp(err.text, "name: fsync: Bad file descriptor") == 0);
}

TEST(a_directory_can_be_made_durable_and_nothing_else)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_sync_dir(folder.path, &err), err);
    CHECK_OK(gsn_file_sync_dir(".", &err), err);
    put(in(&folder, "file", path), "x");
    CHECK(gsn_file_sync_dir(path, &err) == GSN_E_IO);
    CHECK(strncmp(err.text, path, strlen(path)) == 0);
    CHECK(gsn_file_sync_dir(in(&folder, "missing", path), &err) == GSN_E_IO);
}

TEST(the_limit_is_the_last_size_that_is_read)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size;
    struct gsn_error err = { 0 };

    put(in(&folder, "ten", path), "0123456789");
    CHECK_OK(gsn_file_read(path, 10, &bytes, &size, &err), err);
    CHECK(size == 10);
    check_refused(path, 9, GSN_E_LIMIT, &err);
    CHECK(strstr(err.text, "10 bytes are more than the limit of 9") != NULL);
    check_refused(path, 0, GSN_E_LIMIT, &err);
}

TEST(a_huge_file_is_refused_before_anything_is_allocated)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    put(in(&folder, "bomb", path), "");
    CHECK(truncate(path, (off_t)1 << 40) == 0); /* a hole: it takes no room on the disk */
    check_refused(path, (size_t)1 << 30, GSN_E_LIMIT, &err);
}

TEST(a_path_through_a_file_is_refused)
{
    IN_A_FOLDER(folder);
    char path[ROOM], file[ROOM];
    struct gsn_error err = { 0 };

    put(in(&folder, "file", file), "here");
    in(&folder, "file/below", path);
    check_refused(path, 100, GSN_E_IO, &err);
    CHECK(gsn_file_write(path, "x", 1, &err) == GSN_E_IO);
    CHECK(strncmp(err.text, path, strlen(path)) == 0);
    CHECK(holds(file, "here"));
    CHECK(entries(folder.path) == 1);
}

TEST(a_folder_that_is_missing_is_not_made_by_writing)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    CHECK(gsn_file_write(in(&folder, "missing/x", path), "x", 1, &err) == GSN_E_IO);
    CHECK(entries(folder.path) == 0);
}

TEST(when_the_name_is_a_folder_no_temporary_stays)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    CHECK(mkdir(in(&folder, "taken", path), 0755) == 0);
    CHECK(gsn_file_write(path, "x", 1, &err) == GSN_E_IO);
    CHECK(entries(folder.path) == 1 && entries(path) == 0);
}

TEST(when_the_disk_is_full_the_old_file_stays_and_no_temporary)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    gsn_auto_mem(uint8_t) much = gsn_alloc_array(100000, 1);
    struct rlimit before, small;
    struct gsn_error err = { 0 };
    void (*was)(int);
    int r;

    CHECK(much != NULL);
    put(in(&folder, "report.json", path), "old and whole");
    /* A limit on the size of files stops write() half way, as a full disk does. */
    was = signal(SIGXFSZ, SIG_IGN);
    CHECK(getrlimit(RLIMIT_FSIZE, &before) == 0);
    small = (struct rlimit){ .rlim_cur = 50000, .rlim_max = before.rlim_max };
    CHECK(setrlimit(RLIMIT_FSIZE, &small) == 0);
    r = gsn_file_write(path, much, 100000, &err);
    CHECK(setrlimit(RLIMIT_FSIZE, &before) == 0);
    (void)signal(SIGXFSZ, was);
    CHECK(r == GSN_E_IO);
    CHECK(holds(path, "old and whole"));
    CHECK(entries(folder.path) == 1);
}

/* The answer of a write by somebody who is not root. */
static int write_as_nobody(const char *path)
{
    struct gsn_error err = { 0 };
    const pid_t child = fork();
    int status = 0;

    CHECK(child >= 0);
    if (child == 0) {
        if (geteuid() == 0 && setresuid(NOBODY, NOBODY, NOBODY) < 0)
            _exit(100);
        _exit(-gsn_file_write(path, "x", 1, &err));
    }
    CHECK(waitpid(child, &status, 0) == child);
    CHECK(WIFEXITED(status));
    return -WEXITSTATUS(status);
}

TEST(a_read_only_folder_is_refused_and_stays_as_it_was)
{
    IN_A_FOLDER(folder);
    char path[ROOM];

    put(in(&folder, "old", path), "old");
    CHECK(chmod(folder.path, 0555) == 0);
    CHECK(write_as_nobody(path) == GSN_E_IO);
    CHECK(entries(folder.path) == 1 && holds(path, "old"));
    CHECK(chmod(folder.path, 0777) == 0); /* the same write is fine where it may be made */
    CHECK(write_as_nobody(path) == GSN_OK);
    CHECK(entries(folder.path) == 1 && holds(path, "x"));
}

TEST(nested_folders_are_made_and_those_that_exist_are_fine)
{
    static const char *const names[] = { "objects/ab/cd", "objects/ab/cd", "objects/ab/ef/",
                                         "objects//x/./y" };
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct stat st;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        CHECK_OK(gsn_file_mkdir(in(&folder, names[i], path), &err), err);
        CHECK(stat(path, &st) == 0 && S_ISDIR(st.st_mode));
    }
    CHECK_OK(gsn_file_mkdir("/", &err), err);
    CHECK_OK(gsn_file_mkdir("/tmp", &err), err);
    CHECK_OK(gsn_file_mkdir(".", &err), err);
}

TEST(a_file_in_the_way_of_a_folder_is_refused)
{
    IN_A_FOLDER(folder);
    char path[ROOM], below[ROOM];
    struct gsn_error err = { 0 };

    put(in(&folder, "file", path), "here");
    CHECK(gsn_file_mkdir(in(&folder, "file/below/it", below), &err) == GSN_E_IO);
    CHECK(gsn_file_mkdir(path, &err) == GSN_E_IO);
    CHECK(strncmp(err.text, path, strlen(path)) == 0);
    CHECK(holds(path, "here"));
}

TEST(an_empty_path_is_no_folder)
{
    struct gsn_error err = { 0 };

    CHECK(gsn_file_mkdir("", &err) == GSN_E_IO);
}

static int do_everything(const struct folder *folder, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    char path[ROOM];
    size_t size;
    int r = gsn_file_mkdir(in(folder, "a/b", path), err);

    if (r >= 0)
        r = gsn_file_write(in(folder, "a/b/c", path), "text", 4, err);
    if (r >= 0)
        r = gsn_file_read(path, 100, &bytes, &size, err);
    return r;
}

TEST(running_out_of_memory_leaks_nothing_and_leaves_no_temporary)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(do_everything(&folder, &err), err);
    CHECK(entries(in(&folder, "a/b", path)) == 1);
    CHECK(holds(in(&folder, "a/b/c", path), "text"));
}

TEST(no_descriptor_is_left_open)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size;
    struct gsn_error err = { 0 };
    const size_t before = entries("/proc/self/fd");

    CHECK_OK(do_everything(&folder, &err), err);
    CHECK(gsn_file_read(in(&folder, "a", path), 9, &bytes, &size, &err) == GSN_E_INPUT);
    CHECK(gsn_file_write(path, "x", 1, &err) == GSN_E_IO);
    CHECK(gsn_file_read(in(&folder, "a/b/c", path), 1, &bytes, &size, &err) == GSN_E_LIMIT);
    CHECK(entries("/proc/self/fd") == before);
}

/* ---- one way into a folder that others write to ------------------------------------------- */

static int open_in(const struct folder *folder, const char *name, struct gsn_error *err)
{
    gsn_auto_fd fd = -1;
    char byte;
    const int r = gsn_file_open_in(folder->path, name, &fd, err);

    CHECK(r < 0 || (fd >= 0 && read(fd, &byte, 1) == 1));
    return r;
}

TEST(a_file_of_a_folder_is_opened_wherever_it_lies_in_it)
{
    IN_A_FOLDER(folder);
    char path[ROOM];
    struct gsn_error err = { 0 };

    put(in(&folder, "a", path), "x");
    CHECK_OK(gsn_file_mkdir(in(&folder, "deep/er", path), &err), err);
    put(in(&folder, "deep/er/b", path), "x");
    CHECK_OK(open_in(&folder, "a", &err), err);
    CHECK_OK(open_in(&folder, "deep/er/b", &err), err);
    CHECK(open_in(&folder, "none", &err) == GSN_E_NOTFOUND && strstr(err.text, "none: No such"));
    CHECK(open_in(&folder, "none/b", &err) == GSN_E_NOTFOUND);
    CHECK_EVERY_OOM(open_in(&folder, "deep/er/b", &err), err);
}

/* A mask that was a link to a secret file came out as an object for everybody. */
TEST(nothing_leads_out_of_a_folder)
{
    static const char *const out[] = { "../secret",   "in/../../secret", "/etc/passwd", "in/link",
                                       "away/secret", "in//b",           ".",           "",
                                       "..",          "dangling",        "within" };
    IN_A_FOLDER(outer);
    struct folder folder = { "" };
    struct gsn_error err = { 0 };
    char path[ROOM];

    put(in(&outer, "secret", path), "the key");
    CHECK_OK(gsn_file_mkdir(in(&outer, "f/in", path), &err), err);
    (void)snprintf(folder.path, sizeof folder.path, "%.40s/f", outer.path);
    put(in(&folder, "in/b", path), "x");
    CHECK(symlink("../../secret", in(&folder, "in/link", path)) == 0);
    CHECK(symlink("..", in(&folder, "away", path)) == 0);
    CHECK(symlink("nowhere", in(&folder, "dangling", path)) == 0);
    CHECK(symlink("in/b", in(&folder, "within", path)) == 0);
    for (size_t i = 0; i < sizeof out / sizeof out[0]; i++)
        if (open_in(&folder, out[i], &err) != GSN_E_INPUT)
            fail_msg("\"%s\" is not refused: %s", out[i], err.text);
    CHECK(open_in(&folder, "in/link", &err) == GSN_E_INPUT && strstr(err.text, "is a link"));
    CHECK(open_in(&folder, "in", &err) == GSN_E_INPUT && strstr(err.text, "no regular file"));
    CHECK(mkfifo(in(&folder, "pipe", path), 0644) == 0);
    CHECK(open_in(&folder, "pipe", &err) == GSN_E_INPUT);
}

TEST(who_may_not_read_a_file_is_told_whose_it_is)
{
    IN_A_FOLDER(folder);
    const int is_root = geteuid() == 0;
    struct gsn_error err = { 0 };
    char path[ROOM];
    int r;

    put(in(&folder, "P02.png", path), "x");
    CHECK(chmod(path, 0) == 0 && chmod(folder.path, 0755) == 0);
    CHECK(!is_root || seteuid(NOBODY) == 0);
    r = open_in(&folder, "P02.png", &err);
    CHECK(!is_root || seteuid(0) == 0);
    CHECK(r == GSN_E_DENIED);
    CHECK(strstr(err.text, "P02.png may not be read: it is of user "));
    CHECK(strstr(err.text, "with mode 0000"));
}
