/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The bench as people see it: sources, troubles, requests; and who serves the store.
 *
 * A source has a row with its state; a trouble is a picture or file that could not be taken, by
 * source and name, with what a person must do, until it is over; a request waits for the source's
 * process, which answers it. Who serves the store is told by locks on DIR/giesond.lock (open file
 * description locks, fcntl(2)): they end with the process that took them, so a service that was
 * killed leaves none.
 *
 * How it fails: GSN_E_BUSY for a second service; an answer that was given already is not found. */
#include "storage/bench.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "storage/audit_log.h"
#include "storage/sql.h"

static const char *const tasks[] = { "takes panels in", "does the jobs" };

/* Who serves the store. */

/* One byte of the file per service. */
static struct flock byte_of(enum gsn_service service)
{
    return (struct flock){
        .l_type = F_WRLCK, .l_whence = SEEK_SET, .l_start = (off_t)service, .l_len = 1
    };
}

static char *path_of(const char *dir)
{
    return gsn_format("%s/giesond.lock", dir);
}

int gsn_service_take(const char *dir, enum gsn_service service, int *ret_lock,
                     struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of(dir);
    struct flock byte = byte_of(service);
    int fd = -1;
    int r = path ? gsn_file_open_lock(path, &fd, err)
                 : gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);

    if (r < 0)
        return r;
    /* Of the open file, not of the process: another descriptor that is closed cannot drop it. */
    if (fcntl(fd, F_OFD_SETLK, &byte) == 0) {
        *ret_lock = fd;
        return GSN_OK;
    }
    r = errno == EAGAIN || errno == EACCES
            ? gsn_fail(err, GSN_E_BUSY, "another giesond %s for %s already", tasks[service], dir)
            : gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    (void)close(fd);
    return r;
}

int gsn_service_is_there(const char *dir, enum gsn_service service, int *ret_there,
                         struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of(dir);
    struct flock byte = byte_of(service);
    int fd = -1;
    int r =
        path ? gsn_file_open(path, &fd, err) : gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);

    if (r == GSN_E_NOTFOUND) {
        *ret_there = 0;
        return GSN_OK;
    }
    if (r < 0)
        return r;
    if (fcntl(fd, F_OFD_GETLK, &byte) < 0)
        r = gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    (void)close(fd);
    if (r >= 0)
        *ret_there = byte.l_type != F_UNLCK;
    return r;
}

#define SOURCE(type, name)                                                                         \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_bench_source, name)                                    \
    }
static const struct gsn_sql_field source_fields[] = {
    SOURCE(TEXT, name),    SOURCE(TEXT, address), SOURCE(TEXT, device), SOURCE(TEXT, state),
    SOURCE(TEXT, message), SOURCE(TEXT, item),    SOURCE(INT, done),    SOURCE(INT, total),
    SOURCE(TEXT, expects), SOURCE(INT, changed),
};

#undef SOURCE
static const struct gsn_sql_shape source_shape = SQL_SHAPE(struct gsn_bench_source, source_fields);

void gsn_bench_sources_free(struct gsn_bench_sources *rows)
{
    if (rows)
        gsn_sql_free_rows(&source_shape, rows->at, rows->count);
    gsn_free(rows);
}

/* Sources. */

int gsn_bench_list(struct gsn_store *store, struct gsn_bench_sources **ret_rows,
                   struct gsn_error *err)
{
    gsn_auto(gsn_bench_sources) rows = gsn_alloc_array(1, sizeof *rows);
    void *at = NULL;
    int r;

    if (!rows)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a list of rows");
    r = gsn_sql_rows(store, &source_shape,
                     "SELECT b.name, b.address, b.device, b.state, b.message, b.item, b.done, "
                     "b.total, coalesce(s.name, ''), b.changed FROM source b "
                     "LEFT JOIN expectation e ON e.source = b.name "
                     "LEFT JOIN specimen s ON s.id = e.specimen_id ORDER BY b.name",
                     SQL_NO_ARGS, &at, &rows->count, err);
    if (r < 0)
        return r;
    rows->at = at;
    *ret_rows = gsn_steal(&rows);
    return GSN_OK;
}

