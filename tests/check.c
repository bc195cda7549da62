/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <stdatomic.h>
#include <stdio.h>
#include <sys/mman.h>
#include <unistd.h>

enum { MOST_TESTS = 256, SKIPPED = 77 /* what CTest is told to read as skipped */ };

static struct CMUnitTest tests[MOST_TESTS];
static size_t test_count;
static unsigned skipped;
static int bytes_fd = -1;

/* 0: every allocation passes. Otherwise the one with this number fails. */
static atomic_size_t failing, asked;

void *__real_gsn_mem_door(void *old, size_t size, int zeroed);
void *__wrap_gsn_mem_door(void *old, size_t size, int zeroed);

void *__wrap_gsn_mem_door(void *old, size_t size, int zeroed)
{
    const size_t n = atomic_fetch_add(&asked, 1) + 1;

    return n == atomic_load(&failing) ? NULL : __real_gsn_mem_door(old, size, zeroed);
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
