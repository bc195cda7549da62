/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/scan.h"

#include <stdbool.h>
#include <string.h>

#include "storage/catalog.h"
#include "storage/sql.h"
#include "storage/within.h"

#define SCAN(type, name)                                                                           \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_scan_row, name)                                        \
    }
static const struct gsn_sql_field scan_fields[] = {
    SCAN(INT, id),        SCAN(TEXT, source),  SCAN(TEXT, device), SCAN(TEXT, name),
    SCAN(TEXT, key),      SCAN(TEXT, subject), SCAN(TEXT, sha256), SCAN(INT, size),
    SCAN(TEXT, facts),    SCAN(TEXT, state),   SCAN(TEXT, reason), SCAN(INT, panel_id),
    SCAN(TEXT, specimen), SCAN(INT, arrived),
};
#undef SCAN

#define SELECT_SCAN                                                                                \
    "SELECT c.id, c.source, c.device, c.name, c.key, c.subject, c.sha256, c.size, c.facts, "       \
    "c.state, c.reason, coalesce(c.panel_id, 0), coalesce(s.name, ''), c.arrived FROM scan c "     \
    "LEFT JOIN panel p ON p.id = c.panel_id LEFT JOIN specimen s ON s.id = p.specimen_id "

static const struct gsn_sql_shape scan_shape = SQL_SHAPE(struct gsn_scan_row, scan_fields);

SQL_DEFINE_ROW(scan);
SQL_DEFINE_ROWS(scan);

int gsn_scan_list(struct gsn_store *store, const char *state, size_t most,
                  struct gsn_scan_rows **ret_rows, struct gsn_error *err)
{
    const int64_t limit = most == 0 || most > INT64_MAX ? INT64_MAX : (int64_t)most;

    /* Spelt out, so that the index of the unfiled ones is used. */
    if (state && strcmp(state, "unfiled") == 0)
        return scan_rows(store, SELECT_SCAN "WHERE c.state = 'unfiled' ORDER BY c.id DESC LIMIT ?1",
                         SQL_ARGS(SQL_INT(limit)), ret_rows, err);
    return scan_rows(store, SELECT_SCAN "WHERE ?1 IN ('', c.state) ORDER BY c.id DESC LIMIT ?2",
                     SQL_ARGS(SQL_TEXT(state), SQL_INT(limit)), ret_rows, err);
}

int gsn_scan_get(struct gsn_store *store, int64_t id, struct gsn_scan_row **ret_scan,
                 struct gsn_error *err)
{
    const int r =
        scan_row(store, SELECT_SCAN "WHERE c.id = ?1", SQL_ARGS(SQL_INT(id)), ret_scan, err);

    return r == GSN_E_NOTFOUND ? gsn_fail(err, r, "there is no scan %lld", (long long)id) : r;
}

int gsn_scan_newest(struct gsn_store *store, const char *source, const char *subject,
                    struct gsn_scan_row **ret_scan, struct gsn_error *err)
{
    const int r = scan_row(
        store, SELECT_SCAN "WHERE c.source = ?1 AND c.subject = ?2 ORDER BY c.id DESC LIMIT 1",
        SQL_ARGS(SQL_TEXT(source), SQL_TEXT(subject)), ret_scan, err);

    return r == GSN_E_NOTFOUND
               ? gsn_fail(err, r, "%.100s has given no %.20s picture yet", source, subject)
               : r;
}

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
static int renumber(struct gsn_store *store, const struct gsn_scan_row *scan, int64_t specimen,
                    int64_t panel, unsigned number, struct gsn_error *err)
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

static int tell_filing(struct gsn_store *store, const struct gsn_scan_row *scan,
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
static int file(struct gsn_store *store, int64_t id, const char *name, unsigned number,
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
        r = renumber(store, scan, specimen->id, panel, number, err);
    if (r >= 0 && !known)
        r = gsn_queue_ask(store, specimen->id, 0, &job, err);
    if (r >= 0)
        r = gsn_sql_run(
            store,
            "UPDATE scan SET state = 'filed', reason = 'filed by ' || ?2, panel_id = ?3 "
            "WHERE id = ?1",
            SQL_ARGS(SQL_INT(id), SQL_TEXT(actor), SQL_INT(panel)), NULL, err);
    return r < 0 ? r : tell_filing(store, scan, specimen->name, number, actor, now, err);
}

int gsn_scan_file(struct gsn_store *store, int64_t id, const char *specimen, unsigned number,
                  const char *actor, int64_t now, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, file(store, id, specimen, number, actor, now, err), err);
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
static int unfile(struct gsn_store *store, int64_t id, const char *actor, int64_t now,
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

    return r < 0 ? r : gsn_sql_end(store, unfile(store, id, actor, now, err), err);
}

/* In a transaction. */
static int expect(struct gsn_store *store, const char *source, const char *specimen,
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

    return r < 0 ? r : gsn_sql_end(store, expect(store, source, specimen, actor, now, err), err);
}
