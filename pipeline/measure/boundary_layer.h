/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a spline is on tetrahedral cells inside one tetrahedron I of its mesh: a polynomial plus a
 * linear function plus an interval, guaranteed.
 *
 * On Omega^I, the inner side of every plane through three knots of a face's clouds, s is p_I and
 * nothing more. Near the faces functions of other tetrahedra J reach in, and everywhere in I
 *
 *     s - p_I = sum over J != I, beta of d_beta^J N_beta^J,    d = c_beta^J - F_I(knots of (J,
 * beta))
 *
 * (docs/MATH.md, equation (10)). With N >= 0 and sum N <= 1 the d of those that reach a cell bound
 * it there. That bound is constant; one that shrinks with the cell comes from the exact value at
 * its centroid and the gradient, by D_v M of equation (2) with W = X_beta:
 *
 *     grad (s - p_I) = sum over J, |g| = n - 1 of G_g N_g
 *                    + sum over faces J | K, |beta| = n of n (d_beta^J - d_beta^K) normal
 * M(T_beta),
 *
 * G_g the gradient of the linear function that is d_{g + e_j} at t_{j,g_j}; T_beta the knots of the
 * three clouds of the face, normal = (b - a) x (c - a) of its t_{j,beta_j}, towards J. Of M we use
 * 0 <= M(T | u) <= 1 / |det W| for any four knots W of T; where T is no more than W, inside and
 * outside. Neighbours that share control points have
 * no second sum.
 *
 * Where functions are missing, because boundary knots point into I, the polynomial is 0 instead and
 * d = c, those of I included: the same formulas. */
#ifndef GSN_MEASURE_BOUNDARY_LAYER_H
#define GSN_MEASURE_BOUNDARY_LAYER_H

#include "pipeline/measure/tet_cut.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_BOUNDARY_LAYER_MEMBERS = GSN_DMS_MAX_DEGREE + 4 };

/* Knots outside whose hull something vanishes, and the box around them. */
struct gsn_boundary_layer_hull {
    unsigned count;
    double knot[GSN_BOUNDARY_LAYER_MEMBERS][3], low[3], high[3];
};
struct gsn_boundary_layer_value {
    struct gsn_boundary_layer_hull hull;
    double d;
};
struct gsn_boundary_layer_slope {
    struct gsn_boundary_layer_hull hull;
    int jump; /* whether it adds up to the others by itself, at any weight from 0 to 1 */
    double gradient[3];
};

/* All that acts in a tetrahedron besides its polynomial. */
struct gsn_boundary_layer {
    const struct gsn_spline *spline;
    size_t tet;
    unsigned degree;
    double knot[4 * (GSN_DMS_MAX_DEGREE + 1)][3], control[GSN_DMS_MAX_FUNCTIONS];
    int whole;    /* whether the polynomial is p_I; else 0 */
    double slack; /* more than the rounding of any value of s here */
    size_t values, slopes;
    struct gsn_boundary_layer_value *value;
    struct gsn_boundary_layer_slope *slope;
};

/* gives; keeps spline. near: count tetrahedra, among them all whose functions reach the part of tet
 * that matters, and tet. Fails with GSN_E_NOMEM. */
int gsn_boundary_layer_new(const struct gsn_spline *spline, size_t tet, const uint32_t *near,
                           size_t count, struct gsn_boundary_layer **ret_skin,
                           struct gsn_error *err);
void gsn_boundary_layer_free(struct gsn_boundary_layer *skin);
GSN_DEFINE_AUTO(gsn_boundary_layer);

/* Whether the cell lies in Omega^I. */
int gsn_boundary_layer_clear(const struct gsn_boundary_layer *skin,
                             const struct gsn_tet_cell *cell);

/* What is to be added to the polynomial on a cell: the linear function with these values at the
 * corners, and something in low..high, rounding included. */
struct gsn_boundary_layer_bound {
    double corner[4], low, high;
};
/* By the d that reach the cell; returns how many there are. */
size_t gsn_boundary_layer_by_values(const struct gsn_boundary_layer *skin,
                                    const struct gsn_tet_cell *cell,
                                    struct gsn_boundary_layer_bound *ret_bound);
/* By the gradient. Returns 0, the output untouched, where s cannot be evaluated or a slope has no
 * bound. */
int gsn_boundary_layer_by_slopes(const struct gsn_boundary_layer *skin,
                                 const struct gsn_tet_cell *cell,
                                 struct gsn_boundary_layer_bound *ret_bound);

#ifdef __cplusplus
}
#endif
#endif