int gsn_bench_put(struct gsn_store *store, const struct gsn_bench_source *source, int64_t now,
                  struct gsn_error *err)
{
    return gsn_sql_run(
        store,
        "INSERT INTO source (name, address, device, state, message, item, done, total, changed) "
        "VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9) ON CONFLICT (name) DO UPDATE SET "
        "address = excluded.address, device = excluded.device, state = excluded.state, "
        "message = excluded.message, item = excluded.item, done = excluded.done, "
        "total = excluded.total, changed = excluded.changed "
        "WHERE (address, device, state, message, item, done, total) IS NOT "
        "(excluded.address, excluded.device, excluded.state, excluded.message, excluded.item, "
        "excluded.done, excluded.total)",
        SQL_ARGS(SQL_TEXT(source->name), SQL_TEXT(source->address), SQL_TEXT(source->device),
                 SQL_TEXT(source->state), SQL_TEXT(source->message), SQL_TEXT(source->item),
                 SQL_INT(source->done), SQL_INT(source->total), SQL_INT(now)),
        NULL, err);
}

static bool is_among(const char *name, const char *const *names, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (strcmp(names[i], name) == 0)
            return true;
    return false;
}

/* In a transaction. */
static int keep_sources(struct gsn_store *store, const char *const *names, size_t count,
                        int64_t now, struct gsn_error *err)
{
    gsn_auto(gsn_bench_sources) rows = NULL;
    int r = gsn_bench_list(store, &rows, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++) {
        if (is_among(rows->at[i].name, names, count))
            continue;
        r = gsn_sql_run(store,
                        "UPDATE source SET state = 'off', message = '', item = '', done = 0, "
                        "total = 0, changed = ?2 WHERE name = ?1 AND state <> 'off'",
                        SQL_ARGS(SQL_TEXT(rows->at[i].name), SQL_INT(now)), NULL, err);
    }
    return r;
}

int gsn_bench_keep(struct gsn_store *store, const char *const *names, size_t count, int64_t now,
                   struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, keep_sources(store, names, count, now, err), err);
}

/* ---- what could not be taken in ---------------------------------------------------------- */

#define TROUBLE(type, name)                                                                        \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_trouble_row, name)                                     \
    }
static const struct gsn_sql_field trouble_fields[] = {
    TROUBLE(TEXT, source), TROUBLE(TEXT, name), TROUBLE(TEXT, reason), TROUBLE(TEXT, action),
    TROUBLE(INT, tries),   TROUBLE(INT, since), TROUBLE(INT, last),
};

#undef TROUBLE
static const struct gsn_sql_shape trouble_shape = SQL_SHAPE(struct gsn_trouble_row, trouble_fields);

SQL_DEFINE_ROWS(trouble);

/* In a transaction. */
static int add_trouble(struct gsn_store *store, const struct gsn_trouble_row *trouble, int64_t now,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) text = gsn_format("%s: %s", trouble->source, trouble->reason);
    int r;

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the audit log");
    r = gsn_sql_run(store, "INSERT INTO trouble VALUES (?1, ?2, ?3, ?4, 1, ?5, ?5)",
                    SQL_ARGS(SQL_TEXT(trouble->source), SQL_TEXT(trouble->name),
                             SQL_TEXT(trouble->reason), SQL_TEXT(trouble->action), SQL_INT(now)),
                    NULL, err);
    return r < 0 ? r
                 : gsn_event_add(store, now, "gieson-intake", "trouble", trouble->name, text, err);
}

/* In a transaction. One that is known already is no line of the audit log. */
static int put_trouble(struct gsn_store *store, const struct gsn_trouble_row *trouble, int64_t now,
                       struct gsn_error *err)
{
    int64_t changed = 0;
    const int r =
        gsn_sql_run(store,
                    "UPDATE trouble SET reason = ?3, action = ?4, tries = tries + 1, last = ?5 "
                    "WHERE source = ?1 AND name = ?2",
                    SQL_ARGS(SQL_TEXT(trouble->source), SQL_TEXT(trouble->name),
                             SQL_TEXT(trouble->reason), SQL_TEXT(trouble->action), SQL_INT(now)),
                    &changed, err);

    return r < 0 || changed > 0 ? r : add_trouble(store, trouble, now, err);
}

int gsn_trouble_put(struct gsn_store *store, const struct gsn_trouble_row *trouble, int64_t now,
                    struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, put_trouble(store, trouble, now, err), err);
}

/* In a transaction. */
static int clear_trouble(struct gsn_store *store, const char *source, const char *name,
                         const char *actor, int64_t now, struct gsn_error *err)
{
    int64_t changed = 0;
    const int r = gsn_sql_run(store, "DELETE FROM trouble WHERE source = ?1 AND name = ?2",
                              SQL_ARGS(SQL_TEXT(source), SQL_TEXT(name)), &changed, err);

    return r < 0 || changed == 0 ? r
                                 : gsn_event_add(store, now, actor, "cleared", name, source, err);
}

int gsn_trouble_clear(struct gsn_store *store, const char *source, const char *name,
                      const char *actor, int64_t now, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, clear_trouble(store, source, name, actor, now, err), err);
}

