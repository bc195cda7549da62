/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dense and banded linear algebra in double precision, by GSL's, over memory of the caller.
 *
 * Matrices stand row by row; `stride` is the distance of two rows, at least n. Nothing allocates.
 * Every solver refuses (-1) a matrix that it is not for; what it was given is spoilt then. */
#ifndef GSN_CORE_LINALG_H
#define GSN_CORE_LINALG_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The version of GSL that runs, as "2.7.1": figures depend on it. borrows. */
const char *gsn_linalg_version(void);

/* The largest n of gsn_eigen_symmetric() and gsn_solve_general(). */
enum { GSN_LINALG_FEW = 16 };

/* a = L L' for a symmetric positive definite a, of which the lower triangle is read; L comes to
 * stand in it, what stands above is spoilt. 0, or -1 where a is not positive definite (or not
 * finite). */
int gsn_cholesky(double *a, size_t n, size_t stride);
/* Solves L L' x = b with gsn_cholesky()'s factor; x is b before. */
void gsn_cholesky_solve(const double *factor, size_t n, size_t stride, double *x);
/* Both: a x = b. The factor comes to stand in a. */
int gsn_solve_spd(double *a, size_t n, size_t stride, double *x);
/* Inverts a symmetric positive definite matrix in place; both triangles are written. */
int gsn_invert_spd(double *a, size_t n, size_t stride);

/* Solves a x = b for any square a by Householder's QR, for several right sides: the columns of b,
 * which become x. n <= GSN_LINALG_FEW. 0, or -1 where a is singular to rounding; a is spoilt. */
int gsn_solve_general(double *a, size_t n, size_t stride, double *b, size_t columns,
                      size_t b_stride);

/* A symmetric positive definite matrix of which only the diagonal and the `wide` - 1 below it are
 * not zero. band: n rows of `wide`; band[j * wide + k] is the matrix's (j + k, j), k < wide <=
 * n. */
int gsn_band_cholesky(double *band, size_t n, size_t wide);
/* x is the right side before. */
void gsn_band_solve(const double *factor, size_t n, size_t wide, double *x);

/* x' a x. */
double gsn_quadratic_form(const double *a, size_t n, const double *x);

/* Eigenvalues of a symmetric matrix, the largest first, and unit vectors: column k of ret_vector
 * belongs to value k; its sign is arbitrary. Both have n rows, ret_vector of n. a is spoilt.
 * n <= GSN_LINALG_FEW. */
void gsn_eigen_symmetric(double *a, size_t n, double *ret_value, double *ret_vector);

#ifdef __cplusplus
}
#endif
#endif
