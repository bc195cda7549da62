/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Takes what a source has, as the intake does, and keeps it in memory. */
#ifndef GSN_TESTS_DEVICE_PULL_H
#define GSN_TESTS_DEVICE_PULL_H

#include "acquire/source.h"

enum { PULL_MOST = 16 };

struct pulled {
    char name[100];
    uint8_t *bytes; /* free() */
    size_t size;
};

struct pull {
    size_t count;
    struct pulled at[PULL_MOST];
    int64_t now_ms; /* given to the source, and moved on by a second with each look */
};

/* Looks once and takes what is ready; acknowledges it. Returns what failed, else GSN_OK. */
int pull_look(struct pull *pull, struct gsn_source *source, struct gsn_error *err);
/* Looks until so many were taken, at most 20 times. */
int pull_until(struct pull *pull, struct gsn_source *source, size_t count, struct gsn_error *err);
/* borrows: what came under this name; NULL for nothing. */
const struct pulled *pull_find(const struct pull *pull, const char *name);
void pull_free(struct pull *pull);

#endif
