/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/candidate.h"

#include "storage/sql.h"
#include "storage/within.h"

#include <math.h>
#include <string.h>

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

int gsn_candidate_list(struct gsn_store *store, int64_t specimen_id,
                       struct gsn_candidate_rows **ret_rows, struct gsn_error *err)
{
    return candidate_rows(store, LIST, SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

#define VALUES(m)                                                                                  \
    SQL_INT((m)->found != 0), SQL_REAL((m)->x_px), SQL_REAL((m)->y_px), SQL_REAL((m)->radius_px),  \
        SQL_REAL((m)->cov_xx), SQL_REAL((m)->cov_xy), SQL_REAL((m)->cov_yy), SQL_REAL((m)->score)

static int append(struct gsn_store *store, int64_t panel_id, const struct gsn_candidate_row *row,
                  struct gsn_error *err)
{
    const struct gsn_marker_row *m = row->marker;
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
        r = append(store, panel_id, &rows[i], err);
    return gsn_sql_end(store, r, err);
}
