/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the files of the queue share. For queue.c and queue_claim.c alone. */
#ifndef GSN_STORAGE_QUEUE_PARTS_H
#define GSN_STORAGE_QUEUE_PARTS_H

#include "storage/queue.h"

/* What a job is like before anybody claims it. claim and owner stay: they are its history. */
#define GSN_QUEUE_FRESH                                                                            \
    "state = 'waiting', again = 0, boot = '', processes = '', pid = 0, pid_start = 0, "            \
    "lease_s = 0, lease_until = 0, stage = '', done = 0, total = 0, eta_s = NULL, "                \
    "message = '', code = '' "

/* The job of that number; GSN_E_NOTFOUND. returns: an owned row. */
int gsn_queue_job(struct gsn_store *store, int64_t id, struct gsn_job_row **ret_job,
                  struct gsn_error *err);

#endif
