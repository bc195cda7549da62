/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The rigid motion that lays one set of marks on another.
 *
 * Laser marks were burnt through the block parallel to the cutting direction, so each section
 * carries the same triangle, rotated and shifted by the mounting. Units are micrometres; y points
 * down, as in the scan. */
#ifndef GSN_REGISTER_POSE_RIGID_H
#define GSN_REGISTER_POSE_RIGID_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Rotate by the angle with this cosine and sine, then shift. Never scales, never mirrors. */
struct gsn_rigid {
    double cos, sin, dx, dy;
};

/* Finds the motion that carries from[i] nearest to onto[i], in weighted least squares (the planar
 * Procrustes problem, solved in closed form).
 *
 * count is 2 or more. weight holds count positive numbers, or is NULL for equal weights. ret_rms
 * (may be NULL) is the weighted root mean square of the distances left; a value above a mark's own
 * radius means a torn section, a swapped mark or a section turned over, and the caller decides
 * which. Fails with GSN_E_MARKERS when the points of either set coincide, so that no rotation can
 * be told, or when a coordinate is not finite. */
int gsn_rigid_fit(const struct gsn_point *from, const struct gsn_point *onto, const double *weight,
                  size_t count, struct gsn_rigid *ret_motion, double *ret_rms,
                  struct gsn_error *err);

struct gsn_point gsn_rigid_apply(const struct gsn_rigid *motion, struct gsn_point p);

/* Panel pixels -> um: scale by px_um, mirror in x when flipped, then the motion. The determinant is
 * px_um^2, or -px_um^2 when flipped. */
struct gsn_affine gsn_rigid_to_affine(const struct gsn_rigid *motion, double px_um, int flipped);

#ifdef __cplusplus
}
#endif
#endif
