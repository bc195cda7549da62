/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/piece_parts.h"

#include <math.h>
#include <string.h>

double gsn_piece_depth(const struct gsn_piece *piece, const double u[3])
{
    double depth = INFINITY;

    for (int k = 0; k < 4; k++)
        depth = fmin(depth, gsn_piece_lambda(piece, k, u));
    return depth;
}

/* Whether lambda_k rises to least[k] or more somewhere in the box, for every k by itself. */
static int rises_to(const struct gsn_piece *piece, const double least[4], const struct gsn_box *box)
{
    const double scale = 1.0 / piece->scale;

    for (int k = 0; k < 4; k++) {
        double most = 0.25;

        for (int a = 0; a < 3; a++)
            most += piece->lambda[k][a] * ((box->centre[a] - piece->origin[a]) * scale) +
                    fabs(piece->lambda[k][a]) * (box->half[a] * scale);
        if (most < least[k] - GSN_PIECE_LAMBDA_SLACK)
            return 0;
    }
    return 1;
}

int gsn_piece_reaches(const struct gsn_piece *piece, const struct gsn_box *box)
{
    return rises_to(piece, piece->least, box);
}

double gsn_piece_slope_weight(const struct gsn_piece *piece, const struct gsn_piece_slope *slope,
                              const struct gsn_box *box)
{
    const double scale = 1.0 / piece->scale;
    double weight = 1.0;

    if (!rises_to(piece, slope->least, box))
        return 0.0;
    for (unsigned i = 0; i < slope->caps; i++) {
        const double *cap = slope->cap[i];
        double most = cap[3];

        for (int a = 0; a < 3; a++)
            most += cap[a] * ((box->centre[a] - piece->origin[a]) * scale) +
                    fabs(cap[a]) * (box->half[a] * scale);
        weight = fmin(weight, most);
    }
    return fmax(0.0, weight);
}

enum gsn_piece_touch gsn_piece_meets(const struct gsn_piece *piece, const struct gsn_box *box)
{
    const double scale = 1.0 / piece->scale;
    int in_core = 1;

    for (int k = 0; k < 4; k++) {
        double middle = 0.25, reach = 0.0;

        for (int a = 0; a < 3; a++) {
            middle += piece->lambda[k][a] * ((box->centre[a] - piece->origin[a]) * scale);
            reach += fabs(piece->lambda[k][a]) * (box->half[a] * scale);
        }
        if (middle + reach < -GSN_PIECE_LAMBDA_SLACK)
            return GSN_PIECE_APART;
        if (middle - reach <= piece->delta[k] + GSN_PIECE_LAMBDA_SLACK)
            in_core = 0;
    }
    return in_core ? GSN_PIECE_COVERS : GSN_PIECE_TOUCHES;
}

/* The coefficients of one line of the tensor about x0, for steps of w: Horner's rule, repeated. */
static void shift_line(double *first, size_t stride, unsigned degree, double x0, double w)
{
    double power = w;

    for (unsigned r = 0; r < degree; r++) {
        for (unsigned i = degree; i-- > r;)
            first[i * stride] += x0 * first[(i + 1) * stride];
    }
    for (unsigned i = 1; i <= degree; i++) {
        first[i * stride] *= power;
        power *= w;
    }
}

/* The piece as a polynomial in the box's own t in [-1,1]^3. */
static void shift(const struct gsn_piece *piece, const struct gsn_box *box, double *ret_term)
{
    const unsigned n = piece->degree;
    const size_t stride[3] = { (n + 1U) * (n + 1U), n + 1U, 1 };

    memcpy(ret_term, piece->monomial, (n + 1U) * (n + 1U) * (n + 1U) * sizeof *ret_term);
    for (int a = 0; a < 3; a++) {
        const double x0 = (box->centre[a] - piece->origin[a]) / piece->scale;
        const double w = box->half[a] / piece->scale;
        const size_t down = stride[(a + 1) % 3], across = stride[(a + 2) % 3];

        for (unsigned i = 0; i <= n; i++) {
            for (unsigned j = 0; i + j <= n; j++)
                shift_line(ret_term + i * down + j * across, stride[a], n - i - j, x0, w);
        }
    }
}

void gsn_piece_tangent(const struct gsn_piece *piece, const struct gsn_box *box,
                       struct gsn_piece_linear *ret_linear, struct gsn_piece_bend *ret_bend)
{
    const unsigned n = piece->degree;
    double term[GSN_PIECE_TERMS];

