/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Boxes cut into cubes cut into six tetrahedra around their diagonal (Kuhn, Freudenthal), and
 * pseudo-random numbers for tests. */
#ifndef GSN_TESTS_MODEL_KUHN_H
#define GSN_TESTS_MODEL_KUHN_H

#include "pipeline/model/spline.h"

/* gives: the mesh of cells[0] x cells[1] x cells[2] cubes of edge 1 with corner 0. Inner vertices
 * are shifted at random by up to jitter along each axis. */
struct gsn_tets *kuhn_mesh(const size_t cells[3], double jitter);

/* gives: a space over such a mesh, with clouds of this fraction. */
struct gsn_dms *kuhn_space(const size_t cells[3], double jitter, unsigned degree, double fraction,
                           enum gsn_dms_sharing sharing);

/* gives: the same over any mesh, which it takes. */
struct gsn_dms *kuhn_space_on(struct gsn_tets *mesh, unsigned degree, double fraction,
                              enum gsn_dms_sharing sharing);

/* A space, and a spline on it with random control values. */
struct kuhn_made {
    struct gsn_dms *space;
    struct gsn_spline *spline;
};

/* takes: the space, until kuhn_unmake(). */
struct kuhn_made kuhn_make(struct gsn_dms *space);
void kuhn_unmake(struct kuhn_made *made);

/* The next of a fixed sequence, in [0, 1). */
double draw(uint64_t *seed);
/* A point of tetrahedron t with random barycentric coordinates. */
void draw_inside(const struct gsn_tets *mesh, size_t t, uint64_t *seed, double ret_u[3]);

/* A polynomial of three variables by its polar form: F(u_1..u_n) of
 * p = sum over j of weight[j] (a_j . u + b_j)^n is the sum of the products. */
struct polynomial {
    unsigned degree;
    double weight[20], slope[20][3], constant[20];
};
struct polynomial draw_polynomial(unsigned degree, uint64_t *seed);
double polynomial_at(const struct polynomial *p, const double u[3], double *ret_gradient);
double polynomial_polar(const struct polynomial *p, const double *const arg[]);
/* gives: the control points that make the spline that polynomial. */
double *polynomial_controls(const struct polynomial *p, const struct gsn_dms *space);

#endif
