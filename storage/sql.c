/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The open database: its handle, what it says when it fails, and one statement with its arguments,
 * run to its end.
 *
 * store.c opens, migrates and closes it.
 *
 * Steps. Take a kept statement of this text or compile it; bind ?1, ?2, ...; step; copy the rows
 * into structs as a shape says, texts owned; give the statement back. Compiling costs a scan's rows
 * more than writing them, so 48 statements are kept, those used last at the end: what is done again
 * and again uses its statements in turn.
 *
 * How it fails: GSN_E_NOTFOUND where a row was asked for and none is there; else as
 * gsn_store_failed() says. A statement is given back whatever happened. */
#include "storage/sql.h"

#include <assert.h>
#include <math.h>
#include <sqlite3.h>
#include <string.h>

#include "pipeline/core/hash.h"
#include "storage/transaction.h"

/* The handle. */

enum { DIGEST_DIGITS = 64 };

struct gsn_kept *gsn_store_kept(struct gsn_store *store)
{
    return &store->kept;
}

struct gsn_staging *gsn_store_staging(struct gsn_store *store)
{
    return &store->staging;
}

int gsn_store_hash(struct gsn_store *store, struct gsn_hash **ret_hash, struct gsn_error *err)
{
    const int r = store->hash ? gsn_hash_again(store->hash, err) : gsn_hash_new(&store->hash, err);

    if (r >= 0)
        *ret_hash = store->hash;
    return r;
}

void gsn_store_log_grew(struct gsn_store *store)
{
    store->log_grew = 1;
}

struct sqlite3 *gsn_store_handle(struct gsn_store *store)
{
    return store->db;
}

const char *gsn_store_dir(const struct gsn_store *store)
{
    return store->dir;
}

int gsn_digest_check(const char *hex, struct gsn_error *err)
{
    if (strlen(hex) != DIGEST_DIGITS || strspn(hex, "0123456789abcdef") != DIGEST_DIGITS)
        return gsn_fail(err, GSN_E_INPUT, "\"%.80s\" is not a SHA-256", hex);
    return GSN_OK;
}

int gsn_store_object_path(const struct gsn_store *store, const char *hex, char **ret_path,
                          struct gsn_error *err)
{
    const int r = gsn_digest_check(hex, err);
    char *path;

    if (r < 0)
        return r;
    path = gsn_format("%s/objects/%.2s/%s", gsn_store_dir(store), hex, hex + 2);
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    *ret_path = path;
    return GSN_OK;
}

int gsn_sql_code(int sqlite_code)
{
    switch (sqlite_code) {
    case SQLITE_NOMEM:
        return GSN_E_NOMEM;
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
        return GSN_E_BUSY;
    case SQLITE_CONSTRAINT:
        return GSN_E_INPUT;
    case SQLITE_FULL:
    case SQLITE_IOERR:
    case SQLITE_READONLY:
    case SQLITE_CANTOPEN:
    case SQLITE_PERM:
        return GSN_E_IO;
    default:
        return GSN_E_STORE;
    }
}

int gsn_store_failed(struct gsn_store *store, struct gsn_error *err)
{
    /* SQLite's sentence is the one for a database that may only be read. */
    const char *const why =
        sqlite3_extended_errcode(store->db) == SQLITE_READONLY_DBMOVED
            ? "the file was moved, deleted or unmounted while it was open, or cannot be looked at"
            : sqlite3_errmsg(store->db);

    return gsn_fail(err, gsn_sql_code(sqlite3_errcode(store->db) & 0xff), "%s/gieson.db: %s",
                    store->dir, why);
}

/* Kept statements. */

static sqlite3_stmt *take_out(struct gsn_kept *kept, size_t index)
{
    sqlite3_stmt *const statement = kept->at[index];

    kept->count--;
    memmove(&kept->at[index], &kept->at[index + 1], (kept->count - index) * sizeof *kept->at);
    return statement;
}

struct sqlite3_stmt *gsn_kept_take(struct gsn_kept *kept, const char *sql)
{
    for (size_t i = 0; i < kept->count; i++) {
        const size_t at = (kept->next + i) % kept->count;

        if (strcmp(sqlite3_sql(kept->at[at]), sql) != 0)
            continue;
        kept->next = at;
        return take_out(kept, at);
    }
    return NULL;
}

void gsn_kept_give(struct gsn_kept *kept, struct sqlite3_stmt *statement)
{
    if (!statement)
        return;
    /* What reset returns is the failure of the last step, which was told. */
    (void)sqlite3_reset(statement);
    (void)sqlite3_clear_bindings(statement);
    if (kept->count == GSN_KEPT_STATEMENTS)
        (void)sqlite3_finalize(take_out(kept, 0));
    kept->at[kept->count++] = statement;
}

