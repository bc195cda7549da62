/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The queue of jobs: one row per (kind, specimen, panel), claimed under a lease.
 *
 * Steps of a claim, in one transaction.
 * 1. Leases are taken back whose time is over or whose worker is dead: another boot of this
 * machine, or a process id whose start time in /proc is not the one written down. A process of
 * another namespace cannot be asked after.
 * 2. A worker that went down with the machine is no death of the job; any other is counted, and the
 * fifth gives the job up.
 * 3. The first waiting panel job by id; else the first specimen job that waits for nobody: its own
 * panels are done, and so are the specimens its baseline stands for. Specimens that wait for each
 * other in a circle (a strongly connected component, all of it ready) go by id.
 * 4. The row gets owner, process, and the time until which the lease holds; progress renews it.
 *
 * How it fails: GSN_E_NOTFOUND for an empty queue, GSN_E_BUSY while others work; a worker whose
 * lease was taken by another finds its claim number changed, and ends without a word in the rows.
 */
#include "storage/queue.h"

#include <assert.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "storage/sql.h"
#include "storage/transaction.h"

/* Whose process ids they are. */
struct lease_home {
    char boot[GSN_QUEUE_BOOT_SIZE]; /* of the kernel; empty: unknown, and then nothing is ever known
                                       dead */
    char processes[40];             /* the process-id namespace */
};

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

/* The job of that number; GSN_E_NOTFOUND. returns: an owned row. */
static int get_job(struct gsn_store *store, int64_t id, struct gsn_job_row **ret_job,
                   struct gsn_error *err)
{
    return job_row(store, SELECT_JOB "WHERE j.id = ?1", SQL_ARGS(SQL_INT(id)), ret_job, err);
}

/* Leases. */

/* A file of /proc, which has no size of its own, cut at size - 1 bytes; empty when unreadable. */
static void read_proc(const char *path, char *text, size_t size)
{
    ssize_t got = 0;
    int fd;

    if (gsn_file_open(path, &fd, NULL) >= 0) {
        got = read(fd, text, size - 1);
        (void)close(fd);
    }
    text[got > 0 ? got : 0] = '\0';
}

void gsn_queue_boot(char ret_boot[GSN_QUEUE_BOOT_SIZE])
{
    read_proc("/proc/sys/kernel/random/boot_id", ret_boot, GSN_QUEUE_BOOT_SIZE);
    ret_boot[strcspn(ret_boot, "\n")] = '\0';
}

/* Of the calling process. */
static struct lease_home lease_home(void)
{
    struct lease_home home = { "", "" };
    const ssize_t length = readlink("/proc/self/ns/pid", home.processes, sizeof home.processes - 1);

    gsn_queue_boot(home.boot);
    if (length <= 0)
        home.boot[0] = '\0';
    return home;
}

static int64_t parse_digits(const char *text)
{
    int64_t value = 0;

    for (; *text >= '0' && *text <= '9' && value < INT64_MAX / 10 - 1; text++)
        value = 10 * value + (*text - '0');
    return value;
}

/* proc(5): "pid (name) state ppid ...", the start time being field 22. The name may hold anything,
 * blanks and brackets too, so counting starts behind the last bracket. */
static int64_t parse_start(const char *stat)
{
    enum { STATE = 3, START = 22 };
    const char *at = strrchr(stat, ')');

    if (!at || at[1] != ' ' || at[2] == 'Z' || at[2] == 'X')
        return 0;
    for (int field = STATE - 1; at && field < START; field++)
        at = strchr(at + 1, ' ');
    return at ? parse_digits(at + 1) : 0;
}

/* When the process began, in clock ticks since boot; 0: there is none, or it has died and only
 * waits to be reaped. */
static int64_t process_start(int64_t pid)
{
    char path[64], stat[1024];

    (void)snprintf(path, sizeof path, "/proc/%lld/stat", (long long)pid);
    read_proc(path, stat, sizeof stat);
    return parse_start(stat);
}

/* Taken before this machine was started last: a power cut or a reboot ended whoever held it. */
static bool is_of_other_boot(const struct lease_home *here, const char *boot)
{
    return *here->boot && *boot && strcmp(here->boot, boot) != 0;
}

/* Surely gone: a store in WAL mode is never shared between machines, so another boot means that
 * this machine was restarted. A process of another namespace cannot be asked after. start 0: it was
 * not known when the lease was taken, and nothing is known now. */
static bool is_lease_dead(const struct lease_home *here, const char *boot, const char *processes,
                          int64_t pid, int64_t start)
{
    if (is_of_other_boot(here, boot))
        return true;
    if (!*here->boot || !*boot)
        return false;
    if (start == 0 || strcmp(here->processes, processes) != 0)
        return false;
    return process_start(pid) != start;
}

/* The order of specimen jobs. */

static bool is_waiting_for(const struct gsn_queue_node *a, const struct gsn_queue_node *b)
{
    if (a == b)
        return false;
    return (a->base_specimen && a->base_specimen == b->specimen_id) ||
           (a->base_group && a->base_group == b->group_id);
}

struct walk {
    const struct gsn_queue_node *nodes;
    size_t count;
    size_t *stack;
    bool *ahead, *behind; /* whom the start waits for, through others too; who waits for it */
};

/* Marks in seen what is reached from start. Returns false as soon as it meets a node that is not
 * ready. */