int gsn_trouble_list(struct gsn_store *store, struct gsn_trouble_rows **ret_rows,
                     struct gsn_error *err)
{
    return trouble_rows(store,
                        "SELECT source, name, reason, action, tries, since, last FROM trouble "
                        "ORDER BY since, source, name",
                        SQL_NO_ARGS, ret_rows, err);
}

/* ---- requests of people ------------------------------------------------------------------ */

#define REQUEST(type, name)                                                                        \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_request_row, name)                                     \
    }
static const struct gsn_sql_field request_fields[] = {
    REQUEST(INT, id),      REQUEST(INT, time),   REQUEST(TEXT, actor),   REQUEST(TEXT, kind),
    REQUEST(TEXT, source), REQUEST(TEXT, state), REQUEST(TEXT, message),
};

#undef REQUEST
#define SELECT_REQUEST "SELECT id, time, actor, kind, source, state, message FROM request "
static const struct gsn_sql_shape request_shape = SQL_SHAPE(struct gsn_request_row, request_fields);

SQL_DEFINE_ROW(request);

/* In a transaction. */
static int add_request(struct gsn_store *store, const char *source, const char *kind,
                       const char *actor, int64_t now, int64_t *ret_id, struct gsn_error *err)
{
    int64_t there = 0;
    int r = gsn_sql_int(store, "SELECT 1 FROM source WHERE name = ?1 AND state <> 'off'",
                        SQL_ARGS(SQL_TEXT(source)), &there, err);

    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, r, "there is no source \"%.200s\"", source);
    if (r >= 0)
        r = gsn_sql_run(
            store, "INSERT INTO request (time, actor, kind, source) VALUES (?1, ?2, ?3, ?4)",
            SQL_ARGS(SQL_INT(now), SQL_TEXT(actor), SQL_TEXT(kind), SQL_TEXT(source)), NULL, err);
    if (r < 0)
        return r;
    *ret_id = gsn_sql_last_id(store);
    return gsn_event_add(store, now, actor, "request", source, kind, err);
}

int gsn_request_add(struct gsn_store *store, const char *source, const char *kind,
                    const char *actor, int64_t now, int64_t *ret_id, struct gsn_error *err)
{
    int64_t id = 0;
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_sql_end(store, add_request(store, source, kind, actor, now, &id, err), err);
    if (r >= 0)
        *ret_id = id;
    return r;
}

int gsn_request_next(struct gsn_store *store, const char *source, struct gsn_request_row **ret_row,
                     struct gsn_error *err)
{
    const int r = request_row(
        store, SELECT_REQUEST "WHERE source = ?1 AND state = 'waiting' ORDER BY id LIMIT 1",
        SQL_ARGS(SQL_TEXT(source)), ret_row, err);

    return r == GSN_E_NOTFOUND ? gsn_fail(err, r, "nothing is asked of %.200s", source) : r;
}

int gsn_request_get(struct gsn_store *store, int64_t id, struct gsn_request_row **ret_row,
                    struct gsn_error *err)
{
    const int r =
        request_row(store, SELECT_REQUEST "WHERE id = ?1", SQL_ARGS(SQL_INT(id)), ret_row, err);

    return r == GSN_E_NOTFOUND ? gsn_fail(err, r, "there is no request %lld", (long long)id) : r;
}

/* In a transaction. */
static int answer_request(struct gsn_store *store, int64_t id, const char *message, int64_t now,
                          struct gsn_error *err)
{
    gsn_auto(gsn_request_row) row = NULL;
    gsn_auto_mem(char) text = NULL;
    int r = request_row(store, SELECT_REQUEST "WHERE id = ?1 AND state = 'waiting'",
                        SQL_ARGS(SQL_INT(id)), &row, err);

    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, r, "no request %lld waits for an answer", (long long)id);
    if (r >= 0)
        r = gsn_sql_run(
            store, "UPDATE request SET state = ?2, message = ?3 WHERE id = ?1",
            SQL_ARGS(SQL_INT(id), SQL_TEXT(message ? "refused" : "done"), SQL_TEXT(message)), NULL,
            err);
    if (r < 0)
        return r;
    text = message ? gsn_format("%s refused: %s", row->kind, message)
                   : gsn_format("%s done", row->kind);
    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the audit log");
    return gsn_event_add(store, now, "gieson-intake", "answer", row->source, text, err);
}

int gsn_request_answer(struct gsn_store *store, int64_t id, const char *message, int64_t now,
                       struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r : gsn_sql_end(store, answer_request(store, id, message, now, err), err);
}
