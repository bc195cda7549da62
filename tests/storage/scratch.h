/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A directory of its own for a test, and rough hands for what is in it. */
#ifndef GSN_TESTS_STORAGE_SCRATCH_H
#define GSN_TESTS_STORAGE_SCRATCH_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

struct gsn_scratch {
    char dir[128];
};

struct gsn_scratch gsn_scratch_new(void);
/* With all that is in it. */
void gsn_scratch_remove(struct gsn_scratch *scratch);
#define scratch_auto __attribute__((cleanup(gsn_scratch_remove))) struct gsn_scratch

/* borrows: DIR/name, valid until the eighth call after. */
const char *gsn_scratch_path(const struct gsn_scratch *scratch, const char *name);

/* In place, as a copying program does it: the file keeps its inode. */
void gsn_scratch_append(const char *path, const void *bytes, size_t size);
void gsn_scratch_overwrite(const char *path, off_t at, const void *bytes, size_t size);

/* A child process that stands at a gate, then runs body and returns what that returned (0..120).
 *
 * Start it before the parent opens a database: SQLite's locks do not survive a fork. as_nobody: run
 * body as somebody to whom file permissions apply. */
struct gsn_scratch_child {
    pid_t pid;
    int gate;
};
struct gsn_scratch_child gsn_scratch_start(int as_nobody, int (*body)(void *context),
                                           void *context);
void gsn_scratch_open_gate(struct gsn_scratch_child *child);
/* Opens the gate when that was not done; -1 when the child died. */
int gsn_scratch_wait(struct gsn_scratch_child *child);

#endif
