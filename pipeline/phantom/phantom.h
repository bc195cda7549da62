/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One phantom specimen as a folder: panels, job.json, region.mhd and truth/. */
#ifndef GSN_PHANTOM_PHANTOM_H
#define GSN_PHANTOM_PHANTOM_H

#include "pipeline/core/progress.h"
#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writes the planned specimen into folder, which is made when it is missing. The same plan gives
 * the same bytes with any number of threads (0: all there are). job.json is written last, so a
 * folder that has one is complete. borrows: plan, progress (may be NULL). */
int gsn_phantom_make(const struct gsn_phantom_plan *plan, int with_density, unsigned threads,
                     const char *folder, const struct gsn_progress *progress,
                     struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
