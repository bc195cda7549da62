/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/give_back.h"

#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <string.h>
#include <unistd.h>

#include "storage/queue.h"

struct gsn_give_back {
    struct gsn_store *store; /* the thread's own: a connection is for one */
    sigset_t ends;
    atomic_bool over; /* the signal is ours, to end the thread */
    bool has_thread;
    pthread_t thread;
};

/* Who is started with a signal ignored (nohup, a shell's background) is not to hear it. */
static sigset_t ends(void)
{
    static const int people[] = { SIGINT, SIGHUP };
    struct sigaction now;
    sigset_t set;

    (void)sigemptyset(&set);
    (void)sigaddset(&set, SIGTERM);
    for (size_t i = 0; i < sizeof people / sizeof people[0]; i++)
        if (sigaction(people[i], NULL, &now) == 0 && now.sa_handler != SIG_IGN)
            (void)sigaddset(&set, people[i]);
    return set;
}

/* Nothing to give back, or somebody else's by now, is as good. */
static void give_back(struct gsn_store *store)
{
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_error quiet = { 0 };

    if (gsn_queue_of_process(store, getpid(), &job, &quiet) >= 0)
        (void)gsn_queue_release(store, job, &quiet);
}

static void *wait_for_the_end(void *context)
{
    struct gsn_give_back *const watch = context;
    int signal_number = 0;

    if (sigwait(&watch->ends, &signal_number) != 0 || atomic_load(&watch->over))
        return NULL;
    give_back(watch->store);
    /* Whoever waits for us is to see what ended us. */
    (void)pthread_sigmask(SIG_UNBLOCK, &watch->ends, NULL);
    (void)raise(signal_number);
    return NULL;
}

int gsn_give_back_new(const char *store_dir, struct gsn_give_back **ret_watch,
                      struct gsn_error *err)
{
    gsn_auto(gsn_give_back) watch = gsn_alloc_array(1, sizeof *watch);
    int failure, r;

    if (!watch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a worker's last words");
    watch->ends = ends();
    /* Opened now: who is asked to end is waited for. */
    r = gsn_store_open(store_dir, GSN_STORE_WRITE, &watch->store, err);
    if (r < 0)
        return r;
    (void)pthread_sigmask(SIG_BLOCK, &watch->ends, NULL);
    failure = pthread_create(&watch->thread, NULL, wait_for_the_end, watch);
    if (failure) {
        (void)pthread_sigmask(SIG_UNBLOCK, &watch->ends, NULL);
        return gsn_fail(err, GSN_E_IO, "a thread could not be started: %s", strerror(failure));
    }
    watch->has_thread = true;
    *ret_watch = gsn_steal(&watch);
    return GSN_OK;
}

void gsn_give_back_free(struct gsn_give_back *watch)
{
    if (!watch)
        return;
    if (watch->has_thread) {
        atomic_store(&watch->over, true);
        (void)pthread_kill(watch->thread, SIGTERM);
        (void)pthread_join(watch->thread, NULL);
        (void)pthread_sigmask(SIG_UNBLOCK, &watch->ends, NULL);
    }
    gsn_store_free(watch->store);
    gsn_free(watch);
}
