/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The space of trivariate simplex (DMS) splines over a tetrahedral mesh.
 *
 * Every vertex i carries a cloud of knots t_{i,0..n}, t_{i,0} being the vertex. A tetrahedron
 * I = (i_0..i_3) and beta with |beta| = n name one basis function,
 *
 *     N_beta^I(u) = |det X_beta| M(u | V_beta),   X_beta = (t_{i_k,beta_k}),
 *     V_beta = {t_{i_k,0..beta_k}},               M = 1/|det| in degree 0,
 *
 * where M follows the recurrence of Micchelli (docs/MATH.md, equations (1) and (2)). Functions of a
 * tetrahedron are ordered (n,0,0,0), (n-1,1,0,0), (n-1,0,1,0), (n-1,0,0,1), (n-2,2,0,0), ...
 *
 * Every inside/outside decision is exact and taken at u + e (1,0,0) + e^2 (0,1,0) + e^3 (0,0,1),
 * e -> 0+ : a voxel centre on a mesh plane belongs to exactly one side. */
#ifndef GSN_MODEL_DMS_H
#define GSN_MODEL_DMS_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "pipeline/model/kernels.h"
#include "pipeline/model/tets.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    GSN_DMS_MAX_DEGREE = 3,
    GSN_DMS_MAX_FUNCTIONS = 20, /* of one tetrahedron: binomial(n + 3, 3) */
    GSN_DMS_OUTSIDE = 1,        /* returned, not an error: the point lies in no tetrahedron */
};

/* One control point per (vertices of beta with multiplicity), C^{n-1} and without cliffs at faces;
 * or one per (tetrahedron, beta) as the paper prints it. */
enum gsn_dms_sharing { GSN_DMS_SHARED, GSN_DMS_OWN };

struct gsn_dms;

/* gives: (degree + 1) knots per vertex, knot l of vertex i at [i * (degree + 1) + l].
 *
 * The cloud of a vertex has radius fraction * (smallest altitude of the tetrahedra around it),
 * 0 < fraction <= 0.5; clouds of boundary vertices point outward where a common outward direction
 * exists. Clouds are shrunk until every det X_beta (|beta| <= n) is safely positive and sum delta <
 * 1 in every tetrahedron (docs/MATH.md), and drawn anew until no four knots of a V_beta lie in one
 * plane. The same mesh gives the same clouds. Fails with GSN_E_INPUT, GSN_E_MESH, GSN_E_NOMEM. */
int gsn_dms_clouds(const struct gsn_tets *mesh, unsigned degree, double fraction,
                   double (**ret_knots)[3], struct gsn_error *err);

/* gives: the space; copies mesh and knots. degree is 1..GSN_DMS_MAX_DEGREE.
 * Fails with GSN_E_MESH naming the tetrahedron when a cloud is not valid: knots fold over, or two
 * of a vertex are less than 1e-10 of an edge apart and not the same; GSN_E_INPUT on a degree or
 * coordinate out of range, GSN_E_NOMEM. */
int gsn_dms_new(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3],
                enum gsn_dms_sharing sharing, struct gsn_dms **ret_space, struct gsn_error *err);
void gsn_dms_free(struct gsn_dms *space);
GSN_DEFINE_AUTO(gsn_dms);

/* The kernels that evaluate splines of this space: the best of this processor until told otherwise.
 * All give the same bits. keeps kernels. */
void gsn_dms_use(struct gsn_dms *space, const struct gsn_kernels *kernels);

/* Bytes of memory the space holds: its copies of mesh and knots, control numbers, search tree and
 * tables. */
size_t gsn_dms_bytes(const struct gsn_dms *space);

/* borrowed: valid as long as the space. */
const struct gsn_tets *gsn_dms_mesh(const struct gsn_dms *space);
const double (*gsn_dms_knots(const struct gsn_dms *space))[3];
unsigned gsn_dms_degree(const struct gsn_dms *space);
enum gsn_dms_sharing gsn_dms_sharing(const struct gsn_dms *space);
/* binomial(n + 3, 3). */
size_t gsn_dms_functions(const struct gsn_dms *space);
/* The number of control points, i.e. of unknowns. */
size_t gsn_dms_controls(const struct gsn_dms *space);
/* borrowed: control point of each function of a tetrahedron, gsn_dms_functions() of them. */
const uint32_t *gsn_dms_control_ids(const struct gsn_dms *space, size_t tet);
/* borrowed: beta of function f of any tetrahedron of this space. */
const uint8_t *gsn_dms_beta(const struct gsn_dms *space, size_t function);

/* The tetrahedron that holds u by the half-open rule; hint is where to start walking (any number,
 * best the last answer: it is quick when u is near, and decides nothing). A point that is not
 * finite is outside. Returns GSN_OK, or GSN_DMS_OUTSIDE with *ret_tet untouched. */
int gsn_dms_locate(const struct gsn_dms *space, const double u[3], size_t hint, size_t *ret_tet);

/* delta_k of the core of a tetrahedron: where every barycentric lambda_k > delta_k the spline is
 * one polynomial (docs/MATH.md, "core tetrahedron"). */
void gsn_dms_core(const struct gsn_dms *space, size_t tet, double ret_delta[4]);

struct gsn_dms_term {
    uint32_t tet, function, control;
    double value;
    double gradient[3];
};

/* All functions that do not vanish at u, in order of (tet, function); in the domain they sum to 1.
 * Writes at most room terms and says in *ret_count how many there are. Gradients are filled only
 * when with_gradient is not 0. hint as in gsn_dms_locate() and updated.
 * Returns GSN_OK, or GSN_DMS_OUTSIDE when u lies in no tetrahedron (*ret_count is then 0). */
int gsn_dms_basis(const struct gsn_dms *space, const double u[3], int with_gradient, size_t *hint,
                  struct gsn_dms_term *ret_terms, size_t room, size_t *ret_count);

#ifdef __cplusplus
}
#endif
#endif
