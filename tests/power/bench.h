/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A directory for the programs of this folder, with pictures to take in. */
#ifndef GSN_TESTS_POWER_BENCH_H
#define GSN_TESTS_POWER_BENCH_H

#include <stddef.h>

/* In /dev/shm where there is one, else in TMPDIR. */
struct power_bench {
    char dir[200];
    char root[220]; /* an empty directory: the store is root/store */
    char store[240];
    char folder[220];  /* holds the pictures S1-P01.jpg, ... */
    char address[240]; /* of the folder, as a source */
};

struct power_bench power_bench_new(unsigned pictures);
void power_bench_done(const struct power_bench *bench);

void power_remove_tree(const char *path);
/* Says what and why, and ends the program. */
__attribute__((noreturn)) void power_give_up(const char *what);

#endif
