/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A store with a few specimens, for the tests of storage/. */
#ifndef GSN_TESTS_STORAGE_BENCH_H
#define GSN_TESTS_STORAGE_BENCH_H

#include <stdio.h>

#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/store.h"
#include "tests/check.h"
#include "tests/storage/scratch.h"

enum { NOON = 1800000000 };

static inline struct gsn_specimen_row bench_specimen(const char *name, const char *group,
                                                     const char *baseline)
{
    return (struct gsn_specimen_row){ .name = name,
                                      .study = "debris",
                                      .group = group,
                                      .animal = "rat 1",
                                      .week = 4,
                                      .kind = "sections",
                                      .baseline = baseline,
                                      .job_json = "{}",
                                      .job_sha256 = "" };
}

static inline int64_t bench_add_specimen(struct gsn_store *store, const char *name,
                                         const char *group, const char *baseline)
{
    const struct gsn_specimen_row row = bench_specimen(name, group, baseline);
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "test", NOON, &id, &err), err);
    return id;
}

/* A digest that no bytes have, but each number its own. */
static inline const char *bench_digest(unsigned number)
{
    static char digits[4][65];
    static unsigned next;
    char *const at = digits[next++ % 4];

    (void)snprintf(at, sizeof digits[0], "%064x", number);
    return at;
}

static inline struct gsn_panel_row bench_panel(int64_t specimen_id, unsigned number)
{
    return (struct gsn_panel_row){ .specimen_id = specimen_id,
                                   .number = number,
                                   .file_name = "P.tif",
                                   .sha256 = bench_digest(number),
                                   .size = 4711,
                                   .state = "waiting",
                                   .code = "",
                                   .message = "",
                                   .px_um = 16 };
}

static inline int64_t bench_add_panel(struct gsn_store *store, int64_t specimen_id, unsigned number)
{
    const struct gsn_panel_row row = bench_panel(specimen_id, number);
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = -1;

    CHECK_OK(gsn_panel_put(store, &row, &id, &again, &err), err);
    return id;
}

static inline struct gsn_store *bench_open(const struct gsn_scratch *scratch,
                                           enum gsn_store_mode mode)
{
    struct gsn_store *store = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_store_open(scratch->dir, mode, &store, &err), err);
    return store;
}

/* Runs SQL behind the store's back, through a handle of its own; returns SQLite's code. */
int bench_raw(const struct gsn_scratch *scratch, const char *sql);

#endif
