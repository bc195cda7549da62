/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/overview.h"

#include "storage/sql.h"

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
