/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How far s can be from the polynomial of a tetrahedron, anywhere in it:
 *
 *     s(u) - p_I(u) = sum over J != I, beta of (c_beta^J - F_I(knots of (J, beta))) N_beta^J(u)
 *
 * wherever all functions sum to one, F_I being the polar form of p_I. Since the N are not negative
 * and sum to at most one, the extreme coefficients bound the difference (docs/MATH.md, section 6).
 */
#include "pipeline/model/bpatch.h"
#include "pipeline/model/orient.h"
#include "pipeline/model/spline_internal.h"

#include <math.h>

/* One tetrahedron, home, and the range found so far. */
struct home {
    const struct gsn_spline *spline;
    size_t tet;
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], control[GSN_DMS_MAX_FUNCTIONS];
    double low, high;       /* of the coefficients above, and 0 */
    double least, greatest; /* of the control values that act in home, and 0 */
};

static void widen(double value, double *low, double *high)
{
    *low = fmin(*low, value);
    *high = fmax(*high, value);
}

/* Whether a knot lies in the closed half-space beyond face k of a positive tetrahedron. */
static int is_beyond(const double *const corner[4], int k, const double lambda[4],
                     const double *knot)
{
    static const int others[4][3] = { { 1, 3, 2 }, { 0, 2, 3 }, { 0, 3, 1 }, { 0, 1, 2 } };
    const int *f = others[k];

    if (fabs(lambda[k]) > GSN_DMS_SLACK)
        return lambda[k] < 0;
    return gsn_orient3d(corner[f[0]], corner[f[1]], corner[f[2]], knot) <= 0;
}

/* For each face of home the local knots of another tetrahedron that lie beyond it. */
static void find_beyond(const struct home *home, const double (*knot)[3], unsigned ret_beyond[4])
{
    const struct gsn_dms *space = home->spline->space;
    const double *corner[4];

    for (unsigned k = 0; k < 4; k++) {
        corner[k] = home->knot[k * (space->degree + 1)];
        ret_beyond[k] = 0;
    }
    for (unsigned i = 0; i < 4 * (space->degree + 1); i++) {
        double lambda[4];

        gsn_frame_at(&space->shape[home->tet].frame, knot[i], lambda);
        for (int k = 0; k < 4; k++) {
            if (is_beyond(corner, k, lambda, knot[i]))
                ret_beyond[k] |= 1u << i;
        }
    }
}

static int is_out_of_reach(unsigned knots, const unsigned beyond[4])
{
    for (int k = 0; k < 4; k++) {
        if (!(knots & ~beyond[k]))
            return 1;
    }
    return 0;
}

static int is_own_control(const struct home *home, uint32_t control)
{
    const uint32_t *id = gsn_dms_control_ids(home->spline->space, home->tet);

    for (size_t f = 0; f < gsn_dms_functions(home->spline->space); f++) {
        if (id[f] == control)
            return 1;
    }
    return 0;
}

/* F_I at the knots t_{k,0..beta_k-1} of a function of the other tetrahedron. */
static double polar_of(const struct home *home, const double (*knot)[3], const uint8_t beta[4])
{
    const unsigned degree = home->spline->space->degree;
    const double *arg[GSN_DMS_MAX_DEGREE];
    unsigned n = 0;

    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 0; l < beta[k]; l++)
            arg[n++] = knot[k * (degree + 1) + l];
    }
    return gsn_bpatch_polar(degree, (const double(*)[3])home->knot, home->control, arg);
}

static void add_foreign(struct home *home, size_t tet)
{
    const struct gsn_dms *space = home->spline->space;
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    unsigned beyond[4];

    gsn_dms_gather(space, tet, knot);
    find_beyond(home, (const double(*)[3])knot, beyond);
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const double control = home->spline->control[id[f]];

        if (is_out_of_reach(space->sets->set[f].mask, beyond))
            continue;
        widen(control, &home->least, &home->greatest);
        /* The polar value at knots of its own is home's own control value. */
        if (!is_own_control(home, id[f]))
            widen(control - polar_of(home, (const double(*)[3])knot, space->sets->beta[f]),
                  &home->low, &home->high);
    }
}

/* Where functions are missing beyond the boundary: s lies between the control values and 0, p
 * between its Bernstein coefficients. */
static void bound_apart(struct home *home)
{
    const size_t functions = gsn_dms_functions(home->spline->space);
    double coefficient[GSN_DMS_MAX_FUNCTIONS], low = INFINITY, high = -INFINITY;

    gsn_spline_bernstein(home->spline, home->tet, coefficient);
    for (size_t f = 0; f < functions; f++) {
        widen(home->control[f], &home->least, &home->greatest);
        widen(coefficient[f], &low, &high);
    }
    home->low = fmin(0, home->least - high);
    home->high = fmax(0, home->greatest - low);
}

void gsn_spline_residual(const struct gsn_spline *spline, size_t tet, double *ret_low,
                         double *ret_high)
{
    const struct gsn_dms *space = spline->space;
    struct home home = { .spline = spline, .tet = tet };

    gsn_dms_gather(space, tet, home.knot);
    gsn_spline_gather(spline, tet, home.control);
    for (size_t i = space->reach_start[tet]; i < space->reach_start[tet + 1]; i++) {
        if (space->reach[i] >> 4 != tet)
            add_foreign(&home, space->reach[i] >> 4);
    }
    if (!space->whole[tet])
        bound_apart(&home);
    *ret_low = home.low;
    *ret_high = home.high;
}
