/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The parts of which a larger change is made: one panel, one job, one event of the audit log, each
 * in the transaction that the caller has begun. They set no savepoint, which would copy every page
 * that they change: when one fails, the whole transaction must be rolled back. Private to this
 * folder. */
#ifndef GSN_STORAGE_TRANSACTION_H
#define GSN_STORAGE_TRANSACTION_H

#include "pipeline/core/hash.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct gsn_store;
struct gsn_panel_row;
struct gsn_scan_row;
struct gsn_section_row;

/* The rows of a panel's sections lie side by side: schema/006_slices.sql. */
#define SECTIONS_OF(panel) "id BETWEEN " panel " * 4096 AND " panel " * 4096 + 4095 "

/* Fails with GSN_E_INPUT when this is no digest. Here and not in the schema, where the same
 * question costs more than writing the row. */
int gsn_digest_check(const char *hex, struct gsn_error *err);

/* As gsn_panel_put(). */
int gsn_panel_insert(struct gsn_store *store, const struct gsn_panel_row *panel, int64_t *ret_id,
                     int *ret_again, struct gsn_error *err);

/* As gsn_section_replace(). */
int gsn_section_insert_all(struct gsn_store *store, int64_t panel_id,
                           const struct gsn_section_row *sections, size_t count,
                           struct gsn_error *err);

/* What a job is like before anybody claims it. claim and owner stay: they are its history. */
#define FRESH_JOB                                                                                  \
    "state = 'waiting', again = 0, boot = '', processes = '', pid = 0, pid_start = 0, "            \
    "lease_s = 0, lease_until = 0, stage = '', done = 0, total = 0, eta_s = NULL, "                \
    "message = '', code = '' "

/* As gsn_queue_add(), of a panel that is known to be the specimen's; 0: the specimen's own job. */
int gsn_queue_ask(struct gsn_store *store, int64_t specimen_id, int64_t panel_id, int64_t *ret_id,
                  struct gsn_error *err);

/* Makes a scan the panel of a specimen and asks for it; the specimen, which rests on it, is to be
 * asked for next. The same bytes were its panel before: ret_again becomes 1 and nothing is asked.
 */
int gsn_scan_put_panel(struct gsn_store *store, const struct gsn_scan_row *scan,
                       int64_t specimen_id, int64_t number, int64_t *ret_panel, int *ret_again,
                       struct gsn_error *err);

int gsn_scan_is_none_staged(struct gsn_store *store, bool *ret_none, struct gsn_error *err);

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

#endif
