/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One folder while it is imported; for the files of systemd/import.h alone. */
#ifndef GSN_SYSTEMD_IMPORT_PARTS_H
#define GSN_SYSTEMD_IMPORT_PARTS_H

#include "acquire/spool.h"
#include "pipeline/protocol.h"
#include "systemd/import.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_import_work {
    const struct gsn_import *import;
    const struct gsn_protocol *protocol;
    struct gsn_spool *spool;
    int64_t specimen;
    struct gsn_import_counts counts;
    char **left; /* owned; paths of what was left out, as many as counted */
};

/* import_left.c: what is left out, and what was once. */

/* Counts it, tells it, and puts its row unless a source does. Fails as the store does. */
int gsn_import_leave_out(struct gsn_import_work *in, const char *name, const char *reason,
                         const char *action, struct gsn_error *err);
/* Ends the trouble of what was left out once and is taken now or gone. Fails as the store does. */
int gsn_import_forget_left(struct gsn_import_work *in, struct gsn_error *err);

/* import_check.c: what can be told before anything is written. */

/* Keys, units and plausible lengths. Fails with GSN_E_INPUT, and as reading a header does. */
int gsn_import_check_job(const struct gsn_import *import, const struct gsn_protocol *protocol,
                         struct gsn_error *err);
/* What will be withheld, and which panels are missing, as notices. Fails as the store does. */
int gsn_import_tell_job(const struct gsn_import_work *in, struct gsn_error *err);

/* import_files.c: the files that the job names. */

/* Before anything is written: a job that must be corrected leaves no specimen of its name. Fails
 * with GSN_E_INPUT, GSN_E_NOMEM. */
int gsn_import_check_files(const struct gsn_import *import, const struct gsn_protocol *protocol,
                           struct gsn_error *err);
/* Each of them, and what the header of a volume names, into the spool and the store. Fails with
 * GSN_E_INPUT, and as the spool and the store do. */
int gsn_import_attach_files(struct gsn_import_work *in, const struct gsn_protocol *protocol,
                            struct gsn_error *err);

/* import_panels.c: all pictures of the folder become panels. Fails with GSN_E_BUSY when the folder
 * keeps changing, and as the source, the spool and the store do. */
int gsn_import_take_panels(struct gsn_import_work *in, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
