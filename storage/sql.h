/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The open database, and how storage/ speaks to it: one statement with its arguments, run to its
 * end.
 *
 * A shape tells where the columns of a row go in a struct, so reading, writing and freeing rows is
 * written once. Private to this folder. A NaN is written as NULL and NULL is read back as NaN. */
#ifndef GSN_STORAGE_SQL_H
#define GSN_STORAGE_SQL_H

#include "storage/store.h"

#include <sqlite3.h>
#include <stddef.h>
#include <stdint.h>

enum gsn_sql_type { GSN_SQL_INT, GSN_SQL_REAL, GSN_SQL_TEXT };

struct gsn_sql_value {
    enum gsn_sql_type type;
    int64_t integer;
    double real;
    const char *text;
};

#define SQL_INT(x) ((struct gsn_sql_value){ .type = GSN_SQL_INT, .integer = (x) })

#define SQL_REAL(x) ((struct gsn_sql_value){ .type = GSN_SQL_REAL, .real = (x) })

/* NULL stands for the empty text: our columns of text are never NULL. */
#define SQL_TEXT(x) ((struct gsn_sql_value){ .type = GSN_SQL_TEXT, .text = (x) })

/* The values of ?1, ?2, ... */
struct gsn_sql_args {
    size_t count;
    const struct gsn_sql_value *at;
};

#define SQL_ARGS(...)                                                                              \
    ((struct gsn_sql_args){ sizeof((struct gsn_sql_value[]){ __VA_ARGS__ }) /                      \
                                sizeof(struct gsn_sql_value),                                      \
                            (struct gsn_sql_value[]){ __VA_ARGS__ } })

#define SQL_NO_ARGS ((struct gsn_sql_args){ 0, NULL })

/* Where column i of a row goes: an int64_t, a double or a const char *. */
struct gsn_sql_field {
    enum gsn_sql_type type;
    size_t offset;
};

struct gsn_sql_shape {
    size_t size; /* of the struct */
    size_t count;
    const struct gsn_sql_field *field;
};

#define SQL_SHAPE(type_, fields)                                                                   \
    {                                                                                              \
        .size = sizeof(type_), .count = sizeof(fields) / sizeof((fields)[0]), .field = (fields)    \
    }

/* Runs one statement that returns no rows. ret_changed may be NULL: how many rows it changed. */
int gsn_sql_run(struct gsn_store *store, const char *sql, struct gsn_sql_args args,
                int64_t *ret_changed, struct gsn_error *err);

/* The first column of the first row. Fails with GSN_E_NOTFOUND when there is none. */
int gsn_sql_int(struct gsn_store *store, const char *sql, struct gsn_sql_args args,
                int64_t *ret_value, struct gsn_error *err);

/* All rows. gives: an array of count structs, whose texts gsn_sql_free_rows() frees; it is never
 * NULL. */
int gsn_sql_rows(struct gsn_store *store, const struct gsn_sql_shape *shape, const char *sql,
                 struct gsn_sql_args args, void **ret_rows, size_t *ret_count,
                 struct gsn_error *err);

/* The first row. gives: one struct. Fails with GSN_E_NOTFOUND when there is none. */
int gsn_sql_row(struct gsn_store *store, const struct gsn_sql_shape *shape, const char *sql,
                struct gsn_sql_args args, void **ret_row, struct gsn_error *err);

/* Frees the texts of count structs and the array itself. */
void gsn_sql_free_rows(const struct gsn_sql_shape *shape, void *rows, size_t count);

/* The fields of a struct as arguments, from ?1 on: fills values[0..shape->count-1]. */
struct gsn_sql_args gsn_sql_fields(const struct gsn_sql_shape *shape, const void *row,
                                   struct gsn_sql_value *values);

/* For a statement on the stack, read row by row. */
static inline void gsn_statement_done(sqlite3_stmt **statement)
{
    (void)sqlite3_finalize(*statement);
}
#define gsn_auto_statement __attribute__((cleanup(gsn_statement_done))) sqlite3_stmt *

/* The id of the row inserted last. */
int64_t gsn_sql_last_id(struct gsn_store *store);

/* Ends what gsn_store_begin() began: commits when r is no error, else rolls back and returns r
 * (store.c). */
int gsn_sql_end(struct gsn_store *store, int r, struct gsn_error *err);

/* For struct gsn_NAME_row with the shape NAME_shape: its frees, and NAME_rows() and NAME_row() that
 * run a query and give what the public functions give. */
