/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <execinfo.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

enum { MOST_TESTS = 256, SKIPPED = 77 /* what CTest is told to read as skipped */ };

static struct CMUnitTest tests[MOST_TESTS];
static size_t test_count;
static unsigned skipped;
static int bytes_fd = -1;

/* 0: every allocation passes. Otherwise the one with this number fails. */
static atomic_size_t failing, asked;

/* Chains of calls by which memory was asked for, and how often each has failed. A chain is a hash
 * (FNV-1a) of its return addresses; the table is open, and a sweep that fills it fails the test. */
enum { FRAMES = 32, CHAINS = 1 << 14, TIMES = 3 };

static struct {
    pthread_mutex_t lock;
    atomic_int on;
    size_t decided, failed; /* numbers of allocations: up to which all are decided; of this run */
    size_t chains;
    struct {
        uint64_t hash;
        unsigned times;
    } at[CHAINS];
} sweep = { .lock = PTHREAD_MUTEX_INITIALIZER };

void *__real_gsn_mem_door(void *old, size_t size, int zeroed);
void *__wrap_gsn_mem_door(void *old, size_t size, int zeroed);

static uint64_t hash_of_chain(void)
{
    void *frame[FRAMES];
    const int count = backtrace(frame, FRAMES);
    uint64_t hash = 0xcbf29ce484222325;

    for (int i = 0; i < count; i++) {
        uint8_t bytes[sizeof frame[i]];

        memcpy(bytes, &frame[i], sizeof bytes);
        for (size_t k = 0; k < sizeof bytes; k++)
            hash = (hash ^ bytes[k]) * 0x100000001b3;
    }
    return hash ? hash : 1;
}

/* Whether this allocation, the n-th of the run, is the one that fails: the first that is not
 * decided and whose chain has not failed often enough. */
static int is_to_fail(size_t n)
{
    const uint64_t hash = hash_of_chain();
    size_t k = hash % CHAINS;

    while (sweep.at[k].hash && sweep.at[k].hash != hash)
        k = (k + 1) % CHAINS;
    if (!sweep.at[k].hash && sweep.chains < CHAINS - 1) {
        sweep.at[k].hash = hash;
        sweep.chains++;
    }
    sweep.decided = n;
    if (sweep.at[k].times >= TIMES)
        return 0;
    sweep.at[k].times++;
    return 1;
}

void *__wrap_gsn_mem_door(void *old, size_t size, int zeroed)
{
    const size_t n = atomic_fetch_add(&asked, 1) + 1;
    int fails = n == atomic_load(&failing);

    if (atomic_load(&sweep.on)) {
        (void)pthread_mutex_lock(&sweep.lock);
        if (!sweep.failed && n > sweep.decided && is_to_fail(n)) {
            sweep.failed = n;
            fails = 1;
        }
        (void)pthread_mutex_unlock(&sweep.lock);
    }
    return fails ? NULL : __real_gsn_mem_door(old, size, zeroed);
}

void gsn_check_sweep_begin(void)
{
    sweep.decided = sweep.chains = 0;
    memset(sweep.at, 0, sizeof sweep.at);
}

void gsn_check_sweep_run(int on)
{
    atomic_store(&asked, 0);
    if (on)
        sweep.failed = 0;
    atomic_store(&sweep.on, on);
}

size_t gsn_check_sweep_failed(void)
{
    CHECK(sweep.chains < CHAINS - 1);
    return sweep.failed;
}

void gsn_check_fail_allocation(size_t n)
{
    atomic_store(&failing, n);
    atomic_store(&asked, 0);
}

size_t gsn_check_allocations(void)
{
    return atomic_load(&asked);
}

void gsn_check_register(const char *name, void (*body)(void **state))
{
    if (test_count < MOST_TESTS)
        tests[test_count++] = (struct CMUnitTest){ .name = name, .test_func = body };
}

int gsn_check_fd(const void *bytes, size_t size)
{
    if (bytes_fd >= 0)
        (void)close(bytes_fd);
    bytes_fd = memfd_create("test", MFD_CLOEXEC);
    CHECK(bytes_fd >= 0 && write(bytes_fd, bytes, size) == (ssize_t)size);
    return bytes_fd;
}

void gsn_check_near(double value, double truth, double tolerance, const char *what,
                    const char *file, int line)
{
    if (fabs(value - truth) <= tolerance)
        return;
    print_error("%s is %.17g, should be %.17g within %g (off by %g)\n", what, value, truth,
                tolerance, value - truth);
    _fail(file, line);
}

void gsn_check_ok(int code, const struct gsn_error *err, const char *what, const char *file,
                  int line)
{
    if (code >= 0)
        return;
    print_error("%s failed with %s: %s\n", what, gsn_code_name(code), err->text);
    _fail(file, line);
}

void gsn_check_skip(const char *format, ...)
{
    va_list args;

    va_start(args, format);
    print_message("skipped: ");
    vprint_message(format, args);
    print_message("\n");
    va_end(args);
    skipped++;
    skip();
}

/* Weak: a program with a main() of its own may draw with what checks itself. */
__attribute__((weak)) int main(void)
{
    const int failed = _cmocka_run_group_tests("", tests, test_count, NULL, NULL);

    return failed == 0 && skipped > 0 ? SKIPPED : failed;
}
