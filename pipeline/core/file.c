/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whole files by POSIX calls; reading, writing and fsync() go on after a signal.
 *
 * Writing is an atomic replacement: a temporary file beside the target, fsync(), rename() over it,
 * fsync() of the directory, without which the new name might not survive a power cut. Reading asks
 * fstat() for the size before it allocates. A name in a folder that others write to is opened one
 * component after the other, with openat() and O_NOFOLLOW from the folder on, so that neither a
 * link nor ".." leads out of it.
 *
 * Failure: the path and what the system says; a temporary file that was not finished is removed.
 * Cost: a write waits for the disk twice. */
#include "pipeline/core/file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int read_all(int fd, const char *path, uint8_t *bytes, size_t size, struct gsn_error *err)
{
    for (size_t done = 0; done < size;) {
        const ssize_t got = pread(fd, bytes + done, size - done, (off_t)done);

        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return gsn_fail(err, GSN_E_IO, "%s: reading stopped at byte %zu of %zu: %s", path, done,
                            size, got < 0 ? strerror(errno) : "the file became shorter");
        done += (size_t)got;
    }
    return GSN_OK;
}

int gsn_file_read_open(int fd, const char *path, size_t limit, uint8_t **ret_bytes,
                       size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct stat st;
    int r;

    if (fstat(fd, &st) < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (!S_ISREG(st.st_mode))
        return gsn_fail(err, GSN_E_INPUT, "%s: not a regular file", path);
    if ((uint64_t)st.st_size > limit)
        return gsn_fail(err, GSN_E_LIMIT, "%s: %lld bytes are more than the limit of %zu", path,
                        (long long)st.st_size, limit);
    bytes = gsn_alloc((size_t)st.st_size + 1);
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", path);
    r = read_all(fd, path, bytes, (size_t)st.st_size, err);
    if (r < 0)
        return r;
    bytes[st.st_size] = 0;
    *ret_size = (size_t)st.st_size;
    *ret_bytes = gsn_steal(&bytes);
    return GSN_OK;
}

int gsn_file_open(const char *path, int *ret_fd, struct gsn_error *err)
{
    /* O_NONBLOCK: a pipe somebody left in a folder must not stop us. */
    const int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY); /* door */

    if (fd < 0)
        return gsn_fail(err, errno == ENOENT ? GSN_E_NOTFOUND : GSN_E_IO, "%s: %s", path,
                        strerror(errno));
    *ret_fd = fd;
    return GSN_OK;
}

/* Whom this user is kept out by, so that somebody can let him in. */
static int tell_denied(int dir, const char *part, const char *name, struct gsn_error *err)
{
    struct stat st;

    if (fstatat(dir, part, &st, AT_SYMLINK_NOFOLLOW) < 0)
        return gsn_fail(err, GSN_E_DENIED, "%s may not be read", name);
    return gsn_fail(err, GSN_E_DENIED,
                    "%s may not be read: it is of user %lld with mode %04o, and this is user %lld",
                    name, (long long)st.st_uid, (unsigned)st.st_mode & 07777, (long long)geteuid());
}

static int tell_closed(int dir, const char *part, const char *name, int why, struct gsn_error *err)
{
    struct stat st;

    if (fstatat(dir, part, &st, AT_SYMLINK_NOFOLLOW) == 0 && S_ISLNK(st.st_mode))
        return gsn_fail(err, GSN_E_INPUT,
                        "%s is a link, and links in a scan folder are not followed: they could "
                        "lead to any file",
                        name);
    if (why == EACCES || why == EPERM)
        return tell_denied(dir, part, name, err);
    return gsn_fail(err, why == ENOENT ? GSN_E_NOTFOUND : GSN_E_IO, "%s: %s", name, strerror(why));
}

/* One part of a path after the other, so that a link is noticed wherever it stands. O_NONBLOCK: a
 * pipe must not stop us. */
static int open_part(int dir, const char *part, bool last, const char *name, int *ret_fd,
                     struct gsn_error *err)
{
    const int flags = last ? O_RDONLY | O_NONBLOCK | O_NOCTTY : O_PATH | O_DIRECTORY;
    int fd;

