/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A loop on several threads whose result does not depend on their number.
 *
 * The body writes only what belongs to its own index; sums over indices are the caller's, in index
 * order, afterwards. That is what makes reports byte-identical on one core and on sixty-four. */
#ifndef GSN_CORE_PARALLEL_H
#define GSN_CORE_PARALLEL_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef int gsn_parallel_body(size_t index, void *context, struct gsn_error *err);

/* Calls body for 0..count-1 on up to threads threads (0: as many as the process may use).
 *
 * Every index is called even when another failed; the failure of the lowest index is returned, so
 * the sentence too is the same whatever the number of threads. When no thread can be started the
 * caller's own does the work. borrows: context. */
int gsn_parallel_for(size_t count, unsigned threads, gsn_parallel_body *body, void *context,
                     struct gsn_error *err);

/* The number that 0 stands for. */
unsigned gsn_parallel_threads(void);

#ifdef __cplusplus
}
#endif
#endif
