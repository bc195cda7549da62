/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/scan.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "storage/catalog.h"
#include "storage/event.h"
#include "storage/panel_log.h"
#include "storage/panel_name.h"
#include "storage/queue.h"
#include "storage/sql.h"

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

/* Where a picture goes, and why. */
struct place {
    const char *state;
    char reason[400];
    struct gsn_specimen_row *specimen; /* owned; NULL: nowhere */
    int64_t number, panel;
    bool is_expected;
    char named[200]; /* another specimen, which its name begins with; empty: none */
};

static void place_done(struct place *place)
{
    gsn_specimen_row_free(place->specimen);
}
#define auto_place __attribute__((cleanup(place_done))) struct place

/* GSN_OK with no specimen when the query finds none. */
static int find_specimen(struct gsn_store *store, const char *sql, const char *text,
                         struct place *place, struct gsn_error *err)
{
    int64_t id = 0;
    const int r = gsn_sql_int(store, sql, SQL_ARGS(SQL_TEXT(text)), &id, err);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    return r < 0 ? r : gsn_specimen_get_by_id(store, id, &place->specimen, err);
}

/* Whose name a scan's name begins with. */
#define NAMED_SPECIMEN                                                                             \
    "SELECT id FROM specimen WHERE kind = 'sections' AND substr(?1, 1, length(name)) = name AND "  \
    "substr(?1, length(name) + 1, 1) IN ('', '-', '_', ' ', '.') ORDER BY length(name) DESC "      \
    "LIMIT 1"

static int find_place(struct gsn_store *store, const struct gsn_scan_row *scan, struct place *place,
                      struct gsn_error *err)
{
    auto_place named = { .panel = 0 };
    int r = find_specimen(store, "SELECT specimen_id FROM expectation WHERE source = ?1",
                          scan->source, place, err);

    if (r >= 0)
        r = find_specimen(store, NAMED_SPECIMEN, scan->name, &named, err);
    if (r < 0)
        return r;
    place->is_expected = place->specimen != NULL;
    if (!place->specimen)
        place->specimen = gsn_steal(&named.specimen);
    else if (named.specimen && named.specimen->id != place->specimen->id)
        (void)snprintf(place->named, sizeof place->named, "%s", named.specimen->name);
    return GSN_OK;
}

/* What stands for the specimen in a name says nothing about the panel: "S02.tif" is not panel 2. */
static int64_t number_behind(const char *name, const char *specimen, unsigned number)
{
    const size_t length = strlen(specimen);

    return strncmp(name, specimen, length) == 0 ? gsn_panel_number(name, length) : number;
}

/* One behind the highest, so that panels stay in the order in which they came. */
static int next_number(struct gsn_store *store, int64_t specimen, int64_t *ret_number,
                       struct gsn_error *err)
{
    return gsn_sql_int(store,
                       "SELECT coalesce(max(number), 0) + 1 FROM panel "
                       "WHERE specimen_id = ?1 AND state <> 'held'",
                       SQL_ARGS(SQL_INT(specimen)), ret_number, err);
}

/* Settles state, reason and number; in a transaction. */
static int judge(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                 struct place *place, struct gsn_error *err)
{
    int r = GSN_OK;

    place->state = "kept";
    (void)snprintf(place->reason, sizeof place->reason, "%s, taken on purpose",
                   strcmp(scan->subject, "dark") == 0 ? "a dark frame" : "blank glass");
    if (strcmp(scan->subject, "panel") != 0)
        return GSN_OK;
    r = find_place(store, scan, place, err);
    if (r < 0)
        return r;
    if (!place->specimen) {
        place->state = "unfiled";
        (void)snprintf(place->reason, sizeof place->reason,
                       "nothing is expected from %.100s and no specimen has the name that this one "
                       "begins with: say whose it is with `gieson file`",
                       scan->source);
        return GSN_OK;
    }
    if (place->named[0]) {
        place->state = "unfiled";
        (void)snprintf(place->reason, sizeof place->reason,
                       "%.100s is expected from %.100s, but its name is that of %.100s: say whose "
                       "it is with `gieson file`",
                       place->specimen->name, scan->source, place->named);
        gsn_specimen_row_free(gsn_steal(&place->specimen));
        return GSN_OK;
    }
    place->state = "filed";
    place->number = number_behind(scan->name, place->specimen->name, number);
    (void)snprintf(place->reason, sizeof place->reason,
                   place->is_expected ? "%.200s is expected from this source"
                                      : "its name begins with %.200s",
                   place->specimen->name);
    if (place->is_expected && place->number == 0)
        r = next_number(store, place->specimen->id, &place->number, err);
    return r;
}

