/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What any program could do: a table of slices in SQLite, WAL with synchronous=FULL. One row says
 * where a slice is, what it hashes to, its pose, its three marks and its state. Private to this
 * program. */
#ifndef GSN_TESTS_BENCH_LOG_PEER_H
#define GSN_TESTS_BENCH_LOG_PEER_H

#include <stddef.h>

struct sqlite3;
struct sqlite3_stmt;

struct log_peer {
    struct sqlite3 *db;
    struct sqlite3_stmt *begin, *insert, *commit;
};

struct log_peer log_peer_open(const char *folder, const char *name);
/* Inserts slices first, first + 1, ... in one commit. */
void log_peer_slices(const struct log_peer *peer, size_t first, size_t count);
void log_peer_close(struct log_peer *peer);

#endif
