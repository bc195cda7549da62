/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Splines by their definition: every tetrahedron asked by itself, by the recurrence alone, anywhere
 * in space. What the walk, the pruning and the polynomials of the product must agree with. */
#ifndef GSN_TESTS_MODEL_FORMULA_H
#define GSN_TESTS_MODEL_FORMULA_H

#include "pipeline/model/spline.h"

/* The functions of one tetrahedron at u, their gradients unless NULL, and their second derivatives
 * unless NULL. */
void formula_basis(const struct gsn_dms *space, size_t tet, const double u[3], double *ret_value,
                   double (*ret_gradient)[3], double (*ret_hessian)[6]);

/* s(u) and, unless NULL, its gradient. */
double formula_at(const struct gsn_dms *space, const double *control, const double u[3],
                  double *ret_gradient);

/* Adds the gradient of s(u) with respect to every knot to total, in the order of the knots. */
void formula_knots(const struct gsn_dms *space, const double *control, const double u[3],
                   double (*total)[3]);

/* A point of tetrahedron t, near its faces, edges and corners as often as in the middle. */
void draw_in_skins(const struct gsn_tets *mesh, size_t t, uint64_t *seed, double ret_u[3]);

/* gives: a spline with random control values in [-1, 1); keeps space. */
struct gsn_spline *random_spline(const struct gsn_dms *space, uint64_t *seed);

/* gives: the space of such a mesh as in kuhn_space(), with every knot drawn towards its vertex by
 * this factor: 0 makes all knots of a vertex coincide, 1e-6 makes the clouds tiny. */
struct gsn_dms *shrunk_space(const size_t cells[3], double jitter, unsigned degree, double factor,
                             enum gsn_dms_sharing sharing);

/* gives: a space over such a mesh pressed flat along z by this factor: slivers. */
struct gsn_dms *flat_space(const size_t cells[3], double jitter, unsigned degree, double factor,
                           enum gsn_dms_sharing sharing);

#endif
