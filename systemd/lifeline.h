/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What ties the process of one source to the service: a pipe that it breathes into, and the signal
 * that ends it.
 *
 * The signal is waited for by a thread of its own, because a driver may hang: it asks the process
 * to stop through a descriptor, and two seconds later ends it where it stands. Nothing is lost by
 * that, for nothing was acknowledged that is not durable. */
#ifndef GSN_SYSTEMD_LIFELINE_H
#define GSN_SYSTEMD_LIFELINE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

enum {
    GSN_BREATH = 'b',         /* alive */
    GSN_READY = 'r',          /* alive, and the source answers */
    GSN_INTAKE_STOPPED = 143, /* the exit status of who was asked to stop, as a shell says it */
};

struct gsn_lifeline;

/* Takes SIGTERM and SIGINT away from the process; to be called before any other thread is made.
 * heartbeat_fd -1: nobody listens. gives. */
int gsn_lifeline_new(int heartbeat_fd, struct gsn_lifeline **ret_line, struct gsn_error *err);
void gsn_lifeline_free(struct gsn_lifeline *line);
GSN_DEFINE_AUTO(gsn_lifeline);

/* Says that we live; not more often than four times a second, unless what is said changes. */
void gsn_lifeline_breathe(struct gsn_lifeline *line, char what);

/* Whether it is time to stop: we were asked to, or who listened is gone. */
int gsn_lifeline_is_over(const struct gsn_lifeline *line);

/* Can be read once it is time to stop. */
int gsn_lifeline_fd(const struct gsn_lifeline *line);

/* Milliseconds of a clock that never goes back. */
int64_t gsn_now_ms(void);

#endif
