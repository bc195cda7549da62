/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The three marks as a triangle: lengths, how far a section may pull it out of shape, and the
 * triangle that a stack's sections share. */
#ifndef GSN_REGISTER_FIDUCIAL_TRIANGLE_H
#define GSN_REGISTER_FIDUCIAL_TRIANGLE_H

#include "pipeline/core/error.h"
#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How far a mark may lie from where a rigid triangle puts it, one standard deviation, as a share of
 * the triangle's size: sections stretch and shrink by some per cent. The error of localisation is
 * far smaller and is dealt with by the joint solution, which knows it. */
#define GSN_TRIANGLE_STRETCH 0.02

double gsn_fiducial_distance(struct gsn_point a, struct gsn_point b);
struct gsn_point gsn_fiducial_to_um(struct gsn_point px, double px_um, int mirrored);
/* Root mean square distance of the corners from their centroid. */
double gsn_triangle_size(const struct gsn_point corner[GSN_FIDUCIALS]);
/* That stretch in um, with half a pixel for what is measured. */
double gsn_triangle_tolerance(const struct gsn_triangle_prior *prior, double px_um);

/* The triangle that most sections share, where the protocol gives none.
 *
 * Mark 1 lies between the shortest side (to mark 2) and the longest (to mark 3); the majority of
 * sections is taken as the right way up. Nothing is learnt yet. Fails with GSN_E_MARKERS when fewer
 * than 3 sections, or fewer than half of those with three candidates, agree, or so many as blobs
 * that are no marks would by chance. */
int gsn_fiducials_vote_triangle(const struct gsn_fiducial_candidates *sections, size_t count,
                                struct gsn_triangle_prior *ret_prior, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
