/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether spots look like marks, wherever they lie: by how strong and how large they are, beside
 * the section's other spots as long as nothing is learnt, beside the stack's marks afterwards. */
#ifndef GSN_REGISTER_MARK_LOOKS_H
#define GSN_REGISTER_MARK_LOOKS_H

#include "pipeline/register/markers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Of a spot that is less alike (-2 ln of its likelihood), looks say nothing more. */
#define GSN_MARK_UNLIKE_MOST 8.0

/* Whether a spot is of a strength and size that a mark may have. */
int gsn_mark_acceptable(const struct gsn_mark_candidates *section, size_t i,
                        const struct gsn_triangle_prior *prior);
/* -2 ln of the likelihood of these spots' looks, no spot counting for more than most. candidate:
 * indices, or -1 where a mark is not there. */
double gsn_mark_looks(const struct gsn_mark_candidates *section,
                      const struct gsn_triangle_prior *prior, const int candidate[GSN_MARKS],
                      double most);
/* Whether all of them look as the stack's marks do. */
int gsn_mark_alike(const struct gsn_mark_candidates *section,
                   const struct gsn_triangle_prior *prior, const int candidate[GSN_MARKS]);

#ifdef __cplusplus
}
#endif
#endif
