/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Keeps the queue served: gieson-work, one process a job, never more at once than allowed.
 *
 * Steps of a look.
 * 1. Jobs that wait are counted; while the disk is below half of its reserve, none is started.
 * 2. A worker is started for each that may run, with limits of memory, processor and time
 * (spawn.h).
 * 3. Its exit says what follows. Done: look again at once. Nothing to claim: put off for 5 s,
 * doubled to a minute, for others are at what is left. Failed within 2 s of its start: put off for
 * 1 s, doubled to a minute, for it has met something that will not pass at once.
 * 4. One that outlives its time is killed, and its job fails with a sentence. One that died leaves
 * a lease that the next claim finds dead; one that is stopped with the service releases its lease
 * first.
 *
 * How it fails: a worker that cannot be started is logged, and tried again later. */
#include "systemd/service/queue_runner.h"

#include <errno.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/statvfs.h>
#include <sys/wait.h>
#include <sysexits.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/calendar.h"
#include "pipeline/core/process.h"
#include "storage/queue.h"
#include "systemd/service/heartbeat.h"
#include "systemd/service/log.h"
#include "systemd/service/spawn.h"

enum {
    FRUITLESS_MS = 5000, /* a worker found nothing to claim: others are at what is left */
    FAILED_MS = 1000,
    LONGEST_MS = 60000,
    QUICK_MS = 2000, /* who fails within this has met something that will not pass at once */
    STOP_MS = 4000,
};

struct worker {
    struct gsn_queue_runner *runner;
    pid_t pid; /* 0: nobody */
    int64_t began_ms;
    bool is_late;
    sd_event_source *child, *limit;
};

struct gsn_queue_runner {
    sd_event *loop;
    struct gsn_store *store;
    char *program;
    unsigned workers, threads, minutes;
    uint64_t memory_bytes, reserve_bytes;
    bool stopping, paused;
    int64_t next_ms, delay_ms; /* no start before; how long it was put off last */
    sd_event_source *again;
    size_t count; /* of at */
    struct worker **at;
};

static void worker_done(struct worker *worker)
{
    worker->child = sd_event_source_disable_unref(worker->child);
    worker->limit = sd_event_source_disable_unref(worker->limit);
    worker->pid = 0;
}

static int on_again(sd_event_source *source, uint64_t usec, void *context)
{
    (void)source;
    (void)usec;
    gsn_queue_runner_look(context);
    return 0;
}

static void put_off(struct gsn_queue_runner *runner, int64_t ms)
{
    runner->delay_ms = ms < LONGEST_MS ? ms : LONGEST_MS;
    runner->next_ms = gsn_now_ms() + runner->delay_ms;
}

/* ---- the end of a worker ----------------------------------------------------------------- */

static void fail_job(struct gsn_queue_runner *runner, pid_t pid, const char *limit)
{
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_log_about about = { .id = GSN_LOG_JOB_LATE };
    struct gsn_error err = { 0 };
    char sentence[200];

    if (gsn_queue_of_process(runner->store, pid, &job, &err) < 0)
        return;
    about.specimen = job->specimen;
    (void)snprintf(sentence, sizeof sentence,
                   "it was ended because it ran into its limit of %u minutes of %s; raise "
                   "TimeMinutes= or look at its panels",
                   runner->minutes, limit);
    if (gsn_queue_fail(runner->store, job, GSN_E_PROCESS, sentence, &err) >= 0)
        gsn_log(LOG_ERR, &about, "%s job of %s: %s", job->kind, job->specimen, sentence);
}

/* The service stopped it: that is no death of the job. */
static void release_lease(struct gsn_queue_runner *runner, pid_t pid)
{
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_error quiet = { 0 };

    if (gsn_queue_of_process(runner->store, pid, &job, &quiet) >= 0)
        (void)gsn_queue_release(runner->store, job, &quiet);
}

static void judge_exit(struct gsn_queue_runner *runner, int status, int64_t lived_ms)
{
    if (status == EX_OK) {
        runner->next_ms = runner->delay_ms = 0;
    } else if (status == EX_NOINPUT || status == EX_TEMPFAIL) {
        put_off(runner, runner->delay_ms ? 2 * runner->delay_ms : FRUITLESS_MS);
    } else if (lived_ms < QUICK_MS) {
        /* A job that fails has its row; a store that cannot be opened would fail for ever. */
        put_off(runner, runner->delay_ms ? 2 * runner->delay_ms : FAILED_MS);
    }
}

