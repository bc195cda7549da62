/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Takes a folder as a scanner delivers it into the store: job.json, the panels beside it and the
 * files the job names. Original bytes first, then rows, then jobs; nothing at the source is
 * touched.
 */
#ifndef GSN_SYSTEMD_WORKER_IMPORT_H
#define GSN_SYSTEMD_WORKER_IMPORT_H

#include "storage/store.h"

#include <stdint.h>

struct gsn_import {
    struct gsn_store *store;
    const char *dir;      /* the folder */
    const char *job_text; /* instead of DIR/job.json, or NULL */
    int replace;          /* a specimen of the same name takes the new settings */
    const char *actor;    /* who asked, for the events */
    /* Told about every file that is not simply taken; may be NULL. */
    void (*notice)(void *context, const char *name, const char *sentence);
    /* Told about every file that could not be taken, and what a person must do; may be NULL. */
    void (*left_out)(void *context, const char *name, const char *reason, const char *action);
    void *context;
    int served; /* by a source that looks into the folder itself, and keeps the rows of trouble */
};

struct gsn_import_counts {
    unsigned taken, again, held; /* panels: new, same bytes as before, without a usable number */
    unsigned attached;           /* masks, volumes, pictures that the job names */
    unsigned left_out;           /* files that could not be taken; the rest was */
};

/* What is left out is also a row of trouble of the source GSN_IMPORT_SOURCE, by its whole path,
 * until an import finds it taken or gone. */
#define GSN_IMPORT_SOURCE "import"

/* ret_specimen: gives the specimen's name. Fails with GSN_E_NOTFOUND when there is no job.json,
 * GSN_E_INPUT when it is wrong or names a file that is not there, and as the spool and the store
 * do; what was durable by then stays, and importing again goes on from there. */
int gsn_import_folder(const struct gsn_import *import, char **ret_specimen,
                      struct gsn_import_counts *ret_counts, struct gsn_error *err);

#endif
