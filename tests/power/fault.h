/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Calls that fail: stands in for libc's functions in the program it is linked with, libraries
 * included. Nothing fails unless armed. */
#ifndef GSN_TESTS_POWER_FAULT_H
#define GSN_TESTS_POWER_FAULT_H

#include <stdbool.h>
#include <stdint.h>

enum { FAULT_DIED = 99 };

struct fault {
    long at;           /* the first call that fails, from 1; 0: none */
    int error;         /* with this errno */
    bool for_ever;     /* and all calls after it */
    bool only_changes; /* calls that only read are not counted and never fail */
    bool shortened;    /* does not fail: writes half of its bytes */
    bool dies;         /* the process ends there, with FAULT_DIED */
    uint64_t room;     /* bytes by which files may grow before the disk is full; 0: no limit */
};

void fault_arm(const struct fault *fault);
/* How many calls there were. */
long fault_disarm(void);

#endif
