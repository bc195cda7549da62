/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What giesond does all its life: keeps the sources served and the queue worked, and reads its
 * configuration again when it is told to. */
#ifndef GSN_SYSTEMD_DAEMON_H
#define GSN_SYSTEMD_DAEMON_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_DAEMON_WATCHED = 32 };

/* What the command line says; store_dir may be NULL or empty: the configuration's. */
struct gsn_daemon_request {
    const char *store_dir, *config;
    const char *watched[GSN_DAEMON_WATCHED];
    size_t watched_count;
    unsigned parts; /* GSN_STATUS_INTAKE, GSN_STATUS_QUEUE or both */
};

/* Serves until SIGTERM or SIGINT; SIGHUP reads the configuration again. Returns the exit status;
 * why it is not 0 is in the journal. borrows: request. */
int gsn_daemon_run(const struct gsn_daemon_request *request);

#ifdef __cplusplus
}
#endif
#endif
