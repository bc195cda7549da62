/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Runs with their measures, poses and stain batches; and the overview of the store.
 *
 * A run begins as a row with its key and inputs and ends in one transaction with all its rows and
 * its seal (audit.h); rows of a finished run never change. The overview is counted by the database,
 * one row per specimen and one per panel that waits for something, so that it stays quick with
 * thousands of panels.
 *
 * How it fails: a run that has ended does not end again (GSN_E_INPUT); NaN is NULL in the database.
 */
#include "storage/result.h"

#include "storage/audit.h"
#include "storage/catalog.h"
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

/* Runs. */

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
static int insert_row(struct gsn_store *store, const struct gsn_sql_shape *shape, const char *sql,
                      const void *row, int64_t run_id, struct gsn_error *err)
{
    struct gsn_sql_value values[16];
    const struct gsn_sql_args args = gsn_sql_fields(shape, row, values);

    values[0] = SQL_INT(run_id);
    return gsn_sql_run(store, sql, args, NULL, err);
}

/* In a transaction. */
static int finish_run(struct gsn_store *store, int64_t run_id, const struct gsn_run_end *end,
                      int64_t now, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < end->measure_count; i++)
        r = insert_row(store, &measure_shape,
                       "INSERT INTO measure (" MEASURE_COLUMNS ") VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
                       &end->measures[i], run_id, err);
    for (size_t i = 0; r >= 0 && i < end->pose_count; i++)
        r = insert_row(store, &pose_shape,
                       "INSERT INTO pose (" POSE_COLUMNS
                       ") VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, "
                       "?9, ?10, ?11, ?12, ?13, ?14)",
                       &end->poses[i], run_id, err);
    for (size_t i = 0; r >= 0 && i < end->stain_count; i++)
        r = insert_row(store, &stain_shape,
                       "INSERT INTO stain_batch (" STAIN_COLUMNS
                       ") VALUES (?1, ?2, ?3, ?4, ?5, ?6, "
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
        r = finish_run(store, run_id, end, now, err);
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

int gsn_run_latest_report(struct gsn_store *store, const char *specimen_name,
                          struct gsn_run_row **ret_run, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) specimen = NULL;
    gsn_auto(gsn_run_rows) runs = NULL;
    int64_t latest = 0;
    int r = gsn_specimen_get(store, specimen_name, &specimen, err);

    if (r >= 0)
        r = gsn_run_list(store, specimen->id, &runs, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < runs->count; i++)
        if (runs->at[i].json_path[0])
            latest = runs->at[i].id;
    if (!latest)
        return gsn_fail(err, GSN_E_NOTFOUND, "%s has no report yet: `gieson run` does the jobs",
                        specimen_name);
    return gsn_run_get(store, latest, ret_run, err);
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

#define FIELD(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_overview_row, name)                                    \
    }
static const struct gsn_sql_field overview_fields[] = {
    FIELD(INT, id),           FIELD(TEXT, name),
    FIELD(TEXT, group),       FIELD(INT, panels),
    FIELD(INT, registered),   FIELD(INT, refused),
    FIELD(INT, sections),     FIELD(INT, found),
    FIELD(INT, run),          FIELD(TEXT, run_state),
    FIELD(TEXT, run_message), FIELD(TEXT, report_path),
    FIELD(REAL, loss),        FIELD(REAL, loss_lower),
    FIELD(REAL, loss_upper),  FIELD(REAL, mean_density),
    FIELD(INT, changed),      FIELD(TEXT, job.state),
    FIELD(TEXT, job.stage),   FIELD(INT, job.done),
    FIELD(INT, job.total),    FIELD(REAL, job.eta_s),
    FIELD(TEXT, job.message),
};

#undef FIELD
static const struct gsn_sql_shape overview_shape =
    SQL_SHAPE(struct gsn_overview_row, overview_fields);

#define FIELD(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_open_panel_row, name)                                  \
    }
static const struct gsn_sql_field open_panel_fields[] = {
    FIELD(INT, id),         FIELD(INT, specimen_id),  FIELD(INT, number),   FIELD(TEXT, file_name),
    FIELD(TEXT, state),     FIELD(TEXT, message),     FIELD(INT, arrived),  FIELD(INT, scan),
    FIELD(TEXT, job.state), FIELD(TEXT, job.stage),   FIELD(INT, job.done), FIELD(INT, job.total),
    FIELD(REAL, job.eta_s), FIELD(TEXT, job.message),
};

#undef FIELD
static const struct gsn_sql_shape open_panel_shape =
    SQL_SHAPE(struct gsn_open_panel_row, open_panel_fields);

#define FIELD(name)                                                                                \
    {                                                                                              \
        GSN_SQL_INT, offsetof(struct gsn_doubt_row, name)                                          \
    }
static const struct gsn_sql_field doubt_fields[] = { FIELD(specimen_id), FIELD(panel), FIELD(slot),
                                                     FIELD(serial), FIELD(candidates) };

#undef FIELD
static const struct gsn_sql_shape doubt_shape = SQL_SHAPE(struct gsn_doubt_row, doubt_fields);

