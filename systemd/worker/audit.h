/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a store is what it says, as far as that can be told without working its runs again: what
 * storage/audit.h looks at, the files of the reports, the objects, and what the specimens' jobs
 * say.
 *
 * Beside each report lies audit-RUN.json: where the audit log ended when the run was written, and
 * the hashes of its rows and files. It holds what depends on times, which the report itself must
 * not, so that the report can be made again byte for byte. */
#ifndef GSN_SYSTEMD_WORKER_AUDIT_H
#define GSN_SYSTEMD_WORKER_AUDIT_H

#include "storage/audit.h"
#include "storage/result.h"

/* Beside the folders of a specimen's runs: a link to that of its last report. */
#define GSN_LATEST "latest"

/* Where the log ended, by those outside of it who remember. */
struct gsn_audit_heads {
    size_t count, room;
    struct gsn_audit_head *at;
};

void gsn_audit_heads_done(struct gsn_audit_heads *heads);
#define gsn_auto_heads __attribute__((cleanup(gsn_audit_heads_done))) struct gsn_audit_heads

/* Adds what the lines of a journal say that gsn_audit_write_journal() wrote, among any others; "-":
 * standard input. Fails with GSN_E_INPUT when no line says it, and as reading does. */
int gsn_audit_read_journal(const char *path, struct gsn_audit_heads *heads, struct gsn_error *err);
/* One line to the system's journal: where the log ends now. Quietly: a machine may have none. */
void gsn_audit_write_journal(struct gsn_store *store);

/* The file beside the report of a run whose rows are written and not yet committed. */
int gsn_audit_write_beside(struct gsn_store *store, int64_t run, struct gsn_error *err);

/* The report files of a run (0: of all): report.html, report.json, what that names as outputs, and
 * the file beside them, whose head is added to heads (NULL: is not). */
int gsn_audit_reports(struct gsn_store *store, int64_t run, struct gsn_audit_heads *heads,
                      gsn_audit_found *found, void *context, struct gsn_error *err);

/* All of it but the pages and the objects' bytes: tables, reports, log, runs, ledger, jobs,
 * orphans. heads: those from elsewhere. sizes: whether each object is there in its size is looked
 * at as well. ret_events may be NULL. */
int gsn_audit_store(struct gsn_store *store, struct gsn_audit_heads *heads, int sizes,
                    gsn_audit_found *found, void *context, int64_t *ret_events,
                    struct gsn_error *err);

#endif
