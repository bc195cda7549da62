/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Compiled statements, kept for the next time: compiling costs a scan's rows more than writing
 * them. Private to this folder. */
#ifndef GSN_STORAGE_KEPT_H
#define GSN_STORAGE_KEPT_H

#include <stddef.h>

enum { GSN_KEPT_STATEMENTS = 48 };

struct sqlite3_stmt;

/* Those nobody uses now, the one used last at the end. What is done again and again uses its
 * statements in turn: each goes to the end, and the next one comes to lie in its place. */
struct gsn_kept {
    size_t count;
    size_t next; /* where the last one was found */
    struct sqlite3_stmt *at[GSN_KEPT_STATEMENTS];
};

/* gives: a statement of this text, ready to bind; NULL when none is kept. */
struct sqlite3_stmt *gsn_kept_take(struct gsn_kept *kept, const char *sql);
/* takes a statement that is over, or NULL. */
void gsn_kept_give(struct gsn_kept *kept, struct sqlite3_stmt *statement);
void gsn_kept_done(struct gsn_kept *kept);

#endif
