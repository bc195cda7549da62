/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/queue.h"

#include "storage/lease.h"
#include "storage/queue_parts.h"
#include "storage/sql.h"
#include "storage/within.h"

#define JOB(type, name)                                                                            \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_job_row, name)                                         \
    }
static const struct gsn_sql_field job_fields[] = {
    JOB(INT, id),          JOB(TEXT, kind),    JOB(INT, specimen_id), JOB(INT, panel_id),
    JOB(TEXT, specimen),   JOB(TEXT, panel),   JOB(TEXT, state),      JOB(INT, again),
    JOB(INT, attempts),    JOB(INT, claim),    JOB(TEXT, owner),      JOB(INT, pid),
    JOB(INT, lease_until), JOB(TEXT, stage),   JOB(INT, done),        JOB(INT, total),
    JOB(REAL, eta_s),      JOB(TEXT, message), JOB(TEXT, code),
};
#undef JOB

#define SELECT_JOB                                                                                 \
    "SELECT j.id, j.kind, j.specimen_id, coalesce(j.panel_id, 0), s.name, "                        \
    "coalesce(p.file_name, ''), j.state, j.again, j.attempts, j.claim, j.owner, j.pid, "           \
    "j.lease_until, j.stage, j.done, j.total, j.eta_s, j.message, j.code "                         \
    "FROM job j JOIN specimen s ON s.id = j.specimen_id LEFT JOIN panel p ON p.id = j.panel_id "

static const struct gsn_sql_shape job_shape = SQL_SHAPE(struct gsn_job_row, job_fields);

SQL_DEFINE_ROW(job);
SQL_DEFINE_ROWS(job);

int gsn_queue_job(struct gsn_store *store, int64_t id, struct gsn_job_row **ret_job,
                  struct gsn_error *err)
{
    return job_row(store, SELECT_JOB "WHERE j.id = ?1", SQL_ARGS(SQL_INT(id)), ret_job, err);
}

static int check_panel(struct gsn_store *store, int64_t specimen_id, int64_t panel_id,
                       struct gsn_error *err)
{
    int64_t id = 0;
    const int r = gsn_sql_int(store,
                              "SELECT 1 FROM specimen s WHERE s.id = ?1 AND (?2 = 0 OR EXISTS "
                              "(SELECT 1 FROM panel WHERE id = ?2 AND specimen_id = s.id))",
                              SQL_ARGS(SQL_INT(specimen_id), SQL_INT(panel_id)), &id, err);

    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, GSN_E_INPUT, "there is no panel %lld of specimen %lld to work on",
                        (long long)panel_id, (long long)specimen_id);
    return r;
}

#define THIS_JOB "WHERE kind = ?3 AND specimen_id = ?1 AND coalesce(panel_id, 0) = ?2 "

/* The job is there: one that runs is done again, one that ended waits anew. */
static int wake(struct gsn_store *store, const struct gsn_sql_args job, int64_t *ret_id,
                struct gsn_error *err)
{
    int r = gsn_sql_run(store, "UPDATE job SET again = 1 " THIS_JOB "AND state = 'running'", job,
                        NULL, err);

    if (r >= 0)
        r = gsn_sql_run(store,
                        "UPDATE job SET attempts = 0, " GSN_QUEUE_FRESH THIS_JOB
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
        return wake(store, job, ret_id, err);
    if (r >= 0)
        *ret_id = gsn_sql_last_id(store);
    return r;
}

/* In a transaction. */
static int add(struct gsn_store *store, int64_t specimen_id, int64_t panel_id, int64_t *ret_id,
               struct gsn_error *err)
{
    const int r = check_panel(store, specimen_id, panel_id, err);

    return r >= 0 ? gsn_queue_ask(store, specimen_id, panel_id, ret_id, err) : r;
}

int gsn_queue_add(struct gsn_store *store, int64_t specimen_id, int64_t panel_id, int64_t *ret_id,
                  struct gsn_error *err)
{
    int64_t id = 0;
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_sql_end(store, add(store, specimen_id, panel_id, &id, err), err);
    if (r >= 0)
        *ret_id = id;
    return r;
}

int gsn_queue_add_first(struct gsn_store *store, int64_t specimen_id, struct gsn_error *err)
{
    return gsn_sql_run(store,
                       "INSERT INTO job (kind, specimen_id) VALUES ('specimen', ?1) "
                       "ON CONFLICT DO NOTHING",
                       SQL_ARGS(SQL_INT(specimen_id)), NULL, err);
}

/* The statement's last words: only while the job is this claim's. */
#define IF_MINE "WHERE id = ?1 AND claim = ?2 AND state = 'running'"

static int change_mine(struct gsn_store *store, const struct gsn_job_row *job, const char *sql,
                       struct gsn_sql_args args, struct gsn_error *err)
{
    int64_t changed = 0;
    const int r = gsn_sql_run(store, sql, args, &changed, err);

