/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Bytes as an open file, for what is read by its descriptor. */
#ifndef GSN_TESTS_MEMORY_FILE_H
#define GSN_TESTS_MEMORY_FILE_H

#include "pipeline/core/error.h"

#include <errno.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

/* gives: a descriptor to close(), of a file without a name. Fails with GSN_E_IO. */
static inline int gsn_memory_file(const void *bytes, size_t size, int *ret_fd,
                                  struct gsn_error *err)
{
    const int fd = memfd_create("test", MFD_CLOEXEC);
    size_t done = 0;

    while (fd >= 0 && done < size) {
        const ssize_t put = write(fd, (const char *)bytes + done, size - done);

        if (put < 0 && errno != EINTR)
            break;
        done += put > 0 ? (size_t)put : 0;
    }
    if (fd >= 0 && done < size)
        (void)close(fd);
    if (fd < 0 || done < size)
        return gsn_fail(err, GSN_E_IO, "no memory for a file of %zu bytes: %s", size,
                        strerror(errno));
    *ret_fd = fd;
    return GSN_OK;
}

#endif
