/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Stored objects read again and hashed, so that a disk that forgets is noticed while the originals
 * can still be had.
 *
 * A round goes through all objects that rows rest on, in order of their digests; one that is broken
 * off by its time goes on where it stopped, which DIR/scrub.json keeps. */
#ifndef GSN_SYSTEMD_SCRUB_H
#define GSN_SYSTEMD_SCRUB_H

#include "storage/store.h"

#include <stdint.h>

struct gsn_scrub {
    struct gsn_store *store; /* open for writing */
    const char *actor;
    unsigned minutes; /* 0: to the end of the round */
    /* Told of each damaged object: what is wrong, what rests on it, what to do. May be NULL. */
    void (*damaged)(void *context, const char *sha256, const char *sentence);
    void *context;
};

struct gsn_scrub_counts {
    int64_t checked, bytes; /* now */
    int64_t damaged;        /* now */
    int64_t round_checked, round_damaged;
    int complete; /* the round came to its end */
};

/* Each damaged object is a line in the diary and a trouble, which goes when the object is found
 * whole again; the end of a round is a line in the diary. A damaged object is a finding, not a
 * failure. */
int gsn_scrub_run(const struct gsn_scrub *scrub, struct gsn_scrub_counts *ret_counts,
                  struct gsn_error *err);

#endif
