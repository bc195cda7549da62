/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A peer in a process of its own, asked line by line: the order on its stdin, the answer on its
 * stdout, a number or two. */
#ifndef GSN_TESTS_BENCH_PEER_H
#define GSN_TESTS_BENCH_PEER_H

#include <stdio.h>
#include <sys/types.h>

struct bench_peer {
    pid_t child;
    FILE *orders, *answers;
};

/* argv as for posix_spawn(). Returns whether it runs; end it in any case. */
int bench_peer_start(struct bench_peer *peer, char *const argv[]);
/* One order, one answer: seconds of CPU time, negative when the child is gone. ret_number may be
 * NULL; it is the answer's second number, or 0. */
double bench_peer_ask(const struct bench_peer *peer, const char *order, double *ret_number);
void bench_peer_end(struct bench_peer *peer);

#endif
