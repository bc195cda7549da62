/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* An out-of-memory sweep of calls with more allocations than a test has time for. */
#ifndef GSN_TESTS_SPECIMEN_OFTEN_H
#define GSN_TESTS_SPECIMEN_OFTEN_H

#include "tests/check.h"

/* As CHECK_EVERY_OOM, but after the first `first` allocations only about `then` more, evenly spread
 * over those that are left; the counting run shows how many there are. The last one is among them.
 */
#define CHECK_MANY_OOM(call, err, first, then)                                                     \
    do {                                                                                           \
        gsn_check_fail_allocation(0);                                                              \
        CHECK_OK((call), err);                                                                     \
        const size_t all_ = gsn_check_allocations();                                               \
        const size_t step_ = all_ > (first) ? (all_ - (first)) / (then) + 1 : 1;                   \
        for (size_t n_ = 1; n_ <= all_;) {                                                         \
            gsn_check_fail_allocation(n_);                                                         \
            const int code_ = (call);                                                              \
            gsn_check_fail_allocation(0);                                                          \
            if (code_ != GSN_E_NOMEM)                                                              \
                fail_msg("allocation %zu of %zu failed, but the call returned %d (%s)", n_, all_,  \
                         code_, (err).text);                                                       \
            n_ = n_ == all_          ? all_ + 1                                                    \
                 : n_ < (first)      ? n_ + 1                                                      \
                 : n_ + step_ < all_ ? n_ + step_                                                  \
                                     : all_;                                                       \
        }                                                                                          \
    } while (0)

#endif
