/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The original bytes, made durable before anything is computed from them.
 *
 * temporary in DIR/objects/tmp -> fsync -> rename to DIR/objects/ab/rest (the SHA-256 of the
 * content) -> fsync of that directory. What follows is the caller's: insert the row, commit, and
 * only then acknowledge to the source. Objects are read-only (0444) and never change. That a
 * temporary's old name is gone is not synced: if it comes back after a power cut, it is swept. */
#ifndef GSN_ACQUIRE_SPOOL_H
#define GSN_ACQUIRE_SPOOL_H

#include "acquire/source.h"
#include "pipeline/core/error.h"
#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_spool;

/* Opens the spool of a store's directory and makes DIR/objects with its 256 folders when missing.
 * gives: the spool.
 *
 * Temporaries of crashed writers are swept, those of living ones are not: they hold a lock. Parts
 * of broken-off copies stay for a week, the newest eight of them.
 * reserve_bytes: space that must stay free on its file system after each object. */
int gsn_spool_open(const char *dir, uint64_t reserve_bytes, struct gsn_spool **ret_spool,
                   struct gsn_error *err);
void gsn_spool_free(struct gsn_spool *spool);
/* From now on alive is told after every piece that is read or written, also of what is only read
 * again: gigabytes on a slow disk take longer than anybody waits for a sign of life. */
void gsn_spool_watch(struct gsn_spool *spool, void (*alive)(void *context), void *context);
GSN_DEFINE_AUTO(gsn_spool);

enum gsn_spool_found {
    GSN_SPOOL_NEW,    /* written now */
    GSN_SPOOL_SAME,   /* was there: read again in full, and found equal */
    GSN_SPOOL_MENDED, /* was there, but damaged: replaced by the good bytes */
};

struct gsn_spooled {
    struct gsn_digest digest;
    uint64_t size;
    enum gsn_spool_found found;
};

/* All three keep the bytes and tell their digest; name only serves the sentences.
 *
 * Fail with GSN_E_LIMIT "NAME: the disk is below its reserve of ..." before a byte is written,
 * GSN_E_INPUT for 0 bytes, GSN_E_IO when the disk is full or refuses; then no temporary is left
 * and no object was touched. */
int gsn_spool_take(struct gsn_spool *spool, const void *bytes, uint64_t size, const char *name,
                   struct gsn_spooled *ret_spooled, struct gsn_error *err);
/* From the descriptor's start to its end, by pread(). */
int gsn_spool_take_fd(struct gsn_spool *spool, int fd, const char *name,
                      struct gsn_spooled *ret_spooled, struct gsn_error *err);
/* A READY item; passes on the errors of gsn_source_read(). Does not acknowledge it.
 *
 * Where the item has a key, a copy that its source broke off stays as DIR/objects/tmp/partial-*,
 * and the next call for the same key and size goes on from there: the part is hashed again, and its
 * last bytes are read again from the source; where they differ, the copy starts over. Parts give
 * way when a picture needs their room. */
int gsn_spool_take_item(struct gsn_spool *spool, struct gsn_source *source,
                        const struct gsn_source_event *ready, struct gsn_spooled *ret_spooled,
                        struct gsn_error *err);

/* Reads an object again. Fails with GSN_E_NOTFOUND, GSN_E_INPUT when its bytes are not those of the
 * digest, GSN_E_IO. */
int gsn_spool_verify(struct gsn_spool *spool, const struct gsn_digest *digest,
                     struct gsn_error *err);

/* A file that nobody here could read later is not copied at all. */
static const uint64_t GSN_SPOOL_MOST_BYTES = (uint64_t)1 << 30;
/* Fails with GSN_E_LIMIT, and says by how much. */
int gsn_spool_check_size(uint64_t size, const char *name, struct gsn_error *err);

/* Whether one more object of this size would leave the reserve, if need be without the parts of
 * broken-off copies; GSN_E_LIMIT when not. */
int gsn_spool_has_space(struct gsn_spool *spool, uint64_t size, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
