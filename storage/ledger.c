/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The ledger of pictures: its rows, and how what was staged (scan.c) comes into it.
 *
 * Steps of a commit, in the transaction that the caller has begun.
 * 1. Up to 256 rows of the staging table are read in the order in which they came.
 * 2. Whose panel a picture is: the specimen that the source is expected to deliver, else the
 * longest name that the picture's own begins with, else nobody's until a person says.
 * 3. A picture that proves to be a torn beginning of this one gives it its place (torn.h).
 * 4. Each moves into the ledger with its panel, its job and its event of the audit log; then the
 * staging table is emptied.
 *
 * How it fails: as the store does, and then the whole transaction is to be rolled back: the rows
 * stay staged. Cost: tests/bench/log.c. */
#include "storage/scan.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "storage/panel_log.h"
#include "storage/sql.h"
#include "storage/torn.h"
#include "storage/transaction.h"

/* The rows. */

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

/* What is staged, and where it goes. */

/* A specimen, as far as a scan needs it. */
struct whose {
    int64_t is_expected, id;
    const char *name;
};

#define WHOSE(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct whose, name)                                               \
    }
static const struct gsn_sql_field whose_fields[] = { WHOSE(INT, is_expected), WHOSE(INT, id),
                                                     WHOSE(TEXT, name) };

#undef WHOSE
static const struct gsn_sql_shape whose_shape = SQL_SHAPE(struct whose, whose_fields);

/* A picture in the staging table. */
struct letter {
    struct gsn_scan_row row; /* without state, reason, panel and specimen */
    int64_t number;
};

#define LETTER(type, name)                                                                         \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct letter, name)                                              \
    }
static const struct gsn_sql_field letter_fields[] = {
    LETTER(INT, row.id),      LETTER(TEXT, row.source), LETTER(TEXT, row.device),
    LETTER(TEXT, row.name),   LETTER(TEXT, row.key),    LETTER(TEXT, row.subject),
    LETTER(TEXT, row.sha256), LETTER(INT, row.size),    LETTER(TEXT, row.facts),
    LETTER(INT, number),      LETTER(INT, row.arrived),
};

#undef LETTER
static const struct gsn_sql_shape letter_shape = SQL_SHAPE(struct letter, letter_fields);

/* Where a picture goes, and why. */
struct place {
    const char *state;
    char reason[400];
    int64_t specimen; /* 0: nowhere */
    int64_t number, panel;
};

struct candidates {
    struct whose *at; /* owned */
    size_t count;
    const struct whose *expected, *named; /* NULL: none */
};

/* Committing what was staged. */

static void candidates_done(struct candidates *candidates)
{
    gsn_sql_free_rows(&whose_shape, candidates->at, candidates->count);
}
#define auto_candidates __attribute__((cleanup(candidates_done))) struct candidates

/* Whom the source (?1) is expected to deliver, and whose name the scan's name (?2) begins with. The
 * names that a name begins with lie, in order of length, between its first word (?3) and itself,
 * so the index leads to them. */
#define CANDIDATES                                                                                 \
    "SELECT 1, s.id, s.name FROM expectation e JOIN specimen s ON s.id = e.specimen_id "           \
    "WHERE e.source = ?1 UNION ALL SELECT * FROM (SELECT 0, id, name FROM specimen "               \
    "WHERE name BETWEEN ?3 AND ?2 AND kind = 'sections' AND substr(?2, 1, length(name)) = name "   \
    "AND instr('-_ .', substr(?2, length(name) + 1, 1)) > 0 ORDER BY name DESC LIMIT 1)"

static int find_candidates(struct gsn_store *store, const struct gsn_scan_row *scan,
                           struct candidates *candidates, struct gsn_error *err)
{
    const char *const name = scan->name;
    char word[64]; /* of a long one the beginning: it comes before the whole, too */
    void *rows = NULL;
    int r;

    (void)snprintf(word, sizeof word, "%.*s", *name ? 1 + (int)strcspn(name + 1, "-_ .") : 0, name);
    r = gsn_sql_rows(store, &whose_shape, CANDIDATES,
                     SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(name), SQL_TEXT(word)), &rows,
                     &candidates->count, err);
    if (r < 0)
        return r;
    candidates->at = rows;
    for (size_t i = 0; i < candidates->count; i++) {
        if (candidates->at[i].is_expected)
            candidates->expected = &candidates->at[i];
        else
            candidates->named = &candidates->at[i];
    }
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

static void keep_on_purpose(const struct gsn_scan_row *scan, struct place *place)
{
    place->state = "kept";
    (void)snprintf(place->reason, sizeof place->reason, "%s, taken on purpose",
                   strcmp(scan->subject, "dark") == 0 ? "a dark frame" : "blank glass");
}

