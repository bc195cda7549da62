/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether the store still says what it was told: its pages, its tables, its audit log, the rows of
 * its finished runs, and that rows and log agree.
 *
 * Three things vouch for one another. The pages of the database have checksums (pagesum.h). Each
 * event has the hash of the one before. And what a run found is sealed: when it ends, the SHA-256
 * of all its rows becomes an event of kind "seal". Where the log ends is written down outside of
 * it: in DIR/audit.head at every commit that appends to it, beside each report, and in the journal.
 */
#ifndef GSN_STORAGE_AUDIT_H
#define GSN_STORAGE_AUDIT_H

#include "pipeline/core/hash.h"
#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* In the store's directory: how many events there are, and the hash of the last. */
#define GSN_AUDIT_HEAD "audit.head"

/* Told of each finding: what is damaged ("run 3", "page 7"), and the sentence. */
typedef void gsn_audit_found(void *context, const char *what, const char *sentence);

/* Where the log ended once, as something outside of it remembers. */
struct gsn_audit_head {
    int64_t events;
    struct gsn_digest head;
    char where[256]; /* for the sentence: who remembers */
};

/* All of these look and change nothing. A finding is no failure; they fail as the store does.
 * GSN_E_STORE: the database is damaged so badly that it cannot be asked. */

/* The database file, page by page, past SQLite. ret_without may be NULL: how many pages have no
 * checksum, because another program wrote them back. */
int gsn_audit_pages(const char *dir, gsn_audit_found *found, void *context, int64_t *ret_without,
                    struct gsn_error *err);
/* What SQLite itself checks: that pages fit together, rules and references. */
int gsn_audit_tables(struct gsn_store *store, gsn_audit_found *found, void *context,
                     struct gsn_error *err);
/* The chain of the log, and whether it still holds where it once ended, by DIR/audit.head, by every
 * run and by these heads. ret_events may be NULL. */
int gsn_audit_log(struct gsn_store *store, const struct gsn_audit_head *heads, size_t count,
                  gsn_audit_found *found, void *context, int64_t *ret_events,
                  struct gsn_error *err);
/* Whether the rows of a finished run (0: of all) are those that were sealed. */
int gsn_audit_runs(struct gsn_store *store, int64_t run, gsn_audit_found *found, void *context,
                   struct gsn_error *err);
/* Whether panels, scans and decisions are those of the log, and the log's are there. */
int gsn_audit_ledger(struct gsn_store *store, gsn_audit_found *found, void *context,
                     struct gsn_error *err);

/* Whether a file of the store (a path as rows have it, relative to the store) has this hash.
 * Fails with GSN_E_INPUT and the sentence when it has another, GSN_E_NOTFOUND, GSN_E_IO. */
int gsn_audit_file(struct gsn_store *store, const char *relative, const char *sha256,
                   struct gsn_error *err);

/* Seals a run that has ended by the SHA-256 of all its rows. In a transaction. */
int gsn_audit_seal(struct gsn_store *store, int64_t run, int64_t now, struct gsn_error *err);
/* The seal as the log has it; ret_late: of a run that ended before there were seals. Fails with
 * GSN_E_NOTFOUND. */
int gsn_audit_sealed(struct gsn_store *store, int64_t run, struct gsn_digest *ret_digest,
                     int *ret_late, struct gsn_error *err);
/* Where the log ends now. */
int gsn_audit_tail(struct gsn_store *store, struct gsn_audit_head *ret_head, struct gsn_error *err);

/* DIR/audit.head says where the log ends now; every commit says so too, but quietly. Fails with
 * GSN_E_IO. */
int gsn_audit_renew_head(struct gsn_store *store, struct gsn_error *err);

/* For store.c. Seals those that ended before there were seals. */
struct gsn_event_tail;
int gsn_audit_seal_old_runs(struct gsn_store *store, struct gsn_error *err);
/* Whether the file may be written with a new end: not when the log lacks the end that it tells of,
 * for then it is the evidence. */
int gsn_audit_may_write_head(struct gsn_store *store, const char *path, int *ret_may,
                             struct gsn_error *err);
/* Fails with GSN_E_IO, and then says nothing of an end. */
int gsn_audit_write_head(const char *path, const struct gsn_event_tail *tail,
                         struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
