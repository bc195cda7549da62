/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Simplex splines of the knots of one tetrahedron at one point, by Micchelli's recurrence:
 *
 *     M(u | V) = sum_j lambda_j(u | W) M(u | V \ k_j),      W four knots of V,
 *     M(u | V) = 1/|det V| inside the tetrahedron V, 0 outside     (degree 0),
 *     D_v M(u | V) = n sum_j mu_j(v | W) M(u | V \ k_j),
 *     D_{t,v} M(u | V) = -1/(n + 1) D_v M(u | V + t)                (by a knot t of V).
 *
 * The value does not depend on W but its rounding error does: W has the largest |det|, or nearly
 * so where that lets more sets share subsets, chosen once per knot set whatever u is. Inside and
 * outside are exact and half-open, with one sign per knot triple and point, so that neighbouring
 * tetrahedra never both claim or both refuse a point (docs/MATH.md, sections 1, 2 and 9). */
#ifndef GSN_MODEL_SIMPLEX_SPLINE_H
#define GSN_MODEL_SIMPLEX_SPLINE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The knot sets of one tetrahedron, and how they descend from each other.
 *
 * Each of the four vertices of a tetrahedron has a cloud of n + 1 knots. Here they carry local
 * numbers, knot l of vertex k being k (n + 1) + l, and a knot set is a bit mask. The sets that the
 * recurrences of degree n ever meet are the subsets of the V_beta, and they are the same for every
 * tetrahedron: this table lists them once, largest first, so that the recurrences can share what
 * they have computed between functions (691 sets of more than two knots at n = 3, instead of
 * 20 * 99). */

enum {
    GSN_SIMPLEX_MAX_DEGREE = 3,
    GSN_SIMPLEX_MAX_FUNCTIONS = 20, /* binomial(n + 3, 3) */
    GSN_SIMPLEX_MAX_KNOTS = 16,     /* 4 (n + 1) */
    GSN_SIMPLEX_MAX_MEMBERS = 7,    /* n + 4 */
    /* What degree 3 needs: sets of three, of four, and of more knots. */
    GSN_SIMPLEX_MAX_TRIPLES = 216,
    GSN_SIMPLEX_MAX_QUADS = 309,
    GSN_SIMPLEX_MAX_LARGE = 382,
    GSN_SIMPLEX_MAX_SETS = GSN_SIMPLEX_MAX_TRIPLES + GSN_SIMPLEX_MAX_QUADS + GSN_SIMPLEX_MAX_LARGE,
};

struct gsn_simplex_set {
    uint16_t mask;                             /* bit per local knot */
    uint8_t size;                              /* number of knots, 3..n + 4 */
    uint8_t missing;                           /* bit per cloud that has no knot in the set */
    uint8_t member[GSN_SIMPLEX_MAX_MEMBERS];   /* the knots, ascending */
    uint8_t cloud[GSN_SIMPLEX_MAX_MEMBERS];    /* and the clouds they are of */
    uint16_t without[GSN_SIMPLEX_MAX_MEMBERS]; /* the set less member i; none for size 3 */
};

/* Sets are numbered by size, descending: those of m knots are first[m] .. first[m - 1] - 1, so
 * first[n + 4] = 0 and first[2] = count. Set f < functions is V_beta of function f. */
struct gsn_simplex_sets {
    unsigned degree;
    size_t functions, count;
    size_t first[GSN_SIMPLEX_MAX_MEMBERS + 1];
    struct gsn_simplex_set *set;
    uint8_t beta[GSN_SIMPLEX_MAX_FUNCTIONS][4];
    uint16_t corners[GSN_SIMPLEX_MAX_FUNCTIONS]; /* the set X_beta */
    /* The candidates for W of a set s of more than four knots: its subsets of four are
     * quad[quads[s]] .. quad[quads[s + 1] - 1]. */
    size_t *quads;
    uint16_t *quad;
};

/* gives: the table for a degree of 1..3 (the caller guarantees it). Fails with GSN_E_NOMEM. */
int gsn_simplex_sets_new(unsigned degree, struct gsn_simplex_sets **ret_sets,
                         struct gsn_error *err);
void gsn_simplex_sets_free(struct gsn_simplex_sets *sets);
GSN_DEFINE_AUTO(gsn_simplex_sets);

/* The place of beta among the multi-indices of its own degree |beta| in the order (n,0,0,0),
 * (n-1,1,0,0), (n-1,0,1,0), (n-1,0,0,1), (n-2,2,0,0), ... */
size_t gsn_simplex_place(const uint8_t beta[4]);
/* The place of beta + e_j, for the places of degrees below the greatest; it depends on neither
 * beta_0 nor the degree. */
extern const uint8_t gsn_simplex_raised[10][4];
/* The next multi-index in that order; beta = (n,0,0,0) comes first. Returns 0 after the last. */
int gsn_simplex_next(uint8_t beta[4]);
/* binomial(degree + 3, 3). */
size_t gsn_simplex_count(unsigned degree);

