/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures on their way: staged one by one, and filed by hand.
 *
 * Steps.
 * 1. stage: one row in the staging table (SQL: inbox), which has no index and holds all that is
 * known of the picture: one page in one commit. The handle remembers the tags of what it staged, so
 * that it need not look through them for each new picture.
 * 2. What is staged is committed many at once, by whoever begins a transaction next (ledger.c).
 * 3. By hand: file, unfile, expect.
 *
 * How it fails: GSN_E_INPUT with what a person must give. A crash leaves staged rows, which the
 * next who opens the store commits. Cost: tests/bench/log.c. */
#include "storage/scan.h"

#include <sqlite3.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/sql.h"
#include "storage/transaction.h"

/* Without asking before: one statement is a transaction of its own. The ledger is asked by its
 * index; the staging table has none, but what this handle remembers, ?11 to ?12, need not be asked.
 * The next id is known once the staging table is empty, too: those who were there have it in the
 * ledger. */
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

/* Staging. */

/* Of a digest, enough to tell most pictures apart. */
static uint64_t tag_of(const char *sha256)
{
    uint64_t tag;

    memcpy(&tag, sha256, sizeof tag);
    return tag;
}

static bool may_be_there(const struct gsn_staging *staging, uint64_t tag)
{
    for (unsigned i = 0; i < staging->count; i++)
        if (staging->tag[i] == tag)
            return true;
    return false;
}

/* A transaction that is rolled back gives its ids to others, so nothing of one is remembered. */
static void remember_tag(struct gsn_store *store, struct gsn_staging *staging, int64_t id,
                         uint64_t tag)
{
    staging->uncommitted++;
    if (staging->count == GSN_STAGING_MAX || id != staging->first + staging->count) {
        staging->count = 0;
        staging->first = id;
    }
    if (sqlite3_get_autocommit(gsn_store_handle(store)))
        staging->tag[staging->count++] = tag;
    else
        staging->count = 0;
}

static int insert_staged(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                         int64_t now, int64_t *ret_inserted, struct gsn_error *err)
{
    const struct gsn_staging *const staging = gsn_store_staging(store);
    const bool is_new = staging->count > 0 && !may_be_there(staging, tag_of(scan->sha256));
    const int64_t first = is_new ? staging->first : 0;
    const int64_t last = is_new ? staging->first + staging->count - 1 : 0;
    const int r =
        gsn_sql_run(store, TAKE,
                    SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->device), SQL_TEXT(scan->name),
                             SQL_TEXT(scan->key), SQL_TEXT(scan->subject), SQL_TEXT(scan->sha256),
                             SQL_INT(scan->size), SQL_TEXT(scan->facts), SQL_INT(number),
                             SQL_INT(now), SQL_INT(first), SQL_INT(last)),
                    ret_inserted, err);

    return r == GSN_E_INPUT ? gsn_fail_at(err, "scan %.200s", scan->name) : r;
}

