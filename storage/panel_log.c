/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Panels, their sections and marks, and the jobs they ask for; and what a file's name says about
 * its panel.
 *
 * A panel's sections lie side by side in the table (id = panel * 4096 + slot,
 * schema/006_slices.sql), so that replacing them writes few pages. The number in a name is the last
 * one that is called a panel ("P03", "panel 3"), else the last number at all; the specimen's own
 * digits are skipped by the caller.
 *
 * How it fails: GSN_E_NOTFOUND for a panel that is not there. What changes several rows is a part
 * of a transaction that the caller has begun (transaction.h). */
#include "storage/panel_log.h"

#include <ctype.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>
#include <strings.h>

#include "storage/sql.h"
#include "storage/transaction.h"

enum { MOST_PANEL_NUMBER = 10000 };

/* Names of files. */

static bool ends_with_panel(const char *stem, size_t length)
{
    return length >= 5 && strncasecmp(stem + length - 5, "panel", 5) == 0;
}

/* Whether the digits at this place are called a panel: "panel 3", "Panel_3", "-P03"; not "grp2". */
static bool is_called_panel(const char *stem, size_t digits_at)
{
    size_t i = digits_at;

    while (i > 0 && strchr("-_ .", stem[i - 1]))
        i--;
    if (i < digits_at || ends_with_panel(stem, i))
        return ends_with_panel(stem, i);
    return i > 0 && (stem[i - 1] == 'P' || stem[i - 1] == 'p') &&
           (i == 1 || !isalnum((unsigned char)stem[i - 2]));
}

struct numbers {
    unsigned last, called;
};

static struct numbers read_numbers(const char *name, size_t skip)
{
    const char *const dot = strrchr(name, '.');
    const size_t length = dot && dot > name ? (size_t)(dot - name) : strlen(name);
    struct numbers found = { 0, 0 };

    for (size_t i = skip; i < length;) {
        const size_t start = i;
        unsigned value = 0;

        if (!isdigit((unsigned char)name[i])) {
            i++;
            continue;
        }
        for (; i < length && isdigit((unsigned char)name[i]); i++)
            if (value <= MOST_PANEL_NUMBER)
                value = 10 * value + (unsigned)(name[i] - '0');
        found.last = value <= MOST_PANEL_NUMBER ? value : 0;
        if (is_called_panel(name, start))
            found.called = found.last;
    }
    return found;
}

unsigned gsn_panel_number(const char *name, size_t skip)
{
    const struct numbers found = read_numbers(name, skip);

    return found.called ? found.called : found.last;
}

unsigned gsn_panel_number_called(const char *name, size_t skip)
{
    return read_numbers(name, skip).called;
}

#define PANEL(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_panel_row, name)                                       \
    }
static const struct gsn_sql_field panel_fields[] = {
    PANEL(INT, id),         PANEL(INT, specimen_id), PANEL(INT, number),   PANEL(TEXT, file_name),
    PANEL(TEXT, sha256),    PANEL(INT, size),        PANEL(TEXT, state),   PANEL(TEXT, code),
    PANEL(TEXT, message),   PANEL(INT, width),       PANEL(INT, height),   PANEL(REAL, px_um),
    PANEL(INT, turn_known), PANEL(INT, mirrored),    PANEL(INT, quarters), PANEL(TEXT, turn_note),
};

#undef PANEL

#define SELECT_PANEL                                                                               \
    "SELECT id, specimen_id, number, file_name, sha256, size, state, code, message, width, "       \
    "height, px_um, quarters IS NOT NULL, mirrored, quarters, turn_note FROM panel "

static const struct gsn_sql_shape panel_shape = SQL_SHAPE(struct gsn_panel_row, panel_fields);

SQL_DEFINE_ROW(panel);
SQL_DEFINE_ROWS(panel);

#define SECTION(type, name)                                                                        \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_section_row, name)                                     \
    }
#define MARKER(i)                                                                                  \
    SECTION(INT, marker[i].found), SECTION(REAL, marker[i].x_px), SECTION(REAL, marker[i].y_px),   \
        SECTION(REAL, marker[i].radius_px), SECTION(REAL, marker[i].cov_xx),                       \
        SECTION(REAL, marker[i].cov_xy), SECTION(REAL, marker[i].cov_yy),                          \
        SECTION(REAL, marker[i].score)
static const struct gsn_sql_field section_fields[] = {
    SECTION(INT, panel_id),
    SECTION(INT, slot),
    SECTION(INT, serial),
    SECTION(TEXT, state),
    SECTION(TEXT, flags),
    SECTION(REAL, bbox_x),
    SECTION(REAL, bbox_y),
    SECTION(REAL, bbox_w),
    SECTION(REAL, bbox_h),
    SECTION(REAL, area_px),
    MARKER(0),
    MARKER(1),
    MARKER(2),
};

#undef MARKER

#undef SECTION

static const struct gsn_sql_shape section_shape = SQL_SHAPE(struct gsn_section_row, section_fields);

SQL_DEFINE_ROWS(section);

/* Panels and sections. */

