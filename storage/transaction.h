/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The parts of which a larger change is made: one panel, one job, one event of the audit log, each
 * in the transaction that the caller has begun. They set no savepoint, which would copy every page
 * that they change: when one fails, the whole transaction must be rolled back. Private to this
 * folder. */
#ifndef GSN_STORAGE_TRANSACTION_H
#define GSN_STORAGE_TRANSACTION_H

#include "pipeline/core/hash.h"

#include <stdint.h>

struct gsn_store;
struct gsn_panel_row;

/* The rows of a panel's sections lie side by side: schema/006_slices.sql. */
#define SECTIONS_OF(panel) "id BETWEEN " panel " * 4096 AND " panel " * 4096 + 4095 "

/* Fails with GSN_E_INPUT when this is no digest. Here and not in the schema, where the same
 * question costs more than writing the row. */
int gsn_digest_check(const char *hex, struct gsn_error *err);

/* As gsn_panel_put(). */
int gsn_panel_insert(struct gsn_store *store, const struct gsn_panel_row *panel, int64_t *ret_id,
                     int *ret_again, struct gsn_error *err);

/* As gsn_queue_add(), of a panel that is known to be the specimen's; 0: the specimen's own job. */
int gsn_queue_ask(struct gsn_store *store, int64_t specimen_id, int64_t panel_id, int64_t *ret_id,
                  struct gsn_error *err);

/* Commits what lies in the staging table; for gsn_store_begin(). */
int gsn_scan_commit_all_staged(struct gsn_store *store, struct gsn_error *err);

/* Where the audit log ends: as an id and a hash; 0 and zeros when there is none. */
struct gsn_event_tail {
    int64_t id;
    struct gsn_digest head;
};

int gsn_event_tail(struct gsn_store *store, struct gsn_event_tail *ret_tail, struct gsn_error *err);

/* As gsn_event_add(), behind this tail, which moves on: for who adds many. */
int gsn_event_append_to(struct gsn_store *store, struct gsn_event_tail *tail, int64_t now,
                        const char *actor, const char *kind, const char *subject, const char *text,
                        struct gsn_error *err);

/* As gsn_event_add(). */
int gsn_event_append(struct gsn_store *store, int64_t now, const char *actor, const char *kind,
                     const char *subject, const char *text, struct gsn_error *err);

/* What a handle remembers of the pictures that it put into the staging table itself, so that it
 * need not look through them for each new one. So many lie there of one handle at most: enough that
 * committing them adds little to each, few enough that it takes some milliseconds. */
enum { GSN_STAGING_MAX = 256 };

/* The rows first, first + 1, ... in the order of their tags; those of another handle never lie
 * between. count 0: nothing is remembered. */
struct gsn_staging {
    unsigned uncommitted; /* staged and not committed by this handle */
    unsigned count;
    int64_t first;
    uint64_t tag[GSN_STAGING_MAX];
};

#endif
