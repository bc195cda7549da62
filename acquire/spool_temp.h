/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The files in DIR/objects/tmp. Private to the spool.
 *
 * Whoever writes one holds a lock (flock) on it; so a sweep, by any process and at any time, tells
 * what a crash left from what is being written. A part that is kept is named
 * partial-KEY-LENGTH-DIGEST: KEY says of what, and the first LENGTH bytes are good when their
 * SHA-256 is DIGEST, whatever a crash did to the file meanwhile. */
#ifndef GSN_ACQUIRE_SPOOL_TEMP_H
#define GSN_ACQUIRE_SPOOL_TEMP_H

#include "pipeline/core/error.h"
#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

enum gsn_spool_temp_rule {
    GSN_SPOOL_PARTS = 8,     /* the newest that are kept */
    GSN_SPOOL_PART_DAYS = 7, /* and not longer than this */
};

/* One that is open for writing and locked. */
struct gsn_spool_temp {
    int fd; /* -1: none */
    char *path;
};

struct gsn_spool_part {
    uint64_t length;
    struct gsn_digest digest;
};

/* gives: a new, empty one. */
int gsn_spool_temp_make(const char *dir, struct gsn_spool_temp *ret_temp, struct gsn_error *err);
/* Removes its name, unless the path is NULL by now, and closes it. Nothing for an empty struct. */
void gsn_spool_temp_drop(struct gsn_spool_temp *temp);
#define auto_temp __attribute__((cleanup(gsn_spool_temp_drop))) struct gsn_spool_temp

/* gives: the longest part of this key that nobody else writes, cut to its length.
 * Fails with GSN_E_NOTFOUND. */
int gsn_spool_temp_find(const char *dir, const struct gsn_digest *key,
                        struct gsn_spool_temp *ret_temp, struct gsn_spool_part *ret_part,
                        struct gsn_error *err);
/* Lets it stay as this part; takes temp, whose struct is empty afterwards. */
int gsn_spool_temp_keep(const char *dir, const struct gsn_digest *key,
                        const struct gsn_spool_part *part, struct gsn_spool_temp *temp,
                        struct gsn_error *err);

/* Removes what nobody writes any more: everything but the parts newest parts younger than
 * GSN_SPOOL_PART_DAYS. */
int gsn_spool_temp_sweep(const char *dir, size_t parts, struct gsn_error *err);
/* How many bytes of disk all parts take. */
int gsn_spool_temp_parts(const char *dir, uint64_t *ret_bytes, struct gsn_error *err);
/* Removes the parts of this key. */
int gsn_spool_temp_forget(const char *dir, const struct gsn_digest *key, struct gsn_error *err);

#endif
