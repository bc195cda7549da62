/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A night's work as jobs of Slurm: an array whose tasks share the queue, and one job after it. */
#ifndef GSN_UI_SLURM_H
#define GSN_UI_SLURM_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>

struct gsn_slurm_night {
    const char *store_dir; /* absolute */
    const char *began;     /* handed to `night --share` and `night --rest` */
    const char *threads;   /* of a task, in digits; NULL or "0": all processors of a node */
    size_t specimens; /* with work to do: a task for each, but no more than Slurm's default takes */
};

struct gsn_slurm_jobs {
    size_t tasks;
    char *share, *rest; /* Slurm's numbers: of the array, and of the job after it; owned */
};

void gsn_slurm_jobs_done(struct gsn_slurm_jobs *jobs);

/* Submits both. Fails with GSN_E_PROCESS (sbatch is not there, or refuses: its first line is in the
 * sentence), GSN_E_NOTFOUND, GSN_E_NOMEM. gives: *ret_jobs, for gsn_slurm_jobs_done(). */
int gsn_slurm_submit(const struct gsn_slurm_night *night, struct gsn_slurm_jobs *ret_jobs,
                     struct gsn_error *err);

#endif
