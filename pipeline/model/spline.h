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

#ifdef __cplusplus
}
#endif
#endif
