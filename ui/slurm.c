/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Hands a night to Slurm with its own program sbatch.
 *
 * Steps. 1. A job array (`sbatch --array`): a task for each specimen that has work to do. The tasks
 * are alike: each runs `gieson night --share`, which does the next job that waits until none does.
 * So none of them holds a node for a specimen whose baseline is still computed, and the jobs of a
 * task that never comes are done by the others. 2. One job after all of them, however they ended
 * (--dependency=afterany): `gieson night --rest` does what they left, and makes the pages.
 *
 * sbatch is started as a program with a list of arguments. It takes nothing but a script, so there
 * is one of two lines, gieson-slurm-task, that becomes the program given behind it. What a site
 * wants beyond this (partition, account, time) is told to sbatch by its own variables
 * (SBATCH_PARTITION, ...).
 *
 * When a node fails Slurm starts its task anew (--requeue); its worker's lease is found dead before
 * that, by the next claim (storage/queue.c).
 *
 * Failure: the sentence of sbatch. Cost: two programs started. */
#include "ui/slurm.h"

#include <string.h>

#include "pipeline/core/process.h"

enum {
    MOST_TASKS = 1000, /* MaxArraySize of slurm.conf(5) is 1001 where nothing is said */
    PATIENCE_S = 300,  /* sbatch tries for a while where the controller is away */
};

void gsn_slurm_jobs_done(struct gsn_slurm_jobs *jobs)
{
    gsn_free(jobs->share);
    gsn_free(jobs->rest);
}

/* sbatch --parsable prints "NUMBER" or "NUMBER;CLUSTER". */
static int take_number(char *answer, char **ret_number, struct gsn_error *err)
{
    const size_t digits = strspn(answer, "0123456789");

    if (digits == 0 || !strchr(";\n", answer[digits]))
        return gsn_fail(err, GSN_E_PROCESS, "sbatch answered no number of a job: %.80s", answer);
    answer[digits] = '\0';
    *ret_number = answer;
    return GSN_OK;
}

/* what: "--share" or "--rest"; where: the option of sbatch that tells the two apart. */
static int submit_job(const struct gsn_slurm_night *night, const char *where, const char *what,
                      char **ret_number, struct gsn_error *err)
{
    const int has_threads = night->threads && strcmp(night->threads, "0") != 0;
    const struct gsn_process_limits limits = { .wall_s = PATIENCE_S, .answer_bytes = 1 << 16 };
    gsn_auto_mem(char) task = NULL;
    gsn_auto_mem(char) gieson = NULL;
    gsn_auto_mem(char) folder = gsn_format("--chdir=%s", night->store_dir);
    gsn_auto_mem(char) processors =
        has_threads ? gsn_format("--cpus-per-task=%s", night->threads) : gsn_strdup("--exclusive");
    uint8_t *answer = NULL;
    size_t size;
    int r = gsn_process_sibling("gieson-slurm-task", &task, err);

    if (r >= 0)
        r = gsn_process_sibling("gieson", &gieson, err);
    if (r < 0)
        return r;
    if (!folder || !processors)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for sbatch");
    /* env looks for sbatch along the PATH. "\\" in front of the log: no '%' in its path is a
     * pattern. */
    const char *const argv[] = { "/usr/bin/env",
                                 "sbatch",
                                 "--parsable",
                                 "--requeue",
                                 "--job-name=gieson-night",
                                 folder,
                                 "--output=\\night.log",
                                 "--open-mode=append",
                                 processors,
                                 where,
                                 task,
                                 gieson,
                                 "--store",
                                 night->store_dir,
                                 "night",
                                 what,
                                 night->began,
                                 has_threads ? "--threads" : NULL,
                                 night->threads,
                                 NULL };

    r = gsn_process_ask(argv, &limits, NULL, 0, &answer, &size, err);
    if (r < 0)
        return gsn_fail_at(err,
                           "Slurm's sbatch took no job (Debian has it in slurm-client; `sinfo` "
                           "says whether a cluster answers)");
    r = take_number((char *)answer, ret_number, err);
    if (r < 0)
        gsn_free(answer);
    return r;
}

int gsn_slurm_submit(const struct gsn_slurm_night *night, struct gsn_slurm_jobs *ret_jobs,
                     struct gsn_error *err)
{
    const size_t tasks = night->specimens < MOST_TASKS ? night->specimens : MOST_TASKS;
    gsn_auto_mem(char) array = gsn_format("--array=1-%zu", tasks);
    gsn_auto_mem(char) share = NULL;
    gsn_auto_mem(char) after = NULL;
    char *rest = NULL;
    int r;

    if (!array)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for sbatch");
    r = submit_job(night, array, "--share", &share, err);
    if (r < 0)
        return r;
    after = gsn_format("--dependency=afterany:%s", share);
    r = after ? submit_job(night, after, "--rest", &rest, err)
              : gsn_fail(err, GSN_E_NOMEM, "out of memory for sbatch");
    if (r < 0)
        return gsn_fail_at(err, "Slurm computes (job %s), but nothing makes the pages after it",
                           share);
    *ret_jobs = (struct gsn_slurm_jobs){ tasks, gsn_steal(&share), rest };
    return GSN_OK;
}
