/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/result.h"

#include "storage/audit.h"
#include "storage/sql.h"

#define RUN(type, name)                                                                            \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_run_row, name)                                         \
    }
static const struct gsn_sql_field run_fields[] = {
    RUN(INT, id),           RUN(INT, specimen_id),
    RUN(TEXT, key),         RUN(TEXT, version),
    RUN(TEXT, inputs_json), RUN(TEXT, parameters_json),
    RUN(TEXT, state),       RUN(TEXT, message),
    RUN(TEXT, report_path), RUN(TEXT, report_sha256),
    RUN(TEXT, json_path),   RUN(TEXT, json_sha256),
    RUN(TEXT, event_head),  RUN(INT, started),
    RUN(INT, finished),
};
#undef RUN
#define SELECT_RUN                                                                                 \
    "SELECT id, specimen_id, key, version, inputs_json, parameters_json, state, message, "         \
    "report_path, report_sha256, json_path, json_sha256, event_head, started, finished FROM run "
static const struct gsn_sql_shape run_shape = SQL_SHAPE(struct gsn_run_row, run_fields);

SQL_DEFINE_ROW(run);
SQL_DEFINE_ROWS(run);

#define MEASURE(type, name)                                                                        \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_measure_row, name)                                     \
    }
static const struct gsn_sql_field measure_fields[] = {
    MEASURE(INT, run_id), MEASURE(TEXT, name),  MEASURE(REAL, value),
    MEASURE(REAL, lower), MEASURE(REAL, upper), MEASURE(TEXT, unit),
};
#undef MEASURE
#define MEASURE_COLUMNS "run_id, name, value, lower, upper, unit"
static const struct gsn_sql_shape measure_shape = SQL_SHAPE(struct gsn_measure_row, measure_fields);

SQL_DEFINE_ROWS(measure);

#define POSE(type, name)                                                                           \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_pose_row, name)                                        \
    }
static const struct gsn_sql_field pose_fields[] = {
    POSE(INT, run_id),  POSE(INT, panel_id), POSE(INT, slot),    POSE(INT, serial),
    POSE(REAL, m00),    POSE(REAL, m01),     POSE(REAL, m02),    POSE(REAL, m10),
    POSE(REAL, m11),    POSE(REAL, m12),     POSE(INT, flipped), POSE(INT, rotated180),
    POSE(REAL, rms_um), POSE(REAL, tre_um),
};
#undef POSE
#define POSE_COLUMNS                                                                               \
    "run_id, panel_id, slot, serial, m00, m01, m02, m10, m11, m12, flipped, rotated180, rms_um, "  \
    "tre_um"
static const struct gsn_sql_shape pose_shape = SQL_SHAPE(struct gsn_pose_row, pose_fields);

SQL_DEFINE_ROWS(pose);

#define STAIN(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_stain_row, name)                                       \
    }
static const struct gsn_sql_field stain_fields[] = {
    STAIN(INT, run_id),     STAIN(INT, panel_id),   STAIN(REAL, white[0]),  STAIN(REAL, white[1]),
    STAIN(REAL, white[2]),  STAIN(REAL, vector[0]), STAIN(REAL, vector[1]), STAIN(REAL, vector[2]),
    STAIN(REAL, vector[3]), STAIN(REAL, vector[4]), STAIN(REAL, vector[5]), STAIN(REAL, vector[6]),
    STAIN(REAL, vector[7]), STAIN(REAL, vector[8]), STAIN(TEXT, source),
};
#undef STAIN
#define STAIN_COLUMNS                                                                              \
    "run_id, panel_id, white_r, white_g, white_b, dye1_r, dye1_g, dye1_b, dye2_r, dye2_g, "        \
    "dye2_b, dye3_r, dye3_g, dye3_b, source"
static const struct gsn_sql_shape stain_shape = SQL_SHAPE(struct gsn_stain_row, stain_fields);

SQL_DEFINE_ROWS(stain);

static int begin_run(struct gsn_store *store, const struct gsn_run_row *run, int64_t now,
                     int64_t *ret_id, struct gsn_error *err)
{
    int64_t dead = 0;
    int r = gsn_sql_int(store, "SELECT id FROM run WHERE specimen_id = ?1 AND state = 'running'",
                        SQL_ARGS(SQL_INT(run->specimen_id)), &dead, err);

    if (r >= 0)
        r = gsn_sql_run(store,
                        "UPDATE run SET state = 'failed', message = 'its worker died', "
                        "finished = ?2 WHERE id = ?1",
                        SQL_ARGS(SQL_INT(dead), SQL_INT(now)), NULL, err);
    if (r >= 0)
        r = gsn_audit_seal(store, dead, now, err);
    if (r >= 0 || r == GSN_E_NOTFOUND)
        r = gsn_sql_run(store,
                        "INSERT INTO run (specimen_id, key, version, inputs_json, "
                        "parameters_json, state, started) VALUES (?1, ?2, ?3, ?4, ?5, 'running', "
                        "?6)",
                        SQL_ARGS(SQL_INT(run->specimen_id), SQL_TEXT(run->key),
                                 SQL_TEXT(run->version), SQL_TEXT(run->inputs_json),
                                 SQL_TEXT(run->parameters_json), SQL_INT(now)),
                        NULL, err);
    if (r >= 0)
        *ret_id = gsn_sql_last_id(store);
    return r;
}

int gsn_run_begin(struct gsn_store *store, const struct gsn_run_row *run, int64_t now,
                  int64_t *ret_id, struct gsn_error *err)
{
    int64_t id = 0;
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_sql_end(store, begin_run(store, run, now, &id, err), err);
    if (r >= 0)
        *ret_id = id;
    return r;
}