static int on_end(sd_event_source *source, const siginfo_t *end, void *context)
{
    struct worker *const worker = context;
    struct gsn_queue_runner *const runner = worker->runner;
    const int64_t lived_ms = gsn_now_ms() - worker->began_ms;
    const pid_t pid = worker->pid;

    (void)source;
    worker_done(worker);
    if (runner->stopping) {
        release_lease(runner, pid);
        return 0;
    }
    if (end->si_code == CLD_EXITED)
        judge_exit(runner, end->si_status, lived_ms);
    else if (worker->is_late || end->si_status == SIGXCPU)
        fail_job(runner, pid, worker->is_late ? "time" : "a processor's time");
    else if (end->si_status == SIGTERM) {
        /* Who stops us stops our children too, and theirs may be heard first. */
        release_lease(runner, pid);
        put_off(runner, FAILED_MS);
    } else {
        gsn_log(LOG_WARNING, NULL, "gieson-work died of signal %d (%s); its job is done again",
                end->si_status, strsignal(end->si_status));
        put_off(runner, FAILED_MS);
    }
    gsn_queue_runner_look(runner);
    return 0;
}

static int on_late(sd_event_source *source, uint64_t usec, void *context)
{
    struct worker *const worker = context;

    (void)source;
    (void)usec;
    worker->is_late = !worker->runner->stopping;
    (void)kill(worker->pid, SIGKILL);
    return 0;
}

/* ---- the start --------------------------------------------------------------------------- */

static int spawn_worker(struct gsn_queue_runner *runner, pid_t *ret_pid, struct gsn_error *err)
{
    const long processors = sysconf(_SC_NPROCESSORS_ONLN);
    const uint64_t threads =
        runner->threads ? runner->threads : (uint64_t)(processors > 0 ? processors : 1);
    char text[16];
    const char *const argv[] = {
        runner->program, "--store", gsn_store_dir(runner->store), "--threads", text, "work", NULL
    };
    const struct gsn_spawn what = { .argv = argv,
                                    .memory_bytes = runner->memory_bytes,
                                    .cpu_s = 60 * threads * runner->minutes,
                                    .in_background = 1 };

    (void)snprintf(text, sizeof text, "%u", runner->threads);
    return gsn_spawn(&what, ret_pid, err);
}

static int watch_worker(struct worker *worker, struct gsn_error *err)
{
    sd_event *const loop = worker->runner->loop;
    int r = sd_event_add_child(loop, &worker->child, worker->pid, WEXITED, on_end, worker);

    if (r >= 0)
        r = sd_event_add_time_relative(loop, &worker->limit, CLOCK_MONOTONIC,
                                       (uint64_t)worker->runner->minutes * 60 * 1000000, 0, on_late,
                                       worker);
    return r < 0 ? gsn_fail(err, GSN_E_PROCESS, "gieson-work's end cannot be waited for: %s",
                            strerror(-r))
                 : GSN_OK;
}

static struct worker *idle_worker(struct gsn_queue_runner *runner)
{
    struct worker **more;
    struct worker *worker;

    for (size_t i = 0; i < runner->count; i++)
        if (runner->at[i]->pid == 0)
            return runner->at[i];
    more = gsn_realloc_array(runner->at, runner->count + 1, sizeof(struct worker *));
    worker = gsn_alloc_array(1, sizeof *worker);
    if (more)
        runner->at = more;
    if (!more || !worker) {
        gsn_free(worker);
        return NULL;
    }
    worker->runner = runner;
    more[runner->count++] = worker;
    return worker;
}

static int start_worker(struct gsn_queue_runner *runner, struct gsn_error *err)
{
    struct worker *const worker = idle_worker(runner);
    int r;

    if (!worker)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a worker");
    r = spawn_worker(runner, &worker->pid, err);
    if (r < 0)
        return r;
    worker->began_ms = gsn_now_ms();
    worker->is_late = false;
    r = watch_worker(worker, err);
    if (r < 0) {
        (void)kill(worker->pid, SIGKILL);
        (void)gsn_process_wait(worker->pid, 1);
        worker_done(worker);
    }
    return r;
}

