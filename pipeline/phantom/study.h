/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A whole study: three groups of four animals, and one animal each after two, four and eight
 * weeks. */
#ifndef GSN_PHANTOM_STUDY_H
#define GSN_PHANTOM_STUDY_H

#include "pipeline/core/progress.h"
#include "pipeline/phantom/plan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writes folder/GVP-D-N1 and so on, each as gsn_phantom_make() does, and folder/truth/study.csv. A
 * px_um of 0 stands for the usual 24. The true loss of an animal is against the block as it is
 * defined, so that of a control is what its bone is less dense. borrows: progress (may be NULL). */
int gsn_phantom_study_make(const char *level, uint64_t seed, double px_um, unsigned threads,
                           const char *folder, const struct gsn_progress *progress,
                           struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
