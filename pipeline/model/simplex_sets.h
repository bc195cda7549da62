/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The knot sets of one tetrahedron, and how they descend from each other.
 *
 * Each of the four vertices of a tetrahedron has a cloud of n + 1 knots. Here they carry local
 * numbers, knot l of vertex k being k (n + 1) + l, and a knot set is a bit mask. The sets that the
 * recurrences of degree n ever meet are the subsets of the V_beta, and they are the same for every
 * tetrahedron: this table lists them once, largest first, so that the recurrences can share what
 * they have computed between functions (691 sets of more than two knots at n = 3, instead of
 * 20 * 99). */
#ifndef GSN_MODEL_SIMPLEX_SETS_H
#define GSN_MODEL_SIMPLEX_SETS_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

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

#ifdef __cplusplus
}
#endif
#endif
