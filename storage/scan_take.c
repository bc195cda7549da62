/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/scan.h"

#include <sqlite3.h>
#include <stdbool.h>
#include <string.h>

#include "storage/inbox.h"
#include "storage/sql.h"
#include "storage/within.h"

/* Without asking before: one statement is a transaction of its own. The ledger is asked by its
 * index; the inbox has none, but what this handle remembers, ?11 to ?12, need not be asked. The
 * next id is known once the inbox is empty, too: those who were there have it in the ledger. */
#define TAKE                                                                                       \
    "INSERT INTO inbox (id, source, device, name, key, subject, sha256, size, facts, number, "     \
    "arrived) SELECT 1 + max(coalesce((SELECT max(id) FROM inbox), 0), "                           \
    "coalesce((SELECT max(id) FROM scan), 0)), ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10 "           \
    "WHERE NOT EXISTS (SELECT 1 FROM inbox WHERE id < ?11 AND " SAME_PICTURE ") "                  \
    "AND NOT EXISTS (SELECT 1 FROM inbox WHERE id > ?12 AND " SAME_PICTURE ") "                    \
    "AND NOT EXISTS (SELECT 1 FROM scan WHERE source = ?1 AND name = ?3 AND sha256 = ?6)"
#define SAME_PICTURE "size = ?7 AND sha256 = ?6 AND name = ?3 AND source = ?1"

#define TAKEN                                                                                      \
    "SELECT id FROM scan WHERE source = ?1 AND name = ?2 AND sha256 = ?3 UNION ALL "               \
    "SELECT id FROM inbox WHERE source = ?1 AND name = ?2 AND sha256 = ?3"

/* Of a digest, enough to tell most pictures apart. */
static uint64_t tag_of(const char *sha256)
{
    uint64_t tag;

    memcpy(&tag, sha256, sizeof tag);
    return tag;
}

static bool may_be_there(const struct gsn_inbox *inbox, uint64_t tag)
{
    for (unsigned i = 0; i < inbox->count; i++)
        if (inbox->tag[i] == tag)
            return true;
    return false;
}

/* A transaction that is rolled back gives its ids to others, so nothing of one is remembered. */
static void remember(struct gsn_store *store, struct gsn_inbox *inbox, int64_t id, uint64_t tag)
{
    inbox->unsettled++;
    if (inbox->count == GSN_INBOX_MOST || id != inbox->first + inbox->count) {
        inbox->count = 0;
        inbox->first = id;
    }
    if (sqlite3_get_autocommit(gsn_store_handle(store)))
        inbox->tag[inbox->count++] = tag;
    else
        inbox->count = 0;
}

static int insert(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                  int64_t now, int64_t *ret_inserted, struct gsn_error *err)
{
    const struct gsn_inbox *const inbox = gsn_store_inbox(store);
    const bool is_new = inbox->count > 0 && !may_be_there(inbox, tag_of(scan->sha256));
    const int64_t first = is_new ? inbox->first : 0;
    const int64_t last = is_new ? inbox->first + inbox->count - 1 : 0;
    const int r =
        gsn_sql_run(store, TAKE,
                    SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->device), SQL_TEXT(scan->name),
                             SQL_TEXT(scan->key), SQL_TEXT(scan->subject), SQL_TEXT(scan->sha256),
                             SQL_INT(scan->size), SQL_TEXT(scan->facts), SQL_INT(number),
                             SQL_INT(now), SQL_INT(first), SQL_INT(last)),
                    ret_inserted, err);

    return r == GSN_E_INPUT ? gsn_fail_at(err, "scan %.200s", scan->name) : r;
}

int gsn_scan_take(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                  int64_t now, int64_t *ret_id, int *ret_again, struct gsn_error *err)
{
    struct gsn_inbox *const inbox = gsn_store_inbox(store);
    int64_t inserted = 0, id = 0;
    int r = inbox->unsettled < GSN_INBOX_MOST ? GSN_OK : gsn_scan_settle(store, err);

    if (r < 0)
        return r;
    if (gsn_digest_check(scan->sha256, err) < 0)
        return gsn_fail_at(err, "scan %.200s", scan->name);
    r = insert(store, scan, number, now, &inserted, err);
    if (r >= 0 && inserted == 0)
        r = gsn_sql_int(
            store, TAKEN,
            SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->name), SQL_TEXT(scan->sha256)), &id,
            err);
    if (r < 0)
        return r;
    if (inserted) {
        id = gsn_sql_last_id(store);
        remember(store, inbox, id, tag_of(scan->sha256));
    }
    *ret_id = id;
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

int gsn_scan_count_unsettled(struct gsn_store *store, int64_t *ret_count, struct gsn_error *err)
{
    return gsn_sql_int(store, "SELECT count(*) FROM inbox", SQL_NO_ARGS, ret_count, err);
}
