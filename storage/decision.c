/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What operators decided, and the candidates they choose from.
 *
 * Candidates: the poses that a doubtful section may have, written by the specimen's job, replaced
 * as a whole. A decision is one answer to one question (panel, slot); the same answer again changes
 * nothing, an empty one takes it back. Each is an event of the audit log with who gave it and why,
 * and asks for the panels that it is about and the specimen's report, in the same transaction. */
#include "storage/decision.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/mem.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "storage/sql.h"
#include "storage/transaction.h"

#define FIELD(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_candidate_row, name)                                   \
    }
#define MARKER(i)                                                                                  \
    FIELD(INT, marker[i].found), FIELD(REAL, marker[i].x_px), FIELD(REAL, marker[i].y_px),         \
        FIELD(REAL, marker[i].radius_px), FIELD(REAL, marker[i].cov_xx),                           \
        FIELD(REAL, marker[i].cov_xy), FIELD(REAL, marker[i].cov_yy), FIELD(REAL, marker[i].score)
static const struct gsn_sql_field candidate_fields[] = {
    FIELD(INT, panel_id),
    FIELD(INT, slot),
    FIELD(INT, number),
    FIELD(INT, chosen),
    FIELD(INT, mirrored),
    FIELD(INT, flipped),
    FIELD(INT, rotated180),
    FIELD(REAL, share),
    FIELD(REAL, error_um),
    FIELD(TEXT, differs),
    MARKER(0),
    MARKER(1),
    MARKER(2),
};

#undef MARKER

#undef FIELD
static const struct gsn_sql_shape candidate_shape =
    SQL_SHAPE(struct gsn_candidate_row, candidate_fields);

SQL_DEFINE_ROWS(candidate);

/* All marks of a candidate lie in one array, eight numbers each. */
#define SAID(name) "json_extract(c.value, '$." name "'), "
#define MARK(i, end) "json_extract(c.value, '$.mark[" #i "]')" end
#define EIGHT(a, b, c, d, e, f, g, h, end)                                                         \
    MARK(a, ", ")                                                                                  \
    MARK(b, ", ")                                                                                  \
    MARK(c, ", ") MARK(d, ", ") MARK(e, ", ") MARK(f, ", ") MARK(g, ", ") MARK(h, end)
#define MARKERS                                                                                    \
    EIGHT(0, 1, 2, 3, 4, 5, 6, 7, ", ")                                                            \
    EIGHT(8, 9, 10, 11, 12, 13, 14, 15, ", ") EIGHT(16, 17, 18, 19, 20, 21, 22, 23, " ")

static const char LIST[] = "SELECT s.panel_id, s.slot, c.key + 1, " SAID("chosen") SAID("mirrored")
    SAID("flipped") SAID("rotated180") SAID("share") SAID("error_um") SAID("differs") MARKERS
    "FROM panel p CROSS JOIN section s ON s." SECTIONS_OF(
        "p.id") "AND s.candidates <> '' "
                "JOIN json_each(s.candidates) c WHERE p.specimen_id = ?1 "
                "ORDER BY p.number, p.id, s.slot, c.key";

/* The database writes the JSON, so that no text of ours can break it. */
static const char APPEND[] =
    "UPDATE section SET candidates = json_insert(iif(candidates = '', '[]', candidates), '$[#]', "
    "json_object('chosen', ?3, 'mirrored', ?4, 'flipped', ?5, 'rotated180', ?6, 'share', ?7, "
    "'error_um', ?8, 'differs', ?9, 'mark', json_array(?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, "
    "?18, ?19, ?20, ?21, ?22, ?23, ?24, ?25, ?26, ?27, ?28, ?29, ?30, ?31, ?32, ?33))) "
    "WHERE id = ?1 * 4096 + ?2";

/* Candidates. */

