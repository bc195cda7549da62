/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Self-scheduling: each thread takes the next index from one atomic counter until there is none,
 * the caller's own thread among them. Of failures the one of the lowest index is kept, under a
 * lock. As many threads as the process may run on (sched_getaffinity), 64 at most.
 *
 * Failure: that of the body; a thread that cannot be started is done without. Cost: threads are
 * started and joined in every call, and one atomic addition an index. */
#include "pipeline/core/parallel.h"

#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdint.h>

enum { MOST_THREADS = 64 };

struct loop {
    atomic_size_t next;
    size_t count;
    gsn_parallel_body *body;
    void *context;
    pthread_mutex_t lock; /* guards the two below */
    size_t failed_index;
    struct gsn_error failure;
};

static void note_failure(struct loop *loop, size_t index, const struct gsn_error *err)
{
    (void)pthread_mutex_lock(&loop->lock);
    if (index < loop->failed_index) {
        loop->failed_index = index;
        loop->failure = *err;
    }
    (void)pthread_mutex_unlock(&loop->lock);
}

static void *run_worker(void *argument)
{
    struct loop *loop = argument;

    for (;;) {
        struct gsn_error err = { 0 };
        const size_t index = atomic_fetch_add(&loop->next, 1);
        int r;

        if (index >= loop->count)
            return NULL;
        r = loop->body(index, loop->context, &err);
        if (r < 0) {
            err.code = r;
            note_failure(loop, index, &err);
        }
    }
}

unsigned gsn_parallel_threads(void)
{
    cpu_set_t set;
    int count;

    if (sched_getaffinity(0, sizeof set, &set) < 0)
        return 1;
    count = CPU_COUNT(&set);
    return count > MOST_THREADS ? MOST_THREADS : (unsigned)count;
}

int gsn_parallel_for(size_t count, unsigned threads, gsn_parallel_body *body, void *context,
                     struct gsn_error *err)
{
    struct loop loop = { .count = count,
                         .body = body,
                         .context = context,
                         .lock = PTHREAD_MUTEX_INITIALIZER,
                         .failed_index = SIZE_MAX };
    pthread_t helper[MOST_THREADS];
    size_t started = 0;

    if (threads == 0)
        threads = gsn_parallel_threads();
    if (threads > MOST_THREADS)
        threads = MOST_THREADS;
    while (started + 1 < threads && started + 1 < count &&
           pthread_create(&helper[started], NULL, run_worker, &loop) == 0)
        started++;
    (void)run_worker(&loop);
    for (size_t i = 0; i < started; i++)
        (void)pthread_join(helper[i], NULL);
    (void)pthread_mutex_destroy(&loop.lock);

    if (loop.failed_index == SIZE_MAX)
        return GSN_OK;
    if (err)
        *err = loop.failure;
    return loop.failure.code;
}
