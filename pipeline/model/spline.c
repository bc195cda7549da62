/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline on a DMS space: value, gradient, second derivatives, and bounds that are certain.
 *
 * Method: at a point the polynomial of its own tetrahedron in Bernstein form, corrected by the
 * faces whose knots hold the point (face_correction.h, docs/MATH.md, section 13). The recurrence is
 * not run; tests hold the two to each other.
 *
 * Bounds: how far s can be from the polynomial of a tetrahedron anywhere in it. Where all functions
 * sum to one the difference is an average of (c - F(knots)) over the foreign functions with weights
 * N >= 0, so the extreme coefficients bound it (docs/MATH.md, section 6).
 *
 * Steps of making one: copy the control values, refuse what is not finite, turn every B-patch into
 * Bernstein form once.
 * Failure: GSN_E_INPUT on a control value that is not finite; GSN_DMS_OUTSIDE at a point without
 * data. Cost: a value in a core is one blossom; bounds of a tetrahedron a polar value per foreign
 * function. */
#include "pipeline/model/spline.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/face_correction.h"
#include "pipeline/model/simplex_mean.h"
#include "pipeline/model/spline_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* --- values and gradients --- */

static void make_bernstein(struct gsn_spline *spline, size_t tet)
{
    const struct gsn_dms *space = spline->space;
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], control[GSN_DMS_MAX_FUNCTIONS];
    const double *corner[4];

    gsn_dms_gather(space, tet, knot);
    gsn_spline_gather(spline, tet, control);
    for (unsigned k = 0; k < 4; k++)
        corner[k] = knot[k * (space->degree + 1)];
    gsn_bpatch_bernstein(space->degree, (const double(*)[3])knot, control, corner,
                         &spline->bernstein[tet * gsn_dms_functions(space)]);
}

int gsn_spline_new(const struct gsn_dms *space, const double *control,
                   struct gsn_spline **ret_spline, struct gsn_error *err)
{
    gsn_auto(gsn_spline) spline = NULL;
    const size_t tets = gsn_dms_mesh(space)->tet_count;

    assert(space && control && ret_spline);

    for (size_t i = 0; i < gsn_dms_controls(space); i++) {
        if (!isfinite(control[i]))
            return gsn_fail(err, GSN_E_INPUT, "control value %zu is not finite", i);
    }
    spline = gsn_alloc_array(1, sizeof *spline);
    if (spline) {
        spline->space = space;
        spline->control = gsn_memdup(control, gsn_dms_controls(space) * sizeof *control);
        spline->bernstein =
            gsn_alloc_array(tets * gsn_dms_functions(space), sizeof *spline->bernstein);
    }
    if (!spline || !spline->control || !spline->bernstein)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a spline of %zu control values",
                        gsn_dms_controls(space));
    for (size_t t = 0; t < tets; t++)
        make_bernstein(spline, t);
    *ret_spline = gsn_steal(&spline);
    return GSN_OK;
}

void gsn_spline_free(struct gsn_spline *spline)
{
    if (!spline)
        return;
    gsn_free(spline->control);
    gsn_free(spline->bernstein);
    gsn_free(spline);
}

size_t gsn_spline_bytes(const struct gsn_spline *spline)
{
    const struct gsn_dms *space = spline->space;

    return sizeof *spline +
           gsn_dms_mesh(space)->tet_count * gsn_dms_functions(space) * sizeof *spline->bernstein;
}

const struct gsn_dms *gsn_spline_space(const struct gsn_spline *spline)
{
    return spline->space;
}

const double *gsn_spline_controls(const struct gsn_spline *spline)
{
    return spline->control;
}

void gsn_spline_bernstein(const struct gsn_spline *spline, size_t tet,
                          double ret_coefficient[GSN_DMS_MAX_FUNCTIONS])
{
    const size_t functions = gsn_dms_functions(spline->space);

    memcpy(ret_coefficient, &spline->bernstein[tet * functions],
           functions * sizeof *ret_coefficient);
}

