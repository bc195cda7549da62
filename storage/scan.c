/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The ledger of pictures: staged one by one, committed many at once, and filed.
 *
 * Steps.
 * 1. stage: one row in the staging table (SQL: inbox), which has no index and holds all that is
 * known of the picture: one page in one commit. The handle remembers the tags of what it staged, so
 * that it need not look through them for each new picture.
 * 2. commit: up to 256 rows move into the ledger, each with its panel, its job and its event of the
 * audit log. Whose panel it is: the specimen that the source is expected to deliver, else the
 * longest name that the picture's own begins with, else nobody's until a person says.
 * 3. A picture that proves to be a torn beginning of this one gives it its place (torn.h).
 * 4. By hand: file, unfile, expect.
 *
 * How it fails: GSN_E_INPUT with what a person must give. A crash leaves staged rows, which the
 * next who opens the store commits. Cost: tests/bench/log.c. */
#include "storage/scan.h"

#include <math.h>
#include <sqlite3.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/sql.h"
#include "storage/torn.h"
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

/* Makes a scan the panel of a specimen and asks for it; the specimen, which rests on it, is to be
 * asked for next. The same bytes were its panel before: ret_again becomes 1 and nothing is asked.
 */
static int put_panel(struct gsn_store *store, const struct gsn_scan_row *scan, int64_t specimen_id,
                     int64_t number, int64_t *ret_panel, int *ret_again, struct gsn_error *err)
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
        r = put_panel(store, &scan->row, place->specimen, place->number, &place->panel, &again,
                      err);

    if (r < 0 || again || place->specimen == progress->asked)
        return r;
    r = gsn_queue_ask(store, place->specimen, 0, &job, err);
    progress->asked = place->specimen;
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
        r = gsn_torn_forget(store, &scan->row, err);
    if (r >= 0)
        r = insert_scan(store, scan, &place, err);
    return r < 0 ? r : log_arrival(store, &scan->row, &place, &progress->log, err);
}

static int is_empty(struct gsn_store *store, bool *ret_empty, struct gsn_error *err)
{
    int64_t any = 0;
    const int r = gsn_sql_int(store, "SELECT EXISTS (SELECT 1 FROM inbox)", SQL_NO_ARGS, &any, err);

    if (r >= 0)
        *ret_empty = any == 0;
    return r;
}

int gsn_scan_commit_all_staged(struct gsn_store *store, struct gsn_error *err)
{
    struct progress progress = { .asked = 0 };
    const struct letter *letters;
    void *rows = NULL;
    size_t count = 0;
    bool empty = false;
    int r = is_empty(store, &empty, err);

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

int gsn_scan_commit_staged(struct gsn_store *store, struct gsn_error *err)
{
    bool empty = false;
    int r = is_empty(store, &empty, err);

    if (r >= 0 && !empty)
        r = gsn_store_begin(store, err);
    if (r >= 0 && !empty)
        r = gsn_sql_end(store, gsn_scan_commit_all_staged(store, err), err);
    if (r >= 0)
        gsn_store_staging(store)->uncommitted = gsn_store_staging(store)->count = 0;
    return r;
}

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

/* The ledger, and filing by hand. */

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
        r = put_panel(store, scan, specimen->id, number, &panel, &known, err);
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