int gsn_panel_insert(struct gsn_store *store, const struct gsn_panel_row *panel, int64_t *ret_id,
                     int *ret_again, struct gsn_error *err)
{
    int64_t inserted = 0;
    int r = gsn_digest_check(panel->sha256, err);

    if (r >= 0)
        r = gsn_sql_run(
            store,
            "INSERT INTO panel (specimen_id, number, file_name, sha256, size, state, code, "
            "message, "
            "width, height, px_um) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11) "
            "ON CONFLICT (specimen_id, sha256) DO NOTHING",
            SQL_ARGS(SQL_INT(panel->specimen_id), SQL_INT(panel->number),
                     SQL_TEXT(panel->file_name), SQL_TEXT(panel->sha256), SQL_INT(panel->size),
                     SQL_TEXT(panel->state), SQL_TEXT(panel->code), SQL_TEXT(panel->message),
                     SQL_INT(panel->width), SQL_INT(panel->height), SQL_REAL(panel->px_um)),
            &inserted, err);

    if (r < 0)
        return r == GSN_E_INPUT ? gsn_fail_at(err, "panel %.200s", panel->file_name) : r;
    *ret_again = inserted == 0;
    if (inserted == 0)
        return gsn_sql_int(store, "SELECT id FROM panel WHERE specimen_id = ?1 AND sha256 = ?2",
                           SQL_ARGS(SQL_INT(panel->specimen_id), SQL_TEXT(panel->sha256)), ret_id,
                           err);
    *ret_id = gsn_sql_last_id(store);
    return GSN_OK;
}

static int no_panel(int64_t id, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "there is no panel of number %lld", (long long)id);
}

int gsn_panel_get(struct gsn_store *store, int64_t id, struct gsn_panel_row **ret_panel,
                  struct gsn_error *err)
{
    const int r =
        panel_row(store, SELECT_PANEL "WHERE id = ?1", SQL_ARGS(SQL_INT(id)), ret_panel, err);

    return r == GSN_E_NOTFOUND ? no_panel(id, err) : r;
}

