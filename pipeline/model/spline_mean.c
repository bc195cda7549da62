/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Means of a spline over tetrahedral cells. */
#include "pipeline/model/bpatch.h"
#include "pipeline/model/orient.h"
#include "pipeline/model/simplex_mean.h"
#include "pipeline/model/spline_internal.h"

#include <math.h>
#include <string.h>

/* A cell, and what the tetrahedra visited so far have in it. */
struct visit {
    const struct gsn_spline *spline;
    const double (*corner)[3];
    struct gsn_box box;
    double mean;
};

/* Per corner the clouds k with lambda_k > delta_k; returns those that all corners have. */
static unsigned clear_of(const struct gsn_dms *space, size_t tet, const double (*corner)[3],
                         unsigned ret_clear[4])
{
    unsigned common = GSN_DMS_ALL;
    struct gsn_dms_shape shape;

    gsn_dms_shape_of(space, tet, &shape);
    for (int i = 0; i < 4; i++) {
        double lambda[4];

        gsn_frame_at(&shape.frame, corner[i], lambda);
        ret_clear[i] = gsn_dms_clear(&shape, lambda);
        common &= ret_clear[i];
    }
    return common;
}

/* The mean of a polynomial over a tetrahedron is that of its Bernstein coefficients. */
static double core_mean(const struct gsn_spline *spline, size_t tet, const double (*knot)[3],
                        const double (*corner)[3])
{
    const struct gsn_dms *space = spline->space;
    const double *at[4] = { corner[0], corner[1], corner[2], corner[3] };
    double control[GSN_DMS_MAX_FUNCTIONS], coefficient[GSN_DMS_MAX_FUNCTIONS], sum = 0;

    gsn_spline_gather(spline, tet, control);
    gsn_bpatch_bernstein(space->degree, knot, control, at, coefficient);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        sum += coefficient[f];
    return sum / (double)gsn_dms_functions(space);
}

/* Functions that have no part in the cell keep a mean of 0. */
static void pieces_means(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                         const uint16_t *pick, const struct gsn_simplex_cell *cell,
                         double *ret_mean)
{
    for (size_t f = 0; f < sets->functions; f++) {
        ret_mean[f] = 0;
        if (!gsn_simplex_cell_misses(cell, sets->set[f].mask))
            ret_mean[f] = gsn_simplex_mean_by_pieces(sets, knot, pick, cell, f);
    }
}

static void add_tet(struct visit *visit, uint32_t tet)
{
    const struct gsn_dms *space = visit->spline->space;
    const struct gsn_simplex_sets *sets = space->sets;
    const unsigned knots = 4 * (space->degree + 1);
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double mean[GSN_DMS_MAX_FUNCTIONS], own[GSN_SIMPLEX_MAX_KNOTS][3];
    const double(*knot)[3] = (const double(*)[3])own;
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
    struct gsn_simplex_cell cell;
    struct gsn_box box;
    double flat = 6 * GSN_ORIENT_BOUND;
    unsigned clear[4];

    gsn_dms_gather(space, tet, own);
    box = gsn_box_around(knot, knots);
    if (!gsn_box_meets(&box, &visit->box))
        return;
    if (clear_of(space, tet, visit->corner, clear) == GSN_DMS_ALL) {
        visit->mean += core_mean(visit->spline, tet, knot, visit->corner);
        return;
    }
    /* A determinant that rounding alone can make has six products, each at most this box. */
    for (int c = 0; c < 3; c++)
        flat *= box.high[c] - box.low[c];
    gsn_simplex_cell_init(&cell, visit->corner, knot, space->degree);
    if (gsn_simplex_cell_misses(&cell, (1u << knots) - 1))
        return;
    memcpy(cell.clear, clear, sizeof clear);
    if (gsn_simplex_pick(sets, knot, pick) > flat || gsn_dms_is_general(sets, knot))
        gsn_simplex_mean(sets, knot, pick, &cell, mean);
    else
        pieces_means(sets, knot, pick, &cell, mean);
    for (size_t f = 0; f < sets->functions; f++)
        visit->mean += visit->spline->control[id[f]] * mean[f] *
                       fabs(gsn_simplex_det(&sets->set[sets->corners[f]], knot));
}

int gsn_spline_cell_mean(const struct gsn_spline *spline, const double cell[4][3], double *ret_mean,
                         struct gsn_error *err)
{
    struct visit visit = { .spline = spline, .corner = cell, .box = gsn_box_around(cell, 4) };
    struct gsn_ascent ascent;

    for (int i = 0; i < 4; i++) {
        for (int c = 0; c < 3; c++) {
            if (!isfinite(cell[i][c]))
                return gsn_fail(err, GSN_E_INPUT, "corner %d of the cell is not finite", i);
        }
    }
    if (gsn_orient3d(cell[0], cell[1], cell[2], cell[3]) == 0 ||
        gsn_det(cell[0], cell[1], cell[2], cell[3]) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the cell is flat");
    gsn_ascent_begin(&ascent);
    do {
        (void)gsn_boxtree_meeting(spline->space->tree, &visit.box, gsn_ascent_add, &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            add_tet(&visit, ascent.item[i]);
    } while (gsn_ascent_next(&ascent));
    *ret_mean = visit.mean;
    return GSN_OK;
}
