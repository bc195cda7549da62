/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The polynomial pieces of a spline, made ready to be bounded on axis-aligned boxes.
 *
 * On tetrahedron I the spline is p_I + something in [residual_low, residual_high]; the something is
 * 0 on the core of I. A piece holds p_I as a tensor of monomials, so that moving it to a box costs
 * some hundred operations. */
#ifndef GSN_MEASURE_LOCAL_POLYNOMIAL_H
#define GSN_MEASURE_LOCAL_POLYNOMIAL_H

#include "pipeline/measure/aabb.h"
#include "pipeline/model/spline.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    GSN_LOCAL_POLYNOMIAL_SIDE = GSN_DMS_MAX_DEGREE + 1,
    GSN_LOCAL_POLYNOMIAL_TERMS =
        GSN_LOCAL_POLYNOMIAL_SIDE * GSN_LOCAL_POLYNOMIAL_SIDE * GSN_LOCAL_POLYNOMIAL_SIDE,
    GSN_LOCAL_POLYNOMIAL_CAPS = 6,
};

/* One coefficient of the gradient. With shared control points the gradient of s is itself a simplex
 * spline, of degree n - 1, with the coefficients
 *
 *     G_g = n grad of the linear function that is c_{g + e_j} at t_{j,g_j},   |g| = n - 1
 *
 * (terms without a whole cloud cancel between neighbours): on any box grad s is a convex
 * combination of the G_g whose functions reach it, with weights that also give u from the nodes
 * when n >= 2. */
struct gsn_local_polynomial_slope {
    double gradient[3], node[3]; /* node: the mean of the n - 1 knots of g */
    double least[4];             /* of lambda_k over the knots of the function's support */
    /* For n = 2 the function itself is nowhere above any of cap[i][0..2] . x + cap[i][3]. */
    unsigned caps;
    double cap[GSN_LOCAL_POLYNOMIAL_CAPS][4];
};

struct gsn_local_polynomial {
    unsigned degree;
    double origin[3], scale; /* x = (u - origin) / scale; the centroid and the longest reach */
    double lambda[4][3];     /* lambda_k = 1/4 + lambda[k] . x */
    double delta[4];         /* the core: every lambda_k > delta[k] */
    double least[4];         /* of lambda_k over all knots: below it no function of I reaches */
    int inward;              /* whether a cloud on the domain's boundary points into it */
    double residual_low, residual_high;
    double whole_low, whole_high; /* of s on the tetrahedron */
    /* coefficient of x^i y^j z^k at [(i (n+1) + j) (n+1) + k], 0 where i + j + k > n */
    double monomial[GSN_LOCAL_POLYNOMIAL_TERMS];
    /* no less than the sum of the sizes of all terms that made the monomials of total degree d */
    double size[GSN_LOCAL_POLYNOMIAL_SIDE];
    const struct gsn_local_polynomial_slope *slope; /* gsn_local_polynomial_slopes() of them */
};

/* How many gradient coefficients a tetrahedron of this space has. */
size_t gsn_local_polynomial_slopes(const struct gsn_dms *space);

/* ret_slope: room for gsn_local_polynomial_slopes(); the piece keeps it. */
void gsn_local_polynomial_make(const struct gsn_spline *spline, size_t tet,
                               struct gsn_local_polynomial_slope *ret_slope,
                               struct gsn_local_polynomial *ret_piece);

/* Whether any function of the tetrahedron may differ from 0 somewhere in the box. */
int gsn_local_polynomial_reaches(const struct gsn_local_polynomial *piece,
                                 const struct gsn_aabb *box);
/* No less than the function of one gradient coefficient anywhere in the box; 0 when it does not
 * reach it, at most 1. */
double gsn_local_polynomial_slope_weight(const struct gsn_local_polynomial *piece,
                                         const struct gsn_local_polynomial_slope *slope,
                                         const struct gsn_aabb *box);

/* Smallest barycentric coordinate of a point: >= 0 inside. */
double gsn_local_polynomial_depth(const struct gsn_local_polynomial *piece, const double u[3]);

enum gsn_local_polynomial_touch {
    GSN_LOCAL_POLYNOMIAL_APART,   /* the box meets the tetrahedron nowhere */
    GSN_LOCAL_POLYNOMIAL_TOUCHES, /* it may */
    GSN_LOCAL_POLYNOMIAL_COVERS,  /* it lies in the core: s is p_I on the box */
};
enum gsn_local_polynomial_touch gsn_local_polynomial_meets(const struct gsn_local_polynomial *piece,
                                                           const struct gsn_aabb *box);

/* l(t) = value + slope . t on the box, t in [-1,1]^3: value and gradient of p_I at its centre.
 * bend[a] is the sum of the sizes of p_I's further terms that change along axis a. */
struct gsn_local_polynomial_linear {
    double value, slope[3], bend[3];
};
/* The terms of second degree at the same centre: sum square[a] t_a^2 + cross[a] t_b t_c. */
struct gsn_local_polynomial_bend {
    double square[3], cross[3];
};
void gsn_local_polynomial_tangent(const struct gsn_local_polynomial *piece,
                                  const struct gsn_aabb *box,
                                  struct gsn_local_polynomial_linear *ret_linear,
                                  struct gsn_local_polynomial_bend *ret_bend);

/* low <= p_I - l <= high on the whole box, rounding included. */
void gsn_local_polynomial_bound(const struct gsn_local_polynomial *piece,
                                const struct gsn_aabb *box,
                                const struct gsn_local_polynomial_linear *linear, double *ret_low,
                                double *ret_high);

#ifdef __cplusplus
}
#endif
#endif