int gsn_scan_stage(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                   int64_t now, int64_t *ret_id, int *ret_again, struct gsn_error *err)
{
    struct gsn_staging *const staging = gsn_store_staging(store);
    int64_t inserted = 0, id = 0;
    int r = staging->uncommitted < GSN_STAGING_MAX ? GSN_OK : gsn_scan_commit_staged(store, err);

    if (r < 0)
        return r;
    if (gsn_digest_check(scan->sha256, err) < 0)
        return gsn_fail_at(err, "scan %.200s", scan->name);
    r = insert_staged(store, scan, number, now, &inserted, err);
    if (r >= 0 && inserted == 0)
        r = gsn_sql_int(
            store, TAKEN,
            SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->name), SQL_TEXT(scan->sha256)), &id,
            err);
    if (r < 0)
        return r;
    if (inserted) {
        id = gsn_sql_last_id(store);
        remember_tag(store, staging, id, tag_of(scan->sha256));
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

int gsn_scan_count_staged(struct gsn_store *store, int64_t *ret_count, struct gsn_error *err)
{
    return gsn_sql_int(store, "SELECT count(*) FROM inbox", SQL_NO_ARGS, ret_count, err);
}

/* Filing by hand. */

static int is_held(struct gsn_store *store, int64_t panel, bool *ret_held, struct gsn_error *err)
{
    gsn_auto(gsn_panel_row) row = NULL;
    const int r = gsn_panel_get(store, panel, &row, err);

    if (r >= 0)
        *ret_held = strcmp(row->state, "held") == 0;
    return r;
}

/* A filed scan may be filed again where its panel is held: the number is what it waits for. */
static int check_fileable(struct gsn_store *store, const struct gsn_scan_row *scan,
                          const char *specimen, unsigned number, struct gsn_error *err)
{
    bool held = false;
    int r = GSN_OK;

    if (number == 0)
        return gsn_fail(err, GSN_E_INPUT, "panels are counted from 1");
    if (strcmp(scan->subject, "panel") != 0)
        return gsn_fail(err, GSN_E_INPUT, "scan %lld is no picture of a panel: %s",
                        (long long)scan->id, scan->reason);
    if (scan->panel_id && strcmp(scan->specimen, specimen) == 0)
        r = is_held(store, scan->panel_id, &held, err);
    if (r >= 0 && scan->panel_id && !held)
        return gsn_fail(err, GSN_E_INPUT,
                        "scan %lld is filed already, as a panel of %s: `gieson file %lld undo` "
                        "takes that back",
                        (long long)scan->id, scan->specimen, (long long)scan->id);
    return r;
}

static int check_sections(const struct gsn_specimen_row *specimen, struct gsn_error *err)
{
    if (strcmp(specimen->kind, "sections") != 0)
        return gsn_fail(err, GSN_E_INPUT, "%s is a %s and has no panels", specimen->name,
                        specimen->kind);
    return GSN_OK;
}

/* Held panels are looked at again: what stood in their way may be gone. */
static int release_held(struct gsn_store *store, int64_t specimen, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    int64_t job = 0;
    int r = gsn_panel_list(store, specimen, &panels, err);

    for (size_t i = 0; r >= 0 && i < panels->count; i++) {
        if (strcmp(panels->at[i].state, "held") != 0)
            continue;
        r = gsn_panel_set_state(store, panels->at[i].id, "waiting", NULL, NULL, err);
        if (r >= 0)
            r = gsn_queue_ask(store, specimen, panels->at[i].id, &job, err);
    }
    return r < 0 ? r : gsn_queue_ask(store, specimen, 0, &job, err);
}

/* The bytes were a panel of this specimen before: a held one takes the number that a person gives,
 * and the others that are held are looked at again, for it may have stood in their way. */
static int renumber_panel(struct gsn_store *store, const struct gsn_scan_row *scan,
                          int64_t specimen, int64_t panel, unsigned number, struct gsn_error *err)
{
    gsn_auto(gsn_panel_row) row = NULL;
    bool open = false;
    int r = gsn_panel_get(store, panel, &row, err);

    if (r >= 0)
        open = strcmp(row->state, "held") == 0 || strcmp(row->code, "withheld") == 0;
    if (r < 0 || !open)
        return r;
    r = gsn_panel_set_state(store, panel, "held", NULL, NULL, err);
    if (r >= 0)
        r = gsn_panel_set_name(store, panel, number, scan->name, err);
    return r < 0 ? r : release_held(store, specimen, err);
}

static int log_filing(struct gsn_store *store, const struct gsn_scan_row *scan,
                      const char *specimen, unsigned number, const char *actor, int64_t now,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) text =
        gsn_format("scan %lld is panel %u of %s", (long long)scan->id, number, specimen);

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the audit log");
    return gsn_event_append(store, now, actor, "file", scan->name, text, err);
}

/* In a transaction. */
static int file_scan(struct gsn_store *store, int64_t id, const char *name, unsigned number,
                     const char *actor, int64_t now, struct gsn_error *err)
{
    gsn_auto(gsn_scan_row) scan = NULL;
    gsn_auto(gsn_specimen_row) specimen = NULL;
    int64_t panel = 0, job = 0;
    int known = 0;
    int r = gsn_scan_get(store, id, &scan, err);

    if (r >= 0)
        r = check_fileable(store, scan, name, number, err);
    if (r >= 0)
        r = gsn_specimen_get(store, name, &specimen, err);
    if (r >= 0)
        r = check_sections(specimen, err);
    if (r >= 0)
        r = gsn_scan_put_panel(store, scan, specimen->id, number, &panel, &known, err);
    if (r >= 0 && known)
        r = renumber_panel(store, scan, specimen->id, panel, number, err);
    if (r >= 0 && !known)
        r = gsn_queue_ask(store, specimen->id, 0, &job, err);
    if (r >= 0)
        r = gsn_sql_run(
            store,
            "UPDATE scan SET state = 'filed', reason = 'filed by ' || ?2, panel_id = ?3 "
            "WHERE id = ?1",
            SQL_ARGS(SQL_INT(id), SQL_TEXT(actor), SQL_INT(panel)), NULL, err);
    return r < 0 ? r : log_filing(store, scan, specimen->name, number, actor, now, err);
}

int gsn_scan_file(struct gsn_store *store, int64_t id, const char *specimen, unsigned number,
                  const char *actor, int64_t now, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r
                 : gsn_sql_end(store, file_scan(store, id, specimen, number, actor, now, err), err);
}

static int ask_number(struct gsn_store *store, const char *sql, int64_t id, int64_t *ret_number,
                      struct gsn_error *err)
{
    return gsn_sql_int(store, sql, SQL_ARGS(SQL_INT(id)), ret_number, err);
}