/* Intake stops at the reserve; what is here already may use half of it. */
static bool has_room(struct gsn_queue_runner *runner)
{
    struct statvfs fs;
    bool room = true;

    if (statvfs(gsn_store_dir(runner->store), &fs) == 0)
        room = (uint64_t)fs.f_bavail * fs.f_frsize >= runner->reserve_bytes / 2;
    if (!room && !runner->paused)
        gsn_log(LOG_WARNING, &(struct gsn_log_about){ .id = GSN_LOG_PAUSED },
                "the queue rests: the disk is below half its reserve");
    runner->paused = !room;
    return room;
}

static size_t jobs_to_start(struct gsn_queue_runner *runner)
{
    const size_t active = gsn_queue_runner_running(runner);
    struct gsn_job_counts counts = { 0 };
    struct gsn_error err = { 0 };
    size_t open;

    if (active >= runner->workers || gsn_queue_counts(runner->store, &counts, &err) < 0)
        return 0;
    open = (size_t)counts.waiting;
    /* Running, but not by us: perhaps nobody's any more. Who claims looks at that. */
    if (open == 0 && (size_t)counts.running > active)
        open = 1;
    return open < runner->workers - active ? open : runner->workers - active;
}

void gsn_queue_runner_look(struct gsn_queue_runner *runner)
{
    const int64_t wait_ms = runner->next_ms - gsn_now_ms();
    struct gsn_error err = { 0 };
    size_t count;

    if (runner->stopping)
        return;
    count = jobs_to_start(runner);
    runner->again = sd_event_source_disable_unref(runner->again);
    if (count == 0 || !has_room(runner))
        return;
    if (wait_ms > 0) {
        (void)sd_event_add_time_relative(runner->loop, &runner->again, CLOCK_MONOTONIC,
                                         (uint64_t)wait_ms * 1000, 0, on_again, runner);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        if (start_worker(runner, &err) >= 0)
            continue;
        gsn_log(LOG_ERR, NULL, "%s", err.text);
        put_off(runner, LONGEST_MS);
        return;
    }
}

/* ---- the rest ---------------------------------------------------------------------------- */

void gsn_queue_runner_set(struct gsn_queue_runner *runner, const struct gsn_config *config)
{
    runner->workers = config->workers;
    runner->threads = config->threads;
    runner->minutes = config->minutes;
    runner->memory_bytes = (uint64_t)config->memory_mib << 20;
    runner->reserve_bytes = config->reserve_bytes;
}

void gsn_queue_runner_stop(struct gsn_queue_runner *runner)
{
    runner->stopping = true;
    runner->again = sd_event_source_disable_unref(runner->again);
    for (size_t i = 0; i < runner->count; i++) {
        struct worker *const worker = runner->at[i];

        if (worker->pid == 0)
            continue;
        (void)kill(worker->pid, SIGTERM);
        worker->limit = sd_event_source_disable_unref(worker->limit);
        (void)sd_event_add_time_relative(runner->loop, &worker->limit, CLOCK_MONOTONIC,
                                         STOP_MS * 1000, 0, on_late, worker);
    }
}

size_t gsn_queue_runner_running(const struct gsn_queue_runner *runner)
{
    size_t running = 0;

    for (size_t i = 0; i < runner->count; i++)
        running += runner->at[i]->pid > 0;
    return running;
}

int gsn_queue_runner_is_paused(const struct gsn_queue_runner *runner)
{
    return runner->paused;
}

int gsn_queue_runner_new(sd_event *loop, struct gsn_store *store,
                         struct gsn_queue_runner **ret_runner, struct gsn_error *err)
{
    gsn_auto(gsn_queue_runner) runner = gsn_alloc_array(1, sizeof *runner);
    int r;

    if (!runner)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the queue");
    runner->loop = loop;
    runner->store = store;
    r = gsn_process_sibling("gieson-work", &runner->program, err);
    if (r < 0)
        return r;
    *ret_runner = gsn_steal(&runner);
    return GSN_OK;
}

void gsn_queue_runner_free(struct gsn_queue_runner *runner)
{
    if (!runner)
        return;
    (void)sd_event_source_disable_unref(runner->again);
    for (size_t i = 0; i < runner->count; i++) {
        if (runner->at[i]->pid > 0) {
            (void)kill(runner->at[i]->pid, SIGKILL);
            (void)gsn_process_wait(runner->at[i]->pid, 1);
        }
        worker_done(runner->at[i]);
        gsn_free(runner->at[i]);
    }
    gsn_free(runner->at);
    gsn_free(runner->program);
    gsn_free(runner);
}