    if (!part[0] || strcmp(part, ".") == 0 || strcmp(part, "..") == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s leads out of its folder", name);
    fd = openat(dir, part, flags | O_NOFOLLOW | O_CLOEXEC); /* door */
    if (fd < 0)
        return tell_closed(dir, part, name, errno, err);
    *ret_fd = fd;
    return GSN_OK;
}

int gsn_file_open_in(const char *folder, const char *name, int *ret_fd, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(name);
    gsn_auto_fd at = -1;
    struct stat st;
    int r = GSN_OK;

    if (!copy)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", name);
    at = open(folder, O_PATH | O_CLOEXEC | O_DIRECTORY); /* door */
    if (at < 0)
        return gsn_fail(err, errno == ENOENT ? GSN_E_NOTFOUND : GSN_E_IO, "%s: %s", folder,
                        strerror(errno));
    for (char *part = copy; r >= 0 && part;) {
        char *const slash = strchr(part, '/');
        int fd = -1;

        if (slash)
            *slash = '\0';
        r = open_part(at, part, !slash, name, &fd, err);
        if (r >= 0) {
            gsn_fd_close(&at);
            at = fd;
        }
        part = slash ? slash + 1 : NULL;
    }
    if (r < 0)
        return r;
    if (fstat(at, &st) < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", name, strerror(errno));
    if (!S_ISREG(st.st_mode))
        return gsn_fail(err, GSN_E_INPUT, "%s is no regular file", name);
    *ret_fd = at;
    at = -1;
    return GSN_OK;
}

int gsn_file_open_lock(const char *path, int *ret_fd, struct gsn_error *err)
{
    const int fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOCTTY, 0644); /* door */

    if (fd < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    *ret_fd = fd;
    return GSN_OK;
}

int gsn_file_reopen(const char *path, int *ret_fd, struct gsn_error *err)
{
    const int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW); /* door */

    if (fd < 0)
        return gsn_fail(err, errno == ENOENT ? GSN_E_NOTFOUND : GSN_E_IO, "%s: %s", path,
                        strerror(errno));
    *ret_fd = fd;
    return GSN_OK;
}

int gsn_file_sync(int fd, const char *path, struct gsn_error *err)
{
    int r;

    do
        r = fsync(fd);
    while (r < 0 && errno == EINTR);
    return r < 0 ? gsn_fail(err, GSN_E_IO, "%s: fsync: %s", path, strerror(errno)) : GSN_OK;
}

int gsn_file_read(const char *path, size_t limit, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err)
{
    int fd = -1, r = gsn_file_open(path, &fd, err);

    if (r < 0)
        return r;
    r = gsn_file_read_open(fd, path, limit, ret_bytes, ret_size, err);
    (void)close(fd);
    return r;
}

void gsn_fd_close(int *fd)
{
    if (*fd >= 0)
        (void)close(*fd);
    *fd = -1;
}

void gsn_dir_close(DIR **dir)
{
    if (*dir)
        (void)closedir(*dir);
    *dir = NULL;
}

static int write_all(int fd, const char *path, const uint8_t *bytes, size_t size,
                     struct gsn_error *err)
{
    for (size_t done = 0; done < size;) {
        const ssize_t put = write(fd, bytes + done, size - done);

        if (put < 0 && errno == EINTR)
            continue;
        if (put < 0)
            return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
        done += (size_t)put;
    }
    return gsn_file_sync(fd, path, err);
}

int gsn_file_sync_dir(const char *dir, struct gsn_error *err)
{
    const int fd = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC); /* door */
    int r;

    if (fd < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", dir, strerror(errno));
    r = gsn_file_sync(fd, dir, err);
    (void)close(fd);
    return r;
}

static int sync_parent(const char *path, struct gsn_error *err)
{
    gsn_auto_mem(char) parent = gsn_strdup(path);
    char *slash;

    if (!parent)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", path);
    slash = strrchr(parent, '/');
    if (slash == parent)
        slash[1] = '\0';
    else if (slash)
        *slash = '\0';
    return gsn_file_sync_dir(slash ? parent : ".", err);
}

int gsn_file_write(const char *path, const void *bytes, size_t size, struct gsn_error *err)
{
    gsn_auto_mem(char) temp = gsn_format("%s.XXXXXX", path);
    int fd, r;

    if (!temp)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", path);
    fd = mkostemp(temp, O_CLOEXEC);
    if (fd < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    r = write_all(fd, path, bytes, size, err);
    if (r >= 0 && fchmod(fd, 0644) < 0)
        r = gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (close(fd) < 0 && r >= 0)
        r = gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (r >= 0 && rename(temp, path) < 0)
        r = gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (r < 0) {
        (void)unlink(temp);
        return r;
    }
    return sync_parent(path, err);
}

static int make_one(const char *path, struct gsn_error *err)
{
    struct stat st;

    if (mkdir(path, 0755) == 0)
        return sync_parent(path, err);
    if (errno != EEXIST)
        return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (stat(path, &st) < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (!S_ISDIR(st.st_mode))
        return gsn_fail(err, GSN_E_IO, "%s: not a directory", path);
    return GSN_OK;
}

int gsn_file_mkdir(const char *path, struct gsn_error *err)
{
    gsn_auto_mem(char) part = gsn_strdup(path);

    if (!part)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", path);
    for (char *p = strchr(part, '/'); p; p = strchr(p + 1, '/')) {
        int r = GSN_OK;

        *p = '\0';
        if (p > part)
            r = make_one(part, err);
        *p = '/';
        if (r < 0)
            return r;
    }
    return make_one(part, err);
}