    shift(piece, box, term);
    *ret_linear = (struct gsn_piece_linear){
        .value = term[0],
        .slope = { term[gsn_piece_at(n, 1, 0, 0)], term[gsn_piece_at(n, 0, 1, 0)],
                   term[gsn_piece_at(n, 0, 0, 1)] },
    };
    *ret_bend = (struct gsn_piece_bend){ { 0.0 }, { 0.0 } };
    if (n >= 2)
        *ret_bend = (struct gsn_piece_bend){
            .square = { term[gsn_piece_at(n, 2, 0, 0)], term[gsn_piece_at(n, 0, 2, 0)],
                        term[gsn_piece_at(n, 0, 0, 2)] },
            .cross = { term[gsn_piece_at(n, 0, 1, 1)], term[gsn_piece_at(n, 1, 0, 1)],
                       term[gsn_piece_at(n, 1, 1, 0)] },
        };
    for (unsigned i = 0; i <= n; i++) {
        for (unsigned j = 0; i + j <= n; j++) {
            for (unsigned k = 0; i + j + k <= n; k++) {
                const double size = i + j + k > 1 ? fabs(term[gsn_piece_at(n, i, j, k)]) : 0.0;

                ret_linear->bend[0] += i > 0 ? size : 0.0;
                ret_linear->bend[1] += j > 0 ? size : 0.0;
                ret_linear->bend[2] += k > 0 ? size : 0.0;
            }
        }
    }
}

/* One line from powers of t in [-1,1] to Bernstein coefficients. */
static void bernstein_line(double *c, size_t stride, unsigned n)
{
    const double a0 = c[0], a1 = c[stride];

    if (n == 1) {
        c[0] = a0 - a1;
        c[stride] = a0 + a1;
    } else if (n == 2) {
        const double a2 = c[2 * stride];

        c[0] = a0 - a1 + a2;
        c[stride] = a0 - a2;
        c[2 * stride] = a0 + a1 + a2;
    } else {
        const double a2 = c[2 * stride], a3 = c[3 * stride];

        c[0] = a0 - a1 + a2 - a3;
        c[stride] = a0 - (a1 + a2) / 3.0 + a3;
        c[2 * stride] = a0 + (a1 - a2) / 3.0 - a3;
        c[3 * stride] = a0 + a1 + a2 + a3;
    }
}

/* More than the rounding in any coefficient of the piece on this box. */
static double rounding(const struct gsn_piece *piece, const struct gsn_box *box)
{
    double reach = 0.0, sum = 0.0;

    for (int a = 0; a < 3; a++)
        reach = fmax(reach, fabs(box->centre[a] - piece->origin[a]) + box->half[a]);
    reach /= piece->scale;
    for (unsigned d = piece->degree + 1; d-- > 0;)
        sum = sum * reach + piece->size[d];
    return GSN_PIECE_VALUE_SLACK * sum;
}

void gsn_piece_bound(const struct gsn_piece *piece, const struct gsn_box *box,
                     const struct gsn_piece_linear *linear, double *ret_low, double *ret_high)
{
    const unsigned n = piece->degree;
    const size_t side = n + 1U, stride[3] = { side * side, side, 1 };
    double term[GSN_PIECE_TERMS], low = INFINITY, high = -INFINITY;
    double square_low = 0.0, square_high = 0.0, slack = rounding(piece, box);

    shift(piece, box, term);
    term[0] -= linear->value;
    slack += GSN_PIECE_VALUE_SLACK * fabs(linear->value);
    for (int a = 0; a < 3; a++) {
        term[stride[a]] -= linear->slope[a];
        slack += GSN_PIECE_VALUE_SLACK * fabs(linear->slope[a]);
        /* t^2 is in [0,1]; its Bernstein hull would say [-1,1]. */
        if (n >= 2) {
            square_low += fmin(0.0, term[2 * stride[a]]);
            square_high += fmax(0.0, term[2 * stride[a]]);
            term[2 * stride[a]] = 0.0;
        }
    }
    for (int a = 0; a < 3; a++) {
        for (size_t i = 0; i < side; i++) {
            for (size_t j = 0; j < side; j++)
                bernstein_line(term + i * stride[(a + 1) % 3] + j * stride[(a + 2) % 3], stride[a],
                               n);
        }
    }
    for (size_t i = 0; i < side * side * side; i++) {
        low = fmin(low, term[i]);
        high = fmax(high, term[i]);
    }
    *ret_low = low + square_low - slack;
    *ret_high = high + square_high + slack;
}
