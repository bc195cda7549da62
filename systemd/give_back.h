/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A worker that is asked to end gives its job back first.
 *
 * A job whose worker dies too often is given up, because it may be what kills them. A worker that
 * ends because its service was stopped, was killed or crashed says nothing about its job, and the
 * service may be in no state to say so itself. So the worker does: a thread of its own waits for
 * SIGTERM, SIGINT and SIGHUP, since mathematics does not look for them, puts the job back to
 * waiting and lets the signal end the process. Whom SIGKILL or a fault ends dies with its job. */
#ifndef GSN_SYSTEMD_GIVE_BACK_H
#define GSN_SYSTEMD_GIVE_BACK_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_give_back;

/* Takes the three signals away from the process, but for SIGINT and SIGHUP where they are ignored;
 * to be called before any other thread is made and before a job is claimed. gives. */
int gsn_give_back_new(const char *store_dir, struct gsn_give_back **ret_watch,
                      struct gsn_error *err);
void gsn_give_back_free(struct gsn_give_back *watch);
GSN_DEFINE_AUTO(gsn_give_back);

#ifdef __cplusplus
}
#endif

#endif
