/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A scalar field s(u) = sum c_beta^I N_beta^I(u) on a DMS space: value, gradient, integrals, and
 * the polynomials and bounds that certified figures are made from. Outside the mesh there is no
 * data. */
#ifndef GSN_MODEL_SPLINE_H
#define GSN_MODEL_SPLINE_H

#include "pipeline/model/dms.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_spline;

/* gives; keeps space, copies the gsn_dms_controls() control values. Fails with GSN_E_INPUT on a
 * value that is not finite, GSN_E_NOMEM. */
int gsn_spline_new(const struct gsn_dms *space, const double *control,
                   struct gsn_spline **ret_spline, struct gsn_error *err);
void gsn_spline_free(struct gsn_spline *spline);
GSN_DEFINE_AUTO(gsn_spline);

/* Bytes of memory the spline holds beside its control values (8 bytes each) and its space: the
 * coefficients of gsn_spline_bernstein(). */
size_t gsn_spline_bytes(const struct gsn_spline *spline);

const struct gsn_dms *gsn_spline_space(const struct gsn_spline *spline);
const double *gsn_spline_controls(const struct gsn_spline *spline);

/* s(u), and its gradient per um when ret_gradient is not NULL. hint as in gsn_dms_locate(),
 * updated; threads keep one each. Returns GSN_OK, or GSN_DMS_OUTSIDE with the outputs untouched. */
int gsn_spline_eval(const struct gsn_spline *spline, const double u[3], size_t *hint,
                    double *ret_value, double *ret_gradient);

/* Bernstein coefficients over tetrahedron tet of the polynomial p_I that s is on its core, in the
 * order of the space's functions: coefficient f belongs to (lambda^beta) n!/beta!. */
void gsn_spline_bernstein(const struct gsn_spline *spline, size_t tet,
                          double ret_coefficient[GSN_DMS_MAX_FUNCTIONS]);

/* Certified: low <= s(u) - p_I(u) <= high for every u of tetrahedron I (docs/MATH.md, equation
 * (10), residual bound); both 0 when no foreign function reaches it. low <= 0 <= high. */
void gsn_spline_residual(const struct gsn_spline *spline, size_t tet, double *ret_low,
                         double *ret_high);

/* Exact mean of s over a domain tetrahedron by the mean recurrence ("normalised cell density",
 * equation (9) corrected). */
int gsn_spline_tet_mean(const struct gsn_spline *spline, size_t tet, double *ret_mean,
                        struct gsn_error *err);
/* The same over any tetrahedral cell of positive volume inside or across the domain. */
int gsn_spline_cell_mean(const struct gsn_spline *spline, const double cell[4][3], double *ret_mean,
                         struct gsn_error *err);

/* What the functions of one tetrahedron contribute to the integral of s along the whole line
 * p + t d, per unit arc length of the line: the projection formula, exact for any knots. d need not
 * have length 1. NaN when d is 0, a number is not finite, or p so far away that the line cannot be
 * followed. The X-ray picture sums this over the tetrahedra whose support the line meets. */
double gsn_spline_tet_line(const struct gsn_spline *spline, size_t tet, const double p[3],
                           const double d[3]);
/* The same summed over all tetrahedra. */
double gsn_spline_line(const struct gsn_spline *spline, const double p[3], const double d[3]);

/* Second derivatives of a spline: how fast its normals turn.
 *
 * In general position a spline of degree n is C^{n-1}, so the second derivatives are continuous for
 * n = 3, jump at knot planes for n = 2 (the value on a plane is the limit from the side of the
 * half-open rule) and are 0 beside the knot planes for n = 1 (docs/MATH.md, section 2). */

/* The second derivatives xx, xy, xz, yy, yz, zz of s at u, in units of s per um^2. hint as in
 * gsn_dms_locate(), updated. Returns GSN_OK, or GSN_DMS_OUTSIDE with the outputs untouched. */
int gsn_spline_hessian(const struct gsn_spline *spline, const double u[3], size_t *hint,
                       double ret_hessian[6]);

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
