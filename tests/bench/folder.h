/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the measures of a disk share: a folder below the one the program was started in, clocks,
 * means. Private to this program. */
#ifndef GSN_TESTS_BENCH_FOLDER_H
#define GSN_TESTS_BENCH_FOLDER_H

#include "tests/bench/bench.h"

#include <time.h>

struct folder {
    char path[64];
};

struct folder folder_new(void);
void folder_done(struct folder *folder); /* removes it */

/* Ends the program with errno's words when it does not hold. */
void need(int holds, const char *what);
double seconds(clockid_t clock);
double mean(const double *at, size_t count);
double median(double *at, size_t count); /* sorts */

#endif