int gsn_candidate_list(struct gsn_store *store, int64_t specimen_id,
                       struct gsn_candidate_rows **ret_rows, struct gsn_error *err)
{
    return candidate_rows(store, LIST, SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

#define VALUES(m)                                                                                  \
    SQL_INT((m)->found != 0), SQL_REAL((m)->x_px), SQL_REAL((m)->y_px), SQL_REAL((m)->radius_px),  \
        SQL_REAL((m)->cov_xx), SQL_REAL((m)->cov_xy), SQL_REAL((m)->cov_yy), SQL_REAL((m)->score)

static int append_candidate(struct gsn_store *store, int64_t panel_id,
                            const struct gsn_candidate_row *row, struct gsn_error *err)
{
    const struct gsn_fiducial_row *m = row->marker;
    int64_t changed = 0;
    const int r = gsn_sql_run(
        store, APPEND,
        SQL_ARGS(SQL_INT(panel_id), SQL_INT(row->slot), SQL_INT(row->chosen != 0),
                 SQL_INT(row->mirrored != 0), SQL_INT(row->flipped != 0),
                 SQL_INT(row->rotated180 != 0), SQL_REAL(row->share), SQL_REAL(row->error_um),
                 SQL_TEXT(row->differs), VALUES(&m[0]), VALUES(&m[1]), VALUES(&m[2])),
        &changed, err);

    if (r < 0)
        return r;
    return changed == 0 ? gsn_fail(err, GSN_E_NOTFOUND, "panel %lld has no section in slot %lld",
                                   (long long)panel_id, (long long)row->slot)
                        : GSN_OK;
}

int gsn_candidate_replace(struct gsn_store *store, int64_t panel_id,
                          const struct gsn_candidate_row *rows, size_t count, struct gsn_error *err)
{
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_sql_run(
        store, "UPDATE section SET candidates = '' WHERE " SECTIONS_OF("?1") "AND candidates <> ''",
        SQL_ARGS(SQL_INT(panel_id)), NULL, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = append_candidate(store, panel_id, &rows[i], err);
    return gsn_sql_end(store, r, err);
}

static const struct gsn_sql_field decision_fields[] = {
    { GSN_SQL_INT, offsetof(struct gsn_decision_row, number) },
    { GSN_SQL_INT, offsetof(struct gsn_decision_row, slot) },
    { GSN_SQL_TEXT, offsetof(struct gsn_decision_row, answer) },
    { GSN_SQL_REAL, offsetof(struct gsn_decision_row, x_px) },
    { GSN_SQL_REAL, offsetof(struct gsn_decision_row, y_px) },
    { GSN_SQL_TEXT, offsetof(struct gsn_decision_row, actor) },
    { GSN_SQL_TEXT, offsetof(struct gsn_decision_row, reason) },
    { GSN_SQL_INT, offsetof(struct gsn_decision_row, time) },
};
static const struct gsn_sql_shape decision_shape =
    SQL_SHAPE(struct gsn_decision_row, decision_fields);

SQL_DEFINE_ROWS(decision);

/* Decisions. */

int gsn_decision_list(struct gsn_store *store, int64_t specimen_id,
                      struct gsn_decision_rows **ret_rows, struct gsn_error *err)
{
    return decision_rows(store,
                         "SELECT number, slot, answer, x_px, y_px, actor, reason, time "
                         "FROM decision WHERE specimen_id = ?1 ORDER BY number, slot",
                         SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

/* The panels of that number are looked at again; one that never came leaves the report alone. */
static int ask_panels(struct gsn_store *store, int64_t specimen_id, int64_t number,
                      struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    int64_t job;
    int r = gsn_panel_list(store, specimen_id, &panels, err);

    for (size_t i = 0; r >= 0 && i < panels->count; i++)
        if (panels->at[i].number == number)
            r = gsn_queue_ask(store, specimen_id, panels->at[i].id, &job, err);
    return r >= 0 ? gsn_queue_ask(store, specimen_id, 0, &job, err) : r;
}

static int write_answer(struct gsn_store *store, int64_t specimen_id,
                        const struct gsn_decision_row *row, struct gsn_error *err)
{
    if (!row->answer[0])
        return gsn_sql_run(store,
                           "DELETE FROM decision WHERE specimen_id = ?1 AND number = ?2 AND "
                           "slot = ?3",
                           SQL_ARGS(SQL_INT(specimen_id), SQL_INT(row->number), SQL_INT(row->slot)),
                           NULL, err);
    return gsn_sql_run(store,
                       "INSERT OR REPLACE INTO decision (specimen_id, number, slot, answer, x_px, "
                       "y_px, actor, reason, time) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
                       SQL_ARGS(SQL_INT(specimen_id), SQL_INT(row->number), SQL_INT(row->slot),
                                SQL_TEXT(row->answer), SQL_REAL(row->x_px), SQL_REAL(row->y_px),
                                SQL_TEXT(row->actor), SQL_TEXT(row->reason), SQL_INT(row->time)),
                       NULL, err);
}

static int log_decision(struct gsn_store *store, const char *specimen,
                        const struct gsn_decision_row *row, const char *before,
                        struct gsn_error *err)
{
    gsn_auto_mem(char) place = row->slot ? gsn_format("panel %lld, slot %lld",
                                                      (long long)row->number, (long long)row->slot)
                                         : gsn_format("panel %lld", (long long)row->number);
    gsn_auto_mem(char) text =
        place ? gsn_format("%s: %s%s%s%s%s", place, row->answer[0] ? row->answer : "taken back",
                           before[0] ? ", instead of " : "", before, row->reason[0] ? "; " : "",
                           row->reason)
              : NULL;

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a decision");
    return gsn_event_append(store, row->time, row->actor, "decide", specimen, text, err);
}

static const char *answer_before(const struct gsn_decision_rows *rows,
                                 const struct gsn_decision_row *row)
{
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].number == row->number && rows->at[i].slot == row->slot)
            return rows->at[i].answer;
    return "";
}

static int put_decision(struct gsn_store *store, const char *specimen,
                        const struct gsn_decision_row *row, int *ret_again, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) found = NULL;
    gsn_auto(gsn_decision_rows) rows = NULL;
    const char *before;
    int r = gsn_specimen_get(store, specimen, &found, err);

    if (r >= 0)
        r = gsn_decision_list(store, found->id, &rows, err);
    if (r < 0)
        return r;
    before = answer_before(rows, row);
    *ret_again = strcmp(before, row->answer) == 0;
    if (*ret_again)
        return GSN_OK;
    r = write_answer(store, found->id, row, err);
    if (r >= 0)
        r = log_decision(store, specimen, row, before, err);
    return r >= 0 ? ask_panels(store, found->id, row->number, err) : r;
}

int gsn_decision_put(struct gsn_store *store, const char *specimen,
                     const struct gsn_decision_row *row, int *ret_again, struct gsn_error *err)
{
    int again = 0, r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = put_decision(store, specimen, row, &again, err);
    if (r < 0) {
        gsn_store_rollback(store);
        return r;
    }
    r = gsn_store_commit(store, err);
    if (r >= 0)
        *ret_again = again;
    return r;
}
