/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/decision.h"

#include "pipeline/core/mem.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "storage/sql.h"
#include "storage/within.h"

#include <string.h>

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

int gsn_decision_list(struct gsn_store *store, int64_t specimen_id,
                      struct gsn_decision_rows **ret_rows, struct gsn_error *err)
{
    return decision_rows(store,
                         "SELECT number, slot, answer, x_px, y_px, actor, reason, time "
                         "FROM decision WHERE specimen_id = ?1 ORDER BY number, slot",
                         SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

/* The panels of that number are looked at again; one that never came leaves the report alone. */
static int ask(struct gsn_store *store, int64_t specimen_id, int64_t number, struct gsn_error *err)
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

static int tell(struct gsn_store *store, const char *specimen, const struct gsn_decision_row *row,
                const char *before, struct gsn_error *err)
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

static int put(struct gsn_store *store, const char *specimen, const struct gsn_decision_row *row,
               int *ret_again, struct gsn_error *err)
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
        r = tell(store, specimen, row, before, err);
    return r >= 0 ? ask(store, found->id, row->number, err) : r;
}

int gsn_decision_put(struct gsn_store *store, const char *specimen,
                     const struct gsn_decision_row *row, int *ret_again, struct gsn_error *err)
{
    int again = 0, r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = put(store, specimen, row, &again, err);
    if (r < 0) {
        gsn_store_rollback(store);
        return r;
    }
    r = gsn_store_commit(store, err);
    if (r >= 0)
        *ret_again = again;
    return r;
}