/* Asks for the panel and for what rests on it. */
static int ask(struct gsn_store *store, int64_t specimen, int64_t panel, struct gsn_error *err)
{
    int64_t job = 0;
    const int r = gsn_queue_add(store, specimen, panel, &job, err);

    return r < 0 ? r : gsn_queue_add(store, specimen, 0, &job, err);
}

static int put_panel(struct gsn_store *store, const struct gsn_scan_row *scan, struct place *place,
                     int *ret_again, struct gsn_error *err)
{
    const struct gsn_panel_row row = { .specimen_id = place->specimen->id,
                                       .number = place->number,
                                       .file_name = scan->name,
                                       .sha256 = scan->sha256,
                                       .size = scan->size,
                                       .state = "waiting",
                                       .code = "",
                                       .message = "",
                                       .px_um = NAN };
    const int r = gsn_panel_put(store, &row, &place->panel, ret_again, err);

    return r < 0 || *ret_again ? r : ask(store, place->specimen->id, place->panel, err);
}

static int insert(struct gsn_store *store, const struct gsn_scan_row *scan,
                  const struct place *place, int64_t now, int64_t *ret_id, struct gsn_error *err)
{
    const int r = gsn_sql_run(
        store,
        "INSERT INTO scan (source, device, name, key, subject, sha256, size, facts, state, reason, "
        "panel_id, arrived) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, nullif(?11, 0), ?12)",
        SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->device), SQL_TEXT(scan->name),
                 SQL_TEXT(scan->key), SQL_TEXT(scan->subject), SQL_TEXT(scan->sha256),
                 SQL_INT(scan->size), SQL_TEXT(scan->facts), SQL_TEXT(place->state),
                 SQL_TEXT(place->reason), SQL_INT(place->panel), SQL_INT(now)),
        NULL, err);

    if (r < 0)
        return r == GSN_E_INPUT ? gsn_fail_at(err, "scan %.200s", scan->name) : r;
    *ret_id = gsn_sql_last_id(store);
    return GSN_OK;
}

static int tell_arrival(struct gsn_store *store, const struct gsn_scan_row *scan,
                        const struct place *place, int64_t now, struct gsn_error *err)
{
    gsn_auto_mem(char) text =
        gsn_format("%s, from %s, %s: %s", scan->sha256, scan->source, place->state, place->reason);

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the diary");
    return gsn_event_add(store, now, "gieson-intake", "scan", scan->name, text, err);
}

/* In a transaction. */
static int take(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                int64_t now, int64_t *ret_id, int *ret_again, struct gsn_error *err)
{
    auto_place place = { .panel = 0 };
    int known_panel = 0;
    int r =
        gsn_sql_int(store, "SELECT id FROM scan WHERE source = ?1 AND name = ?2 AND sha256 = ?3",
                    SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->name), SQL_TEXT(scan->sha256)),
                    ret_id, err);

    *ret_again = r >= 0;
    if (r != GSN_E_NOTFOUND)
        return r;
    r = judge(store, scan, number, &place, err);
    if (r >= 0 && place.specimen)
        r = put_panel(store, scan, &place, &known_panel, err);
    if (r >= 0)
        r = insert(store, scan, &place, now, ret_id, err);
    return r < 0 ? r : tell_arrival(store, scan, &place, now, err);
}

int gsn_scan_take(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                  int64_t now, int64_t *ret_id, int *ret_again, struct gsn_error *err)
{
    int64_t id = 0;
    int again = 0;
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_sql_end(store, take(store, scan, number, now, &id, &again, err), err);
    if (r < 0)
        return r;
    *ret_id = id;
    *ret_again = again;
    return GSN_OK;
}