int gsn_spline_eval(const struct gsn_spline *spline, const double u[3], size_t *hint,
                    double *ret_value, double *ret_gradient)
{
    const struct gsn_dms *space = spline->space;
    double lambda[4], value, gradient[3];
    struct gsn_dms_shape shape;
    size_t tet;

    assert(hint && ret_value);

    if (gsn_dms_locate(space, u, *hint, &tet) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    *hint = tet;
    gsn_dms_shape_of(space, tet, &shape);
    gsn_barycentric_at(&shape.frame, u, lambda);
    value = gsn_bernstein_at(space->degree, &spline->bernstein[tet * gsn_dms_functions(space)],
                             &shape.frame, lambda, ret_gradient ? gradient : NULL);
    if (gsn_dms_clear(&shape, lambda) != GSN_DMS_ALL)
        gsn_spline_add_face_corrections(spline, tet, u, &value, ret_gradient ? gradient : NULL);
    *ret_value = value;
    if (ret_gradient)
        memcpy(ret_gradient, gradient, sizeof gradient);
    return GSN_OK;
}

/* --- bounds of what is not polynomial --- */

/* How far s can be from the polynomial of a tetrahedron, anywhere in it:
 *
 *     s(u) - p_I(u) = sum over J != I, beta of (c_beta^J - F_I(knots of (J, beta))) N_beta^J(u)
 *
 * wherever all functions sum to one, F_I being the polar form of p_I. Since the N are not negative
 * and sum to at most one, the extreme coefficients bound the difference (docs/MATH.md, section 6).
 */

/* One tetrahedron, home, and the range found so far. */
struct home {
    const struct gsn_spline *spline;
    size_t tet;
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], control[GSN_DMS_MAX_FUNCTIONS];
    double low, high;       /* of the coefficients above, and 0 */
    double least, greatest; /* of the control values that act in home, and 0 */
};

static void widen_range(double value, double *low, double *high)
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
        widen_range(control, &home->least, &home->greatest);
        /* The polar value at knots of its own is home's own control value. */
        if (!is_own_control(home, id[f]))
            widen_range(control - polar_of(home, (const double(*)[3])knot, space->sets->beta[f]),
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
        widen_range(home->control[f], &home->least, &home->greatest);
        widen_range(coefficient[f], &low, &high);
    }
    home->low = fmin(0, home->least - high);
    home->high = fmax(0, home->greatest - low);
}

void gsn_spline_residual(const struct gsn_spline *spline, size_t tet, double *ret_low,
                         double *ret_high)
{
    const struct gsn_dms *space = spline->space;
    struct home home = { .spline = spline, .tet = tet };
    struct gsn_sorted_batch ascent;

    gsn_dms_gather(space, tet, home.knot);
    gsn_spline_gather(spline, tet, home.control);
    gsn_sorted_batch_begin(&ascent);
    do {
        gsn_dms_reaching(space, tet, &ascent);
        for (size_t i = 0; i < ascent.count; i++) {
            if (ascent.item[i] != tet)
                add_foreign(&home, ascent.item[i]);
        }
    } while (gsn_sorted_batch_next(&ascent));
    if (!space->whole[tet])
        bound_apart(&home);
    *ret_low = home.low;
    *ret_high = home.high;
}

/* --- second derivatives --- */

/* The second derivatives while the tetrahedra that reach u add their share. */
struct sum {
    const struct gsn_spline *spline;
    const double *u;
    double hessian[6];
};

static void add_tet(void *context, size_t tet, const double *value, const double (*gradient)[3])
{
    struct sum *sum = context;
    const struct gsn_dms *space = gsn_spline_space(sum->spline);
    const double *control = gsn_spline_controls(sum->spline);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], hessian[GSN_DMS_MAX_FUNCTIONS][6];
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];

    (void)value;
    (void)gradient;
    gsn_dms_gather(space, tet, knot);
    gsn_simplex_pick(space->sets, (const double(*)[3])knot, pick);
    gsn_simplex_basis_hessian(space->sets, (const double(*)[3])knot, pick, sum->u, 0, hessian);
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        for (int i = 0; i < 6; i++)
            sum->hessian[i] += control[id[f]] * hessian[f][i];
    }
}

int gsn_spline_hessian(const struct gsn_spline *spline, const double u[3], size_t *hint,
                       double ret_hessian[6])
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    struct sum sum = { .spline = spline, .u = u };
    size_t tet;

    assert(hint && ret_hessian);

    if (gsn_dms_locate(space, u, *hint, &tet) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    *hint = tet;
    gsn_dms_each(space, tet, u, 0, add_tet, &sum);
    memcpy(ret_hessian, sum.hessian, sizeof sum.hessian);
    return GSN_OK;
}
