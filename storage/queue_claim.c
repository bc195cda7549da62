/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/queue_parts.h"

#include <assert.h>
#include <stdbool.h>
#include <time.h>

#include "storage/lease.h"
#include "storage/queue_order.h"
#include "storage/sql.h"
#include "storage/within.h"

int64_t gsn_queue_clock(void)
{
    struct timespec now;

    /* CLOCK_BOOTTIME is there on every Linux that this is built for. */
    return clock_gettime(CLOCK_BOOTTIME, &now) == 0 ? (int64_t)now.tv_sec : 0;
}

struct lease {
    int64_t job, pid, pid_start, lease_s, lease_until;
    const char *boot, *processes;
};

#define LEASE(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct lease, name)                                               \
    }
static const struct gsn_sql_field lease_fields[] = {
    LEASE(INT, job),         LEASE(INT, pid),   LEASE(INT, pid_start),  LEASE(INT, lease_s),
    LEASE(INT, lease_until), LEASE(TEXT, boot), LEASE(TEXT, processes),
};
#undef LEASE
static const struct gsn_sql_shape lease_shape = SQL_SHAPE(struct lease, lease_fields);

/* Its worker went down with the machine, which says nothing against the job: back to waiting. */
static int revive(struct gsn_store *store, int64_t job, struct gsn_error *err)
{
    return gsn_sql_run(store, "UPDATE job SET " GSN_QUEUE_FRESH "WHERE id = ?1",
                       SQL_ARGS(SQL_INT(job)), NULL, err);
}

/* Back to waiting, with one death more; the last death fails it. */
static int bury(struct gsn_store *store, int64_t job, struct gsn_error *err)
{
    int r = gsn_sql_run(store,
                        "UPDATE job SET attempts = attempts + 1, " GSN_QUEUE_FRESH "WHERE id = ?1",
                        SQL_ARGS(SQL_INT(job)), NULL, err);

    if (r < 0)
        return r;
    return gsn_sql_run(
        store,
        "UPDATE job SET state = 'failed', code = ?3, "
        "message = format('the worker died %d times', attempts) "
        "WHERE id = ?1 AND attempts >= ?2",
        SQL_ARGS(SQL_INT(job), SQL_INT(GSN_QUEUE_DEATHS), SQL_TEXT(gsn_code_name(GSN_E_PROCESS))),
        NULL, err);
}

/* One that ends later than a whole lease from now was counted by the clock of another start. */
static bool is_of_other_start(const struct gsn_lease_home *here, const struct lease *lease,
                              int64_t now)
{
    return gsn_lease_is_of_other_start(here, lease->boot) ||
           lease->lease_until - now > lease->lease_s;
}

static int take_back(struct gsn_store *store, const struct gsn_lease_home *here, int64_t now,
                     struct gsn_error *err)
{
    struct lease *leases = NULL;
    void *rows = NULL;
    size_t count = 0;
    int r =
        gsn_sql_rows(store, &lease_shape,
                     "SELECT id, pid, pid_start, lease_s, lease_until, boot, processes FROM job "
                     "WHERE state = 'running' ORDER BY id",
                     SQL_NO_ARGS, &rows, &count, err);

    leases = rows;
    for (size_t i = 0; r >= 0 && i < count; i++) {
        const struct lease *const l = &leases[i];

        if (is_of_other_start(here, l, now))
            r = revive(store, l->job, err);
        else if (l->lease_until <= now ||
                 gsn_lease_is_dead(here, l->boot, l->processes, l->pid, l->pid_start))
            r = bury(store, l->job, err);
    }
    gsn_sql_free_rows(&lease_shape, rows, count);
    return r;
}

#define NODE(name)                                                                                 \
    {                                                                                              \
        GSN_SQL_INT, offsetof(struct gsn_queue_node, name)                                         \
    }
static const struct gsn_sql_field node_fields[] = {
    NODE(specimen_id), NODE(group_id), NODE(ready_job), NODE(base_specimen), NODE(base_group),
};
#undef NODE
static const struct gsn_sql_shape node_shape = SQL_SHAPE(struct gsn_queue_node, node_fields);

