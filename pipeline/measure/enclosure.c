/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Enclosures: a linear function plus an interval that holds a spline on a box, guaranteed.
 *
 * Method: interval enclosure of first order. Where one tetrahedron's functions are alone, its
 * tensor Bernstein coefficients (local_polynomial.h); elsewhere the exact value at the centre and
 * bounds of the gradient; where the gradient says nothing, the hull of all polynomials touched and
 * their residual bounds (docs/MATH.md, section 6).
 *
 * Steps: (1) a cheap hull from coefficients; (2) the linear function and its interval, for boxes
 * that the hull does not settle. Evaluation is good to about 1e-14 of the largest control value,
 * 1e-12 next to knot planes, and every bound has a slack above that.
 *
 * Failure: GSN_E_NOMEM when the polynomials are made; bounds never fail, they get wide.
 * Cost: linear in the tetrahedra touched, and one value of the spline. */
#include "pipeline/measure/enclosure.h"

#include "pipeline/core/parallel.h"

#include <math.h>

enum { BATCH = 64, MOST_PULLS = 256 };

/* Evaluation is good to about 1e-14 of the largest control value, 1e-12 next to knot planes. */
static const double value_slack = 1e-11;

static int make_batch(size_t batch, void *context, struct gsn_error *err)
{
    const struct gsn_local_polynomials *pieces = context;
    const size_t slopes = gsn_local_polynomial_slopes(gsn_spline_space(pieces->spline));

    (void)err;
    for (size_t t = batch * BATCH; t < pieces->count && t < (batch + 1) * BATCH; t++)
        gsn_local_polynomial_make(pieces->spline, t, pieces->slope + t * slopes, &pieces->piece[t]);
    return GSN_OK;
}

/* The control value of the function of tet with these multiplicities of three vertices. */
static double value_of(const struct gsn_spline *spline, size_t tet, const uint32_t vertex[3],
                       const uint8_t times[3])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const uint32_t *corner = gsn_dms_mesh(space)->tet[tet];
    size_t f = 0;

    for (;; f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        int same = 1;

        for (int k = 0; k < 4; k++) {
            uint8_t want = 0;

            for (int j = 0; j < 3; j++) {
                if (corner[k] == vertex[j])
                    want = times[j];
            }
            same &= beta[k] == want;
        }
        if (same)
            return gsn_spline_controls(spline)[gsn_dms_control_ids(space, tet)[f]];
    }
}

/* Whether both sides of face k of tet have the same control values for the face's functions. */
static int sides_agree(const struct gsn_spline *spline, size_t tet, int k)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const uint32_t *control = gsn_dms_control_ids(space, tet);
    uint32_t vertex[3];

    for (int j = 0; j < 3; j++)
        vertex[j] = mesh->tet[tet][(k + 1 + j) % 4];
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        const uint8_t times[3] = { beta[(k + 1) % 4], beta[(k + 2) % 4], beta[(k + 3) % 4] };
        const double here = gsn_spline_controls(spline)[control[f]];
        double there;

        if (beta[k] > 0)
            continue;
        there = value_of(spline, (size_t)mesh->neighbour[tet][k], vertex, times);
        if (here < there || here > there)
            return 0;
    }
    return 1;
}

static int all_agree(const struct gsn_spline *spline)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(spline));

    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (int k = 0; k < 4; k++) {
            if (mesh->neighbour[t][k] > (int32_t)t && !sides_agree(spline, t, k))
                return 0;
        }
    }
    return 1;
}

int gsn_local_polynomials_new(const struct gsn_spline *spline, unsigned threads,
                              struct gsn_local_polynomials **ret_pieces, struct gsn_error *err)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const size_t count = gsn_dms_mesh(space)->tet_count;
    gsn_auto(gsn_local_polynomials) pieces = gsn_alloc_array(1, sizeof *pieces);
    int r;

    if (pieces) {
        pieces->piece = gsn_alloc_array(count, sizeof *pieces->piece);
        pieces->slope =
            gsn_alloc_array(count, gsn_local_polynomial_slopes(space) * sizeof *pieces->slope);
    }
    if (!pieces || !pieces->piece || !pieces->slope)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    pieces->spline = spline;
    pieces->count = count;
    pieces->shared = all_agree(spline);
    for (size_t c = 0; c < gsn_dms_controls(space); c++)
        pieces->slack = fmax(pieces->slack, value_slack * fabs(gsn_spline_controls(spline)[c]));
    r = gsn_parallel_for((count + BATCH - 1) / BATCH, threads, make_batch, pieces, err);
    if (r < 0)
        return r;
    *ret_pieces = gsn_steal(&pieces);
    return GSN_OK;
}

