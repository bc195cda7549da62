/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Work to do, and who is at it.
 *
 * A panel job registers one panel; a specimen job takes all panels of a specimen to its report.
 * There is one row per (kind, specimen, panel): asking twice is asking once. A worker holds a
 * lease that its progress renews; when the lease runs out, or its process is gone, the job goes
 * back to waiting. Claims are ordered: panel jobs first, by id; then specimen jobs by id, each
 * after its own panel jobs and after all jobs of the specimens its baseline stands for. Specimens
 * that wait for each other in a circle go by id. */
#ifndef GSN_STORAGE_QUEUE_H
#define GSN_STORAGE_QUEUE_H

#include "pipeline/core/error.h"
#include "storage/store.h"

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_queue_rule {
    GSN_QUEUE_DEATHS = 5, /* a job whose worker died this often is given up */
};

struct gsn_job_row {
    int64_t id;
    const char *kind; /* "panel" or "specimen" */
    int64_t specimen_id;
    int64_t panel_id;     /* 0 for a specimen job */
    const char *specimen; /* its name */
    const char *panel;    /* its file name, or empty */
    const char *state;    /* "waiting", "running", "done", "failed" */
    int64_t again;        /* 1: asked for again while running, so it will be redone */
    int64_t attempts;     /* workers that died on it, and not with the whole machine */
    int64_t claim;        /* counts the claims; tells an old owner that it lost the job */
    const char *owner;    /* who runs it, or ran it last */
    int64_t pid;          /* its process; 0 when not running */
    int64_t lease_until;  /* by gsn_queue_clock(); 0 when not running */
    const char *stage;    /* empty before the first progress */
    int64_t done, total;
    double eta_s;        /* seconds left; NaN: unknown */
    const char *message; /* why it failed, or empty */
    const char *code;    /* gsn_code_name() of that, or empty */
};

struct gsn_job_rows {
    size_t count;
    struct gsn_job_row *at;
};

void gsn_job_row_free(struct gsn_job_row *row);

GSN_DEFINE_AUTO(gsn_job_row);

void gsn_job_rows_free(struct gsn_job_rows *rows);

GSN_DEFINE_AUTO(gsn_job_rows);

/* Asks for a job; panel_id 0 means the specimen job. A waiting one stays as it is, a running one
 * will be redone, a done or failed one waits again. Fails with GSN_E_INPUT when there is no such
 * specimen or the panel is not one of its panels. */
int gsn_queue_add(struct gsn_store *store, int64_t specimen_id, int64_t panel_id, int64_t *ret_id,
                  struct gsn_error *err);

/* Asks for a specimen's job where nobody ever did; one that is there stays as it is. */
int gsn_queue_add_first(struct gsn_store *store, int64_t specimen_id, struct gsn_error *err);

/* Seconds since this machine was started, sleep included: leases are counted by a clock that nobody
 * sets, so that a wrong date put right takes no job from its worker. */
int64_t gsn_queue_clock(void);

/* Which start of which machine this is, as the kernel names it; empty where it does not say. A
 * store is worked on by one machine: other processes on it can be seen, and SQLite's WAL lies in
 * its memory. */
enum { GSN_QUEUE_BOOT_SIZE = 40 };

void gsn_queue_boot(char ret_boot[GSN_QUEUE_BOOT_SIZE]);

/* gives: the job to do next, now running under the lease of owner (words for people) and pid.
 *
 * First takes back what dead owners left: leases that ran out, and leases of processes that are
 * gone on this machine (by boot, process id and its start time). Who went down with the machine is
 * no death of the job, however often its power is cut. Fails with GSN_E_NOTFOUND "the
 * queue is empty", GSN_E_BUSY when what waits must wait for running jobs, or only those are left.
 * lease_s > 0; now is gsn_queue_clock(). */
int gsn_queue_claim(struct gsn_store *store, const char *owner, pid_t pid, int64_t lease_s,
                    int64_t now, struct gsn_job_row **ret_job, struct gsn_error *err);

/* Tells how far a claimed job is, and renews its lease. eta_s NaN: unknown.
 *
 * This and the three below fail with GSN_E_BUSY when the job is no longer this claim's: the worker
 * must then stop and write nothing. */
int gsn_queue_progress(struct gsn_store *store, const struct gsn_job_row *job, const char *stage,
                       int64_t done, int64_t total, double eta_s, int64_t now,
                       struct gsn_error *err);

/* Done; or waiting again when it was asked for meanwhile. */
int gsn_queue_done(struct gsn_store *store, const struct gsn_job_row *job, struct gsn_error *err);

/* Failed with this code (enum gsn_code) and sentence; or waiting again when asked for meanwhile. */
int gsn_queue_fail(struct gsn_store *store, const struct gsn_job_row *job, int code,
                   const char *message, struct gsn_error *err);

/* Given back undone, because the service stops: it waits again, and no death is counted. */
int gsn_queue_release(struct gsn_store *store, const struct gsn_job_row *job,
                      struct gsn_error *err);

/* gives: the running job that this process of this machine claimed. Fails with GSN_E_NOTFOUND. */
int gsn_queue_of_process(struct gsn_store *store, pid_t pid, struct gsn_job_row **ret_job,
                         struct gsn_error *err);

/* Failed jobs of the specimen (0: of all) wait again, their deaths forgotten. ret_count: how many.
 */
int gsn_queue_retry(struct gsn_store *store, int64_t specimen_id, size_t *ret_count,
                    struct gsn_error *err);

/* gives: all jobs, in order of id. */
int gsn_queue_list(struct gsn_store *store, struct gsn_job_rows **ret_rows, struct gsn_error *err);

struct gsn_job_counts {
    int64_t waiting, running, done, failed;
};

int gsn_queue_counts(struct gsn_store *store, struct gsn_job_counts *ret_counts,
                     struct gsn_error *err);

/* For the claim and its test: a specimen with a waiting or running job. */
struct gsn_queue_node {
    int64_t specimen_id, group_id;
    int64_t ready_job; /* its specimen job, when only that is left and waits; else 0 */
    int64_t base_specimen, base_group; /* what its baseline stands for; 0: nothing */
};

/* The lowest ready job that waits for nobody, or only for such as wait for it in turn, all of them
 * ready: without the second a circle of baselines would stand still for ever. ret_job is 0 when
 * there is none, and then something else is running or runs before. Fails with GSN_E_NOMEM. */
int gsn_queue_next_specimen_job(const struct gsn_queue_node *nodes, size_t count, int64_t *ret_job,
                                struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
