/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/service.h"

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <unistd.h>

static const char *const names[] = { "takes panels in", "works the queue" };

/* One byte of the file per service. */
static struct flock byte_of(enum gsn_service service)
{
    return (struct flock){
        .l_type = F_WRLCK, .l_whence = SEEK_SET, .l_start = (off_t)service, .l_len = 1
    };
}

static char *path_of(const char *dir)
{
    return gsn_format("%s/giesond.lock", dir);
}

int gsn_service_take(const char *dir, enum gsn_service service, int *ret_lock,
                     struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of(dir);
    struct flock byte = byte_of(service);
    int fd = -1;
    int r = path ? gsn_file_open_lock(path, &fd, err)
                 : gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);

    if (r < 0)
        return r;
    /* Of the open file, not of the process: another descriptor that is closed cannot drop it. */
    if (fcntl(fd, F_OFD_SETLK, &byte) == 0) {
        *ret_lock = fd;
        return GSN_OK;
    }
    r = errno == EAGAIN || errno == EACCES
            ? gsn_fail(err, GSN_E_BUSY, "another giesond %s for %s already", names[service], dir)
            : gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    (void)close(fd);
    return r;
}

int gsn_service_is_there(const char *dir, enum gsn_service service, int *ret_there,
                         struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of(dir);
    struct flock byte = byte_of(service);
    int fd = -1;
    int r =
        path ? gsn_file_open(path, &fd, err) : gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);

    if (r == GSN_E_NOTFOUND) {
        *ret_there = 0;
        return GSN_OK;
    }
    if (r < 0)
        return r;
    if (fcntl(fd, F_OFD_GETLK, &byte) < 0)
        r = gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    (void)close(fd);
    if (r >= 0)
        *ret_there = byte.l_type != F_UNLCK;
    return r;
}
