/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* B-patches: the polynomial that a simplex spline is on the core of a tetrahedron.
 *
 * With X_gamma = (t_{k,gamma_k}) and F the polar form,
 *
 *     c_gamma^{(r)} = sum_j lambda_j(u_r | X_gamma) c_{gamma+e_j}^{(r-1)},   |gamma| = n - r,
 *     F(u_1..u_n) = c_0^{(n)},   p(u) = F(u,..,u)            (docs/MATH.md, section 7).
 *
 * knot always holds the 4 (n + 1) knots of the tetrahedron, knot l of corner k at k (n + 1) + l.
 * All X_gamma, |gamma| < n, must be true tetrahedra. */
#ifndef GSN_MODEL_BPATCH_H
#define GSN_MODEL_BPATCH_H

#include "pipeline/model/barycentric.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The B-patch basis at u: p(u) = sum control[f] ret_value[f]; its gradient too unless that is
 * NULL. */
void gsn_bpatch_basis(unsigned degree, const double (*knot)[3], const double u[3],
                      double *ret_value, double (*ret_gradient)[3]);

/* The polar form F(arg[0], .., arg[degree - 1]). */
double gsn_bpatch_polar(unsigned degree, const double (*knot)[3], const double *control,
                        const double *const arg[]);

/* Bernstein coefficients of p over the tetrahedron corner: coefficient beta is F at corner k
 * repeated beta_k times. */
void gsn_bpatch_bernstein(unsigned degree, const double (*knot)[3], const double *control,
                          const double *const corner[4], double *ret_coefficient);

/* A polynomial in Bernstein form at lambda, and its gradient unless that is NULL; frame is the one
 * of its tetrahedron. */
double gsn_bernstein_at(unsigned degree, const double *coefficient,
                        const struct gsn_barycentric *frame, const double lambda[4],
                        double *ret_gradient);

/* Polynomials of three variables as sums of monomials, what the kernels run fastest on. */

/* The coefficients of sum_beta b_beta n!/beta! lambda^beta as a polynomial of lambda_1..3, in the
 * order of kernels.h: monomial (a,b,c) has n!/(a! b! c! (n-a-b-c)!) times the forward difference
 * of order a, b, c of b at (n,0,0,0). */
void gsn_poly_of_bernstein(unsigned degree, const double *bernstein, double *ret_coefficient);

#ifdef __cplusplus
}
#endif
#endif
