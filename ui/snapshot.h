/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The store at one moment, as rows a person or a script would read: what comes in, what needs a
 * person, and one row per specimen, with the state of its work in a word and the next action as a
 * command. */
#ifndef GSN_UI_SNAPSHOT_H
#define GSN_UI_SNAPSHOT_H

#include "storage/bench.h"
#include "storage/result.h"
#include "storage/queue.h"
#include "storage/scan.h"
#include "storage/store.h"

struct gsn_snapshot_row {
    int64_t id;
    char *name, *group; /* owned */
    const char *state;  /* "waiting", "working", "reported", "withheld" or "failed" */
    char *detail;       /* owned; stage and progress, or the sentence of a refusal, or NULL */
    char *progress;     /* owned; of its own job while that runs, as gsn_look_progress(), or NULL */
    char *action;       /* owned; the command to give next, or NULL when there is nothing to do */
    unsigned panels, panels_registered, panels_refused;
    unsigned sections, sections_found;
    double loss_percent, loss_lower, loss_upper; /* NaN: none */
    double mean_density;                         /* NaN: none */
    int64_t run;                                 /* latest finished run; 0: none */
    char *report;                                /* owned; path of its HTML, or NULL */
    int64_t changed;                             /* when something last happened; 0: unknown */
};

/* Whether it has any: a volume or a single picture has none to count. */
static inline int gsn_snapshot_has_panels(const struct gsn_snapshot_row *row)
{
    return row->panels > 0 || row->sections > 0;
}

struct gsn_snapshot {
    size_t count;
    struct gsn_snapshot_row *at; /* in order of id */
    struct gsn_job_counts jobs;
    struct gsn_open_panel_rows *panels; /* what is not settled, by specimen */
    struct gsn_doubt_rows *doubts;      /* sections that need an eye, by specimen */
    struct gsn_bench_sources *sources;
    struct gsn_trouble_rows *troubles;
    struct gsn_scan_rows *unfiled;
    int64_t unsettled; /* pictures that are safe and in no list yet */
    int intake, queue; /* 1: giesond takes panels in, works the queue; 0: it does not */
};

/* gives. Fails as the store does. */
int gsn_snapshot_take(struct gsn_store *store, struct gsn_snapshot **ret_snapshot,
                      struct gsn_error *err);
void gsn_snapshot_free(struct gsn_snapshot *snapshot);
GSN_DEFINE_AUTO(gsn_snapshot);

/* Who serves the store in this directory: 1 or 0 each. Fails with GSN_E_NOMEM. */
int gsn_snapshot_services(const char *dir, int *ret_intake, int *ret_queue, struct gsn_error *err);

/* gives: the command that says where a scan belongs, quoted for a shell; specimen NULL: that is to
 * be said too. NULL when memory runs out. */
char *gsn_snapshot_file_command(int64_t scan, const char *specimen);

#endif
