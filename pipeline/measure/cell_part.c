/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/cell_part.h"

#include <math.h>
#include <string.h>

#include "pipeline/model/bpatch.h"
#include "pipeline/model/simplex_spline.h"

static double linear_at(const uint8_t beta[4], const double corner[4], unsigned degree)
{
    double sum = 0.0;

    for (int k = 0; k < 4; k++)
        sum += beta[k] * corner[k];
    return sum / degree;
}

/* p on a part, less the threshold: within low..high of the linear function with these corner
 * values, and within least..most. */
struct linear {
    double corner[4], low, high, least, most;
};

static struct linear linear_of(const struct gsn_skin *skin, const double *coefficient,
                               double threshold)
{
    const struct gsn_dms *space = gsn_spline_space(skin->spline);
    struct linear linear = { { 0.0 }, 0.0, 0.0, INFINITY, -INFINITY };

    for (int k = 0; k < 4; k++) {
        uint8_t beta[4] = { 0, 0, 0, 0 };

        beta[k] = (uint8_t)skin->degree;
        linear.corner[k] = coefficient[gsn_simplex_place(beta)] - threshold;
    }
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const double value = coefficient[f] - threshold;
        const double rest = value - linear_at(gsn_dms_beta(space, f), linear.corner, skin->degree);

        linear.low = fmin(linear.low, rest);
        linear.high = fmax(linear.high, rest);
        linear.least = fmin(linear.least, value);
        linear.most = fmax(linear.most, value);
    }
    return linear;
}

/* Narrows the part's shares by one bound of what is to be added to p. */
static void narrow(const struct linear *linear, const struct gsn_skin_bound *bound, double *lower,
                   double *upper)
{
    double low[4], high[4];

    for (int k = 0; k < 4; k++) {
        low[k] = linear->corner[k] + bound->corner[k] + linear->low + bound->low;
        high[k] = linear->corner[k] + bound->corner[k] + linear->high + bound->high;
    }
    *lower = fmax(*lower, gsn_tet_share_above(low));
    *upper = fmin(*upper, gsn_tet_share_above(high));
}

static double square_length(const struct gsn_tet_cell *cell, int i, int j)
{
    double edge[3];

    gsn_subtract(cell->corner[i], cell->corner[j], edge);
    return gsn_dot(edge, edge);
}

/* The largest second difference of the coefficients along an edge. */
static double bend(const struct gsn_cell_part *part, int i, int j)
{
    uint8_t g[4] = { (uint8_t)(part->skin->degree - 2U), 0, 0, 0 };
    double most = 0.0;

    do {
        double value[3];

        for (int s = 0; s < 3; s++) {
            uint8_t beta[4];

            memcpy(beta, g, sizeof beta);
            beta[i] = (uint8_t)(beta[i] + 2 - s);
            beta[j] = (uint8_t)(beta[j] + s);
            value[s] = part->coefficient[gsn_simplex_place(beta)];
        }
        most = fmax(most, fabs(value[0] - 2.0 * value[1] + value[2]));
    } while (gsn_simplex_next(g));
    return most;
}

/* Across the strongest bend; where the gap is not bend, parts are to get smaller all round. */
static void choose_edge(int bent, struct gsn_cell_part *part)
{
    double best = -1.0;

    for (uint8_t i = 0; i < 4; i++) {
        for (uint8_t j = (uint8_t)(i + 1); j < 4; j++) {
            const double size = bent ? bend(part, i, j) : square_length(&part->at, i, j);

            if (size > best) {
                best = size;
                part->edge[0] = i;
                part->edge[1] = j;
            }
        }
    }
}

/* Finds the part's volumes, and its edge. */
static void measure(struct gsn_cell_part *part, double threshold)
{
    static const double nothing[GSN_DMS_MAX_FUNCTIONS] = { 0.0 };
    const struct gsn_skin *skin = part->skin;
    const int clear = gsn_skin_clear(skin, &part->at);
    const struct linear linear =
        linear_of(skin, clear || skin->whole ? part->coefficient : nothing, threshold);
    struct gsn_skin_bound by_values = { .low = -skin->slack, .high = skin->slack }, by_slopes;
    const size_t reach = clear ? 0 : gsn_skin_by_values(skin, &part->at, &by_values);
    double lower = 0.0, upper = 1.0, width;

    narrow(&linear, &by_values, &lower, &upper);
    if (linear.least + by_values.low > 0.0)
        lower = 1.0;
    if (linear.most + by_values.high <= 0.0)
        upper = 0.0;
    width = by_values.high - by_values.low;
    if (reach > 0 && upper > lower && gsn_skin_by_slopes(skin, &part->at, &by_slopes)) {
        narrow(&linear, &by_slopes, &lower, &upper);
        width = fmin(width, by_slopes.high - by_slopes.low);
    }
    choose_edge(skin->degree > 1 && linear.high - linear.low > width, part);
    /* Both are true; rounding may cross them by a little, which the slack of the sum covers. */
    part->lower = fmin(lower, upper) * part->volume;
    part->upper = fmax(lower, upper) * part->volume;
}

void gsn_cell_part_make(const struct gsn_skin *skin, const struct gsn_tet_cell *at,
                        double threshold, struct gsn_cell_part *ret_part)
{
    const double *const corner[4] = { at->corner[0], at->corner[1], at->corner[2], at->corner[3] };

    *ret_part = (struct gsn_cell_part){ .at = *at, .skin = skin };
    gsn_bpatch_bernstein(skin->degree, (const double(*)[3])skin->knot, skin->control, corner,
                         ret_part->coefficient);
    ret_part->volume = gsn_tet_cell_volume(at);
    measure(ret_part, threshold);
}

/* One corner goes to the middle of the edge: coefficient beta is the mean of those with some of
 * beta_move given to keep, weighted by the binomials. */
void gsn_cell_part_halve(const struct gsn_cell_part *part, double threshold, int end,
                         struct gsn_cell_part *ret_half)
{
    static const double binomial[4][4] = { { 1 }, { 1, 1 }, { 1, 2, 1 }, { 1, 3, 3, 1 } };
    const struct gsn_dms *space = gsn_spline_space(part->skin->spline);
    const int keep = part->edge[end], move = part->edge[1 - end];

    *ret_half = *part;
    for (int a = 0; a < 3; a++)
        ret_half->at.corner[move][a] =
            0.5 * part->at.corner[keep][a] + 0.5 * part->at.corner[move][a];
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        uint8_t beta[4];
        const uint8_t *whole = gsn_dms_beta(space, f);
        double sum = 0.0;

        memcpy(beta, whole, sizeof beta);
        for (uint8_t s = 0; s <= whole[move]; s++) {
            beta[move] = s;
            beta[keep] = (uint8_t)(whole[keep] + whole[move] - s);
            sum += binomial[whole[move]][s] * part->coefficient[gsn_simplex_place(beta)];
        }
        ret_half->coefficient[f] = ldexp(sum, -whole[move]);
    }
    ret_half->volume = 0.5 * part->volume;
    ret_half->level++;
    measure(ret_half, threshold);
}