/* A run's poses and stains name their panel, and what a report rests on is history. */
static int drop_panel(struct gsn_store *store, int64_t panel, const char *actor,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) why = gsn_format(
        "taken back by %s: it is not used; the scan it came as waits for its place", actor);
    int64_t reported = 0;
    int r = ask_number(store,
                       "SELECT EXISTS (SELECT 1 FROM pose WHERE panel_id = ?1) OR "
                       "EXISTS (SELECT 1 FROM stain_batch WHERE panel_id = ?1)",
                       panel, &reported, err);

    if (r >= 0 && !why)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for a sentence");
    if (r >= 0 && reported)
        return gsn_panel_set_state(store, panel, "refused", "withheld", why, err);
    if (r >= 0)
        r = gsn_sql_run(store, "DELETE FROM job WHERE panel_id = ?1", SQL_ARGS(SQL_INT(panel)),
                        NULL, err);
    if (r >= 0)
        r = gsn_sql_run(store, "DELETE FROM section WHERE " SECTIONS_OF("?1"),
                        SQL_ARGS(SQL_INT(panel)), NULL, err);
    return r < 0 ? r
                 : gsn_sql_run(store, "DELETE FROM panel WHERE id = ?1", SQL_ARGS(SQL_INT(panel)),
                               NULL, err);
}

/* In a transaction. */
static int unfile_scan(struct gsn_store *store, int64_t id, const char *actor, int64_t now,
                       struct gsn_error *err)
{
    gsn_auto(gsn_scan_row) scan = NULL;
    gsn_auto(gsn_panel_row) panel = NULL;
    gsn_auto_mem(char) text = NULL;
    int64_t running = 0, others = 0;
    int r = gsn_scan_get(store, id, &scan, err);

    if (r >= 0 && !scan->panel_id)
        return gsn_fail(err, GSN_E_INPUT, "scan %lld is not filed: there is nothing to take back",
                        (long long)id);
    if (r >= 0)
        r = gsn_panel_get(store, scan->panel_id, &panel, err);
    if (r >= 0)
        r = ask_number(store,
                       "SELECT EXISTS (SELECT 1 FROM job WHERE panel_id = ?1 AND state = "
                       "'running')",
                       scan->panel_id, &running, err);
    if (r >= 0 && running)
        return gsn_fail(err, GSN_E_BUSY, "scan %lld is being looked at: try again in a minute",
                        (long long)id);
    text = r >= 0
               ? gsn_format("scan %lld is no panel of %s any more", (long long)id, scan->specimen)
               : NULL;
    if (r >= 0 && !text)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for the audit log");
    if (r >= 0)
        r = gsn_sql_run(store,
                        "UPDATE scan SET state = 'unfiled', panel_id = NULL, reason = 'taken back "
                        "by ' || ?2 || ': say whose it is with `gieson file`' WHERE id = ?1",
                        SQL_ARGS(SQL_INT(id), SQL_TEXT(actor)), NULL, err);
    /* The same bytes may have come twice, and be a panel by the other scan, too. */
    if (r >= 0)
        r = ask_number(store, "SELECT count(*) FROM scan WHERE panel_id = ?1", panel->id, &others,
                       err);
    if (r >= 0 && others == 0)
        r = drop_panel(store, panel->id, actor, err);
    if (r >= 0)
        r = release_held(store, panel->specimen_id, err);
    return r < 0 ? r : gsn_event_append(store, now, actor, "unfile", scan->name, text, err);
}

int gsn_scan_unfile(struct gsn_store *store, int64_t id, const char *actor, int64_t now,
                    struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, unfile_scan(store, id, actor, now, err), err);
}

/* In a transaction. */
static int expect_specimen(struct gsn_store *store, const char *source, const char *specimen,
                           const char *actor, int64_t now, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) row = NULL;
    int r = specimen ? gsn_specimen_get(store, specimen, &row, err) : GSN_OK;

    if (r >= 0 && row)
        r = check_sections(row, err);
    if (r >= 0)
        r = gsn_sql_run(store, "DELETE FROM expectation WHERE source = ?1",
                        SQL_ARGS(SQL_TEXT(source)), NULL, err);
    if (r >= 0 && row)
        r = gsn_sql_run(
            store,
            "INSERT INTO expectation (source, specimen_id, actor, since) VALUES (?1, ?2, ?3, ?4)",
            SQL_ARGS(SQL_TEXT(source), SQL_INT(row->id), SQL_TEXT(actor), SQL_INT(now)), NULL, err);
    if (r < 0)
        return r;
    return gsn_event_append(store, now, actor, "expect", source, row ? row->name : "nobody", err);
}

int gsn_scan_expect(struct gsn_store *store, const char *source, const char *specimen,
                    const char *actor, int64_t now, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0
               ? r
               : gsn_sql_end(store, expect_specimen(store, source, specimen, actor, now, err), err);
}