/* A specimen job is the only one left when it is one of one. */
static int pick_specimen_job(struct gsn_store *store, int64_t *ret_job, struct gsn_error *err)
{
    void *nodes = NULL;
    size_t count = 0;
    int r =
        gsn_sql_rows(store, &node_shape,
                     "SELECT s.id, s.group_id, iif(count(*) = 1 AND max(j.kind) = 'specimen' AND "
                     "max(j.state) = 'waiting', max(j.id), 0), coalesce(b.id, 0), "
                     "iif(b.id IS NULL AND s.baseline <> '', coalesce(g.id, 0), 0) FROM job j JOIN "
                     "specimen s ON s.id = j.specimen_id "
                     "LEFT JOIN specimen b ON b.name = s.baseline "
                     "LEFT JOIN study_group g ON g.study_id = s.study_id AND g.name = s.baseline "
                     "WHERE j.state IN ('waiting', 'running') GROUP BY s.id ORDER BY s.id",
                     SQL_NO_ARGS, &nodes, &count, err);

    if (r >= 0)
        r = gsn_queue_next_specimen_job(nodes, count, ret_job, err);
    gsn_sql_free_rows(&node_shape, nodes, count);
    return r;
}

/* ret_job is 0 when none may go. */
static int pick(struct gsn_store *store, int64_t *ret_job, struct gsn_error *err)
{
    const int r = gsn_sql_int(store,
                              "SELECT coalesce(min(id), 0) FROM job "
                              "WHERE state = 'waiting' AND kind = 'panel'",
                              SQL_NO_ARGS, ret_job, err);

    return r >= 0 && *ret_job == 0 ? pick_specimen_job(store, ret_job, err) : r;
}

struct claimant {
    const char *owner;
    int64_t pid, lease_s, now;
};

static int take(struct gsn_store *store, const struct gsn_lease_home *here,
                const struct claimant *who, int64_t job, struct gsn_job_row **ret_job,
                struct gsn_error *err)
{
    const int r = gsn_sql_run(
        store,
        "UPDATE job SET " GSN_QUEUE_FRESH ", state = 'running', claim = claim + 1, owner = ?2, "
        "boot = ?3, processes = ?4, pid = ?5, pid_start = ?6, lease_s = ?7, "
        "lease_until = ?8 WHERE id = ?1",
        SQL_ARGS(SQL_INT(job), SQL_TEXT(who->owner), SQL_TEXT(here->boot),
                 SQL_TEXT(here->processes), SQL_INT(who->pid), SQL_INT(gsn_lease_start(who->pid)),
                 SQL_INT(who->lease_s), SQL_INT(who->now + who->lease_s)),
        NULL, err);

    if (r < 0)
        return r;
    return gsn_queue_job(store, job, ret_job, err);
}

/* In a transaction. ret_job stays NULL when none may go: what was taken back must be kept. */
static int claim(struct gsn_store *store, const struct claimant *who, struct gsn_job_row **ret_job,
                 struct gsn_error *err)
{
    const struct gsn_lease_home here = gsn_lease_home();
    int64_t job = 0;
    int r = take_back(store, &here, who->now, err);

    if (r >= 0)
        r = pick(store, &job, err);
    return r >= 0 && job ? take(store, &here, who, job, ret_job, err) : r;
}

static int say_why_none(struct gsn_store *store, struct gsn_error *err)
{
    struct gsn_job_counts counts;
    const int r = gsn_queue_counts(store, &counts, err);

    if (r < 0)
        return r;
    if (counts.waiting == 0 && counts.running == 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "the queue is empty");
    if (counts.waiting == 0)
        return gsn_fail(err, GSN_E_BUSY, "only running jobs: %lld", (long long)counts.running);
    return gsn_fail(err, GSN_E_BUSY, "nothing to claim: %lld waiting for %lld running",
                    (long long)counts.waiting, (long long)counts.running);
}

int gsn_queue_claim(struct gsn_store *store, const char *owner, pid_t pid, int64_t lease_s,
                    int64_t now, struct gsn_job_row **ret_job, struct gsn_error *err)
{
    const struct claimant who = { owner, pid, lease_s, now };
    gsn_auto(gsn_job_row) job = NULL;
    int r;

    assert(lease_s > 0);
    r = gsn_store_begin(store, err);
    if (r < 0)
        return r;
    r = gsn_sql_end(store, claim(store, &who, &job, err), err);
    if (r < 0)
        return r;
    if (!job)
        return say_why_none(store, err);
    *ret_job = gsn_steal(&job);
    return GSN_OK;
}
