/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Integrals of a spline along finite segments, equations (7) and (8).
 *
 * The printed recurrence lacks a boundary term. With x(t) = a + t (b - a) and
 * A(V) = int_0^1 M(x(t) | V) dt it must read
 *
 *     (n + 1) A(V) = n sum_j lambda_j(a | W) A(V \ k_j) + M(b | V),      A = chord / |det V| for n
 * = 0,
 *
 * and even so it needs general position (with coinciding knots the flat subsets do contribute) and
 * loses digits where a lies far from W in terms of the size of W: ends outside, and clouds that are
 * small. Here the segment is cut where it crosses the knot triangles instead. Between two cuts s is
 * one polynomial in t, and Gauss's rule of ceil((n + 1) / 2) points is exact. Nothing but values of
 * s inside the pieces enters, so the error is that of values of s, for any knots and any segment
 * (docs/MATH.md, section 4). */
#ifndef GSN_MODEL_SPLINE_SEGMENT_H
#define GSN_MODEL_SPLINE_SEGMENT_H

#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The integral of s along the segment from a to b by arc length, in units of s times um; divided
 * by |b - a| it is the mean. Where the segment leaves the domain s is what the formula gives there,
 * 0 but for the outer skin. A segment in a knot plane is the limit from the side of the half-open
 * rule. A segment of length 0 has the integral 0.
 *
 * Ends may be far away without loss, up to 1e12 times the size of the mesh. Takes time in
 * proportion to the number of tetrahedra. Fails with GSN_E_INPUT, *ret_integral untouched, when an
 * end is farther than that or not finite. */
int gsn_spline_segment(const struct gsn_spline *spline, const double a[3], const double b[3],
                       double *ret_integral, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
