/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/storage/bench.h"

#include <sqlite3.h>

int bench_raw(const struct gsn_scratch *scratch, const char *sql)
{
    sqlite3 *db = NULL;
    int r = sqlite3_open_v2(gsn_scratch_path(scratch, "gieson.db"), &db, /* door */
                            SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, NULL);

    if (r == SQLITE_OK)
        r = sqlite3_exec(db, sql, NULL, NULL, NULL); /* door */
    (void)sqlite3_close(db);
    return r;
}
