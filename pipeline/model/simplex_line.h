/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Integrals of simplex splines along whole lines, by projection.
 *
 * Seen along a line of unit direction, a trivariate spline of degree n over n + 4 knots becomes a
 * bivariate one of degree n + 1 over the same knots projected:
 *
 *     int M(x + t d | V) dt = M2(0 | P V) / (n + 1),     P x = 0,
 *
 * and M2 follows the same recurrence with three knots for W. Any knots will do, coinciding ones as
 * well (docs/MATH.md, section 4). */
#ifndef GSN_MODEL_SIMPLEX_LINE_H
#define GSN_MODEL_SIMPLEX_LINE_H

#include "pipeline/model/simplex_sets.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Integrals of M(. | V_beta) of all functions. knot holds the 4 (n + 1) knots projected along the
 * line, which itself is the origin of the plane. Returns 0, leaving ret_integral undefined, when
 * the line misses them all. */
int gsn_simplex_line(const struct gsn_simplex_sets *sets, const double (*knot)[2],
                     double *ret_integral);

#ifdef __cplusplus
}
#endif
#endif
