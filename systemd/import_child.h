/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Has gieson-work take in a specimen's folder, because that needs the pipeline's reading of
 * job.json, and waits for it without losing breath. */
#ifndef GSN_SYSTEMD_IMPORT_CHILD_H
#define GSN_SYSTEMD_IMPORT_CHILD_H

#include "systemd/lifeline.h"

struct gsn_import_child {
    const char *worker, *store_dir; /* borrowed */
    const char *source, *folder;
    int again; /* it failed before: what it says was told then */
    struct gsn_lifeline *line;
    int64_t patience_ms; /* how long it may neither compute nor read nor write */
};

/* Runs it to its end. What it says goes to the log; its last line is the sentence when it fails.
 * Files that it left out are for who looks into the folder to tell. Fails with GSN_E_BUSY when the
 * folder still changes or we were asked to stop, GSN_E_PROCESS when it cannot be run or hangs and
 * was ended, GSN_E_DENIED when it may not read what the folder needs, GSN_E_IO when a disk or the
 * store refused, and GSN_E_INPUT when it refused. One that cannot even be ended costs us our
 * breath, so that whoever watches us notices. */
int gsn_import_child_run(const struct gsn_import_child *child, struct gsn_error *err);

#endif