void gsn_kept_done(struct gsn_kept *kept)
{
    while (kept->count > 0)
        (void)sqlite3_finalize(kept->at[--kept->count]);
}

/* Goes back to those that are kept. */
struct statement {
    struct gsn_store *store;
    sqlite3_stmt *sqlite;
};

/* Statements and rows. */

static void statement_done(struct statement *statement)
{
    gsn_kept_give(gsn_store_kept(statement->store), statement->sqlite);
}
#define auto_statement __attribute__((cleanup(statement_done))) struct statement

static int bind_value(sqlite3_stmt *statement, int index, const struct gsn_sql_value *value)
{
    if (value->type == GSN_SQL_INT)
        return sqlite3_bind_int64(statement, index, value->integer);
    if (value->type == GSN_SQL_REAL)
        return sqlite3_bind_double(statement, index, value->real); /* a NaN becomes NULL */
    /* The arguments outlive the statement, so SQLite need not copy them. */
    return sqlite3_bind_text(statement, index, value->text ? value->text : "", -1, SQLITE_STATIC);
}

static int prepare_statement(struct statement *statement, const char *sql, struct gsn_sql_args args,
                             struct gsn_error *err)
{
    struct gsn_store *const store = statement->store;

    statement->sqlite = gsn_kept_take(gsn_store_kept(store), sql);
    if (!statement->sqlite &&
        sqlite3_prepare_v3(gsn_store_handle(store), sql, -1, SQLITE_PREPARE_PERSISTENT,
                           &statement->sqlite, NULL) != SQLITE_OK)
        return gsn_store_failed(store, err);
    assert((size_t)sqlite3_bind_parameter_count(statement->sqlite) == args.count);
    for (size_t i = 0; i < args.count; i++) {
        if (bind_value(statement->sqlite, (int)i + 1, &args.at[i]) != SQLITE_OK)
            return gsn_store_failed(store, err);
    }
    return GSN_OK;
}

int gsn_sql_run(struct gsn_store *store, const char *sql, struct gsn_sql_args args,
                int64_t *ret_changed, struct gsn_error *err)
{
    auto_statement statement = { .store = store };
    int r = prepare_statement(&statement, sql, args, err);

    if (r < 0)
        return r;
    do
        r = sqlite3_step(statement.sqlite);
    while (r == SQLITE_ROW);
    if (r != SQLITE_DONE)
        return gsn_store_failed(store, err);
    if (ret_changed)
        *ret_changed = sqlite3_changes64(gsn_store_handle(store));
    return GSN_OK;
}

int gsn_sql_int(struct gsn_store *store, const char *sql, struct gsn_sql_args args,
                int64_t *ret_value, struct gsn_error *err)
{
    auto_statement statement = { .store = store };
    int r = prepare_statement(&statement, sql, args, err);

    if (r < 0)
        return r;
    r = sqlite3_step(statement.sqlite);
    if (r == SQLITE_DONE)
        return gsn_fail(err, GSN_E_NOTFOUND, "%s: no such row", gsn_store_dir(store));
    if (r != SQLITE_ROW)
        return gsn_store_failed(store, err);
    *ret_value = sqlite3_column_int64(statement.sqlite, 0);
    return GSN_OK;
}

static void free_texts(const struct gsn_sql_shape *shape, void *row)
{
    for (size_t i = 0; i < shape->count; i++) {
        if (shape->field[i].type == GSN_SQL_TEXT)
            gsn_free(*(char **)((char *)row + shape->field[i].offset));
    }
}

void gsn_sql_free_rows(const struct gsn_sql_shape *shape, void *rows, size_t count)
{
    for (size_t i = 0; rows && i < count; i++)
        free_texts(shape, (char *)rows + i * shape->size);
    gsn_free(rows);
}

static int read_text(struct gsn_store *store, sqlite3_stmt *statement, int column, const char **to,
                     struct gsn_error *err)
{
    const char *text = (const char *)sqlite3_column_text(statement, column);

    /* A text that is there but cannot be had: SQLite ran out of memory. */
    if (!text && sqlite3_column_type(statement, column) != SQLITE_NULL)
        return gsn_store_failed(store, err);
    *to = gsn_strdup(text ? text : "");
    return *to ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for a row");
}

