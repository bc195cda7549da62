/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Loaded before a program's libraries, it writes down every change of a file below
 * GSN_POWER_ROOT. Calls it does not know would be missing from the trace: the rebuilder compares
 * the last state of the trace with the directory that the program left. */
#include "tests/power/trace.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/sendfile.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { MOST_FILES = 65536 };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static char root[PATH_MAX];
static int trace = -1;
static dev_t device;
static ino_t known[MOST_FILES]; /* inodes of files below the root; a free place is 0 */

/* The next definition of the function we stand in for, as a pointer of this type. */
#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void start(void)
{
    const char *const dir = getenv("GSN_POWER_ROOT"), *const file = getenv("GSN_POWER_TRACE");
    struct stat st;

    if (!dir || !file || !realpath(dir, root) || stat(root, &st) < 0)
        return;
    device = st.st_dev;
    trace =
        (int)syscall(SYS_openat, AT_FDCWD, file, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
}

static void out_of_order(const char *what)
{
    (void)!write(STDERR_FILENO, what, strlen(what));
    _exit(70);
}

/* The name below the root, or NULL for files that are none of ours. */
static const char *below(int dir, const char *path, char room[static PATH_MAX])
{
    const size_t length = strlen(root);
    char link[64];
    ssize_t got;

    if (trace < 0 || !path)
        return NULL;
    if (path[0] != '/') {
        (void)snprintf(link, sizeof link, "/proc/self/fd/%d", dir);
        got = dir == AT_FDCWD ? (getcwd(room, PATH_MAX) ? (ssize_t)strlen(room) : -1)
                              : (ssize_t)syscall(SYS_readlinkat, AT_FDCWD, link, room, PATH_MAX);
        if (got < 0 || (size_t)got + strlen(path) + 2 > PATH_MAX)
            return NULL;
        room[got] = '/';
        strcpy(room + got + 1, path);
        path = room;
    }
    return strncmp(path, root, length) == 0 && path[length] == '/' ? path + length + 1 : NULL;
}

static ino_t *place_of(ino_t inode)
{
    size_t i = (size_t)inode * 2654435761u % MOST_FILES;

    while (known[i] && known[i] != inode)
        i = (i + 1) % MOST_FILES;
    return &known[i];
}

/* The inode of a file of ours, else 0. */
static uint64_t inode_of(int fd)
{
    struct stat st;

    if (trace < 0 || fstat(fd, &st) < 0 || st.st_dev != device || !*place_of(st.st_ino))
        return 0;
    return st.st_ino;
}

static void note(const struct power_record *record, const char *name, const char *other,
                 const struct iovec *data, int pieces)
{
    struct power_record full = *record;
    struct iovec at[64];
    size_t size = sizeof full;
    const int error = errno;

    full.name = name ? (uint32_t)strlen(name) : 0;
    full.other = other ? (uint32_t)strlen(other) : 0;
    at[0] = (struct iovec){ &full, sizeof full };
    at[1] = (struct iovec){ (void *)name, full.name };
    at[2] = (struct iovec){ (void *)other, full.other };
    for (int i = 0; i < pieces; i++)
        at[3 + i] = data[i];
    for (int i = 1; i < 3 + pieces; i++)
        size += at[i].iov_len;
    (void)pthread_mutex_lock(&lock);
    if (syscall(SYS_writev, trace, at, 3 + pieces) != (long)size)
        out_of_order("the recorder cannot write its trace\n");
    (void)pthread_mutex_unlock(&lock);
    errno = error;
}

static void note_name(enum power_op op, const char *name, const char *other, uint64_t inode)
{
    note(&(struct power_record){ .op = op, .inode = inode }, name, other, NULL, 0);
}

void power_mark(const char *text)
{
    if (trace >= 0)
        note_name(POWER_MARK, text, NULL, 0);
}

/* ---- names ---- */

static bool exists(int dir, const char *path)
{
    struct stat st;
    const int error = errno;
    const bool there = fstatat(dir, path, &st, AT_SYMLINK_NOFOLLOW) == 0;

    errno = error;
    return there;
}

static void opened(int fd, int dir, const char *path, int flags, bool was_there)
{
    char room[PATH_MAX];
    const char *const name = below(dir, path, room);
    struct stat st;

    if (fd < 0 || !name || fstat(fd, &st) < 0 || !S_ISREG(st.st_mode))
        return;
    *place_of(st.st_ino) = st.st_ino;
    if (!was_there)
        note(&(struct power_record){ .op = POWER_CREATE, .inode = st.st_ino, .mode = st.st_mode },
             name, NULL, NULL, 0);
    else if (flags & O_TRUNC)
        note_name(POWER_SIZE, NULL, NULL, st.st_ino);
}

static int open_any(int dir, const char *path, int flags, mode_t mode)
{
    const bool was_there = !(flags & O_CREAT) || exists(dir, path);
    const int fd = (int)syscall(SYS_openat, dir, path, flags, mode);

    opened(fd, dir, path, flags, was_there);
    return fd;
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
        return open_any(AT_FDCWD, path, flags, mode);                                              \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                                                               \
    int name(int dir, const char *path, int flags, ...)                                            \
    {                                                                                              \
        va_list rest;                                                                              \
        mode_t mode;                                                                               \
                                                                                                   \
        va_start(rest, flags);                                                                     \
        mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;                           \
        va_end(rest);                                                                              \
        return open_any(dir, path, flags, mode);                                                   \
    }
OPENAT(openat)
OPENAT(openat64)

int creat(const char *path, mode_t mode)
{
    return open_any(AT_FDCWD, path, O_CREAT | O_WRONLY | O_TRUNC, mode);
}

#define MKSTEMP(name, parameters, arguments)                                                       \
    int name parameters                                                                            \
    {                                                                                              \
        const int fd = NEXT(name) arguments;                                                       \
                                                                                                   \
        opened(fd, AT_FDCWD, path, O_CREAT, false);                                                \
        return fd;                                                                                 \
    }
MKSTEMP(mkostemp, (char *path, int flags), (path, flags))
MKSTEMP(mkostemp64, (char *path, int flags), (path, flags))
MKSTEMP(mkstemp, (char *path), (path))
MKSTEMP(mkstemp64, (char *path), (path))

int mkdirat(int dir, const char *path, mode_t mode)
{
    char room[PATH_MAX];
    const char *const name = below(dir, path, room);
    const int r = (int)syscall(SYS_mkdirat, dir, path, mode);

    if (r == 0 && name)
        note_name(POWER_MKDIR, name, NULL, 0);
    return r;
}

int mkdir(const char *path, mode_t mode)
{
    return mkdirat(AT_FDCWD, path, mode);
}

int unlinkat(int dir, const char *path, int flags)
{
    char room[PATH_MAX];
    const char *const name = below(dir, path, room);
    const int r = (int)syscall(SYS_unlinkat, dir, path, flags);

    if (r == 0 && name)
        note_name(POWER_UNLINK, name, NULL, 0);
    return r;
}

int unlink(const char *path)
{
    return unlinkat(AT_FDCWD, path, 0);
}

int rmdir(const char *path)
{
    return unlinkat(AT_FDCWD, path, AT_REMOVEDIR);
}

int renameat2(int from, const char *path, int to, const char *other, unsigned flags)
{
    char rooms[2][PATH_MAX];
    const char *const name = below(from, path, rooms[0]), *const onto = below(to, other, rooms[1]);
    const int r = (int)syscall(SYS_renameat2, from, path, to, other, flags);

    if (r == 0 && (name || onto)) {
        if (!name || !onto || flags & ~1u)
            out_of_order("the recorder does not know renames over its border\n");
        note_name(POWER_RENAME, name, onto, 0);
    }
    return r;
}

int renameat(int from, const char *path, int to, const char *other)
{
    return renameat2(from, path, to, other, 0);
}

int rename(const char *path, const char *other)
{
    return renameat2(AT_FDCWD, path, AT_FDCWD, other, 0);
}

int linkat(int from, const char *path, int to, const char *other, int flags)
{
    char rooms[2][PATH_MAX];
    const char *const name = below(from, path, rooms[0]), *const onto = below(to, other, rooms[1]);
    const int r = (int)syscall(SYS_linkat, from, path, to, other, flags);

    if (r == 0 && onto) {
        if (!name)
            out_of_order("the recorder does not know links over its border\n");
        note_name(POWER_LINK, name, onto, 0);
    }
    return r;
}

int link(const char *path, const char *other)
{
    return linkat(AT_FDCWD, path, AT_FDCWD, other, 0);
}

/* ---- bytes ---- */

static void wrote(int fd, ssize_t put, off_t offset, const struct iovec *at, int pieces)
{
    const uint64_t inode = put > 0 ? inode_of(fd) : 0;
    struct iovec part[60];
    size_t left = (size_t)put;

    if (!inode)
        return;
    if (pieces > 60)
        out_of_order("the recorder does not know writes of so many pieces\n");
    for (int i = 0; i < pieces; i++) {
        part[i] = at[i];
        part[i].iov_len = at[i].iov_len < left ? at[i].iov_len : left;
        left -= part[i].iov_len;
    }
    note(
        &(struct power_record){
            .op = POWER_WRITE, .inode = inode, .offset = (uint64_t)offset, .data = (uint64_t)put },
        NULL, NULL, part, pieces);
}

ssize_t writev(int fd, const struct iovec *at, int pieces)
{
    const ssize_t put = syscall(SYS_writev, fd, at, pieces);

    if (put > 0 && inode_of(fd)) /* the position is behind what was written, O_APPEND or not */
        wrote(fd, put, lseek(fd, 0, SEEK_CUR) - put, at, pieces);
    return put;
}

ssize_t write(int fd, const void *bytes, size_t size)
{
    const struct iovec at = { (void *)bytes, size };
    const ssize_t put = syscall(SYS_write, fd, bytes, size);

    if (put > 0 && inode_of(fd))
        wrote(fd, put, lseek(fd, 0, SEEK_CUR) - put, &at, 1);
    return put;
}

#define PWRITE(name)                                                                               \
    ssize_t name(int fd, const void *bytes, size_t size, off_t offset)                             \
    {                                                                                              \
        const struct iovec at = { (void *)bytes, size };                                           \
        const ssize_t put = syscall(SYS_pwrite64, fd, bytes, size, offset);                        \
                                                                                                   \
        wrote(fd, put, offset, &at, 1);                                                            \
        return put;                                                                                \
    }
PWRITE(pwrite)
PWRITE(pwrite64)

#define PWRITEV(name)                                                                              \
    ssize_t name(int fd, const struct iovec *at, int pieces, off_t offset)                         \
    {                                                                                              \
        const ssize_t put = syscall(SYS_pwritev, fd, at, pieces, offset, 0);                       \
                                                                                                   \
        wrote(fd, put, offset, at, pieces);                                                        \
        return put;                                                                                \
    }
PWRITEV(pwritev)
PWRITEV(pwritev64)

/* Copies within the kernel are written down as the writes they stand for. */
#define IN_KERNEL(type, name, parameters)                                                          \
    type name parameters                                                                           \
    {                                                                                              \
        if (inode_of(to))                                                                          \
            out_of_order("the recorder does not know " #name "\n");                                \
        errno = ENOSYS;                                                                            \
        return -1;                                                                                 \
    }
IN_KERNEL(ssize_t, copy_file_range,
          (int from __attribute__((unused)), off64_t *at __attribute__((unused)), int to,
           off64_t *there __attribute__((unused)), size_t size __attribute__((unused)),
           unsigned flags __attribute__((unused))))
IN_KERNEL(ssize_t, sendfile,
          (int to, int from __attribute__((unused)), off_t *at __attribute__((unused)),
           size_t size __attribute__((unused))))

static int sized(int fd, int r, off_t size)
{
    const uint64_t inode = r == 0 ? inode_of(fd) : 0;

    if (inode)
        note(&(struct power_record){ .op = POWER_SIZE, .inode = inode, .offset = (uint64_t)size },
             NULL, NULL, NULL, 0);
    return r;
}

#define FTRUNCATE(name)                                                                            \
    int name(int fd, off_t size)                                                                   \
    {                                                                                              \
        return sized(fd, (int)syscall(SYS_ftruncate, fd, size), size);                             \
    }
FTRUNCATE(ftruncate)
FTRUNCATE(ftruncate64)

static int allocate(int fd, int mode, off_t offset, off_t size)
{
    struct stat before;
    int r;

    if (fstat(fd, &before) < 0)
        return -1;
    if (mode && inode_of(fd))
        out_of_order("the recorder does not know fallocate with a mode\n");
    r = (int)syscall(SYS_fallocate, fd, mode, offset, size);
    return offset + size > before.st_size ? sized(fd, r, offset + size) : r;
}

int fallocate(int fd, int mode, off_t offset, off_t size)
{
    return allocate(fd, mode, offset, size);
}

int fallocate64(int fd, int mode, off_t offset, off_t size)
{
    return allocate(fd, mode, offset, size);
}

int posix_fallocate(int fd, off_t offset, off_t size)
{
    return allocate(fd, 0, offset, size) < 0 ? errno : 0;
}

int posix_fallocate64(int fd, off_t offset, off_t size)
{
    return allocate(fd, 0, offset, size) < 0 ? errno : 0;
}

int fchmod(int fd, mode_t mode)
{
    const int r = (int)syscall(SYS_fchmod, fd, mode);
    const uint64_t inode = r == 0 ? inode_of(fd) : 0;

    if (inode)
        note(&(struct power_record){ .op = POWER_MODE, .inode = inode, .mode = mode }, NULL, NULL,
             NULL, 0);
    return r;
}

#define MMAP(name)                                                                                 \
    void *name(void *at, size_t size, int protection, int flags, int fd, off_t offset)             \
    {                                                                                              \
        const uint64_t inode =                                                                     \
            flags & MAP_SHARED && protection & PROT_WRITE && fd >= 0 ? inode_of(fd) : 0;           \
                                                                                                   \
        if (inode)                                                                                 \
            note_name(POWER_MAPPED, NULL, NULL, inode);                                            \
        return (void *)syscall(SYS_mmap, at, size, protection, flags, fd, offset);                 \
    }
MMAP(mmap)
MMAP(mmap64)

/* ---- syncs ---- */

static int synced(int fd, int r)
{
    char link[64], room[PATH_MAX + 1];
    struct stat st;
    ssize_t got;

    if (r < 0 || trace < 0 || fstat(fd, &st) < 0)
        return r;
    if (!S_ISDIR(st.st_mode)) {
        if (inode_of(fd))
            note_name(POWER_SYNC, NULL, NULL, st.st_ino);
        return r;
    }
    (void)snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    got = syscall(SYS_readlinkat, AT_FDCWD, link, room, PATH_MAX);
    if (got < 0)
        return r;
    room[got] = '\0';
    if (strcmp(room, root) == 0)
        note_name(POWER_SYNC_DIR, NULL, NULL, 0);
    else if (strncmp(room, root, strlen(root)) == 0 && room[strlen(root)] == '/')
        note_name(POWER_SYNC_DIR, room + strlen(root) + 1, NULL, 0);
    return r;
}

int fsync(int fd)
{
    return synced(fd, (int)syscall(SYS_fsync, fd));
}

int fdatasync(int fd)
{
    return synced(fd, (int)syscall(SYS_fdatasync, fd));
}