#define SQL_DEFINE_ROW(name)                                                                       \
    void gsn_##name##_row_free(struct gsn_##name##_row *row)                                       \
    {                                                                                              \
        gsn_sql_free_rows(&name##_shape, row, row ? 1 : 0);                                        \
    }                                                                                              \
    static int name##_row(struct gsn_store *store, const char *sql, struct gsn_sql_args args,      \
                          struct gsn_##name##_row **ret_row, struct gsn_error *err)                \
    {                                                                                              \
        void *row = NULL;                                                                          \
        const int r = gsn_sql_row(store, &name##_shape, sql, args, &row, err);                     \
                                                                                                   \
        if (r >= 0)                                                                                \
            *ret_row = row;                                                                        \
        return r;                                                                                  \
    }                                                                                              \
    struct gsn_##name##_row_needs_a_semicolon

#define SQL_DEFINE_ROWS(name)                                                                      \
    void gsn_##name##_rows_free(struct gsn_##name##_rows *rows)                                    \
    {                                                                                              \
        if (rows)                                                                                  \
            gsn_sql_free_rows(&name##_shape, rows->at, rows->count);                               \
        gsn_free(rows);                                                                            \
    }                                                                                              \
    static int name##_rows(struct gsn_store *store, const char *sql, struct gsn_sql_args args,     \
                           struct gsn_##name##_rows **ret_rows, struct gsn_error *err)             \
    {                                                                                              \
        gsn_auto(gsn_##name##_rows) rows = gsn_alloc_array(1, sizeof *rows);                       \
        void *at = NULL;                                                                           \
        int r;                                                                                     \
                                                                                                   \
        if (!rows)                                                                                 \
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for a list of rows");                 \
        r = gsn_sql_rows(store, &name##_shape, sql, args, &at, &rows->count, err);                 \
        if (r < 0)                                                                                 \
            return r;                                                                              \
        rows->at = at;                                                                             \
        *ret_rows = gsn_steal(&rows);                                                              \
        return GSN_OK;                                                                             \
    }                                                                                              \
    struct gsn_##name##_rows_needs_a_semicolon

/* Compiled statements, kept for the next time: compiling costs a scan's rows more than writing
 * them. */
enum { GSN_KEPT_STATEMENTS = 48 };

/* Those nobody uses now, the one used last at the end. What is done again and again uses its
 * statements in turn: each goes to the end, and the next one comes to lie in its place. */
struct gsn_kept {
    size_t count;
    size_t next; /* where the last one was found */
    struct sqlite3_stmt *at[GSN_KEPT_STATEMENTS];
};

/* What a handle remembers of the pictures that it put into the staging table itself, so that it
 * need not look through them for each new one. So many lie there of one handle at most: enough that
 * committing them adds little to each, few enough that it takes some milliseconds. */
enum { GSN_STAGING_MAX = 256 };

/* The rows first, first + 1, ... in the order of their tags; those of another handle never lie
 * between. count 0: nothing is remembered. */
struct gsn_staging {
    unsigned uncommitted; /* staged and not committed by this handle */
    unsigned count;
    int64_t first;
    uint64_t tag[GSN_STAGING_MAX];
};

/* Opened, migrated and closed by store.c. */
struct gsn_store {
    char *dir, *head; /* and DIR/audit.head */
    sqlite3 *db;
    unsigned depth; /* of nested transactions */
    struct gsn_staging staging;
    struct gsn_kept kept;
    struct gsn_hash *hash; /* NULL until it is needed */
    int log_grew;          /* in the transaction that is open */
};

/* The open database, and its last failure as a code and a sentence of ours. */
struct sqlite3 *gsn_store_handle(struct gsn_store *store);

struct gsn_kept *gsn_store_kept(struct gsn_store *store);

struct gsn_staging *gsn_store_staging(struct gsn_store *store);

/* borrows: the store's own hash, with nothing added. */
int gsn_store_hash(struct gsn_store *store, struct gsn_hash **ret_hash, struct gsn_error *err);

/* Told by who appends to the audit log: the commit writes down where it ends. */
void gsn_store_log_grew(struct gsn_store *store);

int gsn_store_failed(struct gsn_store *store, struct gsn_error *err);

/* Our code for one of SQLite's, which is no extended one. */
int gsn_sql_code(int sqlite_code);

/* gives: a statement of this text, ready to bind; NULL when none is kept. */
struct sqlite3_stmt *gsn_kept_take(struct gsn_kept *kept, const char *sql);

/* takes a statement that is over, or NULL. */
void gsn_kept_give(struct gsn_kept *kept, struct sqlite3_stmt *statement);

void gsn_kept_done(struct gsn_kept *kept);

/* The SQL of schema/NNN_*.sql, built into the program: schema n takes a store from version n-1 to
 * version n. */

extern const char gsn_schema_001[];
extern const char gsn_schema_002[];
extern const char gsn_schema_003[];
extern const char gsn_schema_004[];
extern const char gsn_schema_005[];
extern const char gsn_schema_006[];
extern const char gsn_schema_007[];
extern const char gsn_schema_008[];
extern const char gsn_schema_009[];

#endif
