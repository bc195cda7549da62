/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Linear algebra of a few unknowns, and the limits of the tests that poses are put to. */
#ifndef GSN_REGISTER_SMALL_H
#define GSN_REGISTER_SMALL_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_SMALL = 6 };

/* Inverts a symmetric positive definite matrix in place, n <= GSN_SMALL, rows of GSN_SMALL. 0, or
 * -1 where it is not positive definite; it is then spoilt. */
int gsn_small_invert(double a[GSN_SMALL][GSN_SMALL], size_t n);
/* Solves a x = b for any square matrix, n <= GSN_SMALL, several right sides (columns of b, which
 * becomes x); a is spoilt. 0, or -1 where a is singular. */
int gsn_small_solve(double a[GSN_SMALL][GSN_SMALL], double b[GSN_SMALL][GSN_SMALL], size_t n,
                    size_t columns);
/* Solves a x = b for a symmetric positive definite n x n matrix, rows one after the other, by
 * Cholesky; b becomes x, a its lower factor. 0, or -1 where it is not positive definite. */
int gsn_small_solve_spd(double *a, double *x, size_t n);
/* Eigenvalues, the largest first, and vectors (columns) of a symmetric 3 x 3 matrix. */
void gsn_small_eigen3(const double a[3][3], double ret_value[3], double ret_vector[3][3]);
/* Lower Cholesky factor of a 3 x 3 matrix; 0, or -1 where it is not positive definite. */
int gsn_small_cholesky3(const double a[3][3], double ret_lower[3][3]);

/* The value that a sum of p squares of normal numbers, over their variance, exceeds by the chance
 * alpha when that variance is itself known from freedom degrees of freedom (INFINITY: exactly, and
 * the sum is chi-squared; else it is p times Fisher's F). p is 1 to 6, alpha 1e-9 to 0.5. */
double gsn_chance_limit(unsigned p, double freedom, double alpha);

/* The chance that the sum of three such squares exceeds square: what gsn_chance_limit(3, ...)
 * turns round. freedom is 2 or more. */
double gsn_chance_beyond3(double freedom, double square);

#ifdef __cplusplus
}
#endif
#endif