int gsn_panel_list(struct gsn_store *store, int64_t specimen_id, struct gsn_panel_rows **ret_rows,
                   struct gsn_error *err)
{
    return panel_rows(store, SELECT_PANEL "WHERE specimen_id = ?1 ORDER BY number = 0, number, id",
                      SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

static int update_panel(struct gsn_store *store, int64_t id, const char *sql,
                        struct gsn_sql_args args, struct gsn_error *err)
{
    int64_t changed = 0;
    const int r = gsn_sql_run(store, sql, args, &changed, err);

    if (r < 0)
        return r;
    return changed == 0 ? no_panel(id, err) : GSN_OK;
}

int gsn_panel_set_state(struct gsn_store *store, int64_t id, const char *state, const char *code,
                        const char *message, struct gsn_error *err)
{
    return update_panel(
        store, id, "UPDATE panel SET state = ?2, code = ?3, message = ?4 WHERE id = ?1",
        SQL_ARGS(SQL_INT(id), SQL_TEXT(state), SQL_TEXT(code), SQL_TEXT(message)), err);
}

int gsn_panel_set_name(struct gsn_store *store, int64_t id, int64_t number, const char *file_name,
                       struct gsn_error *err)
{
    return update_panel(store, id, "UPDATE panel SET number = ?2, file_name = ?3 WHERE id = ?1",
                        SQL_ARGS(SQL_INT(id), SQL_INT(number), SQL_TEXT(file_name)), err);
}

int gsn_panel_set_size(struct gsn_store *store, int64_t id, int64_t width, int64_t height,
                       double px_um, struct gsn_error *err)
{
    return update_panel(
        store, id, "UPDATE panel SET width = ?2, height = ?3, px_um = ?4 WHERE id = ?1",
        SQL_ARGS(SQL_INT(id), SQL_INT(width), SQL_INT(height), SQL_REAL(px_um)), err);
}

int gsn_panel_set_turn(struct gsn_store *store, int64_t id, int64_t mirrored, int64_t quarters,
                       const char *note, struct gsn_error *err)
{
    return update_panel(
        store, id, "UPDATE panel SET mirrored = ?2, quarters = ?3, turn_note = ?4 WHERE id = ?1",
        SQL_ARGS(SQL_INT(id), SQL_INT(mirrored), SQL_INT(quarters), SQL_TEXT(note)), err);
}

static double if_found(const struct gsn_fiducial_row *marker, double value)
{
    return marker->found ? value : NAN;
}

#define MARK(m)                                                                                    \
    SQL_REAL(if_found(m, (m)->x_px)), SQL_REAL(if_found(m, (m)->y_px)),                            \
        SQL_REAL(if_found(m, (m)->radius_px)), SQL_REAL(if_found(m, (m)->cov_xx)),                 \
        SQL_REAL(if_found(m, (m)->cov_xy)), SQL_REAL(if_found(m, (m)->cov_yy)),                    \
        SQL_REAL(if_found(m, (m)->score))

#define SECTION_COLUMNS                                                                            \
    "panel_id, slot, serial, state, flags, bbox_x, bbox_y, bbox_w, bbox_h, area_px, "
#define MARK_COLUMNS(m)                                                                            \
    m "_x_px, " m "_y_px, " m "_radius_px, " m "_cov_xx, " m "_cov_xy, " m "_cov_yy, " m "_score"

static int insert_section(struct gsn_store *store, int64_t panel_id,
                          const struct gsn_section_row *section, struct gsn_error *err)
{
    const int r = gsn_sql_run(
        store,
        "INSERT INTO section (id, " SECTION_COLUMNS
            MARK_COLUMNS("mark1") ", " MARK_COLUMNS("mark2") ", " MARK_COLUMNS(
                "mark3") ") VALUES (?1 * 4096 + ?2, ?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, "
                         "?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19, "
                         "?20, ?21, ?22, ?23, ?24, ?25, ?26, "
                         "?27, ?28, ?29, ?30, ?31)",
        SQL_ARGS(SQL_INT(panel_id), SQL_INT(section->slot), SQL_INT(section->serial),
                 SQL_TEXT(section->state), SQL_TEXT(section->flags), SQL_REAL(section->bbox_x),
                 SQL_REAL(section->bbox_y), SQL_REAL(section->bbox_w), SQL_REAL(section->bbox_h),
                 SQL_REAL(section->area_px), MARK(&section->marker[0]), MARK(&section->marker[1]),
                 MARK(&section->marker[2])),
        NULL, err);

    return r == GSN_E_INPUT ? gsn_fail_at(err, "panel %lld, slot %lld", (long long)panel_id,
                                          (long long)section->slot)
                            : r;
}

#undef MARK

int gsn_section_insert_all(struct gsn_store *store, int64_t panel_id,
                           const struct gsn_section_row *sections, size_t count,
                           struct gsn_error *err)
{
    int64_t known = 0;
    int r = gsn_sql_int(store, "SELECT id FROM panel WHERE id = ?1", SQL_ARGS(SQL_INT(panel_id)),
                        &known, err);

    if (r == GSN_E_NOTFOUND)
        r = no_panel(panel_id, err);
    if (r >= 0)
        r = gsn_sql_run(store, "DELETE FROM section WHERE " SECTIONS_OF("?1"),
                        SQL_ARGS(SQL_INT(panel_id)), NULL, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = insert_section(store, panel_id, &sections[i], err);
    return r;
}

/* That it has a place tells that it was found. */
#define FOUND_MARK(m) m "_x_px IS NOT NULL, " MARK_COLUMNS(m)

int gsn_section_list(struct gsn_store *store, int64_t specimen_id,
                     struct gsn_section_rows **ret_rows, struct gsn_error *err)
{
    return section_rows(
        store,
        "SELECT " SECTION_COLUMNS FOUND_MARK("mark1") ", " FOUND_MARK("mark2") ", " FOUND_MARK(
            "mark3") " FROM (SELECT id AS panel FROM panel WHERE specimen_id = ?1) "
                     "CROSS JOIN section ON " SECTIONS_OF(
                         "panel") "ORDER BY serial = 0, serial, panel_id, slot",
        SQL_ARGS(SQL_INT(specimen_id)), ret_rows, err);
}

/* The jobs that panels and specimens ask for. */

#define THIS_JOB "WHERE kind = ?3 AND specimen_id = ?1 AND coalesce(panel_id, 0) = ?2 "

/* The job is there: one that runs is done again, one that ended waits anew. */
static int wake_job(struct gsn_store *store, const struct gsn_sql_args job, int64_t *ret_id,
                    struct gsn_error *err)
{
    int r = gsn_sql_run(store, "UPDATE job SET again = 1 " THIS_JOB "AND state = 'running'", job,
                        NULL, err);

    if (r >= 0)
        r = gsn_sql_run(store,
                        "UPDATE job SET attempts = 0, " FRESH_JOB THIS_JOB
                        "AND state IN ('done', 'failed')",
                        job, NULL, err);
    return r >= 0 ? gsn_sql_int(store, "SELECT id FROM job " THIS_JOB, job, ret_id, err) : r;
}

int gsn_queue_ask(struct gsn_store *store, int64_t specimen_id, int64_t panel_id, int64_t *ret_id,
                  struct gsn_error *err)
{
    const struct gsn_sql_args job = SQL_ARGS(SQL_INT(specimen_id), SQL_INT(panel_id),
                                             SQL_TEXT(panel_id ? "panel" : "specimen"));
    int64_t inserted = 0;
    int r = GSN_E_NOTFOUND;

    /* A panel is asked for when it is new, a specimen with each of its panels. */
    if (panel_id == 0)
        r = gsn_sql_int(store, "SELECT id FROM job " THIS_JOB "AND state = 'waiting'", job, ret_id,
                        err);
    if (r != GSN_E_NOTFOUND)
        return r;
    r = gsn_sql_run(store,
                    "INSERT INTO job (kind, specimen_id, panel_id) VALUES (?3, ?1, nullif(?2, 0)) "
                    "ON CONFLICT DO NOTHING",
                    job, &inserted, err);
    if (r >= 0 && !inserted)
        return wake_job(store, job, ret_id, err);
    if (r >= 0)
        *ret_id = gsn_sql_last_id(store);
    return r;
}
