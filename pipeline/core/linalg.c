/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Small and banded systems by GSL (GNU Scientific Library 2.7, chapters "Linear Algebra" and
 * "Eigensystems"): Cholesky's factor, Householder's QR and the symmetric QR algorithm (Golub & Van
 * Loan, Matrix Computations, 4th ed., algorithms 4.2.1, 5.2.1, 4.3.5 and 8.3.3).
 *
 * GSL is asked for the arithmetic because it brings its own BLAS: no processor's instructions and
 * no alternative libblas change a bit. It works on views of the caller's memory; where it wants
 * work space, that is on our stack, so nothing here can run out of memory.
 *
 * What is refused: a pivot that is not positive, a diagonal of R below n epsilon of the largest.
 * GSL lets NaN through its comparisons; the diagonal is looked at afterwards. */
#include "pipeline/core/linalg.h"

#include <assert.h>
#include <float.h>
#include <math.h>

#include <gsl/gsl_eigen.h>
#include <gsl/gsl_linalg.h>
#include <gsl/gsl_version.h>

#include "pipeline/core/gsl_door.h"

const char *gsn_linalg_version(void)
{
    return gsl_version;
}

/* ---- symmetric and positive definite ------------------------------------------------------- */

/* Whether n numbers, `apart` of each other, are all positive and finite. */
static int is_positive(const double *value, size_t n, size_t apart)
{
    for (size_t i = 0; i < n; i++)
        if (!(value[i * apart] > 0) || isinf(value[i * apart]))
            return 0;
    return 1;
}

int gsn_cholesky(double *a, size_t n, size_t stride)
{
    gsl_matrix_view of_a = gsl_matrix_view_array_with_tda(a, n, n, stride);

    gsn_gsl_open();
    return gsl_linalg_cholesky_decomp1(&of_a.matrix) == GSL_SUCCESS && is_positive(a, n, stride + 1)
               ? 0
               : -1;
}

void gsn_cholesky_solve(const double *factor, size_t n, size_t stride, double *x)
{
    const gsl_matrix_const_view of_factor =
        gsl_matrix_const_view_array_with_tda(factor, n, n, stride);
    gsl_vector_view of_x = gsl_vector_view_array(x, n);

    (void)gsl_linalg_cholesky_svx(&of_factor.matrix, &of_x.vector);
}

int gsn_solve_spd(double *a, size_t n, size_t stride, double *x)
{
    if (gsn_cholesky(a, n, stride) < 0)
        return -1;
    gsn_cholesky_solve(a, n, stride, x);
    return 0;
}

int gsn_invert_spd(double *a, size_t n, size_t stride)
{
    gsl_matrix_view of_a = gsl_matrix_view_array_with_tda(a, n, n, stride);

    if (gsn_cholesky(a, n, stride) < 0)
        return -1;
    return gsl_linalg_cholesky_invert(&of_a.matrix) == GSL_SUCCESS ? 0 : -1;
}

/* ---- general ------------------------------------------------------------------------------- */

int gsn_solve_general(double *a, size_t n, size_t stride, double *b, size_t columns,
                      size_t b_stride)
{
    double tau[GSN_LINALG_FEW], most = 0;
    gsl_matrix_view of_a = gsl_matrix_view_array_with_tda(a, n, n, stride);
    gsl_vector_view of_tau = gsl_vector_view_array(tau, n);

    assert(n >= 1 && n <= GSN_LINALG_FEW);

    gsn_gsl_open();
    if (gsl_linalg_QR_decomp(&of_a.matrix, &of_tau.vector) != GSL_SUCCESS)
        return -1;
    for (size_t i = 0; i < n; i++)
        most = fmax(most, fabs(a[i * stride + i]));
    for (size_t i = 0; i < n; i++)
        if (!(fabs(a[i * stride + i]) > (double)n * DBL_EPSILON * most) || isinf(most))
            return -1;
    for (size_t c = 0; c < columns; c++) {
        gsl_vector_view x = gsl_vector_view_array_with_stride(b + c, b_stride, n);

        (void)gsl_linalg_QR_svx(&of_a.matrix, &of_tau.vector, &x.vector);
    }
    return 0;
}

/* ---- banded -------------------------------------------------------------------------------- */

int gsn_band_cholesky(double *band, size_t n, size_t wide)
{
    gsl_matrix_view of_band = gsl_matrix_view_array(band, n, wide);

    assert(wide >= 1 && wide <= n);

    gsn_gsl_open();
    return gsl_linalg_cholesky_band_decomp(&of_band.matrix) == GSL_SUCCESS &&
                   is_positive(band, n, wide)
               ? 0
               : -1;
}

void gsn_band_solve(const double *factor, size_t n, size_t wide, double *x)
{
    const gsl_matrix_const_view of_factor = gsl_matrix_const_view_array(factor, n, wide);
    gsl_vector_view of_x = gsl_vector_view_array(x, n);

    (void)gsl_linalg_cholesky_band_svx(&of_factor.matrix, &of_x.vector);
}

double gsn_quadratic_form(const double *a, size_t n, const double *x)
{
    double sum = 0;

    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            sum += x[i] * a[i * n + j] * x[j];
    return sum;
}

/* ---- eigenvalues --------------------------------------------------------------------------- */

void gsn_eigen_symmetric(double *a, size_t n, double *ret_value, double *ret_vector)
{
    double d[GSN_LINALG_FEW], sd[GSN_LINALG_FEW], gc[GSN_LINALG_FEW], gs[GSN_LINALG_FEW];
    gsl_eigen_symmv_workspace room = { .size = n, .d = d, .sd = sd, .gc = gc, .gs = gs };
    gsl_matrix_view of_a = gsl_matrix_view_array(a, n, n);
    gsl_vector_view value = gsl_vector_view_array(ret_value, n);
    gsl_matrix_view vector = gsl_matrix_view_array(ret_vector, n, n);

    assert(n >= 1 && n <= GSN_LINALG_FEW);

    gsn_gsl_open();
    (void)gsl_eigen_symmv(&of_a.matrix, &value.vector, &vector.matrix, &room);
    (void)gsl_eigen_symmv_sort(&value.vector, &vector.matrix, GSL_EIGEN_SORT_VAL_DESC);
}
