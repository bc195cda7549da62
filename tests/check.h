/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Our thin layer on cmocka: TEST() registers itself, CHECK() names what was untrue,
 * CHECK_EVERY_OOM() fails each allocation in turn.
 *
 * One test program per file; link it with gsn_check (which brings main()). */
#ifndef GSN_TESTS_CHECK_H
#define GSN_TESTS_CHECK_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "pipeline/core/error.h"

#ifdef __cplusplus
extern "C" {
#endif

void gsn_check_register(const char *name, void (*body)(void **state));

#define TEST(name)                                                                                 \
    static void name(void **state);                                                                \
    __attribute__((constructor)) static void register_##name(void)                                 \
    {                                                                                              \
        gsn_check_register(#name, name);                                                           \
    }                                                                                              \
    static void name(void **state __attribute__((unused)))

#define CHECK(claim) _assert_true((claim) ? 1 : 0, #claim, __FILE__, __LINE__)

/* Ends the test here and says why; the program then counts as skipped, unless a test of it fails.
 */
void gsn_check_skip(const char *format, ...) __attribute__((format(printf, 1, 2)));

/* A descriptor of a file without a name that holds the bytes, until the next call. */
int gsn_check_fd(const void *bytes, size_t size);

void gsn_check_near(double value, double truth, double tolerance, const char *what,
                    const char *file, int line);
/* |value - truth| <= tolerance; prints all three when it is not, and fails on NaN. */
#define CHECK_NEAR(value, truth, tolerance)                                                        \
    gsn_check_near(value, truth, tolerance, #value, __FILE__, __LINE__)

void gsn_check_ok(int code, const struct gsn_error *err, const char *what, const char *file,
                  int line);
/* The call returned no error; prints err's sentence when it did. */
#define CHECK_OK(call, err) gsn_check_ok(call, &(err), #call, __FILE__, __LINE__)

/* From the n-th allocation on (n >= 1) every one fails; 0 ends that. Counts those asked for. */
void gsn_check_fail_allocation(size_t n);
size_t gsn_check_allocations(void);

/* One sweep of runs: in each run one allocation fails, the next of those whose chain of calls has
 * not failed three times yet; gsn_check_sweep_failed() is its number in the run, 0: none was left. */
void gsn_check_sweep_begin(void);
void gsn_check_sweep_run(int on);
size_t gsn_check_sweep_failed(void);

/* Runs the call with one allocation failing at a time (all later ones succeed again) until it
 * passes undisturbed: each failed run must return GSN_E_NOMEM. Each chain of calls by which it asks
 * for memory fails the first three times that it is taken. Leaks are ASan's to find. */
#define CHECK_EVERY_OOM(call, err)                                                                 \
    do {                                                                                           \
        gsn_check_sweep_begin();                                                                   \
        for (;;) {                                                                                 \
            gsn_check_sweep_run(1);                                                                \
            const int code_ = (call);                                                              \
            const size_t failed_ = gsn_check_sweep_failed();                                       \
            gsn_check_sweep_run(0);                                                                \
            if (!failed_) {                                                                        \
                CHECK_OK(code_, err);                                                              \
                break;                                                                             \
            }                                                                                      \
            if (code_ != GSN_E_NOMEM)                                                              \
                fail_msg("allocation %zu failed, but the call returned %d (%s)", failed_, code_,   \
                         (err).text);                                                              \
        }                                                                                          \
    } while (0)

#ifdef __cplusplus
}
#endif
#endif
