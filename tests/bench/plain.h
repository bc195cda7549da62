/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The textbook evaluator that the fast paths are measured against: equations (1) and (2) and
 * nothing else. For every tetrahedron whose support can hold u and every beta it recurses,
 *
 *     M(u | V) = sum_j lambda_j(u | W) M(u | V \ k_j),   M(u | V) = 1/|det V| inside, of 4 knots,
 *
 * sharing nothing between functions and remembering nothing between sets. Inside and outside are
 * decided exactly (gsn_orient_side), because without that the answer is wrong, not slow. */
#ifndef GSN_TESTS_BENCH_PLAIN_H
#define GSN_TESTS_BENCH_PLAIN_H

#include "pipeline/model/spline.h"

/* Which four knots W is, and which tetrahedra are asked. A tetrahedron is left out when u lies
 * beyond all of its knots in one of its barycentric coordinates; PLAIN_BOX asks all whose knots'
 * box holds u, about five times as many, and is the least fair to compare with. */
enum plain_choice {
    PLAIN_LARGEST, /* of largest |det|: chosen once per knot set, looked up */
    PLAIN_FIRST,   /* the first four that are independent, as public code does, found on the way */
    PLAIN_BOX,     /* PLAIN_LARGEST by boxes */
    PLAIN_CHOICES
};

struct plain;

/* gives; keeps spline. */
struct plain *plain_new(const struct gsn_spline *spline);
void plain_free(struct plain *plain);

/* s(u); 0 outside all supports. */
double plain_eval(const struct plain *plain, enum plain_choice choice, const double u[3]);

#endif
