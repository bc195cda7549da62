/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The store at a glance: one row per specimen and one per panel that is not settled, counted by the
 * database so that it stays quick with thousands of panels. */
#ifndef GSN_STORAGE_OVERVIEW_H
#define GSN_STORAGE_OVERVIEW_H

#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A job as far as it is not done: "waiting", "running", "failed", or empty when there is none. */
struct gsn_overview_job {
    const char *state;
    const char *stage; /* empty before the first progress */
    int64_t done, total;
    double eta_s;        /* seconds left; NaN: unknown */
    const char *message; /* why it failed, or empty */
};

struct gsn_overview_row {
    int64_t id;
    const char *name, *group;
    int64_t panels, registered, refused; /* refused or held */
    int64_t sections, found;             /* slots that are not empty, and those with a section */
    int64_t run;                         /* the latest; 0: none */
    const char *run_state, *run_message, *report_path; /* its own; empty where there is none */
    double loss, loss_lower, loss_upper, mean_density; /* NaN: none */
    int64_t changed;             /* when a panel last arrived or a run last ended; 0: unknown */
    struct gsn_overview_job job; /* the specimen's own, not its panels' */
};

struct gsn_overview_rows {
    size_t count;
    struct gsn_overview_row *at;
};

void gsn_overview_rows_free(struct gsn_overview_rows *rows);
GSN_DEFINE_AUTO(gsn_overview_rows);

/* gives: all specimens, in order of id. */
int gsn_overview_list(struct gsn_store *store, struct gsn_overview_rows **ret_rows,
                      struct gsn_error *err);

struct gsn_open_panel_row {
    int64_t id, specimen_id;
    int64_t number; /* 0: unknown */
    const char *file_name;
    const char *state, *message; /* of the panel */
    int64_t arrived;             /* 0: unknown */
    int64_t scan;                /* that it came as; 0: it was imported */
    struct gsn_overview_job job;
};

struct gsn_open_panel_rows {
    size_t count;
    struct gsn_open_panel_row *at;
};

void gsn_open_panel_rows_free(struct gsn_open_panel_rows *rows);
GSN_DEFINE_AUTO(gsn_open_panel_rows);

/* gives: panels that are refused or held or whose job is not done, by specimen, number, id. */
int gsn_overview_panels(struct gsn_store *store, struct gsn_open_panel_rows **ret_rows,
                        struct gsn_error *err);

/* A section whose pose a person is to choose: nobody did, or the choice could not be used. */
struct gsn_doubt_row {
    int64_t specimen_id;
    int64_t panel, slot; /* the panel's number, the slot from 1 */
    int64_t serial;      /* from 1; 0: unknown */
    int64_t candidates;  /* poses to choose from */
};

struct gsn_doubt_rows {
    size_t count;
    struct gsn_doubt_row *at;
};

void gsn_doubt_rows_free(struct gsn_doubt_rows *rows);
GSN_DEFINE_AUTO(gsn_doubt_rows);

/* gives: those of all specimens, by specimen, panel, slot. */
int gsn_overview_doubts(struct gsn_store *store, struct gsn_doubt_rows **ret_rows,
                        struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
