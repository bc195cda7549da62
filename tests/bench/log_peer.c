/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/bench/log_peer.h"

#include <sqlite3.h>
#include <stdio.h>
#include <string.h>

#include "tests/bench/folder.h"

enum { SLICES = 300, DIGEST = 32 };

static sqlite3_stmt *prepare(sqlite3 *db, const char *sql)
{
    sqlite3_stmt *statement = NULL;

    need(sqlite3_prepare_v2(db, sql, -1, &statement, NULL) == SQLITE_OK, sql);
    return statement;
}

struct log_peer log_peer_open(const char *folder, const char *name)
{
    struct log_peer peer = { NULL };
    char path[200];

    (void)snprintf(path, sizeof path, "%s/%s", folder, name);
    need(sqlite3_open(path, &peer.db) == SQLITE_OK &&
             sqlite3_exec(peer.db,
                          "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; "
                          "CREATE TABLE slice (id INTEGER PRIMARY KEY, specimen INT, no INT, "
                          "path TEXT, sha BLOB, th REAL, tx REAL, ty REAL, flip INT, m0x REAL, "
                          "m0y REAL, m1x REAL, m1y REAL, m2x REAL, m2y REAL, rms REAL, state INT, "
                          "t REAL, UNIQUE (specimen, no))",
                          NULL, NULL, NULL) == SQLITE_OK,
         path);
    peer.begin = prepare(peer.db, "BEGIN IMMEDIATE");
    peer.insert = prepare(peer.db, "INSERT INTO slice VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, "
                                   "?, ?, ?, ?, ?, ?, ?)");
    peer.commit = prepare(peer.db, "COMMIT");
    return peer;
}

static void run(sqlite3_stmt *statement)
{
    need(sqlite3_step(statement) == SQLITE_DONE && sqlite3_reset(statement) == SQLITE_OK,
         "bare SQLite");
}

static void insert(sqlite3_stmt *row, size_t slice)
{
    unsigned char digest[DIGEST];
    char path[64];
    int bad = 0;

    memset(digest, (int)(slice & 255), sizeof digest);
    (void)snprintf(path, sizeof path, "specimen%zu/slice_%05zu.tif", slice / SLICES, slice);
    bad |= sqlite3_bind_int64(row, 1, (sqlite3_int64)(slice / SLICES));
    bad |= sqlite3_bind_int64(row, 2, (sqlite3_int64)(slice % SLICES));
    bad |= sqlite3_bind_text(row, 3, path, -1, SQLITE_STATIC);
    bad |= sqlite3_bind_blob(row, 4, digest, sizeof digest, SQLITE_STATIC);
    for (int column = 5; column <= 15; column++)
        bad |= sqlite3_bind_double(row, column, (double)slice * .25 + column);
    bad |= sqlite3_bind_int(row, 8, (int)(slice & 1));
    bad |= sqlite3_bind_int(row, 16, 2);
    bad |= sqlite3_bind_double(row, 17, (double)slice);
    need(bad == SQLITE_OK, "bind");
    run(row);
}

void log_peer_slices(const struct log_peer *peer, size_t first, size_t count)
{
    run(peer->begin);
    for (size_t i = 0; i < count; i++)
        insert(peer->insert, first + i);
    run(peer->commit);
}

void log_peer_close(struct log_peer *peer)
{
    (void)sqlite3_finalize(peer->begin);
    (void)sqlite3_finalize(peer->insert);
    (void)sqlite3_finalize(peer->commit);
    (void)sqlite3_close(peer->db);
}
