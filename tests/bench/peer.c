/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/bench/peer.h"

#include <spawn.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

int bench_peer_start(struct bench_peer *peer, char *const argv[])
{
    int orders[2], answers[2], failed;
    posix_spawn_file_actions_t moves;

    if (pipe(orders) < 0 || pipe(answers) < 0 || posix_spawn_file_actions_init(&moves) != 0)
        return 0;
    failed = posix_spawn_file_actions_adddup2(&moves, orders[0], 0) ||
             posix_spawn_file_actions_adddup2(&moves, answers[1], 1) ||
             posix_spawn_file_actions_addclose(&moves, orders[1]) ||
             posix_spawn_file_actions_addclose(&moves, answers[0]) ||
             posix_spawn(&peer->child, argv[0], &moves, NULL, argv, environ);
    (void)posix_spawn_file_actions_destroy(&moves);
    (void)close(orders[0]);
    (void)close(answers[1]);
    peer->orders = fdopen(orders[1], "w");
    peer->answers = fdopen(answers[0], "r");
    return !failed && peer->orders && peer->answers;
}

double bench_peer_ask(const struct bench_peer *peer, const char *order, double *ret_number)
{
    char line[128], *rest;
    double seconds;

    if (fprintf(peer->orders, "%s\n", order) < 0 || fflush(peer->orders) < 0 ||
        !fgets(line, sizeof line, peer->answers))
        return -1;
    seconds = strtod(line, &rest);
    if (ret_number)
        *ret_number = strtod(rest, NULL);
    return seconds;
}

void bench_peer_end(struct bench_peer *peer)
{
    int status;

    if (peer->orders)
        (void)fclose(peer->orders);
    if (peer->answers)
        (void)fclose(peer->answers);
    if (peer->child > 0)
        (void)waitpid(peer->child, &status, 0);
}
