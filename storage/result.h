/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What was computed, from which inputs, by which version: runs with their measures, poses and
 * stain batches.
 *
 * A derived row names its run and a run names its inputs, so a percentage can be walked back to
 * pixels. Rows of a finished run never change; a new computation is a new run. */
#ifndef GSN_STORAGE_RESULT_H
#define GSN_STORAGE_RESULT_H

#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Texts may be empty but never NULL. Paths are relative to the store's directory. */
struct gsn_run_row {
    int64_t id, specimen_id;
    const char *key; /* SHA-256 text of inputs, parameters and version */
    const char *version;
    const char *inputs_json, *parameters_json;
    const char *state;   /* "running", "reported", "withheld", "failed" */
    const char *message; /* why withheld or failed, or empty */
    const char *report_path, *report_sha256;
    const char *json_path, *json_sha256;
    const char *event_head;    /* where the audit log ended before this run did, or empty */
    int64_t started, finished; /* finished is 0 while running */
};

struct gsn_run_rows {
    size_t count;
    struct gsn_run_row *at;
};

void gsn_run_row_free(struct gsn_run_row *row);

GSN_DEFINE_AUTO(gsn_run_row);

void gsn_run_rows_free(struct gsn_run_rows *rows);

GSN_DEFINE_AUTO(gsn_run_rows);

/* One figure; run_id is not read when given to gsn_run_finish(). */
struct gsn_measure_row {
    int64_t run_id;
    const char *name;           /* unique in its run */
    double value, lower, upper; /* NaN: none */
    const char *unit;
};

struct gsn_measure_rows {
    size_t count;
    struct gsn_measure_row *at;
};

void gsn_measure_rows_free(struct gsn_measure_rows *rows);

GSN_DEFINE_AUTO(gsn_measure_rows);

/* Where a section lies in the block: x_um = m00 x_px + m01 y_px + m02, y_um likewise. It keeps the
 * place on the panel and not the section's row, which a new registration replaces. */
struct gsn_pose_row {
    int64_t run_id, panel_id, slot, serial;
    double m00, m01, m02, m10, m11, m12;
    int64_t flipped, rotated180; /* 0 or 1 */
    double rms_um;               /* left over at the marks */
    double tre_um;               /* predicted at the region; NaN: none */
};

struct gsn_pose_rows {
    size_t count;
    struct gsn_pose_row *at;
};

void gsn_pose_rows_free(struct gsn_pose_rows *rows);

GSN_DEFINE_AUTO(gsn_pose_rows);

/* The colours one panel was read with. */
struct gsn_stain_row {
    int64_t run_id, panel_id;
    double white[3];    /* linear light of the blank glass: red, green, blue */
    double vector[9];   /* three dyes, each as optical density in red, green, blue */
    const char *source; /* where the vectors come from, in words */
};

struct gsn_stain_rows {
    size_t count;
    struct gsn_stain_row *at;
};

void gsn_stain_rows_free(struct gsn_stain_rows *rows);

GSN_DEFINE_AUTO(gsn_stain_rows);

/* Starts a run: reads specimen_id, key, version, inputs_json and parameters_json. An earlier run
 * of the specimen that is still "running" was left by a dead worker and becomes "failed". */
int gsn_run_begin(struct gsn_store *store, const struct gsn_run_row *run, int64_t now,
                  int64_t *ret_id, struct gsn_error *err);

/* Everything a finished run leaves. borrows. NULL texts stand for empty. */
struct gsn_run_end {
    const char *state; /* "reported", "withheld" or "failed" */
    const char *message;
    const char *report_path, *report_sha256;
    const char *json_path, *json_sha256;
    const char *event_head;
    const struct gsn_measure_row *measures;
    size_t measure_count;
    const struct gsn_pose_row *poses;
    size_t pose_count;
    const struct gsn_stain_row *stains;
    size_t stain_count;
};

/* Ends a running run: its row, measures, poses, stain batches and seal (audit.h) in one
 * transaction. Fails with GSN_E_NOTFOUND when there is no such run, GSN_E_INPUT when it is not
 * running or a value is not allowed; then nothing was written. */
int gsn_run_finish(struct gsn_store *store, int64_t run_id, const struct gsn_run_end *end,
                   int64_t now, struct gsn_error *err);

/* gives: the specimen's latest run in this state; NULL: in any. Fails with GSN_E_NOTFOUND. */
int gsn_run_latest(struct gsn_store *store, int64_t specimen_id, const char *state,
                   struct gsn_run_row **ret_run, struct gsn_error *err);

/* gives. Fails with GSN_E_NOTFOUND. */
int gsn_run_get(struct gsn_store *store, int64_t id, struct gsn_run_row **ret_run,
                struct gsn_error *err);

/* gives: the specimen's runs (0: of all specimens), oldest first. */
int gsn_run_list(struct gsn_store *store, int64_t specimen_id, struct gsn_run_rows **ret_rows,
                 struct gsn_error *err);

/* gives: the specimen's last run that left a report. Fails with GSN_E_NOTFOUND, and the sentence
 * says whether there is no such specimen or no report yet. */
int gsn_run_latest_report(struct gsn_store *store, const char *specimen_name,
                          struct gsn_run_row **ret_run, struct gsn_error *err);

/* give: in the order they were written. */
int gsn_measure_list(struct gsn_store *store, int64_t run_id, struct gsn_measure_rows **ret_rows,
                     struct gsn_error *err);

int gsn_pose_list(struct gsn_store *store, int64_t run_id, struct gsn_pose_rows **ret_rows,
                  struct gsn_error *err);

int gsn_stain_list(struct gsn_store *store, int64_t run_id, struct gsn_stain_rows **ret_rows,
                   struct gsn_error *err);

/* The store at a glance: one row per specimen and one per panel that is not settled, counted by the
 * database so that it stays quick with thousands of panels. */

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
