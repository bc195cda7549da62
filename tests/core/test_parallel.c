/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/parallel.h"

#include "pipeline/core/mem.h"
#include "tests/check.h"

#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>

enum { MANY = 1000, MOST_THREADS = 64 };

static int count_call(size_t index, void *context, struct gsn_error *err)
{
    atomic_int *calls = context;

    (void)err;
    (void)atomic_fetch_add(&calls[index], 1);
    return GSN_OK;
}

TEST(every_index_is_called_exactly_once_for_any_number_of_threads)
{
    for (unsigned threads = 0; threads <= MOST_THREADS + 1; threads++) {
        atomic_int calls[MANY];
        struct gsn_error err = { 0 };

        for (size_t i = 0; i < MANY; i++)
            atomic_init(&calls[i], 0);
        CHECK_OK(gsn_parallel_for(MANY, threads, count_call, calls, &err), err);
        for (size_t i = 0; i < MANY; i++)
            CHECK(atomic_load(&calls[i]) == 1);
    }
}

TEST(fewer_indices_than_threads_are_enough)
{
    for (size_t count = 0; count <= 5; count++) {
        atomic_int calls[5] = { 0 };
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_parallel_for(count, 7, count_call, calls, &err), err);
        for (size_t i = 0; i < 5; i++)
            CHECK(atomic_load(&calls[i]) == (i < count));
    }
}

struct failing {
    atomic_int calls;
    size_t lowest, spacing;
};

/* The lowest failing index is made to come last in time where there is more than one thread. */
static int fail_some(size_t index, void *context, struct gsn_error *err)
{
    struct failing *f = context;
    int r = GSN_OK;

    if (index == f->lowest)
        for (int i = 0; i < 200; i++)
            (void)sched_yield();
    if (index >= f->lowest && (index - f->lowest) % f->spacing == 0)
        r = gsn_fail(err, index == f->lowest ? GSN_E_STAIN : GSN_E_FIT, "index %zu", index);
    (void)atomic_fetch_add(&f->calls, 1);
    return r;
}

TEST(the_lowest_failing_index_wins_whatever_the_threads)
{
    for (unsigned threads = 1; threads <= MOST_THREADS; threads++) {
        struct failing f = { .lowest = 13, .spacing = 1 + threads % 3 };
        struct gsn_error err = { 0 };

        atomic_init(&f.calls, 0);
        CHECK(gsn_parallel_for(200, threads, fail_some, &f, &err) == GSN_E_STAIN);
        CHECK(err.code == GSN_E_STAIN);
        assert_string_equal(err.text, "index 13");
        CHECK(atomic_load(&f.calls) == 200); /* the others still had their turn */
    }
}

TEST(the_first_and_the_last_index_may_fail)
{
    for (unsigned threads = 1; threads <= 8; threads++) {
        struct failing first = { .lowest = 0, .spacing = 1000 };
        struct failing last = { .lowest = 199, .spacing = 1 };
        struct gsn_error err = { 0 };

        CHECK(gsn_parallel_for(200, threads, fail_some, &first, &err) == GSN_E_STAIN);
        assert_string_equal(err.text, "index 0");
        CHECK(gsn_parallel_for(200, threads, fail_some, &last, &err) == GSN_E_STAIN);
        assert_string_equal(err.text, "index 199");
    }
}

TEST(a_failure_needs_no_error_to_be_told)
{
    struct failing f = { .lowest = 5, .spacing = 2 };

    CHECK(gsn_parallel_for(50, 3, fail_some, &f, NULL) == GSN_E_STAIN);
}

TEST(success_leaves_the_error_as_it_was)
{
    atomic_int calls[3] = { 0 };
    struct gsn_error err = { 0 };

    (void)gsn_fail(&err, GSN_E_BUSY, "earlier");
    CHECK(gsn_parallel_for(3, 2, count_call, calls, &err) == GSN_OK);
    CHECK(err.code == GSN_E_BUSY);
    assert_string_equal(err.text, "earlier");
}

/* Sums in which the order of the terms shows in the last bits. */
static int sum_terms(size_t index, void *context, struct gsn_error *err)
{
    double *sums = context;
    double sum = 0;

    (void)err;
    for (size_t k = 1; k < 300; k++)
        sum += sin((double)(index * k)) / (double)k;
    sums[index] = sum;
    return GSN_OK;
}

TEST(one_and_seven_threads_give_the_same_bytes)
{
    gsn_auto_mem(double) one = gsn_alloc_array(MANY, sizeof *one);
    gsn_auto_mem(double) seven = gsn_alloc_array(MANY, sizeof *seven);
    struct gsn_error err = { 0 };

    CHECK(one && seven);
    CHECK_OK(gsn_parallel_for(MANY, 1, sum_terms, one, &err), err);
    CHECK_OK(gsn_parallel_for(MANY, 7, sum_terms, seven, &err), err);
    assert_memory_equal(one, seven, MANY * sizeof *one);
    CHECK_NEAR(one[0], 0, 0);
    CHECK_NEAR(one[1], (M_PI - 1) / 2, 0.01); /* the Fourier series of a sawtooth */
}

/* A loop inside a loop, as when sections are rendered in parallel and each asks for one too. */
static int inner_loop(size_t index, void *context, struct gsn_error *err)
{
    atomic_int *calls = context;

    return gsn_parallel_for(10, 3, count_call, calls + 10 * index, err);
}

TEST(loops_may_stand_in_loops)
{
    atomic_int calls[100];
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < 100; i++)
        atomic_init(&calls[i], 0);
    CHECK_OK(gsn_parallel_for(10, 4, inner_loop, calls, &err), err);
    for (size_t i = 0; i < 100; i++)
        CHECK(atomic_load(&calls[i]) == 1);
}

TEST(no_more_threads_are_meant_than_the_process_may_use)
{
    const unsigned before = gsn_parallel_threads();
    cpu_set_t all, one;

    CHECK(before >= 1 && before <= MOST_THREADS);
    CHECK(sched_getaffinity(0, sizeof all, &all) == 0);
    CPU_ZERO(&one);
    for (size_t cpu = 0; cpu < CPU_SETSIZE && CPU_COUNT(&one) == 0; cpu++)
        if (CPU_ISSET(cpu, &all))
            CPU_SET(cpu, &one);
    CHECK(sched_setaffinity(0, sizeof one, &one) == 0);
    CHECK(gsn_parallel_threads() == 1);
    CHECK(sched_setaffinity(0, sizeof all, &all) == 0);
    CHECK(gsn_parallel_threads() == before);
}
