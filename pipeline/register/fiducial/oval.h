/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a mark is an oval, and what makes it round: a beam that meets the block aslant, or that
 * is not round itself, burns one.
 *
 * The second moments of what is higher than half way between the disc and what is around it (Hu,
 * IRE Trans. Inf. Theory 8, 179, 1962). The pixels' places are then stretched, along one axis as
 * much as they are squeezed along the other, and a round mark is fitted to them. Lengths are in
 * pixels. */
#ifndef GSN_REGISTER_FIDUCIAL_OVAL_H
#define GSN_REGISTER_FIDUCIAL_OVAL_H

#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"
#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Axes that differ by a larger factor are no mark's. A round outline that explains so much of the
 * picture is not asked whether it is an oval. */
extern const double gsn_oval_axes_max, gsn_oval_round_score;

/* Symmetric, with determinant 1. */
struct gsn_oval_stretch {
    double xx, xy, yy;
};

/* Whether what lies around the start is an oval rather than round or of another shape; then start
 * and radius become its centre and its radius by area. borrows: plane. */
int gsn_oval_find(const struct gsn_plane *plane, struct gsn_point *start, double *radius,
                  struct gsn_oval_stretch *ret_stretch);

/* A mark of the stretched picture, relative to where that begins, in the picture as it is. */
void gsn_oval_unstretch(const struct gsn_oval_stretch *stretch, struct gsn_fiducial *mark);

#ifdef __cplusplus
}
#endif
#endif
