/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/sql.h"

#include <sqlite3.h>
#include <stdio.h>

#include "tests/check.h"

static sqlite3 *open_memory(void)
{
    sqlite3 *db = NULL;

    CHECK(sqlite3_open(":memory:", &db) == SQLITE_OK);
    CHECK(sqlite3_exec(db, "CREATE TABLE t (x UNIQUE); INSERT INTO t VALUES (1)", NULL, NULL,
                       NULL) == SQLITE_OK);
    return db;
}

static sqlite3_stmt *compile(sqlite3 *db, const char *sql)
{
    sqlite3_stmt *statement = NULL;

    CHECK(sqlite3_prepare_v2(db, sql, -1, &statement, NULL) == SQLITE_OK);
    return statement;
}

TEST(a_statement_comes_back_reset_and_without_its_arguments)
{
    sqlite3 *const db = open_memory();
    struct gsn_kept kept = { 0 };
    sqlite3_stmt *statement = compile(db, "SELECT x, ?1 FROM t");

    CHECK(gsn_kept_take(&kept, "SELECT x, ?1 FROM t") == NULL);
    CHECK(sqlite3_bind_int(statement, 1, 7) == SQLITE_OK);
    CHECK(sqlite3_step(statement) == SQLITE_ROW && sqlite3_column_int(statement, 1) == 7);
    gsn_kept_give(&kept, statement);
    CHECK(gsn_kept_take(&kept, "SELECT x FROM t") == NULL);
    CHECK(gsn_kept_take(&kept, "SELECT x, ?1 FROM t") == statement && kept.count == 0);
    CHECK(sqlite3_step(statement) == SQLITE_ROW);
    CHECK(sqlite3_column_type(statement, 1) == SQLITE_NULL);
    gsn_kept_give(&kept, statement);
    gsn_kept_give(&kept, NULL);
    gsn_kept_done(&kept);
    CHECK(sqlite3_close(db) == SQLITE_OK);
}

TEST(a_statement_that_failed_works_again)
{
    sqlite3 *const db = open_memory();
    struct gsn_kept kept = { 0 };
    sqlite3_stmt *statement = compile(db, "INSERT INTO t VALUES (?1)");

    CHECK(sqlite3_bind_int(statement, 1, 1) == SQLITE_OK);
    CHECK(sqlite3_step(statement) == SQLITE_CONSTRAINT);
    gsn_kept_give(&kept, statement);
    statement = gsn_kept_take(&kept, "INSERT INTO t VALUES (?1)");
    CHECK(sqlite3_bind_int(statement, 1, 2) == SQLITE_OK);
    CHECK(sqlite3_step(statement) == SQLITE_DONE);
    gsn_kept_give(&kept, statement);
    gsn_kept_done(&kept);
    CHECK(sqlite3_close(db) == SQLITE_OK);
}

TEST(the_one_not_used_for_longest_makes_room)
{
    sqlite3 *const db = open_memory();
    struct gsn_kept kept = { 0 };
    char sql[40];

    for (int i = 0; i < GSN_KEPT_STATEMENTS; i++) {
        (void)snprintf(sql, sizeof sql, "SELECT %d", i);
        gsn_kept_give(&kept, compile(db, sql));
    }
    gsn_kept_give(&kept, gsn_kept_take(&kept, "SELECT 0"));
    gsn_kept_give(&kept, compile(db, "SELECT x FROM t"));
    CHECK(kept.count == GSN_KEPT_STATEMENTS);
    CHECK(gsn_kept_take(&kept, "SELECT 1") == NULL);
    gsn_kept_give(&kept, gsn_kept_take(&kept, "SELECT 0"));
    CHECK(kept.count == GSN_KEPT_STATEMENTS);
    gsn_kept_done(&kept);
    /* SQLite does not close while a statement is left. */
    CHECK(sqlite3_close(db) == SQLITE_OK);
}
