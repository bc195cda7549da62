/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Second derivatives of a spline: how fast its normals turn.
 *
 * In general position a spline of degree n is C^{n-1}, so the second derivatives are continuous for
 * n = 3, jump at knot planes for n = 2 (the value on a plane is the limit from the side of the
 * half-open rule) and are 0 beside the knot planes for n = 1 (docs/MATH.md, section 2). */
#ifndef GSN_MODEL_SPLINE_HESSIAN_H
#define GSN_MODEL_SPLINE_HESSIAN_H

#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The second derivatives xx, xy, xz, yy, yz, zz of s at u, in units of s per um^2. hint as in
 * gsn_dms_locate(), updated. Returns GSN_OK, or GSN_DMS_OUTSIDE with the outputs untouched. */
int gsn_spline_hessian(const struct gsn_spline *spline, const double u[3], size_t *hint,
                       double ret_hessian[6]);

#ifdef __cplusplus
}
#endif
#endif