void gsn_local_polynomials_free(struct gsn_local_polynomials *pieces)
{
    if (!pieces)
        return;
    gsn_free(pieces->piece);
    gsn_free(pieces->slope);
    gsn_free(pieces);
}

void gsn_enclosure_hull(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                        size_t count, const struct gsn_aabb *box, struct gsn_enclosure *ret_bracket,
                        uint32_t *ret_deepest)
{
    double depth = -INFINITY;

    *ret_bracket = (struct gsn_enclosure){ .least = INFINITY, .most = -INFINITY };
    for (size_t i = 0; i < count; i++) {
        const struct gsn_local_polynomial *piece = &pieces->piece[tet[i]];
        double here;

        if (gsn_local_polynomial_meets(piece, box) == GSN_LOCAL_POLYNOMIAL_APART)
            continue;
        ret_bracket->least = fmin(ret_bracket->least, piece->whole_low);
        ret_bracket->most = fmax(ret_bracket->most, piece->whole_high);
        here = gsn_local_polynomial_depth(piece, box->centre);
        if (here > depth) {
            depth = here;
            *ret_deepest = tet[i];
        }
    }
}

/* Which way the box is to be bounded. */
enum way { BY_POLYNOMIAL, BY_GRADIENT, BY_RESIDUAL };

static enum way choose_way(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                           size_t count, const struct gsn_aabb *box, uint32_t deepest)
{
    int alone = 1, inward = 0;

    if (gsn_local_polynomial_meets(&pieces->piece[deepest], box) == GSN_LOCAL_POLYNOMIAL_COVERS)
        return BY_POLYNOMIAL;
    for (size_t i = 0; i < count; i++) {
        if (gsn_local_polynomial_reaches(&pieces->piece[tet[i]], box)) {
            alone &= tet[i] == deepest;
            inward |= pieces->piece[tet[i]].inward;
        }
    }
    if (alone && !inward)
        return BY_POLYNOMIAL;
    return pieces->shared && !inward ? BY_GRADIENT : BY_RESIDUAL;
}

/* A gradient coefficient that reaches the box, less what the deepest polynomial's bend makes of its
 * node, in units of s per half edge; and how much it can weigh. */
struct pull {
    double gradient[3], weight;
};

static struct pull pull_of(const struct gsn_local_polynomial_slope *slope, double weight,
                           const struct gsn_aabb *box, const struct gsn_local_polynomial_bend *bend)
{
    struct pull pull = { .weight = weight };
    double t[3];

    for (int a = 0; a < 3; a++)
        t[a] = (slope->node[a] - box->centre[a]) / box->half[a];
    for (int a = 0; a < 3; a++) {
        const int b = (a + 1) % 3, c = (a + 2) % 3;

        pull.gradient[a] = slope->gradient[a] * box->half[a] - 2.0 * bend->square[a] * t[a] -
                           bend->cross[b] * t[c] - bend->cross[c] * t[b];
    }
    return pull;
}

/* When there is no room left, the last two places stand for the ends of all that came since, with
 * any weight. */
static void add_pull(struct pull *pull, size_t *count, struct pull more)
{
    if (*count < MOST_PULLS) {
        pull[(*count)++] = more;
        return;
    }
    for (int a = 0; a < 3; a++) {
        struct pull *low = &pull[MOST_PULLS - 2], *high = &pull[MOST_PULLS - 1];
        const double least = fmin(more.gradient[a], fmin(low->gradient[a], high->gradient[a]));
        const double most = fmax(more.gradient[a], fmax(low->gradient[a], high->gradient[a]));

        low->gradient[a] = least;
        high->gradient[a] = most;
    }
    pull[MOST_PULLS - 2].weight = pull[MOST_PULLS - 1].weight = 1.0;
}

/* The largest mean of sign * gradient[a] with weights up to their bounds that sum to 1: the largest
 * pulls first. */
static double strongest_pull(const struct pull *pull, size_t count, int a, double sign)
{
    double before = INFINITY, left = 1.0, mean = 0.0;

    while (left > 0.0) {
        double next = -INFINITY, weight = 0.0;

        /* All that pull equally are taken together. */
        for (size_t i = 0; i < count; i++) {
            const double here = sign * pull[i].gradient[a];

            if (here < before && here >= next) {
                weight = (here > next ? 0.0 : weight) + pull[i].weight;
                next = here;
            }
        }
        /* Bounds sum to 1 or more; rounding may leave a crumb, which the weakest takes. */
        if (isinf(next))
            return mean + left * before;
        mean += fmin(left, weight) * next;
        left -= weight;
        before = next;
    }
    return mean;
}

