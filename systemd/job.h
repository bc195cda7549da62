/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One job of the queue, from claim to commit: rows and objects go into the pipeline, its results
 * come back as rows and files. A worker that dies anywhere leaves a job that another one redoes. */
#ifndef GSN_SYSTEMD_JOB_H
#define GSN_SYSTEMD_JOB_H

#include "storage/store.h"

#include <stdint.h>

struct gsn_job_options {
    const char *mesher;  /* path of gieson-mesh */
    const char *decoder; /* path of gieson-decode; NULL: pictures are decoded in this process */
    /* What is missing, where it was looked for and what to do, of a program that is not there;
     * NULL: it is there. */
    const char *lacks_mesher, *lacks_decoder;
    const char *owner; /* who works, for people */
    unsigned threads;  /* 0: all */
};

/* Claims the next job and does it. A job whose material is bad is done with a refusal in its rows:
 * that is success here. One that needs a program that is not there fails at once with that
 * sentence, and the next job is not kept waiting by it. Fails with GSN_E_NOTFOUND (the queue is
 * empty), GSN_E_BUSY (only running jobs are left, or this one was taken away), and otherwise with
 * what made the job itself fail, which its row says too. */
int gsn_job_next(struct gsn_store *store, const struct gsn_job_options *options,
                 struct gsn_error *err);

/* Whether the programs are there that a job needs. Asked before the work begins: a specimen would
 * come to its mesher after hours. */
int gsn_job_check_programs(const struct gsn_job_options *options, int meshes,
                           struct gsn_error *err);

#endif
