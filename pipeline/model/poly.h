/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Polynomials of three variables as sums of monomials, what the kernels run fastest on. */
#ifndef GSN_MODEL_POLY_H
#define GSN_MODEL_POLY_H

#ifdef __cplusplus
extern "C" {
#endif

/* The coefficients of sum_beta b_beta n!/beta! lambda^beta as a polynomial of lambda_1..3, in the
 * order of kernels.h: monomial (a,b,c) has n!/(a! b! c! (n-a-b-c)!) times the forward difference
 * of order a, b, c of b at (n,0,0,0). */
void gsn_poly_of_bernstein(unsigned degree, const double *bernstein, double *ret_coefficient);

#ifdef __cplusplus
}
#endif
#endif