    if (r >= 0 && changed == 0)
        return gsn_fail(err, GSN_E_BUSY, "job %lld is no longer %.100s's: its lease ran out",
                        (long long)job->id, job->owner);
    return r;
}

int gsn_queue_progress(struct gsn_store *store, const struct gsn_job_row *job, const char *stage,
                       int64_t done, int64_t total, double eta_s, int64_t now,
                       struct gsn_error *err)
{
    return change_mine(store, job,
                       "UPDATE job SET stage = ?3, done = ?4, total = ?5, eta_s = ?6, "
                       "lease_until = ?7 + lease_s " IF_MINE,
                       SQL_ARGS(SQL_INT(job->id), SQL_INT(job->claim), SQL_TEXT(stage),
                                SQL_INT(done), SQL_INT(total), SQL_REAL(eta_s), SQL_INT(now)),
                       err);
}

/* In a transaction. */
static int end_job(struct gsn_store *store, const struct gsn_job_row *job, const char *state,
                   const char *code, const char *message, struct gsn_error *err)
{
    int r = change_mine(store, job,
                        "UPDATE job SET state = ?3, code = ?4, message = ?5, attempts = 0, "
                        "pid = 0, pid_start = 0, lease_until = 0, eta_s = NULL " IF_MINE,
                        SQL_ARGS(SQL_INT(job->id), SQL_INT(job->claim), SQL_TEXT(state),
                                 SQL_TEXT(code), SQL_TEXT(message)),
                        err);

    if (r < 0)
        return r;
    return gsn_sql_run(store, "UPDATE job SET " GSN_QUEUE_FRESH "WHERE id = ?1 AND again = 1",
                       SQL_ARGS(SQL_INT(job->id)), NULL, err);
}

int gsn_queue_done(struct gsn_store *store, const struct gsn_job_row *job, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, end_job(store, job, "done", "", "", err), err);
}

int gsn_queue_fail(struct gsn_store *store, const struct gsn_job_row *job, int code,
                   const char *message, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    return gsn_sql_end(store, end_job(store, job, "failed", gsn_code_name(code), message, err),
                       err);
}

int gsn_queue_release(struct gsn_store *store, const struct gsn_job_row *job, struct gsn_error *err)
{
    return change_mine(store, job, "UPDATE job SET " GSN_QUEUE_FRESH IF_MINE,
                       SQL_ARGS(SQL_INT(job->id), SQL_INT(job->claim)), err);
}

int gsn_queue_of_process(struct gsn_store *store, pid_t pid, struct gsn_job_row **ret_job,
                         struct gsn_error *err)
{
    const struct gsn_lease_home here = gsn_lease_home();
    const int r = job_row(store,
                          SELECT_JOB "WHERE j.state = 'running' AND j.pid = ?1 AND j.boot = ?2 AND "
                                     "j.processes = ?3",
                          SQL_ARGS(SQL_INT(pid), SQL_TEXT(here.boot), SQL_TEXT(here.processes)),
                          ret_job, err);

    return r == GSN_E_NOTFOUND ? gsn_fail(err, r, "process %ld has no job", (long)pid) : r;
}

int gsn_queue_retry(struct gsn_store *store, int64_t specimen_id, size_t *ret_count,
                    struct gsn_error *err)
{
    int64_t changed = 0;
    const int r = gsn_sql_run(store,
                              "UPDATE job SET attempts = 0, " GSN_QUEUE_FRESH
                              "WHERE state = 'failed' AND ?1 IN (0, specimen_id)",
                              SQL_ARGS(SQL_INT(specimen_id)), &changed, err);

    if (r >= 0)
        *ret_count = (size_t)changed;
    return r;
}

int gsn_queue_list(struct gsn_store *store, struct gsn_job_rows **ret_rows, struct gsn_error *err)
{
    return job_rows(store, SELECT_JOB "ORDER BY j.id", SQL_NO_ARGS, ret_rows, err);
}

#define COUNT(name)                                                                                \
    {                                                                                              \
        GSN_SQL_INT, offsetof(struct gsn_job_counts, name)                                         \
    }
static const struct gsn_sql_field count_fields[] = {
    COUNT(waiting),
    COUNT(running),
    COUNT(done),
    COUNT(failed),
};
#undef COUNT
static const struct gsn_sql_shape count_shape = SQL_SHAPE(struct gsn_job_counts, count_fields);

int gsn_queue_counts(struct gsn_store *store, struct gsn_job_counts *ret_counts,
                     struct gsn_error *err)
{
    void *row = NULL;
    const int r = gsn_sql_row(store, &count_shape,
                              "SELECT count(*) FILTER (WHERE state = 'waiting'), "
                              "count(*) FILTER (WHERE state = 'running'), "
                              "count(*) FILTER (WHERE state = 'done'), "
                              "count(*) FILTER (WHERE state = 'failed') FROM job",
                              SQL_NO_ARGS, &row, err);

    if (r < 0)
        return r;
    *ret_counts = *(const struct gsn_job_counts *)row;
    gsn_sql_free_rows(&count_shape, row, 1);
    return GSN_OK;
}
