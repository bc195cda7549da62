/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How long work says where it is. The library never prints; whoever started it decides what to do
 * with a report. Calls come from the thread that called the stage, done grows to total. */
#ifndef GSN_CORE_PROGRESS_H
#define GSN_CORE_PROGRESS_H

#include <stddef.h>

struct gsn_progress {
    void (*report)(void *context, const char *stage, size_t done, size_t total);
    void *context;
};

/* progress may be NULL or empty. */
static inline void gsn_progress_say(const struct gsn_progress *progress, const char *stage,
                                    size_t done, size_t total)
{
    if (progress && progress->report)
        progress->report(progress->context, stage, done, total);
}

#endif
