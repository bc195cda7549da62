/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/kept.h"

#include <sqlite3.h>
#include <string.h>

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
