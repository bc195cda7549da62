/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Is a picture file all there? Walks the container, not the picture: PNG chunks to IEND, JPEG
 * markers to EOI, TIFF and BigTIFF directories with all their strips and tiles, PAM by what its
 * header states.
 *
 * The answer keeps half-copied files out of the store; whether the picture is any good is for the
 * decoder to say. Input is hostile: every offset is checked, work is bounded by the file's size. */
#ifndef GSN_ACQUIRE_CONTAINER_H
#define GSN_ACQUIRE_CONTAINER_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_container_kind {
    GSN_CONTAINER_UNKNOWN,
    GSN_CONTAINER_PNG,
    GSN_CONTAINER_JPEG,
    GSN_CONTAINER_TIFF, /* classic and BigTIFF */
    GSN_CONTAINER_PAM,
};

struct gsn_container {
    enum gsn_container_kind kind;
    int complete;     /* 1: everything the container names is inside the file */
    char reason[120]; /* why not, as a sentence without full stop; empty when complete */
};

/* Judges a file by its descriptor, which is read with pread() and not moved.
 * Fails with GSN_E_IO alone; bad content is an answer, not a failure. */
int gsn_container_check_fd(int fd, struct gsn_container *ret_container, struct gsn_error *err);

/* The same for bytes in memory; cannot fail. */
struct gsn_container gsn_container_check(const void *bytes, size_t size);

#ifdef __cplusplus
}
#endif
#endif