static bool reach_from(const struct walk *walk, size_t start, bool forward, bool *seen)
{
    size_t depth = 0;

    memset(seen, 0, walk->count * sizeof *seen);
    walk->stack[depth++] = start;
    while (depth > 0) {
        const struct gsn_queue_node *const at = &walk->nodes[walk->stack[--depth]];

        for (size_t i = 0; i < walk->count; i++) {
            const struct gsn_queue_node *const next = &walk->nodes[i];

            if (seen[i] || i == start ||
                !(forward ? is_waiting_for(at, next) : is_waiting_for(next, at)))
                continue;
            if (forward && !next->ready_job)
                return false;
            seen[i] = true;
            walk->stack[depth++] = i;
        }
    }
    return true;
}

static bool may_go(const struct walk *walk, size_t start)
{
    if (!walk->nodes[start].ready_job || !reach_from(walk, start, true, walk->ahead))
        return false;
    (void)reach_from(walk, start, false, walk->behind);
    for (size_t i = 0; i < walk->count; i++) {
        if (walk->ahead[i] && !walk->behind[i])
            return false;
    }
    return true;
}

int gsn_queue_next_specimen_job(const struct gsn_queue_node *nodes, size_t count, int64_t *ret_job,
                                struct gsn_error *err)
{
    gsn_auto_mem(size_t) stack = gsn_alloc_array(count, sizeof *stack);
    gsn_auto_mem(bool) seen = gsn_alloc_array(count, 2 * sizeof *seen);
    const struct walk walk = { nodes, count, stack, seen, seen ? seen + count : NULL };
    int64_t job = 0;

    if (!stack || !seen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a queue of %zu specimens", count);
    for (size_t i = 0; i < count; i++) {
        if ((!job || nodes[i].ready_job < job) && may_go(&walk, i))
            job = nodes[i].ready_job;
    }
    *ret_job = job;
    return GSN_OK;
}

/* Claiming. */

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
static int return_job(struct gsn_store *store, int64_t job, struct gsn_error *err)
{
    return gsn_sql_run(store, "UPDATE job SET " FRESH_JOB "WHERE id = ?1", SQL_ARGS(SQL_INT(job)),
                       NULL, err);
}

/* Back to waiting, with one death more; the last death fails it. */
static int count_death(struct gsn_store *store, int64_t job, struct gsn_error *err)
{
    int r = gsn_sql_run(store, "UPDATE job SET attempts = attempts + 1, " FRESH_JOB "WHERE id = ?1",
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
static bool is_of_other_start(const struct lease_home *here, const struct lease *lease, int64_t now)
{
    return is_of_other_boot(here, lease->boot) || lease->lease_until - now > lease->lease_s;
}

static int take_back_leases(struct gsn_store *store, const struct lease_home *here, int64_t now,
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
            r = return_job(store, l->job, err);
        else if (l->lease_until <= now ||
                 is_lease_dead(here, l->boot, l->processes, l->pid, l->pid_start))
            r = count_death(store, l->job, err);
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
static int pick_job(struct gsn_store *store, int64_t *ret_job, struct gsn_error *err)
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

static int take_job(struct gsn_store *store, const struct lease_home *here,
                    const struct claimant *who, int64_t job, struct gsn_job_row **ret_job,
                    struct gsn_error *err)
{
    const int r = gsn_sql_run(
        store,
        "UPDATE job SET " FRESH_JOB ", state = 'running', claim = claim + 1, owner = ?2, "
        "boot = ?3, processes = ?4, pid = ?5, pid_start = ?6, lease_s = ?7, "
        "lease_until = ?8 WHERE id = ?1",
        SQL_ARGS(SQL_INT(job), SQL_TEXT(who->owner), SQL_TEXT(here->boot),
                 SQL_TEXT(here->processes), SQL_INT(who->pid), SQL_INT(process_start(who->pid)),
                 SQL_INT(who->lease_s), SQL_INT(who->now + who->lease_s)),
        NULL, err);

    if (r < 0)
        return r;
    return get_job(store, job, ret_job, err);
}

/* In a transaction. ret_job stays NULL when none may go: what was taken back must be kept. */
static int claim_job(struct gsn_store *store, const struct claimant *who,
                     struct gsn_job_row **ret_job, struct gsn_error *err)
{
    const struct lease_home here = lease_home();
    int64_t job = 0;
    int r = take_back_leases(store, &here, who->now, err);

    if (r >= 0)
        r = pick_job(store, &job, err);
    return r >= 0 && job ? take_job(store, &here, who, job, ret_job, err) : r;
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
    r = gsn_sql_end(store, claim_job(store, &who, &job, err), err);
    if (r < 0)
        return r;
    if (!job)
        return say_why_none(store, err);
    *ret_job = gsn_steal(&job);
    return GSN_OK;
}

/* Asking for jobs, and ending them. */

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

/* In a transaction. */
static int add_job(struct gsn_store *store, int64_t specimen_id, int64_t panel_id, int64_t *ret_id,
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
    r = gsn_sql_end(store, add_job(store, specimen_id, panel_id, &id, err), err);
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
    return gsn_sql_run(store, "UPDATE job SET " FRESH_JOB "WHERE id = ?1 AND again = 1",
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
    return change_mine(store, job, "UPDATE job SET " FRESH_JOB IF_MINE,
                       SQL_ARGS(SQL_INT(job->id), SQL_INT(job->claim)), err);
}

int gsn_queue_of_process(struct gsn_store *store, pid_t pid, struct gsn_job_row **ret_job,
                         struct gsn_error *err)
{
    const struct lease_home here = lease_home();
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
                              "UPDATE job SET attempts = 0, " FRESH_JOB
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
