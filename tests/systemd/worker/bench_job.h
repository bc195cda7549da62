/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Folders as a scanner delivers them and stores to take them in, for the tests of the jobs. */
#ifndef GSN_TESTS_SYSTEMD_WORKER_BENCH_JOB_H
#define GSN_TESTS_SYSTEMD_WORKER_BENCH_JOB_H

#include "pipeline/core/file.h"
#include "systemd/worker/import.h"
#include "systemd/worker/job.h"
#include "systemd/worker/verify.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/storage/bench.h"

#include <string.h>

/* What one import said about the files that were not simply taken. */
struct heard {
    char text[2000];
};

static inline void bench_hear(void *context, const char *name, const char *sentence)
{
    struct heard *heard = context;
    const size_t used = strlen(heard->text);

    (void)snprintf(heard->text + used, sizeof heard->text - used, "%s: %s\n", name, sentence);
}

static inline void bench_write(const struct gsn_scratch *scratch, const char *folder,
                               const char *name, const void *bytes, size_t size)
{
    gsn_auto_mem(char) dir = gsn_format("%s/%s", scratch->dir, folder);
    gsn_auto_mem(char) path = gsn_format("%s/%s/%s", scratch->dir, folder, name);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_mkdir(dir, &err), err);
    CHECK_OK(gsn_file_write(path, bytes, size, &err), err);
}

static inline void bench_write_job(const struct gsn_scratch *scratch, const char *folder,
                                   const char *job)
{
    bench_write(scratch, folder, "job.json", job, strlen(job));
}

static inline void bench_write_panel(const struct gsn_scratch *scratch, const char *folder,
                                     const char *name, unsigned number, double density)
{
    const struct drawn_panel panel = drawn_panel_of(number, 24, density);
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

    bench_write(scratch, folder, name, png, size);
}

static inline int bench_import(const struct gsn_scratch *scratch, struct gsn_store *store,
                               const char *folder, int replace, struct heard *heard,
                               struct gsn_import_counts *counts, struct gsn_error *err)
{
    gsn_auto_mem(char) dir = gsn_format("%s/%s", scratch->dir, folder);
    gsn_auto_mem(char) specimen = NULL;
    const struct gsn_import import = { .store = store,
                                       .dir = dir,
                                       .replace = replace,
                                       .actor = "test",
                                       .notice = bench_hear,
                                       .context = heard };

    memset(heard, 0, sizeof *heard);
    return gsn_import_folder(&import, &specimen, counts, err);
}

/* What verify found, a line each, in heard. */
static inline int bench_verify_loudly(struct gsn_store *store, int64_t run,
                                      const struct gsn_job_options *options, struct heard *heard,
                                      struct gsn_verdict *verdict, struct gsn_error *err)
{
    const struct gsn_verify how = {
        .store = store, .run = run, .options = options, .found = bench_hear, .context = heard
    };

    memset(heard, 0, sizeof *heard);
    return gsn_verify_run(&how, verdict, err);
}

static inline int bench_verify(struct gsn_store *store, int64_t run,
                               const struct gsn_job_options *options, struct gsn_verdict *verdict,
                               struct gsn_error *err)
{
    struct heard heard;

    return bench_verify_loudly(store, run, options, &heard, verdict, err);
}

#endif
