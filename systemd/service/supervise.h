/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Keeps one gieson-intake alive per source of the configuration.
 *
 * One that ends is started again: at once when somebody killed it; later each time, up to a
 * minute, while it fails by itself; when its device is away, once the kernel reports something in
 * that subsystem, and every minute. One whose heartbeats stop for its watchdog timeout
 * (PatienceS) hangs in a driver and is killed. */
#ifndef GSN_SYSTEMD_SERVICE_SUPERVISE_H
#define GSN_SYSTEMD_SERVICE_SUPERVISE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "storage/store.h"
#include "systemd/service/config.h"

#include <systemd/sd-event.h>

struct gsn_supervisor;

/* keeps: loop and store. gives. Fails with GSN_E_NOTFOUND when gieson-intake is not there. */
int gsn_supervisor_new(sd_event *loop, struct gsn_store *store,
                       struct gsn_supervisor **ret_supervisor, struct gsn_error *err);
/* Kills what is left. */
void gsn_supervisor_free(struct gsn_supervisor *supervisor);
GSN_DEFINE_AUTO(gsn_supervisor);

/* Makes the processes those of this configuration: what stayed as it was is left alone.
 * keeps nothing of config. */
int gsn_supervisor_set(struct gsn_supervisor *supervisor, const struct gsn_config *config,
                       struct gsn_error *err);

/* Something came in this subsystem: whoever waits for a device there looks again, now. */
void gsn_supervisor_arrival(struct gsn_supervisor *supervisor, const char *subsystem);

/* Asks all to stop and starts none again; those that do not within a bound are killed. */
void gsn_supervisor_stop(struct gsn_supervisor *supervisor);

/* How many processes there are. */
size_t gsn_supervisor_running(const struct gsn_supervisor *supervisor);

#endif
