/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The folders inside a hot folder that hold a job.json: each is a specimen, taken in as a whole by
 * `gieson-work import` whenever something new in it is ready and nothing in it still changes. What
 * can be had comes in without what cannot. A folder with pictures that has no job.json when the
 * patience is over, or one that cannot be looked into, is told. */
#ifndef GSN_SYSTEMD_INGEST_SPECIMEN_FOLDERS_H
#define GSN_SYSTEMD_INGEST_SPECIMEN_FOLDERS_H

#include "acquire/source.h"
#include "systemd/service/heartbeat.h"

#include <stdint.h>

struct gsn_specimen_folders;

/* Who is told what a person must change, by the name below the root ("S01/P02.tif", "S01"), and
 * when that is over. A failure ends the look. */
struct gsn_specimen_ear {
    int (*barred)(void *context, const char *name, const char *reason, const char *action,
                  struct gsn_error *err);
    int (*over)(void *context, const char *name, struct gsn_error *err);
    void *context;
};

/* gives. The times are those of gsn_source_options. keeps: the ear. */
int gsn_specimen_folders_new(const char *root, int64_t settle_ms, int64_t patience_ms,
                             const struct gsn_specimen_ear *ear,
                             struct gsn_specimen_folders **ret_folders, struct gsn_error *err);

void gsn_specimen_folders_free(struct gsn_specimen_folders *folders);

GSN_DEFINE_AUTO(gsn_specimen_folders);

/* One that is due for an import. */
struct gsn_specimen_due {
    const char *path, *name; /* borrowed until the folder vanishes */
    uint64_t bytes;          /* that are ready */
    int again;               /* the last import failed, and no person has changed job.json since */
    size_t index;
};

/* Looks at all of them. ret_due: gives the first that is due after the one of index `after` (-1:
 * from the beginning), else its path is NULL. A folder that vanished is forgotten. */
int gsn_specimen_folders_next(struct gsn_specimen_folders *folders, int64_t now_ms, long after,
                              struct gsn_specimen_due *ret_due, struct gsn_error *err);

/* What came of the import: it is done, and what was ready is acknowledged; or it is tried again,
 * later each time. */
void gsn_specimen_folders_done(struct gsn_specimen_folders *folders, size_t index);

void gsn_specimen_folders_failed(struct gsn_specimen_folders *folders, size_t index,
                                 int64_t now_ms);

/* Whether in any something changes or is to be taken. */
int gsn_specimen_folders_is_busy(const struct gsn_specimen_folders *folders);

/* Has gieson-work take in a specimen's folder, because that needs the pipeline's reading of
 * job.json, and waits for it while its heart beats on. */

struct gsn_import_child {
    const char *worker, *store_dir; /* borrowed */
    const char *source, *folder;
    int again; /* it failed before: what it says was told then */
    struct gsn_heartbeat *heartbeat;
    int64_t patience_ms; /* how long it may neither compute nor read nor write */
};

/* Runs it to its end. What it says goes to the log; its last line is the sentence when it fails.
 * Files that it left out are for who looks into the folder to tell. Fails with GSN_E_BUSY when the
 * folder still changes or we were asked to stop, GSN_E_PROCESS when it cannot be run or hangs and
 * was ended, GSN_E_DENIED when it may not read what the folder needs, GSN_E_IO when a disk or the
 * store refused, and GSN_E_INPUT when it refused. One that cannot even be ended costs us our
 * heartbeat, so that whoever watches us notices. */
int gsn_import_child_run(const struct gsn_import_child *child, struct gsn_error *err);

#endif
