/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A second copy of a store, and a store from such a copy. Both are the same act: the copy is a
 * store itself, which every command can open. */
#ifndef GSN_SYSTEMD_WORKER_BACKUP_H
#define GSN_SYSTEMD_WORKER_BACKUP_H

#include "storage/audit.h"
#include "storage/store.h"

struct gsn_backup_counts {
    int64_t objects, bytes; /* originals */
    int64_t files;          /* of reports */
    int64_t events;         /* in the audit log */
};

/* Copies the database, the objects that its rows rest on and the files of its reports into a folder
 * that is made, or is empty. Everything is read back from the disk and compared; only then does the
 * folder get its database, and is a store. found: told of what was damaged already in the store;
 * that is not copied. May be NULL.
 *
 * Fails with GSN_E_INPUT when the folder is not empty or something in the store is damaged,
 * GSN_E_IO when the copy is not what was written, and as reading and writing do. */
int gsn_backup_make(struct gsn_store *store, const char *dir, const char *actor,
                    gsn_audit_found *found, void *context, struct gsn_backup_counts *ret_counts,
                    struct gsn_error *err);

#endif