/* row is zeroed, so that what was read before a failure can be freed. */
static int read_row(struct gsn_store *store, sqlite3_stmt *statement,
                    const struct gsn_sql_shape *shape, void *row, struct gsn_error *err)
{
    for (size_t i = 0; i < shape->count; i++) {
        char *const to = (char *)row + shape->field[i].offset;
        const int column = (int)i;
        int r = GSN_OK;

        if (shape->field[i].type == GSN_SQL_INT)
            *(int64_t *)to = sqlite3_column_int64(statement, column);
        else if (shape->field[i].type == GSN_SQL_TEXT)
            r = read_text(store, statement, column, (const char **)to, err);
        else if (sqlite3_column_type(statement, column) == SQLITE_NULL)
            *(double *)to = NAN;
        else
            *(double *)to = sqlite3_column_double(statement, column);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

struct rows {
    const struct gsn_sql_shape *shape;
    size_t count, room;
    char *at;
};

static void rows_done(struct rows *rows)
{
    gsn_sql_free_rows(rows->shape, rows->at, rows->count);
}

static int rows_grow(struct rows *rows, struct gsn_error *err)
{
    const size_t room = rows->room ? 2 * rows->room : 8;
    char *at = gsn_realloc_array(rows->at, room, rows->shape->size);

    if (!at)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu rows", room);
    rows->at = at;
    rows->room = room;
    return GSN_OK;
}

static int rows_add(struct gsn_store *store, sqlite3_stmt *statement, struct rows *rows,
                    struct gsn_error *err)
{
    char *row;
    int r = GSN_OK;

    if (rows->count == rows->room)
        r = rows_grow(rows, err);
    if (r < 0)
        return r;
    row = rows->at + rows->count++ * rows->shape->size;
    memset(row, 0, rows->shape->size);
    return read_row(store, statement, rows->shape, row, err);
}

static int collect_rows(struct gsn_store *store, sqlite3_stmt *statement, size_t most,
                        struct rows *rows, struct gsn_error *err)
{
    int r = rows_grow(rows, err);

    if (r < 0)
        return r;
    assert((size_t)sqlite3_column_count(statement) == rows->shape->count);
    while (rows->count < most && (r = sqlite3_step(statement)) != SQLITE_DONE) {
        if (r != SQLITE_ROW)
            return gsn_store_failed(store, err);
        r = rows_add(store, statement, rows, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

static int run_query(struct gsn_store *store, const struct gsn_sql_shape *shape, const char *sql,
                     struct gsn_sql_args args, size_t most, void **ret_rows, size_t *ret_count,
                     struct gsn_error *err)
{
    __attribute__((cleanup(rows_done))) struct rows rows = { .shape = shape };
    auto_statement statement = { .store = store };
    int r = prepare_statement(&statement, sql, args, err);

    if (r >= 0)
        r = collect_rows(store, statement.sqlite, most, &rows, err);
    if (r < 0)
        return r;
    *ret_count = rows.count;
    *ret_rows = gsn_steal(&rows.at);
    return GSN_OK;
}

int gsn_sql_rows(struct gsn_store *store, const struct gsn_sql_shape *shape, const char *sql,
                 struct gsn_sql_args args, void **ret_rows, size_t *ret_count,
                 struct gsn_error *err)
{
    return run_query(store, shape, sql, args, SIZE_MAX, ret_rows, ret_count, err);
}

int gsn_sql_row(struct gsn_store *store, const struct gsn_sql_shape *shape, const char *sql,
                struct gsn_sql_args args, void **ret_row, struct gsn_error *err)
{
    void *row = NULL;
    size_t count = 0;
    const int r = run_query(store, shape, sql, args, 1, &row, &count, err);

    if (r < 0)
        return r;
    if (count == 0) {
        gsn_free(row);
        return gsn_fail(err, GSN_E_NOTFOUND, "%s: no such row", gsn_store_dir(store));
    }
    *ret_row = row;
    return GSN_OK;
}

struct gsn_sql_args gsn_sql_fields(const struct gsn_sql_shape *shape, const void *row,
                                   struct gsn_sql_value *values)
{
    for (size_t i = 0; i < shape->count; i++) {
        const char *const from = (const char *)row + shape->field[i].offset;

        values[i] = (struct gsn_sql_value){ .type = shape->field[i].type };
        if (shape->field[i].type == GSN_SQL_INT)
            values[i].integer = *(const int64_t *)from;
        else if (shape->field[i].type == GSN_SQL_REAL)
            values[i].real = *(const double *)from;
        else
            values[i].text = *(const char *const *)from;
    }
    return (struct gsn_sql_args){ shape->count, values };
}

int64_t gsn_sql_last_id(struct gsn_store *store)
{
    return sqlite3_last_insert_rowid(gsn_store_handle(store));
}