static int check_running(struct gsn_store *store, int64_t run_id, struct gsn_error *err)
{
    int64_t running = 0;
    const int r = gsn_sql_int(store, "SELECT state = 'running' FROM run WHERE id = ?1",
                              SQL_ARGS(SQL_INT(run_id)), &running, err);

    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, r, "there is no run %lld", (long long)run_id);
    if (r >= 0 && !running)
        return gsn_fail(err, GSN_E_INPUT, "run %lld is finished already", (long long)run_id);
    return r;
}

static int end_run(struct gsn_store *store, int64_t run_id, const struct gsn_run_end *end,
                   int64_t now, struct gsn_error *err)
{
    return gsn_sql_run(
        store,
        "UPDATE run SET state = ?2, message = ?3, report_path = ?4, report_sha256 = ?5, "
        "json_path = ?6, json_sha256 = ?7, event_head = ?8, finished = ?9 WHERE id = ?1",
        SQL_ARGS(SQL_INT(run_id), SQL_TEXT(end->state), SQL_TEXT(end->message),
                 SQL_TEXT(end->report_path), SQL_TEXT(end->report_sha256), SQL_TEXT(end->json_path),
                 SQL_TEXT(end->json_sha256), SQL_TEXT(end->event_head), SQL_INT(now)),
        NULL, err);
}

/* Inserts one row whose first field is the run's id. */
static int insert(struct gsn_store *store, const struct gsn_sql_shape *shape, const char *sql,
                  const void *row, int64_t run_id, struct gsn_error *err)
{
    struct gsn_sql_value values[16];
    const struct gsn_sql_args args = gsn_sql_fields(shape, row, values);

    values[0] = SQL_INT(run_id);
    return gsn_sql_run(store, sql, args, NULL, err);
}

/* In a transaction. */
static int finish(struct gsn_store *store, int64_t run_id, const struct gsn_run_end *end,
                  int64_t now, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < end->measure_count; i++)
        r = insert(store, &measure_shape,
                   "INSERT INTO measure (" MEASURE_COLUMNS ") VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
                   &end->measures[i], run_id, err);
    for (size_t i = 0; r >= 0 && i < end->pose_count; i++)
        r = insert(store, &pose_shape,
                   "INSERT INTO pose (" POSE_COLUMNS ") VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, "
                   "?9, ?10, ?11, ?12, ?13, ?14)",
                   &end->poses[i], run_id, err);
    for (size_t i = 0; r >= 0 && i < end->stain_count; i++)
        r = insert(store, &stain_shape,
                   "INSERT INTO stain_batch (" STAIN_COLUMNS ") VALUES (?1, ?2, ?3, ?4, ?5, ?6, "
                   "?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15)",
                   &end->stains[i], run_id, err);
    if (r >= 0)
        r = end_run(store, run_id, end, now, err);
    if (r >= 0)
        r = gsn_audit_seal(store, run_id, now, err);
    return r == GSN_E_INPUT ? gsn_fail_at(err, "run %lld", (long long)run_id) : r;
}

int gsn_run_finish(struct gsn_store *store, int64_t run_id, const struct gsn_run_end *end,
                   int64_t now, struct gsn_error *err)
{
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = check_running(store, run_id, err);
    if (r >= 0)
        r = finish(store, run_id, end, now, err);
    return gsn_sql_end(store, r, err);
}

int gsn_run_latest(struct gsn_store *store, int64_t specimen_id, const char *state,
                   struct gsn_run_row **ret_run, struct gsn_error *err)
{
    const int r = run_row(store,
                          SELECT_RUN "WHERE specimen_id = ?1 AND ?2 IN ('', state) "
                                     "ORDER BY id DESC LIMIT 1",
                          SQL_ARGS(SQL_INT(specimen_id), SQL_TEXT(state)), ret_run, err);

    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, r, "specimen %lld has no %s run yet: `gieson run` makes one",
                        (long long)specimen_id, state && state[0] ? state : "finished");
    return r;
}

int gsn_run_get(struct gsn_store *store, int64_t id, struct gsn_run_row **ret_run,
                struct gsn_error *err)
{
    const int r = run_row(store, SELECT_RUN "WHERE id = ?1", SQL_ARGS(SQL_INT(id)), ret_run, err);

    return r == GSN_E_NOTFOUND ? gsn_fail(err, r, "there is no run %lld", (long long)id) : r;
}

int gsn_run_list(struct gsn_store *store, int64_t specimen_id, struct gsn_run_rows **ret_rows,
                 struct gsn_error *err)
{
    return run_rows(store, SELECT_RUN "WHERE ?1 IN (0, specimen_id) ORDER BY id",
                    SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

int gsn_measure_list(struct gsn_store *store, int64_t run_id, struct gsn_measure_rows **ret_rows,
                     struct gsn_error *err)
{
    return measure_rows(store,
                        "SELECT " MEASURE_COLUMNS " FROM measure WHERE run_id = ?1 ORDER BY id",
                        SQL_ARGS(SQL_INT(run_id)), ret_rows, err);
}

int gsn_pose_list(struct gsn_store *store, int64_t run_id, struct gsn_pose_rows **ret_rows,
                  struct gsn_error *err)
{
    return pose_rows(store, "SELECT " POSE_COLUMNS " FROM pose WHERE run_id = ?1 ORDER BY id",
                     SQL_ARGS(SQL_INT(run_id)), ret_rows, err);
}

int gsn_stain_list(struct gsn_store *store, int64_t run_id, struct gsn_stain_rows **ret_rows,
                   struct gsn_error *err)
{
    return stain_rows(store,
                      "SELECT " STAIN_COLUMNS " FROM stain_batch WHERE run_id = ?1 ORDER BY id",
                      SQL_ARGS(SQL_INT(run_id)), ret_rows, err);
}