static void leave_unfiled(const struct gsn_scan_row *scan, const struct candidates *found,
                          struct place *place)
{
    place->state = "unfiled";
    if (!found->expected)
        (void)snprintf(place->reason, sizeof place->reason,
                       "nothing is expected from %.100s and no specimen has the name that this one "
                       "begins with: say whose it is with `gieson file`",
                       scan->source);
    else
        (void)snprintf(place->reason, sizeof place->reason,
                       "%.100s is expected from %.100s, but its name is that of %.100s: say whose "
                       "it is with `gieson file`",
                       found->expected->name, scan->source, found->named->name);
}

static void place_scan(const struct gsn_scan_row *scan, unsigned number, const struct whose *whose,
                       struct place *place)
{
    place->state = "filed";
    place->specimen = whose->id;
    place->number = number_behind(scan->name, whose->name, number);
    (void)snprintf(place->reason, sizeof place->reason,
                   whose->is_expected ? "%.200s is expected from this source"
                                      : "its name begins with %.200s",
                   whose->name);
}

/* Settles state, reason and number; in a transaction. */
static int place_staged(struct gsn_store *store, const struct gsn_scan_row *scan, unsigned number,
                        struct place *place, struct gsn_error *err)
{
    auto_candidates found = { .count = 0 };
    int r;

    if (strcmp(scan->subject, "panel") != 0) {
        keep_on_purpose(scan, place);
        return GSN_OK;
    }
    r = find_candidates(store, scan, &found, err);
    if (r < 0)
        return r;
    if (found.expected && (!found.named || found.named->id == found.expected->id))
        place_scan(scan, number, found.expected, place);
    else if (found.named && !found.expected)
        place_scan(scan, number, found.named, place);
    else
        leave_unfiled(scan, &found, place);
    if (place->specimen && found.expected && place->number == 0)
        r = next_number(store, place->specimen, &place->number, err);
    return r;
}

int gsn_scan_put_panel(struct gsn_store *store, const struct gsn_scan_row *scan,
                       int64_t specimen_id, int64_t number, int64_t *ret_panel, int *ret_again,
                       struct gsn_error *err)
{
    const struct gsn_panel_row row = { .specimen_id = specimen_id,
                                       .number = number,
                                       .file_name = scan->name,
                                       .sha256 = scan->sha256,
                                       .size = scan->size,
                                       .state = "waiting",
                                       .code = "",
                                       .message = "",
                                       .px_um = NAN };
    int64_t job = 0;
    const int r = gsn_panel_insert(store, &row, ret_panel, ret_again, err);

    return r < 0 || *ret_again ? r : gsn_queue_ask(store, specimen_id, *ret_panel, &job, err);
}

/* With the id that it was taken in under. */
static int insert_scan(struct gsn_store *store, const struct letter *scan,
                       const struct place *place, struct gsn_error *err)
{
    return gsn_sql_run(
        store,
        "INSERT INTO scan (id, source, device, name, key, subject, sha256, size, facts, state, "
        "reason, panel_id, arrived) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, "
        "nullif(?12, 0), ?13)",
        SQL_ARGS(SQL_INT(scan->row.id), SQL_TEXT(scan->row.source), SQL_TEXT(scan->row.device),
                 SQL_TEXT(scan->row.name), SQL_TEXT(scan->row.key), SQL_TEXT(scan->row.subject),
                 SQL_TEXT(scan->row.sha256), SQL_INT(scan->row.size), SQL_TEXT(scan->row.facts),
                 SQL_TEXT(place->state), SQL_TEXT(place->reason), SQL_INT(place->panel),
                 SQL_INT(scan->row.arrived)),
        NULL, err);
}

static int log_arrival(struct gsn_store *store, const struct gsn_scan_row *scan,
                       const struct place *place, struct gsn_event_tail *log, struct gsn_error *err)
{
    gsn_auto_mem(char) text =
        gsn_format("%s, from %s, %s: %s", scan->sha256, scan->source, place->state, place->reason);

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the audit log");
    return gsn_event_append_to(store, log, scan->arrived, "gieson-intake", "scan", scan->name, text,
                               err);
}

/* What one picture leaves to the next of the same transaction. */
struct progress {
    struct gsn_event_tail log;
    int64_t asked; /* the specimen asked for last */
};

/* Whether this source gave another picture of this name before. */
static int find_earlier(struct gsn_store *store, const struct gsn_scan_row *scan, int64_t *ret_came,
                        struct gsn_error *err)
{
    return gsn_sql_int(
        store,
        "SELECT EXISTS (SELECT 1 FROM scan WHERE source = ?1 AND name = ?2 AND "
        "sha256 <> ?3)",
        SQL_ARGS(SQL_TEXT(scan->source), SQL_TEXT(scan->name), SQL_TEXT(scan->sha256)), ret_came,
        err);
}

