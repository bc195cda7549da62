/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/scan.h"

#include "storage/sql.h"
#include "storage/within.h"

/* So many lie in the inbox of one handle at most: few enough to be looked through for each new one,
 * many enough that settling them adds little to each. */
enum { MOST_IN_INBOX = 128 };

/* Without asking before: one statement is a transaction of its own. The ledger is asked by its
 * index, the inbox has none because it is short. The next id is known once the inbox is empty, too:
 * those who were there have it in the ledger. */
#define TAKE                                                                                       \
    "INSERT INTO inbox (id, source, device, name, key, subject, sha256, size, facts, number, "     \
    "arrived) SELECT 1 + max(coalesce((SELECT max(id) FROM inbox), 0), "                           \
    "coalesce((SELECT max(id) FROM scan), 0)), ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10 "           \
    "WHERE NOT EXISTS (SELECT 1 FROM inbox WHERE size = ?7 AND sha256 = ?6 AND name = ?3 "         \
    "AND source = ?1) "                                                                            \
    "AND NOT EXISTS (SELECT 1 FROM scan WHERE source = ?1 AND name = ?3 AND sha256 = ?6)"

#define TAKEN                                                                                      \
    "SELECT id FROM scan WHERE source = ?1 AND name = ?2 AND sha256 = ?3 UNION ALL "               \
    "SELECT id FROM inbox WHERE source = ?1 AND name = ?2 AND sha256 = ?3"

int gsn_scan_take(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                  int64_t now, int64_t *ret_id, int *ret_again, struct gsn_error *err)
{
    unsigned *const unsettled = gsn_store_unsettled(store);
    int64_t inserted = 0, id = 0;
    int r = *unsettled < MOST_IN_INBOX ? GSN_OK : gsn_scan_settle(store, err);

    if (r < 0)
        return r;
    r = gsn_digest_check(scan->sha256, err);
    if (r >= 0)
        r = gsn_sql_run(store, TAKE,
                        SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->device),
                                 SQL_TEXT(scan->name), SQL_TEXT(scan->key), SQL_TEXT(scan->subject),
                                 SQL_TEXT(scan->sha256), SQL_INT(scan->size), SQL_TEXT(scan->facts),
                                 SQL_INT(number), SQL_INT(now)),
                        &inserted, err);
    if (r == GSN_E_INPUT)
        return gsn_fail_at(err, "scan %.200s", scan->name);
    if (r >= 0 && inserted == 0)
        r = gsn_sql_int(
            store, TAKEN,
            SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->name), SQL_TEXT(scan->sha256)), &id,
            err);
    if (r < 0)
        return r;
    *unsettled += inserted != 0;
    *ret_id = inserted ? gsn_sql_last_id(store) : id;
    *ret_again = inserted == 0;
    return GSN_OK;
}

int gsn_scan_is_known(struct gsn_store *store, const char *key, int *ret_known,
                      struct gsn_error *err)
{
    int64_t known = 0;
    const int r = gsn_sql_int(store,
                              "SELECT ?1 <> '' AND (EXISTS (SELECT 1 FROM scan WHERE key = ?1 AND "
                              "key <> '') OR EXISTS (SELECT 1 FROM inbox WHERE key = ?1))",
                              SQL_ARGS(SQL_TEXT(key)), &known, err);

    if (r >= 0)
        *ret_known = known != 0;
    return r;
}
