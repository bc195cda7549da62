/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The one pass over a picture's bytes: from where they come through the hash into a file. Private
 * to the spool. */
#ifndef GSN_ACQUIRE_SPOOL_COPY_H
#define GSN_ACQUIRE_SPOOL_COPY_H

#include "pipeline/core/error.h"
#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

/* Where the bytes come from: fills up to size bytes from offset, 0 at the end. */
struct gsn_spool_feed {
    int (*read)(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                struct gsn_error *err);
    void *context;
    uint64_t size; /* announced */
};

/* A descriptor as a feed of this size; context is its address. */
int gsn_spool_read_fd(void *context, uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                      struct gsn_error *err);

enum { GSN_SPOOL_TAIL = 1 << 16 };

/* How far it is. */
struct gsn_spool_copy {
    struct gsn_hash *hash; /* of the first done bytes */
    uint64_t done;
    int broken_off;               /* the feed failed, not the disk */
    void (*alive)(void *context); /* told after every piece; NULL: nobody is */
    void *alive_context;
    uint8_t *piece;
    uint8_t tail[GSN_SPOOL_TAIL]; /* room to compare a part's end */
};

int gsn_spool_copy_new(struct gsn_spool_copy **ret_copy, struct gsn_error *err);
void gsn_spool_copy_free(struct gsn_spool_copy *copy);
GSN_DEFINE_AUTO(gsn_spool_copy);

/* Back to the first byte. */
int gsn_spool_copy_rewind(struct gsn_spool_copy *copy, struct gsn_error *err);

/* Goes on to the end of the feed, which must come where it was announced. fd -1: hashes only.
 * Fails with the feed's error, GSN_E_IO. */
int gsn_spool_copy_run(struct gsn_spool_copy *copy, const struct gsn_spool_feed *feed, int fd,
                       const char *name, struct gsn_error *err);

/* Whether the bytes before copy->done are in the feed as they are in fd, by the last of them. */
int gsn_spool_copy_fits(struct gsn_spool_copy *copy, const struct gsn_spool_feed *feed, int fd,
                        int *ret_fits, struct gsn_error *err);

#endif