/* Its panel, and the jobs that this asks for. */
static int commit_panel(struct gsn_store *store, const struct letter *scan, struct place *place,
                        struct progress *progress, struct gsn_error *err)
{
    const struct gsn_panel_row whole = { .specimen_id = place->specimen,
                                         .file_name = scan->row.name,
                                         .sha256 = scan->row.sha256,
                                         .size = scan->row.size };
    int64_t job = 0, came = 0;
    int again = 0;
    int r = find_earlier(store, &scan->row, &came, err);

    if (r >= 0 && came)
        r = gsn_torn_replace(store, &whole, scan->row.arrived, "gieson-intake", &place->panel, err);
    if (r >= 0 && place->panel) {
        const size_t used = strlen(place->reason);

        (void)snprintf(place->reason + used, sizeof place->reason - used,
                       "; what came under this name before was a torn beginning of it");
        return gsn_event_tail(store, &progress->log, err);
    }
    if (r >= 0)
        r = gsn_scan_put_panel(store, &scan->row, place->specimen, place->number, &place->panel,
                               &again, err);

    if (r < 0 || again || place->specimen == progress->asked)
        return r;
    r = gsn_queue_ask(store, place->specimen, 0, &job, err);
    progress->asked = place->specimen;
    return r;
}

/* Of a scan that nobody could place: the unfiled ones from the same source, of the same name, that
 * are a torn beginning of it, are kept and wait for nobody any more. */
static int forget_torn(struct gsn_store *store, const struct gsn_scan_row *whole,
                       struct gsn_error *err)
{
    gsn_auto(gsn_scan_rows) rows = NULL;
    int r = gsn_scan_list(store, "unfiled", 0, &rows, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++) {
        const struct gsn_scan_row *const scan = &rows->at[i];
        struct gsn_error quiet = { 0 };
        int is_torn = 0;

        if (strcmp(scan->source, whole->source) != 0 || strcmp(scan->name, whole->name) != 0 ||
            strcmp(scan->sha256, whole->sha256) == 0 ||
            gsn_torn_compare(store, scan->sha256, whole->sha256, &is_torn, &quiet) < 0 || !is_torn)
            continue;
        r = gsn_sql_run(store,
                        "UPDATE scan SET state = 'kept', reason = 'a torn beginning of the picture "
                        "that came under this name later' WHERE id = ?1",
                        SQL_ARGS(SQL_INT(scan->id)), NULL, err);
    }
    return r;
}

/* Its panel, its row in the ledger, its event in the audit log. */
static int commit_row(struct gsn_store *store, const struct letter *scan, struct progress *progress,
                      struct gsn_error *err)
{
    struct place place = { .panel = 0 };
    int64_t came = 0;
    int r = place_staged(store, &scan->row, (unsigned)scan->number, &place, err);

    if (r >= 0 && place.specimen)
        r = commit_panel(store, scan, &place, progress, err);
    if (r >= 0 && strcmp(place.state, "unfiled") == 0)
        r = find_earlier(store, &scan->row, &came, err);
    if (r >= 0 && came)
        r = forget_torn(store, &scan->row, err);
    if (r >= 0)
        r = insert_scan(store, scan, &place, err);
    return r < 0 ? r : log_arrival(store, &scan->row, &place, &progress->log, err);
}

int gsn_scan_is_none_staged(struct gsn_store *store, bool *ret_none, struct gsn_error *err)
{
    int64_t any = 0;
    const int r = gsn_sql_int(store, "SELECT EXISTS (SELECT 1 FROM inbox)", SQL_NO_ARGS, &any, err);

    if (r >= 0)
        *ret_none = any == 0;
    return r;
}

int gsn_scan_commit_all_staged(struct gsn_store *store, struct gsn_error *err)
{
    struct progress progress = { .asked = 0 };
    const struct letter *letters;
    void *rows = NULL;
    size_t count = 0;
    bool empty = false;
    int r = gsn_scan_is_none_staged(store, &empty, err);

    if (r < 0 || empty)
        return r;
    r = gsn_sql_rows(store, &letter_shape,
                     "SELECT id, source, device, name, key, subject, sha256, size, facts, number, "
                     "arrived FROM inbox ORDER BY id",
                     SQL_NO_ARGS, &rows, &count, err);
    letters = rows;
    if (r >= 0)
        r = gsn_event_tail(store, &progress.log, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = commit_row(store, &letters[i], &progress, err);
    if (r >= 0)
        r = gsn_sql_run(store, "DELETE FROM inbox", SQL_NO_ARGS, NULL, err);
    gsn_sql_free_rows(&letter_shape, rows, count);
    return r;
}