int gsn_scan_is_known(struct gsn_store *store, const char *key, int *ret_known,
                      struct gsn_error *err)
{
    int64_t known = 0;
    const int r = gsn_sql_int(store,
                              "SELECT ?1 <> '' AND EXISTS (SELECT 1 FROM scan WHERE key = ?1 AND "
                              "key <> '')",
                              SQL_ARGS(SQL_TEXT(key)), &known, err);

    if (r >= 0)
        *ret_known = known != 0;
    return r;
}

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
        return gsn_fail(err, GSN_E_INPUT, "scan %lld is filed already, as a panel of %s",
                        (long long)scan->id, scan->specimen);
    return r;
}

static int check_sections(const struct gsn_specimen_row *specimen, struct gsn_error *err)
{
    if (strcmp(specimen->kind, "sections") != 0)
        return gsn_fail(err, GSN_E_INPUT, "%s is a %s and has no panels", specimen->name,
                        specimen->kind);
    return GSN_OK;
}

/* The bytes were a panel of this specimen before: a held one takes the number that a person gives,
 * and the others that are held are looked at again, for it may have stood in their way. */
static int renumber(struct gsn_store *store, const struct gsn_scan_row *scan,
                    const struct place *place, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    bool held = false;
    int r = is_held(store, place->panel, &held, err);

    if (r < 0 || !held)
        return r;
    r = gsn_panel_set_name(store, place->panel, place->number, scan->name, err);
    if (r >= 0)
        r = gsn_panel_list(store, place->specimen->id, &panels, err);
    for (size_t i = 0; r >= 0 && i < panels->count; i++) {
        if (strcmp(panels->at[i].state, "held") != 0)
            continue;
        r = gsn_panel_set_state(store, panels->at[i].id, "waiting", NULL, NULL, err);
        if (r >= 0)
            r = ask(store, place->specimen->id, panels->at[i].id, err);
    }
    return r;
}

static int tell_filing(struct gsn_store *store, const struct gsn_scan_row *scan,
                       const struct place *place, const char *actor, int64_t now,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) text = gsn_format("scan %lld is panel %lld of %s", (long long)scan->id,
                                         (long long)place->number, place->specimen->name);

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the diary");
    return gsn_event_add(store, now, actor, "file", scan->name, text, err);
}

/* In a transaction. */
static int file(struct gsn_store *store, int64_t id, const char *specimen, unsigned number,
                const char *actor, int64_t now, struct gsn_error *err)
{
    gsn_auto(gsn_scan_row) scan = NULL;
    auto_place place = { .number = number };
    int known = 0;
    int r = gsn_scan_get(store, id, &scan, err);

    if (r >= 0)
        r = check_fileable(store, scan, specimen, number, err);
    if (r >= 0)
        r = gsn_specimen_get(store, specimen, &place.specimen, err);
    if (r >= 0)
        r = check_sections(place.specimen, err);
    if (r >= 0)
        r = put_panel(store, scan, &place, &known, err);
    if (r >= 0 && known)
        r = renumber(store, scan, &place, err);
    if (r >= 0)
        r = gsn_sql_run(
            store,
            "UPDATE scan SET state = 'filed', reason = 'filed by ' || ?2, panel_id = ?3 "
            "WHERE id = ?1",
            SQL_ARGS(SQL_INT(id), SQL_TEXT(actor), SQL_INT(place.panel)), NULL, err);
    return r < 0 ? r : tell_filing(store, scan, &place, actor, now, err);
}

int gsn_scan_file(struct gsn_store *store, int64_t id, const char *specimen, unsigned number,
                  const char *actor, int64_t now, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, file(store, id, specimen, number, actor, now, err), err);
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
    return gsn_event_add(store, now, actor, "expect", source, row ? row->name : "nobody", err);
}

int gsn_scan_expect(struct gsn_store *store, const char *source, const char *specimen,
                    const char *actor, int64_t now, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, expect(store, source, specimen, actor, now, err), err);
}
