/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How far s can be from the polynomial of a tetrahedron, anywhere in it:
 *
 *     s(u) - p_I(u) = sum over J != I, beta of (c_beta^J - F_I(knots of (J, beta))) N_beta^J(u)
 *
 * wherever all functions sum to one, F_I being the polar form of p_I. Since the N are not negative
 * and sum to at most one, the extreme coefficients bound the difference (docs/MATH.md, section 6).
 */
#include "pipeline/model/bpatch.h"
#include "pipeline/model/simplex_mean.h"
#include "pipeline/model/spline_internal.h"

#include <math.h>
#include <string.h>

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
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], corner[4][3];
    struct gsn_simplex_cell cell;

    gsn_dms_gather(space, tet, knot);
    for (unsigned k = 0; k < 4; k++)
        memcpy(corner[k], home->knot[k * (space->degree + 1)], sizeof corner[k]);
    gsn_simplex_cell_init(&cell, (const double(*)[3])corner, (const double(*)[3])knot,
                          space->degree);
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const double control = home->spline->control[id[f]];

        if (gsn_simplex_cell_misses(&cell, space->sets->set[f].mask))
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
    struct gsn_ascent ascent;

    gsn_dms_gather(space, tet, home.knot);
    gsn_spline_gather(spline, tet, home.control);
    gsn_ascent_begin(&ascent);
    do {
        gsn_dms_reaching(space, tet, &ascent);
        for (size_t i = 0; i < ascent.count; i++) {
            if (ascent.item[i] != tet)
                add_foreign(&home, ascent.item[i]);
        }
    } while (gsn_ascent_next(&ascent));
    if (!space->whole[tet])
        bound_apart(&home);
    *ret_low = home.low;
    *ret_high = home.high;
}
