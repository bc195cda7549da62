/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The three marks as a triangle: lengths, and how far a section may pull it out of shape. For the
 * files that agree on it, learn it and choose by it. */
#ifndef GSN_REGISTER_MARK_TRIANGLE_H
#define GSN_REGISTER_MARK_TRIANGLE_H

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
/* Root mean square distance of the corners from their centroid. */
double gsn_mark_triangle_size(const struct gsn_point corner[GSN_MARKS]);
/* That stretch in um, with half a pixel for what is measured. */
double gsn_mark_tolerance(const struct gsn_triangle_prior *prior, double px_um);

#ifdef __cplusplus
}
#endif
#endif
