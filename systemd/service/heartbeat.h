/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The heartbeat pipe of a child: bytes that say it lives, and the signal that ends it.
 *
 * The signal is waited for by a thread of its own, because a driver may hang: it asks the process
 * to stop through a descriptor, and two seconds later ends it where it stands. Nothing is lost by
 * that, for nothing was acknowledged that is not durable. */
#ifndef GSN_SYSTEMD_SERVICE_HEARTBEAT_H
#define GSN_SYSTEMD_SERVICE_HEARTBEAT_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

enum {
    GSN_HEARTBEAT_ALIVE = 'b', /* alive */
    GSN_HEARTBEAT_READY = 'r', /* alive, and the source answers */
    GSN_INTAKE_STOPPED = 143,  /* the exit status of who was asked to stop, as a shell says it */
};

struct gsn_heartbeat;

/* Takes SIGTERM and SIGINT away from the process; to be called before any other thread is made.
 * heartbeat_fd -1: nobody listens. gives. */
int gsn_heartbeat_new(int heartbeat_fd, struct gsn_heartbeat **ret_heartbeat,
                      struct gsn_error *err);
void gsn_heartbeat_free(struct gsn_heartbeat *heartbeat);
GSN_DEFINE_AUTO(gsn_heartbeat);

/* Says that we live; not more often than four times a second, unless what is said changes. */
void gsn_heartbeat_beat(struct gsn_heartbeat *heartbeat, char what);

/* Whether it is time to stop: we were asked to, or who listened is gone. */
int gsn_heartbeat_is_over(const struct gsn_heartbeat *heartbeat);

/* Can be read once it is time to stop. */
int gsn_heartbeat_fd(const struct gsn_heartbeat *heartbeat);

#endif
