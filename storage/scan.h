/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The ledger of what came from the bench: one row per picture.
 *
 * A picture is logged in two steps. Its source waits for the first: when the bytes are durable, one
 * row of the staging table says all that is known of them, in one commit that writes one page. The
 * second commits what lies there, many at once: the row in the ledger, the panel, its job and the
 * line in the audit log. Nobody can come between them, because every transaction that writes begins
 * with committing; so all is as if a picture were filed in the moment in which it came. */
#ifndef GSN_STORAGE_SCAN_H
#define GSN_STORAGE_SCAN_H

#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Texts may be empty but never NULL. */
struct gsn_scan_row {
    int64_t id;
    const char *source;  /* its name in the configuration */
    const char *device;  /* which device, as it says itself */
    const char *name;    /* the file's or object's name there */
    const char *key;     /* who the device says it is; empty: it cannot tell */
    const char *subject; /* "panel", "blank" or "dark" */
    const char *sha256;  /* names the object */
    int64_t size;        /* bytes */
    const char *facts;   /* what the device stated, JSON or empty */
    const char *state;  /* "filed" (has its panel), "unfiled" (a person must say), "kept" (blank and
                           dark frames) */
    const char *reason; /* why it is unfiled, or by what it was filed */
    int64_t panel_id;   /* 0: none */
    const char *specimen; /* the panel's specimen, or empty; not read by put */
    int64_t arrived;
};

struct gsn_scan_rows {
    size_t count;
    struct gsn_scan_row *at;
};

void gsn_scan_row_free(struct gsn_scan_row *row);
GSN_DEFINE_AUTO(gsn_scan_row);
void gsn_scan_rows_free(struct gsn_scan_rows *rows);
GSN_DEFINE_AUTO(gsn_scan_rows);

/* Puts a picture into the staging table: when this returns it is durable. The row's state, reason
 * and panel_id are not read. number: the panel's number as far as the source's names tell it, 0 for
 * none. ret_id: of its row in the ledger, once it is committed. ret_again: 1 when the same picture
 * (source, name, bytes) was there; then nothing is written. A handle commits by itself when it has
 * staged many. */
int gsn_scan_stage(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                   int64_t now, int64_t *ret_id, int *ret_again, struct gsn_error *err);

/* Commits what lies in the staging table, in one transaction; nothing there, nothing is written.
 * Until then no list shows it. To be called when a burst is over. A panel goes
 *   1. to the specimen that the source is expected to deliver (gsn_scan_expect), unless its own
 *      name begins with another one's: then a person must say;
 *   2. else to the specimen whose name its own name begins with, the longest of them, followed by
 *      the end, '-', '_', ' ' or '.';
 *   3. else it stays unfiled with the reason.
 * Where the picture's name begins with its specimen's, the panel's number is read from what
 * follows, never from the specimen's own digits. A picture without one that goes to an expected
 * specimen takes the number behind the highest there; else the panel is held as an import would.
 * Only specimens cut into sections have panels. */
int gsn_scan_commit_staged(struct gsn_store *store, struct gsn_error *err);
/* How many pictures are durable and not committed yet, whoever staged them. */
int gsn_scan_count_staged(struct gsn_store *store, int64_t *ret_count, struct gsn_error *err);

/* Whether a scan with this key was taken in; an empty key never is. */
int gsn_scan_is_known(struct gsn_store *store, const char *key, int *ret_known,
                      struct gsn_error *err);

/* gives: scans in this state (NULL: all), newest first, at most most of them (0: all). */
int gsn_scan_list(struct gsn_store *store, const char *state, size_t most,
                  struct gsn_scan_rows **ret_rows, struct gsn_error *err);
/* gives. Fails with GSN_E_NOTFOUND "there is no scan N". */
int gsn_scan_get(struct gsn_store *store, int64_t id, struct gsn_scan_row **ret_scan,
                 struct gsn_error *err);

/* gives: the newest picture of this subject from this source. Fails with GSN_E_NOTFOUND when there
 * is none. */
int gsn_scan_newest(struct gsn_store *store, const char *source, const char *subject,
                    struct gsn_scan_row **ret_scan, struct gsn_error *err);

/* A person says where an unfiled scan belongs, or which number a held panel has. Fails with
 * GSN_E_INPUT when it is filed already (and its panel not held), is no picture of a panel, the
 * specimen has no panels or number is 0; with GSN_E_NOTFOUND. */
int gsn_scan_file(struct gsn_store *store, int64_t id, const char *specimen, unsigned number,
                  const char *actor, int64_t now, struct gsn_error *err);

/* Takes that back, whoever placed it: the scan is unfiled again. Its panel is forgotten, with what
 * was found on it; one that a report rests on stays, and is refused until it is filed again. Fails
 * with GSN_E_INPUT when the scan is not filed, GSN_E_BUSY while its panel is being looked at,
 * GSN_E_NOTFOUND. */
int gsn_scan_unfile(struct gsn_store *store, int64_t id, const char *actor, int64_t now,
                    struct gsn_error *err);

/* From now on what this source delivers belongs to the specimen; NULL: to nobody in particular.
 * Fails with GSN_E_NOTFOUND when there is no such specimen, GSN_E_INPUT when it has no panels. */
int gsn_scan_expect(struct gsn_store *store, const char *source, const char *specimen,
                    const char *actor, int64_t now, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
