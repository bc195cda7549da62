/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What making a piece (piece_make.c) and bounding it on boxes (piece.c) share. Private to them. */
#ifndef GSN_MEASURE_PIECE_PARTS_H
#define GSN_MEASURE_PIECE_PARTS_H

#include "pipeline/measure/piece.h"

/* Barycentric coordinates are sums of four products of order one: their rounding is some 1e-15. A
 * box this much nearer than it seems is looked at too. */
#define GSN_PIECE_LAMBDA_SLACK 1e-12

/* A value on a box is some hundred operations away from the Bernstein coefficients, each with a
 * relative rounding of 1.1e-16 of terms no larger than the sizes kept: 1e-12 of their sum is more
 * than all of it. */
#define GSN_PIECE_VALUE_SLACK 1e-12

/* Place of x^i y^j z^k among the monomials of degree n. */
static inline size_t gsn_piece_at(unsigned n, unsigned i, unsigned j, unsigned k)
{
    return (i * (n + 1U) + j) * (n + 1U) + k;
}

/* Barycentric coordinate k of a point. */
static inline double gsn_piece_lambda(const struct gsn_piece *piece, int k, const double u[3])
{
    double lambda = 0.25;

    for (int a = 0; a < 3; a++)
        lambda += piece->lambda[k][a] * ((u[a] - piece->origin[a]) / piece->scale);
    return lambda;
}

#endif
