/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A file seen through a small window, for the walks of container.c. Private to this folder. */
#ifndef GSN_ACQUIRE_CONTAINER_WALK_H
#define GSN_ACQUIRE_CONTAINER_WALK_H

#include "acquire/container.h"

enum { GSN_WALK_WINDOW = 32768 };

struct gsn_walk {
    const uint8_t *bytes; /* the whole content; NULL: read from fd through the window */
    uint64_t size;
    int fd;
    int failure; /* errno of a pread() that failed; 0: none */
    uint64_t at; /* offset of the window */
    size_t filled;
    uint8_t window[GSN_WALK_WINDOW];
};

/* size bytes (at most GSN_WALK_WINDOW) from offset, valid until the next call; NULL when they are
 * not all inside the file. */
const uint8_t *gsn_walk_view(struct gsn_walk *walk, uint64_t offset, size_t size);

/* How many bytes from offset a view can cheaply hold; 0 at the end of the file. */
size_t gsn_walk_run(const struct gsn_walk *walk, uint64_t offset);

/* An answer "not complete" with its reason. */
struct gsn_container gsn_walk_missing(enum gsn_container_kind kind, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* The file's first four bytes are those of a TIFF or BigTIFF. */
struct gsn_container gsn_walk_tiff(struct gsn_walk *walk);

#endif
