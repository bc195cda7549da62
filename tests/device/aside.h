/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* umockdev names the socket of a udev monitor by the number of its descriptor, and the process that
 * opens one last has the name. Called in a service that is about to be started: its numbers become
 * others than those of its children, which inherit none of these. */
#ifndef GSN_TESTS_DEVICE_ASIDE_H
#define GSN_TESTS_DEVICE_ASIDE_H

#include <unistd.h>

static inline void umock_open_aside(void)
{
    enum { ASIDE = 64 };

    for (int i = 0; i < ASIDE; i++)
        (void)!dup(STDIN_FILENO);
}

#endif
