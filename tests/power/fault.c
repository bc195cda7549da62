/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/power/fault.h"

#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <unistd.h>

static struct fault plan;
static bool armed;
static long calls;
static uint64_t grown;

void fault_arm(const struct fault *fault)
{
    plan = *fault;
    calls = 0;
    grown = 0;
    armed = true;
}

long fault_disarm(void)
{
    armed = false;
    return calls;
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static bool is_turn(void)
{
    calls++;
    if (plan.dies && calls == plan.at)
        _exit(FAULT_DIED);
    return !plan.dies && plan.at && (calls == plan.at || (plan.for_ever && calls > plan.at));
}

static bool fails(bool changes)
{
    if (!armed || (plan.only_changes && !changes) || !is_turn() || plan.shortened)
        return false;
    errno = plan.error;
    return true;
}

/* What of a write may happen: all of it, half, as much as there is room for, or 0 for a failure
 * with errno set. */
static size_t allowed(int fd, size_t size, off_t offset)
{
    struct stat st;
    uint64_t growth;
    const int error = errno;

    if (!armed || size == 0)
        return size;
    if (is_turn()) {
        if (plan.shortened)
            return size > 1 ? size / 2 : size;
        errno = plan.error;
        return 0;
    }
    if (!plan.room || syscall(SYS_newfstatat, fd, "", &st, AT_EMPTY_PATH) < 0 ||
        !S_ISREG(st.st_mode))
        return size;
    if (offset < 0)
        offset = lseek(fd, 0, SEEK_CUR);
    growth = (uint64_t)offset + size > (uint64_t)st.st_size
                 ? (uint64_t)offset + size - (uint64_t)st.st_size
                 : 0;
    if (grown + growth <= plan.room) {
        grown += growth;
        errno = error;
        return size;
    }
    /* What fits is written, the rest is for the next call to fail on. */
    growth -= plan.room - grown;
    grown = plan.room;
    errno = ENOSPC;
    return growth < size ? size - growth : 0;
}

static bool is_change(int flags)
{
    return (flags & O_ACCMODE) != O_RDONLY || flags & (O_CREAT | O_TRUNC);
}

#define OPEN(name)                                                                                 \
    int name(const char *path, int flags, ...)                                                     \
    {                                                                                              \
        va_list rest;                                                                              \
        mode_t mode;                                                                               \
                                                                                                   \
        va_start(rest, flags);                                                                     \
        mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;                           \
        va_end(rest);                                                                              \
        return fails(is_change(flags)) ? -1                                                        \
                                       : (int)syscall(SYS_openat, AT_FDCWD, path, flags, mode);    \
    }
OPEN(open)
OPEN(open64)

int openat(int dir, const char *path, int flags, ...)
{
    va_list rest;
    mode_t mode;

    va_start(rest, flags);
    mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    return fails(is_change(flags)) ? -1 : (int)syscall(SYS_openat, dir, path, flags, mode);
}

int mkostemp(char *path, int flags)
{
    return fails(true) ? -1 : NEXT(mkostemp)(path, flags);
}

DIR *opendir(const char *path)
{
    return fails(false) ? NULL : NEXT(opendir)(path);
}

ssize_t read(int fd, void *to, size_t size)
{
    return fails(false) ? -1 : syscall(SYS_read, fd, to, size);
}

ssize_t write(int fd, const void *from, size_t size)
{
    const size_t most = allowed(fd, size, -1);

    return size && !most ? -1 : syscall(SYS_write, fd, from, most);
}

#define PREAD(name)                                                                                \
    ssize_t name(int fd, void *to, size_t size, off_t offset)                                      \
    {                                                                                              \
        return fails(false) ? -1 : syscall(SYS_pread64, fd, to, size, offset);                     \
    }
PREAD(pread)
PREAD(pread64)

#define PWRITE(name)                                                                               \
    ssize_t name(int fd, const void *from, size_t size, off_t offset)                              \
    {                                                                                              \
        const size_t most = allowed(fd, size, offset);                                             \
                                                                                                   \
        return size && !most ? -1 : syscall(SYS_pwrite64, fd, from, most, offset);                 \
    }
PWRITE(pwrite)
PWRITE(pwrite64)

#define FTRUNCATE(name)                                                                            \
    int name(int fd, off_t size)                                                                   \
    {                                                                                              \
        return fails(true) ? -1 : (int)syscall(SYS_ftruncate, fd, size);                           \
    }
FTRUNCATE(ftruncate)
FTRUNCATE(ftruncate64)

int fsync(int fd)
{
    return fails(true) ? -1 : (int)syscall(SYS_fsync, fd);
}

int fdatasync(int fd)
{
    return fails(true) ? -1 : (int)syscall(SYS_fdatasync, fd);
}

int rename(const char *from, const char *to)
{
    return fails(true) ? -1 : (int)syscall(SYS_rename, from, to);
}

int unlink(const char *path)
{
    return fails(true) ? -1 : (int)syscall(SYS_unlink, path);
}

int mkdir(const char *path, mode_t mode)
{
    return fails(true) ? -1 : (int)syscall(SYS_mkdir, path, mode);
}

int fchmod(int fd, mode_t mode)
{
    return fails(true) ? -1 : (int)syscall(SYS_fchmod, fd, mode);
}

#define STAT(name, type)                                                                           \
    int name(const char *path, struct type *st)                                                    \
    {                                                                                              \
        return fails(false) ? -1 : (int)syscall(SYS_newfstatat, AT_FDCWD, path, st, 0);            \
    }
STAT(stat, stat)
STAT(stat64, stat64)

#define LSTAT(name, type)                                                                          \
    int name(const char *path, struct type *st)                                                    \
    {                                                                                              \
        return fails(false)                                                                        \
                   ? -1                                                                            \
                   : (int)syscall(SYS_newfstatat, AT_FDCWD, path, st, AT_SYMLINK_NOFOLLOW);        \
    }
LSTAT(lstat, stat)
LSTAT(lstat64, stat64)

#define FSTAT(name, type)                                                                          \
    int name(int fd, struct type *st)                                                              \
    {                                                                                              \
        return fails(false) ? -1 : (int)syscall(SYS_newfstatat, fd, "", st, AT_EMPTY_PATH);        \
    }
FSTAT(fstat, stat)
FSTAT(fstat64, stat64)

int flock(int fd, int how)
{
    return fails(false) ? -1 : (int)syscall(SYS_flock, fd, how);
}

int statvfs(const char *path, struct statvfs *fs)
{
    return fails(false) ? -1 : NEXT(statvfs)(path, fs);
}

/* A failed close has closed. */
int close(int fd)
{
    const bool failed = fails(false);
    const int error = errno, r = (int)syscall(SYS_close, fd);

    errno = failed ? error : errno;
    return failed ? -1 : r;
}

/* A lock is no disk's business: it fails in its turn, but not for ever, or SQLite would wait for
 * the other process that it takes for the cause. */
static bool lock_fails(void)
{
    return fails(false) && calls == plan.at;
}

#define FCNTL(name)                                                                                \
    int name(int fd, int what, ...)                                                                \
    {                                                                                              \
        va_list rest;                                                                              \
        void *argument;                                                                            \
                                                                                                   \
        va_start(rest, what);                                                                      \
        argument = va_arg(rest, void *);                                                           \
        va_end(rest);                                                                              \
        return (what == F_SETLK || what == F_GETLK) && lock_fails()                                \
                   ? -1                                                                            \
                   : (int)syscall(SYS_fcntl, fd, what, argument);                                  \
    }
FCNTL(fcntl)
FCNTL(fcntl64)

#define MMAP(name)                                                                                 \
    void *name(void *at, size_t size, int protection, int flags, int fd, off_t offset)             \
    {                                                                                              \
        return fd >= 0 && flags & MAP_SHARED && fails(protection & PROT_WRITE)                     \
                   ? MAP_FAILED                                                                    \
                   : (void *)syscall(SYS_mmap, at, size, protection, flags, fd, offset);           \
    }
MMAP(mmap)
MMAP(mmap64)