/* det[b - a, c - a, d - a] of a set of four knots a < b < c < d; knot holds the 4 (n + 1) knots of
 * the tetrahedron. Knots of one cloud are subtracted from each other first, so that the result is
 * accurate relative to itself however small the clouds are. */
double gsn_simplex_det(const struct gsn_simplex_set *quad, const double (*knot)[3]);

/* (b - a) x (c - a) of a set of three knots a < b < c, as accurate. Unless ret_permanent is NULL it
 * gets, per component, the sum of the magnitudes that were subtracted. */
void gsn_simplex_normal(const struct gsn_simplex_set *triple, const double (*knot)[3],
                        double ret_normal[3], double *ret_permanent);

/* Chooses W, as the number of a set of four, for each of the sets->first[4] sets that have more
 * than four knots. Returns the least |det| of all sets of four. */
double gsn_simplex_pick(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                        uint16_t *ret_pick);

/* The plane through a knot triple a < b < c as seen from u. */
struct gsn_simplex_plane {
    double normal[3]; /* (b - a) x (c - a) */
    double value;     /* normal . (u - a), that is det[b - a, c - a, u - a] */
    int side;         /* exact sign of value after the half-open rule; 0: a, b, c on one line */
};

/* One evaluation: everything known so far at u. Fill with gsn_simplex_at_init(); large, so keep it
 * on the stack of one function. borrows all pointers. */
struct gsn_simplex_at {
    const struct gsn_simplex_sets *sets;
    const double (*knot)[3];
    const uint16_t *pick;
    const double *u;
    uint8_t nearest[4]; /* clouds by their distance from u */
    unsigned clear;     /* clouds k such that sets without a knot of k vanish at u */
    uint8_t knows_plane[GSN_SIMPLEX_MAX_TRIPLES];
    uint8_t knows_det[GSN_SIMPLEX_MAX_QUADS];
    uint8_t knows_value[GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS];
    struct gsn_simplex_plane plane[GSN_SIMPLEX_MAX_TRIPLES];
    double det[GSN_SIMPLEX_MAX_QUADS];
    double value[GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS];
};

/* clear is a bit per cloud, 0 being always right: bit k may be set when lambda_k(u) exceeds that
 * of every knot outside cloud k, lambda with respect to the tetrahedron. */
void gsn_simplex_at_init(struct gsn_simplex_at *at, const struct gsn_simplex_sets *sets,
                         const double (*knot)[3], const uint16_t *pick, const double u[3],
                         unsigned clear);

/* M(u | set s), for any set of four knots or more. */
double gsn_simplex_value(struct gsn_simplex_at *at, size_t s);
/* Its gradient; 0 for sets of four knots. */
void gsn_simplex_gradient(struct gsn_simplex_at *at, size_t s, double ret_gradient[3]);

/* Its second derivatives xx, xy, xz, yy, yz, zz, by the same formula applied twice; 0 for sets of
 * five knots or fewer. On a knot plane they are the limit from the side of the half-open rule. */
void gsn_simplex_hessian(struct gsn_simplex_at *at, size_t s, double ret_hessian[6]);

/* The gradient of N_beta(u) of one function with respect to the place of knot t, equation (6)
 * corrected:
 *
 *     D_{t,v} N = - |det X_beta| sum_m mu_m(v | W) M(u | (V_beta + t) \ k_m) + mu_t(v | X_beta) N,
 *
 * where t counts twice in V_beta + t, and the last term is there when t is a corner of X_beta. 0
 * for knots outside V_beta. */
void gsn_simplex_knot_gradient(struct gsn_simplex_at *at, size_t function, unsigned t,
                               double ret_gradient[3]);

/* Everything a tetrahedron contributes at u: N_beta = |det X_beta| M(V_beta) of all functions and,
 * unless ret_gradient is NULL, their gradients. */
void gsn_simplex_basis(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                       const uint16_t *pick, const double u[3], unsigned clear, double *ret_value,
                       double (*ret_gradient)[3]);
/* The second derivatives of all N_beta, as in gsn_simplex_hessian(). */
void gsn_simplex_basis_hessian(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                               const uint16_t *pick, const double u[3], unsigned clear,
                               double (*ret_hessian)[6]);

/* Integrals of simplex splines along whole lines, by projection.
 *
 * Seen along a line of unit direction, a trivariate spline of degree n over n + 4 knots becomes a
 * bivariate one of degree n + 1 over the same knots projected:
 *
 *     int M(x + t d | V) dt = M2(0 | P V) / (n + 1),     P x = 0,
 *
 * and M2 follows the same recurrence with three knots for W. Any knots will do, coinciding ones as
 * well (docs/MATH.md, section 4). */

/* Integrals of M(. | V_beta) of all functions. knot holds the 4 (n + 1) knots projected along the
 * line, which itself is the origin of the plane. Returns 0, leaving ret_integral undefined, when
 * the line misses them all. */
int gsn_simplex_line(const struct gsn_simplex_sets *sets, const double (*knot)[2],
                     double *ret_integral);

#ifdef __cplusplus
}
#endif
#endif
