/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pictures of a source that could not be taken in, and when each is tried again: at once, then
 * later each time. What is in the list has its row in the store. */
#ifndef GSN_SYSTEMD_FAILING_H
#define GSN_SYSTEMD_FAILING_H

#include "storage/store.h"

#include <stdint.h>

struct gsn_failing_entry {
    char *name, *reason; /* reason: as it was told last, or NULL */
    int64_t next_ms, delay_ms;
};

/* keeps: store and source (its name). */
struct gsn_failing {
    struct gsn_store *store;
    const char *source;
    size_t count;
    struct gsn_failing_entry *at;
};

/* Reads the rows that an earlier process left; those are tried at once. */
int gsn_failing_load(struct gsn_failing *list, struct gsn_error *err);
void gsn_failing_done(struct gsn_failing *list);

/* Whether it is too early to try this one again. */
int gsn_failing_rests(const struct gsn_failing *list, const char *name, int64_t now_ms);

/* The same, and that is why. */
int gsn_failing_rests_for(const struct gsn_failing *list, const char *name, const char *reason,
                          int64_t now_ms);

/* It failed (once more). ret_new: 1 when it was in no trouble before, or in another one. */
int gsn_failing_add(struct gsn_failing *list, const char *name, const char *reason,
                    const char *action, int64_t now_ms, int *ret_new, struct gsn_error *err);

/* It came in, or is none of ours any more. */
int gsn_failing_over(struct gsn_failing *list, const char *name, struct gsn_error *err);
/* What does not lie in this folder any more is in no trouble. */
int gsn_failing_forget_gone(struct gsn_failing *list, const char *folder, struct gsn_error *err);

#endif
