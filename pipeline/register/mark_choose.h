/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What choosing, learning and agreeing on a triangle have in common; for their files alone. */
#ifndef GSN_REGISTER_MARK_CHOOSE_H
#define GSN_REGISTER_MARK_CHOOSE_H

#include "pipeline/register/markers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How far a mark may lie from where a rigid triangle puts it, one standard deviation, as a share of
 * the triangle's size: sections stretch and shrink by some per cent. The error of localisation is
 * far smaller and is dealt with by the joint solution, which knows it. */
#define GSN_MARK_STRETCH 0.02

double gsn_mark_distance(struct gsn_point a, struct gsn_point b);
struct gsn_point gsn_mark_to_um(struct gsn_point px, double px_um, int mirrored);
/* Whether a spot is of a strength and size that a mark may have. */
int gsn_mark_acceptable(const struct gsn_mark_candidates *section, size_t i,
                        const struct gsn_triangle_prior *prior);

#ifdef __cplusplus
}
#endif
#endif
