/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the service says of itself: to the journal with fields, when its stderr is the journal; else
 * as lines on stderr. */
#ifndef GSN_SYSTEMD_SERVICE_LOG_H
#define GSN_SYSTEMD_SERVICE_LOG_H

#include <stdint.h>
#include <syslog.h> /* LOG_ERR, LOG_WARNING, LOG_NOTICE, LOG_INFO */

/* Kinds of message worth a search: journalctl MESSAGE_ID=... */
#define GSN_LOG_ARRIVED "5f0c3a5e4e2b4f0f9a0d7e2f6c1b8a31"  /* a scan is in the ledger */
#define GSN_LOG_TROUBLE "0b9d7e3c2a614c62b1f4a87d5e90c6f2"  /* something could not be taken in */
#define GSN_LOG_AWAY "c41e8a6f7d5349a0b3c2d9e15f7a6b84"     /* a source's device is away */
#define GSN_LOG_PAUSED "8a7b2f1d9c3e4e5fa6d0b4c8e2f19375"   /* the disk is below its reserve */
#define GSN_LOG_HUNG "e3d2c1b0a9f84765b4c3d2e1f0a98b7c"     /* a silent process was killed */
#define GSN_LOG_JOB_LATE "29f4c6d8e0a14b3795c7d1e3f5a7b9c0" /* a job ran into its limit */

/* What a message is about; empty or NULL texts and a scan of 0 are left out. */
struct gsn_log_about {
    const char *id; /* GSN_LOG_... */
    const char *source, *specimen;
    int64_t scan;
};

void gsn_log(int priority, const struct gsn_log_about *about, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

#endif
