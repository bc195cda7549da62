/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The store looked over, so that a disk that forgets, and a hand that changed something, is noticed
 * while the originals can still be had.
 *
 * First the audit (systemd/worker/audit.h). Then, unless it is to be quick, a round through all
 * objects that rows rest on, in order of their digests; one that is broken off by its time goes on
 * where it stopped, which DIR/scrub.json keeps. */
#ifndef GSN_SYSTEMD_WORKER_SCRUB_H
#define GSN_SYSTEMD_WORKER_SCRUB_H

#include "systemd/worker/audit.h"

#include <stdint.h>

struct gsn_scrub {
    struct gsn_store *store; /* open for writing */
    const char *actor;
    int quick;                     /* no objects are read */
    unsigned minutes;              /* 0: to the end of the round */
    struct gsn_audit_heads *heads; /* where the audit log ended, by others; NULL: nobody knows */
    /* Told of each damaged object: what is wrong, what rests on it, what to do. May be NULL. */
    void (*damaged)(void *context, const char *sha256, const char *sentence);
    gsn_audit_found *found; /* of each finding of the audit. May be NULL */
    void *context;
};

struct gsn_scrub_counts {
    int64_t checked, bytes; /* now */
    int64_t damaged;        /* now */
    int64_t round_checked, round_damaged;
    int complete;     /* the round came to its end */
    int64_t findings; /* of the audit */
    int64_t events;   /* in the audit log */
    int64_t without; /* pages of the database that another program wrote back: without a checksum */
};

/* Each damaged object and each finding of the audit is an event and a trouble, which goes when it
 * is found whole again; the end of a round is an event. None of them is a failure. Fails with
 * GSN_E_STORE when the database is damaged too badly to be asked, after telling which pages are. */
int gsn_scrub_run(const struct gsn_scrub *scrub, struct gsn_scrub_counts *ret_counts,
                  struct gsn_error *err);

#endif