/* Between which bounds the mean gradient lies, less the bend. */
static void bound_gradient(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                           size_t count, const struct gsn_aabb *box,
                           const struct gsn_local_polynomial_bend *bend, double low[3],
                           double high[3])
{
    const size_t slopes = gsn_local_polynomial_slopes(gsn_spline_space(pieces->spline));
    struct pull pull[MOST_PULLS];
    size_t pulls = 0;

    for (size_t i = 0; i < count; i++) {
        const struct gsn_local_polynomial *piece = &pieces->piece[tet[i]];

        if (!gsn_local_polynomial_reaches(piece, box))
            continue;
        for (size_t f = 0; f < slopes; f++) {
            const double weight = gsn_local_polynomial_slope_weight(piece, &piece->slope[f], box);

            if (weight > 0.0)
                add_pull(pull, &pulls, pull_of(&piece->slope[f], weight, box, bend));
        }
    }
    for (int a = 0; a < 3; a++) {
        low[a] = -strongest_pull(pull, pulls, a, -1.0);
        high[a] = strongest_pull(pull, pulls, a, 1.0);
    }
}

/* s(u) = s(centre) + bend + sum over the axes of t_a times a mean of the spread coefficients. */
static void by_gradient(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                        size_t count, const struct gsn_aabb *box, uint32_t deepest,
                        const struct gsn_local_polynomial_bend *bend, struct gsn_enclosure *bracket)
{
    double low[3], high[3], value = bracket->linear.value;
    size_t hint = deepest;

    /* A centre on the domain's very boundary may count as outside; then the polynomial's value and
     * its residual are what is known. */
    bracket->low = bracket->high = 0.0;
    if (gsn_spline_eval(pieces->spline, box->centre, &hint, &value, NULL) != GSN_OK) {
        bracket->low = pieces->piece[deepest].residual_low;
        bracket->high = pieces->piece[deepest].residual_high;
    }
    bracket->linear.value = value;
    bound_gradient(pieces, tet, count, box, bend, low, high);
    for (int a = 0; a < 3; a++) {
        const double size = fmax(fabs(low[a]), fabs(high[a]));
        const double error =
            0.5 * (high[a] - low[a]) + fabs(bend->cross[a]) + pieces->slack + 1e-11 * size;

        bracket->linear.slope[a] = 0.5 * (low[a] + high[a]);
        bracket->low += fmin(0.0, bend->square[a]) - error;
        bracket->high += fmax(0.0, bend->square[a]) + error;
    }
}

static void by_residual(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                        size_t count, const struct gsn_aabb *box, struct gsn_enclosure *bracket)
{
    bracket->low = INFINITY;
    bracket->high = -INFINITY;
    for (size_t i = 0; i < count; i++) {
        const struct gsn_local_polynomial *piece = &pieces->piece[tet[i]];
        double low, high;

        if (gsn_local_polynomial_meets(piece, box) == GSN_LOCAL_POLYNOMIAL_APART)
            continue;
        gsn_local_polynomial_bound(piece, box, &bracket->linear, &low, &high);
        bracket->low = fmin(bracket->low, low + piece->residual_low);
        bracket->high = fmax(bracket->high, high + piece->residual_high);
    }
}

void gsn_enclosure_tighten(const struct gsn_local_polynomials *pieces, const uint32_t *tet,
                           size_t count, const struct gsn_aabb *box, uint32_t deepest,
                           struct gsn_enclosure *bracket)
{
    const struct gsn_local_polynomial *piece = &pieces->piece[deepest];
    const enum way way = choose_way(pieces, tet, count, box, deepest);
    struct gsn_local_polynomial_bend bend;
    double swing = 0.0, bends = 0.0;

    gsn_local_polynomial_tangent(piece, box, &bracket->linear, &bend);
    if (way == BY_POLYNOMIAL)
        gsn_local_polynomial_bound(piece, box, &bracket->linear, &bracket->low, &bracket->high);
    else if (way == BY_GRADIENT)
        by_gradient(pieces, tet, count, box, deepest, &bend, bracket);
    else
        by_residual(pieces, tet, count, box, bracket);
    for (int a = 0; a < 3; a++) {
        swing += fabs(bracket->linear.slope[a]);
        bends += bracket->linear.bend[a];
    }
    bracket->bent = bracket->high - bracket->low <= 2.0 * bends;
    bracket->least = fmax(bracket->least, bracket->linear.value - swing + bracket->low);
    bracket->most = fmin(bracket->most, bracket->linear.value + swing + bracket->high);
}