SQL_DEFINE_ROWS(doubt);
SQL_DEFINE_ROWS(overview);
SQL_DEFINE_ROWS(open_panel);

/* When each panel came: by the ledger, or by the audit log for one that was imported by hand. The
 * audit log grows for ever and has no index for this; its end tells of what is recent. */
#define ARRIVAL                                                                                    \
    "WITH told AS MATERIALIZED (SELECT text AS sha256, time FROM event WHERE kind = 'panel' AND "  \
    "id > (SELECT coalesce(max(id), 0) FROM event) - 20000), "                                     \
    "arrival AS MATERIALIZED (SELECT panel_id, max(at) AS at, max(scan) AS scan FROM ("            \
    "SELECT panel_id, arrived AS at, id AS scan FROM scan WHERE panel_id IS NOT NULL "             \
    "UNION ALL SELECT p.id, t.time, 0 FROM panel p JOIN told t ON t.sha256 = p.sha256) "           \
    "GROUP BY panel_id) "

#define JOB                                                                                        \
    "coalesce(j.state, ''), coalesce(j.stage, ''), coalesce(j.done, 0), coalesce(j.total, 0), "    \
    "j.eta_s, coalesce(j.message, '') "

/* The overview. */

int gsn_overview_list(struct gsn_store *store, struct gsn_overview_rows **ret_rows,
                      struct gsn_error *err)
{
    return overview_rows(
        store,
        ARRIVAL
        ", p AS MATERIALIZED (SELECT specimen_id, sum(code <> 'spare') AS n, sum(state = "
        "'registered') "
        "AS registered, sum(state IN ('refused', 'held') AND code <> 'spare') AS refused, "
        "max(a.at) AS at "
        "FROM panel LEFT JOIN arrival a ON a.panel_id = panel.id GROUP BY specimen_id), "
        "c AS MATERIALIZED (SELECT panel.specimen_id, sum(section.state <> 'empty') AS n, "
        "sum(section.state = 'found') AS found FROM panel JOIN section "
        "ON section.panel_id = panel.id GROUP BY panel.specimen_id) "
        "SELECT s.id, s.name, g.name, coalesce(p.n, 0), coalesce(p.registered, 0), "
        "coalesce(p.refused, 0), coalesce(c.n, 0), coalesce(c.found, 0), coalesce(r.id, 0), "
        "coalesce(r.state, ''), coalesce(r.message, ''), coalesce(r.report_path, ''), l.value, "
        "l.lower, l.upper, d.value, max(coalesce(r.finished, 0), coalesce(p.at, 0)), " JOB
        "FROM specimen s JOIN study_group g ON g.id = s.group_id "
        "LEFT JOIN p ON p.specimen_id = s.id LEFT JOIN c ON c.specimen_id = s.id "
        "LEFT JOIN run r ON r.id = (SELECT max(id) FROM run WHERE specimen_id = s.id) "
        "LEFT JOIN measure l ON l.run_id = r.id AND l.name = 'loss' "
        "LEFT JOIN measure d ON d.run_id = r.id AND d.name = 'mean_density' "
        "LEFT JOIN job j ON j.kind = 'specimen' AND j.specimen_id = s.id AND "
        "coalesce(j.panel_id, 0) = 0 AND j.state <> 'done' ORDER BY s.id",
        SQL_NO_ARGS, ret_rows, err);
}

int gsn_overview_panels(struct gsn_store *store, struct gsn_open_panel_rows **ret_rows,
                        struct gsn_error *err)
{
    return open_panel_rows(
        store,
        ARRIVAL
        "SELECT p.id, p.specimen_id, p.number, p.file_name, p.state, p.message, "
        "coalesce(a.at, 0), coalesce(a.scan, 0), " JOB
        "FROM panel p LEFT JOIN job j ON j.kind = 'panel' AND "
        "j.specimen_id = p.specimen_id AND coalesce(j.panel_id, 0) = p.id AND j.state <> 'done' "
        "LEFT JOIN arrival a ON a.panel_id = p.id "
        "WHERE j.id IS NOT NULL OR (p.state IN ('refused', 'held') AND p.code <> 'spare') "
        "ORDER BY p.specimen_id, p.number = 0, p.number, p.id",
        SQL_NO_ARGS, ret_rows, err);
}

int gsn_overview_doubts(struct gsn_store *store, struct gsn_doubt_rows **ret_rows,
                        struct gsn_error *err)
{
    return doubt_rows(
        store,
        "SELECT p.specimen_id, p.number, s.slot, s.serial, json_array_length(s.candidates) "
        "FROM section s JOIN panel p ON p.id = s.panel_id LEFT JOIN decision d ON "
        "d.specimen_id = p.specimen_id AND d.number = p.number AND d.slot = s.slot "
        "WHERE s.candidates <> '' AND p.state = 'registered' AND (d.slot IS NULL OR "
        "s.flags LIKE '%decision-void%' OR s.flags LIKE '%decided%') AND NOT EXISTS ("
        "SELECT 1 FROM json_each(s.candidates) c WHERE json_extract(c.value, '$.chosen') = 1) "
        "ORDER BY p.specimen_id, p.number, s.slot",
        SQL_NO_ARGS, ret_rows, err);
}
