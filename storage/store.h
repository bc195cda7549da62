/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One directory that holds everything the lab knows: DIR/gieson.db (rows), DIR/objects (the
 * original bytes, named by their SHA-256) and DIR/reports.
 *
 * The three programs meet here and nowhere else. The database runs in WAL mode with
 * synchronous=FULL, so what was committed survives a power cut, and the WAL files stay in place
 * after the last writer has gone, so readers work when the service is down. A handle belongs to
 * one thread at a time. Every time is given by the caller, in seconds since 1970 (UTC). */
#ifndef GSN_STORAGE_STORE_H
#define GSN_STORAGE_STORE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_store;

enum gsn_store_mode {
    GSN_STORE_READ,   /* looks only */
    GSN_STORE_WRITE,  /* the store must be there */
    GSN_STORE_CREATE, /* makes the directory and the store when missing */
};

/* gives: an open store; gsn_store_free() closes it.
 *
 * Fails with GSN_E_NOTFOUND when the directory holds no store ("... is not a gieson store;
 * `gieson import` makes one"), GSN_E_UNSUPPORTED when a newer gieson made it, GSN_E_IO when the
 * file system refuses, GSN_E_BUSY when another process keeps it locked for 10 seconds,
 * GSN_E_STORE when the database is damaged or cannot promise durability. */
int gsn_store_open(const char *dir, enum gsn_store_mode mode, struct gsn_store **ret_store,
                   struct gsn_error *err);
/* Rolls back what was begun and not committed. */
void gsn_store_free(struct gsn_store *store);
GSN_DEFINE_AUTO(gsn_store);

/* Several changes as one. They nest: only the outermost commit reaches the disk, and an inner
 * rollback undoes the inner part alone. The outermost begin takes the write lock at once, so
 * nothing read after it can be outdated when it is written back, and first commits what has come
 * (gsn_scan_stage): a transaction sees the ledger whole. */
int gsn_store_begin(struct gsn_store *store, struct gsn_error *err);
/* When it fails, the transaction is rolled back. */
int gsn_store_commit(struct gsn_store *store, struct gsn_error *err);
/* Undoes the innermost begin; keeps quiet, because there is a first error to tell. */
void gsn_store_rollback(struct gsn_store *store);

/* A number that changes when another handle has committed: cheap enough to be asked twice a second.
 */
int gsn_store_change(struct gsn_store *store, int64_t *ret_change, struct gsn_error *err);
/* Waits at most so long (ms) for others' locks from now on; 10 seconds when nothing is said. */
void gsn_store_set_busy_timeout(struct gsn_store *store, int patience_ms);

/* A copy of the database as it is now, by SQLite's backup interface, while others read and write;
 * durable when this returns. path: a file that is not there. Fails with GSN_E_IO, GSN_E_BUSY,
 * GSN_E_STORE, GSN_E_NOMEM. */
int gsn_store_copy(struct gsn_store *store, const char *path, struct gsn_error *err);

/* As given to gsn_store_open(). borrows: valid as long as the store. */
const char *gsn_store_dir(const struct gsn_store *store);

/* gives: DIR/objects/ab/cdef..., where the bytes with this SHA-256 (64 lower-case hexadecimal
 * digits) are kept. Fails with GSN_E_INPUT when hex is not such a digest. */
int gsn_store_object_path(const struct gsn_store *store, const char *hex, char **ret_path,
                          struct gsn_error *err);

/* gives: DIR/reports/NAME, where the reports of this specimen go; makes no directory.
 *
 * NAME is the specimen's name with everything but letters, digits, '_', '-' and inner '.'
 * percent-escaped; a long one is cut and ends in '~' and the SHA-256 of the whole name. Two names
 * never share a directory and none leaves DIR/reports. Fails with GSN_E_INPUT on an empty name. */
int gsn_store_report_dir(const struct gsn_store *store, const char *specimen, char **ret_path,
                         struct gsn_error *err);

/* gives: DIR/studies/NAME, by the same rule: the pages of a study, which can be made again. */
int gsn_store_study_dir(const struct gsn_store *store, const char *study, char **ret_path,
                        struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
