/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/storage/scratch.h"

#include <fcntl.h>
#include <ftw.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/check.h"

struct gsn_scratch gsn_scratch_new(void)
{
    const char *const base = getenv("TMPDIR");
    struct gsn_scratch scratch;

    (void)snprintf(scratch.dir, sizeof scratch.dir, "%.80s/gieson-test-XXXXXX",
                   base ? base : "/tmp");
    CHECK(mkdtemp(scratch.dir) != NULL);
    /* Children that gave up their rights must still get in. */
    CHECK(chmod(scratch.dir, 0755) == 0);
    return scratch;
}

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *at)
{
    (void)st;
    (void)kind;
    (void)at;
    return remove(path);
}

void gsn_scratch_remove(struct gsn_scratch *scratch)
{
    (void)nftw(scratch->dir, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

const char *gsn_scratch_path(const struct gsn_scratch *scratch, const char *name)
{
    static char paths[8][4096];
    static unsigned next;
    char *const path = paths[next++ % 8];

    (void)snprintf(path, sizeof paths[0], "%s/%s", scratch->dir, name);
    return path;
}

static void put(const char *path, int flags, off_t at, const void *bytes, size_t size)
{
    const int fd = open(path, flags | O_CREAT | O_CLOEXEC, 0644); /* door */

    CHECK(fd >= 0);
    if (flags & O_APPEND)
        CHECK(write(fd, bytes, size) == (ssize_t)size);
    else
        CHECK(pwrite(fd, bytes, size, at) == (ssize_t)size);
    CHECK(close(fd) == 0);
}

void gsn_scratch_append(const char *path, const void *bytes, size_t size)
{
    put(path, O_WRONLY | O_APPEND, 0, bytes, size);
}

void gsn_scratch_overwrite(const char *path, off_t at, const void *bytes, size_t size)
{
    put(path, O_WRONLY, at, bytes, size);
}

static void run_child(const int gate[2], int as_nobody, int (*body)(void *context), void *context)
{
    enum { NOBODY = 65534 };
    char byte;

    (void)close(gate[1]);
    (void)!read(gate[0], &byte, 1);
    if (as_nobody && geteuid() == 0 && (setegid(NOBODY) < 0 || seteuid(NOBODY) < 0))
        _exit(121);
    _exit(body(context));
}

struct gsn_scratch_child gsn_scratch_start(int as_nobody, int (*body)(void *context), void *context)
{
    struct gsn_scratch_child child;
    int gate[2];

    CHECK(pipe2(gate, O_CLOEXEC) == 0);
    child.pid = fork();
    CHECK(child.pid >= 0);
    if (child.pid == 0)
        run_child(gate, as_nobody, body, context);
    (void)close(gate[0]);
    child.gate = gate[1];
    return child;
}

void gsn_scratch_open_gate(struct gsn_scratch_child *child)
{
    /* Later children hold this end too, so closing it alone would not be noticed. */
    if (child->gate >= 0)
        CHECK(write(child->gate, "", 1) == 1 && close(child->gate) == 0);
    child->gate = -1;
}

int gsn_scratch_wait(struct gsn_scratch_child *child)
{
    int status = 0;

    gsn_scratch_open_gate(child);
    CHECK(waitpid(child->pid, &status, 0) == child->pid);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}
