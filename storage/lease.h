/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Is the process that took a lease still there? A process id alone does not say: ids are reused,
 * and mean nothing after a reboot or in another container. Private to this folder. */
#ifndef GSN_STORAGE_LEASE_H
#define GSN_STORAGE_LEASE_H

#include <stdbool.h>
#include <stdint.h>

struct gsn_lease_home {
    char boot[40];      /* of the kernel; empty: unknown, and then nothing is ever known dead */
    char processes[40]; /* the process-id namespace */
};

/* Of the calling process. */
struct gsn_lease_home gsn_lease_home(void);

/* When the process began, in clock ticks since boot; 0: there is none, or it has died and only
 * waits to be reaped. */
int64_t gsn_lease_start(int64_t pid);

/* Taken before this machine was started last: a power cut or a reboot ended whoever held it. */
bool gsn_lease_is_of_other_start(const struct gsn_lease_home *here, const char *boot);

/* Surely gone: a store in WAL mode is never shared between machines, so another boot means that
 * this machine was restarted. A process of another namespace cannot be asked after. start 0: it was
 * not known when the lease was taken, and nothing is known now. */
bool gsn_lease_is_dead(const struct gsn_lease_home *here, const char *boot, const char *processes,
                       int64_t pid, int64_t start);

#endif
