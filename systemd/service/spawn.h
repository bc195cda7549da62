/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A child of the service: under limits, with the descriptors it is given, ended by the kernel when
 * its parent dies. */
#ifndef GSN_SYSTEMD_SERVICE_SPAWN_H
#define GSN_SYSTEMD_SERVICE_SPAWN_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

/* The child finds our descriptor ours under the number its. */
struct gsn_spawn_fd {
    int ours, its;
};

struct gsn_spawn {
    const char *const *argv; /* NULL at the end; argv[0] is a path */
    size_t fd_count;         /* at most 4 */
    const struct gsn_spawn_fd *fd;
    uint64_t memory_bytes; /* address space; 0: no limit */
    uint64_t cpu_s;        /* processor seconds; 0: no limit */
    int in_background;     /* yields processor and disk to everybody else */
};

/* Fails with GSN_E_PROCESS, also when the program cannot be run. The caller waits for the child. */
int gsn_spawn(const struct gsn_spawn *what, pid_t *ret_child, struct gsn_error *err);

#endif
