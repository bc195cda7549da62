/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Level set volume: how much of a region of voxels is above a threshold, with bounds that are
 * guaranteed.
 *
 * Method: branch and bound on equation (10): on a box the spline is a linear function plus an
 * interval (enclosure.h), and both ends of the interval are half-spaces whose share of the box has
 * a closed form. What differs most is halved first. Reference: docs/MATH.md, section 6.
 *
 * Steps: (1) which tetrahedra reach each voxel (overlap.h); (2) bound all voxels for all thresholds
 * at once; (3) halve boxes, a batch at a time, until the sum of the differences is small enough or
 * the boxes are spent. All sums run in a fixed order.
 *
 * Failure: GSN_E_INPUT when a voxel sticks out of the mesh, GSN_E_NOMEM. When the boxes are spent
 * the bounds are true but wider than wanted. Cost: the number of boxes grows with the area of the
 * level, not with the volume. */
#include "pipeline/measure/level_set.h"

#include "pipeline/core/parallel.h"
#include "pipeline/measure/enclosure.h"
#include "pipeline/measure/overlap.h"
#include "pipeline/measure/sum.h"

#include <math.h>
#include <string.h>

enum {
    BATCH = 256,      /* items a thread takes at a time */
    NEAR = 64,        /* tetrahedra that reach a cell, as a rule a few */
    MOST_LEVELS = 12, /* a voxel's edge is cut into at most 2^12 */
};

static const double default_gap = 1e-3;
static const size_t default_cells = 1000000;
/* Of the sums: those of some 1e6 shares are compensated, every share is good to about 1e-14. */
static const double sum_slack = 1e-12;

/* One box that the threshold cuts: voxel v of the overlap, part place[a] of the 2^level[a] along
 * each axis, and the axis along which to cut it next. Shares are of the voxel's volume. */
struct cell {
    size_t v;
    uint16_t place[3];
    uint8_t level[3], axis;
    double lower, upper;
};

struct work {
    const struct gsn_local_polynomials *pieces;
    const struct gsn_voxel_overlap *overlap;
    const double *threshold;
    size_t thresholds;
    unsigned threads;
};

static struct gsn_aabb cell_box(const struct gsn_voxel_overlap *overlap, const struct cell *cell)
{
    struct gsn_aabb box = gsn_voxel_aabb(&overlap->at, overlap->voxel[cell->v]);

    for (int a = 0; a < 3; a++) {
        const double parts = (double)(1U << cell->level[a]);

        box.centre[a] += box.half[a] * ((2.0 * cell->place[a] + 1.0) / parts - 1.0);
        box.half[a] /= parts;
    }
    return box;
}

static void bound_shares(const struct gsn_enclosure *bracket, double threshold, double *ret_lower,
                         double *ret_upper)
{
    const struct gsn_local_polynomial_linear *linear = &bracket->linear;

    if (bracket->least > threshold) {
        *ret_lower = *ret_upper = 1.0;
    } else if (bracket->most <= threshold) {
        *ret_lower = *ret_upper = 0.0;
    } else {
        *ret_lower = gsn_aabb_share_above(linear->value + bracket->low - threshold, linear->slope);
        *ret_upper = gsn_aabb_share_above(linear->value + bracket->high - threshold, linear->slope);
    }
}

/* The tetrahedra that matter to a box in voxel v: those that reach it, kept in near when they are
 * few enough, else all that reach the voxel. */
static const uint32_t *around(const struct work *work, size_t v, const struct gsn_aabb *box,
                              uint32_t near[NEAR], size_t *ret_count)
{
    const uint32_t *tet = work->overlap->tet + work->overlap->first[v];
    const size_t count = work->overlap->first[v + 1] - work->overlap->first[v];
    size_t kept = 0;

    *ret_count = count;
    for (size_t i = 0; i < count; i++) {
        if (!gsn_local_polynomial_reaches(&work->pieces->piece[tet[i]], box))
            continue;
        if (kept == NEAR)
            return tet;
        near[kept++] = tet[i];
    }
    *ret_count = kept;
    return near;
}

/* Where cutting helps most: across the strongest bend; where the gap is not bend, boxes are to get
 * smaller all round. */
static uint8_t cut_axis(const struct gsn_aabb *box, const struct gsn_enclosure *bracket)
{
    const double *size = bracket->bent ? bracket->linear.bend : box->half;
    uint8_t axis = 0;

    for (uint8_t a = 1; a < 3; a++) {
        if (size[a] > size[axis])
            axis = a;
    }
    return axis;
}

/* Fills the cell's shares for one threshold, and its axis. */
static void measure_cell(const struct work *work, double threshold, struct cell *cell)
{
    const struct gsn_aabb box = cell_box(work->overlap, cell);
    const double part = ldexp(1.0, -(cell->level[0] + cell->level[1] + cell->level[2]));
    uint32_t near[NEAR];
    size_t count;
    const uint32_t *tet = around(work, cell->v, &box, near, &count);
    struct gsn_enclosure bracket;
    uint32_t deepest = tet[0];

    gsn_enclosure_hull(work->pieces, tet, count, &box, &bracket, &deepest);
    if (bracket.least <= threshold && bracket.most > threshold) {
        gsn_enclosure_tighten(work->pieces, tet, count, &box, deepest, &bracket);
        cell->axis = cut_axis(&box, &bracket);
    }
    bound_shares(&bracket, threshold, &cell->lower, &cell->upper);
    cell->lower *= part;
    cell->upper *= part;
}

/* What a voxel as a whole is for one threshold. */
enum verdict { BELOW, ABOVE, OPEN };

struct judging {
    const struct work *work;
    uint8_t *verdict; /* [v * thresholds + t] */
};

static void judge_tet(const struct judging *judging, size_t v)
{
    const struct work *work = judging->work;
    const struct gsn_aabb box = gsn_voxel_aabb(&work->overlap->at, work->overlap->voxel[v]);
    uint8_t *verdict = judging->verdict + v * work->thresholds;
    const size_t first = work->overlap->first[v], count = work->overlap->first[v + 1] - first;
    const uint32_t *tet = work->overlap->tet + first;
    struct gsn_enclosure bracket;
    uint32_t deepest = tet[0];

    gsn_enclosure_hull(work->pieces, tet, count, &box, &bracket, &deepest);
    for (int tight = 0; tight < 2; tight++) {
        size_t open = 0;

        for (size_t t = 0; t < work->thresholds; t++) {
            verdict[t] = bracket.least > work->threshold[t]   ? ABOVE
                         : bracket.most <= work->threshold[t] ? BELOW
                                                              : OPEN;
            open += verdict[t] == OPEN;
        }
        if (open == 0 || tight)
            return;
        gsn_enclosure_tighten(work->pieces, tet, count, &box, deepest, &bracket);
    }
}

static int judge_batch(size_t batch, void *context, struct gsn_error *err)
{
    const struct judging *judging = context;
    const size_t count = judging->work->overlap->voxel_count;

    (void)err;
    for (size_t v = batch * BATCH; v < count && v < (batch + 1) * BATCH; v++)
        judge_tet(judging, v);
    return GSN_OK;
}

struct measuring {
    const struct work *work;
    double threshold;
    struct cell *cell;
    size_t count;
};

static int measure_batch(size_t batch, void *context, struct gsn_error *err)
{
    const struct measuring *measuring = context;

    (void)err;
    for (size_t i = batch * BATCH; i < measuring->count && i < (batch + 1) * BATCH; i++)
        measure_cell(measuring->work, measuring->threshold, &measuring->cell[i]);
    return GSN_OK;
}

static int measure_all(const struct work *work, double threshold, struct cell *cell, size_t count,
                       struct gsn_error *err)
{
    struct measuring measuring = { work, threshold, cell, count };

    return gsn_parallel_for((count + BATCH - 1) / BATCH, work->threads, measure_batch, &measuring,
                            err);
}

/* The open cells of one threshold and the certain part of the volume, in voxels. */
struct front {
    struct cell *cell;
    size_t count;
    struct gsn_sum sure;
    int was_open; /* whether the threshold cut any voxel at all */
};

/* Drops decided cells, adding what they hold to the certain part. Order is kept. */
static void drop_decided(struct front *front, struct cell *cell, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        if (cell[i].upper > cell[i].lower)
            front->cell[front->count++] = cell[i];
        else
            gsn_sum_add(&front->sure, cell[i].lower);
    }
}

static void halve_cell(const struct cell *cell, struct cell *ret_half)
{
    for (unsigned k = 0; k < 2; k++) {
        const unsigned place = 2U * cell->place[cell->axis] + k;

        ret_half[k] = *cell;
        ret_half[k].place[cell->axis] = (uint16_t)place;
        ret_half[k].level[cell->axis]++;
    }
}

static int can_be_cut(const struct cell *cell)
{
    return cell->level[cell->axis] < MOST_LEVELS;
}

/* Whether a cell is among those to be cut in this round. */
static int is_wide(const struct cell *cell, double cutoff)
{
    return can_be_cut(cell) && cell->upper - cell->lower >= cutoff;
}

/* Cuts the widest cells, at most most_cuts of them. *ret_cuts is how many. */
static int cut_round(const struct work *work, double threshold, double cutoff, size_t most_cuts,
                     struct front *front, size_t *ret_cuts, struct gsn_error *err)
{
    gsn_auto_mem(struct cell) part = NULL;
    gsn_auto_mem(struct cell) old = NULL;
    struct cell *grown;
    size_t cuts = 0, kept = 0;
    int r;

    for (size_t i = 0; i < front->count && cuts < most_cuts; i++)
        cuts += is_wide(&front->cell[i], cutoff) ? 1U : 0U;
    *ret_cuts = cuts;
    if (cuts == 0)
        return GSN_OK;
    part = gsn_alloc_array(2 * cuts, sizeof *part);
    grown = gsn_alloc_array(front->count + cuts, sizeof *grown);
    old = front->cell;
    if (!part || !grown) {
        front->cell = gsn_steal(&old);
        gsn_free(grown);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", 2 * cuts);
    }
    cuts = 0;
    for (size_t i = 0; i < front->count; i++) {
        if (cuts < most_cuts && is_wide(&old[i], cutoff))
            halve_cell(&old[i], part + 2 * cuts++);
        else
            grown[kept++] = old[i];
    }
    front->cell = grown;
    front->count = kept;
    r = measure_all(work, threshold, part, 2 * cuts, err);
    if (r < 0)
        return r;
    drop_decided(front, part, 2 * cuts);
    return GSN_OK;
}

static void add_up(const struct front *front, double *ret_lower, double *ret_upper)
{
    struct gsn_sum lower = front->sure, upper = front->sure;

    for (size_t i = 0; i < front->count; i++) {
        gsn_sum_add(&lower, front->cell[i].lower);
        gsn_sum_add(&upper, front->cell[i].upper);
    }
    *ret_lower = lower.value + lower.rest;
    *ret_upper = upper.value + upper.rest;
}

/* The largest gap of a cell that can still be cut. Every round cuts the cells with half of it or
 * more: nearly largest first, without sorting, and in an order that no thread changes. */
static double widest_gap(const struct front *front)
{
    double gap = 0.0;

    for (size_t i = 0; i < front->count; i++) {
        if (can_be_cut(&front->cell[i]))
            gap = fmax(gap, front->cell[i].upper - front->cell[i].lower);
    }
    return gap;
}

/* Cuts until the gap is small enough, the budget is spent or nothing can be cut. In voxels. */
static int refine_front(const struct work *work, double threshold, double wanted, size_t most_cells,
                        struct front *front, struct gsn_volume_bound *bound, struct gsn_error *err)
{
    const double floor_voxels = 0.01 * (double)work->overlap->voxel_count;

    for (;;) {
        const size_t left = most_cells - (bound->cells - work->overlap->voxel_count);
        size_t cuts;
        double gap;
        int r;

        add_up(front, &bound->lower_um3, &bound->upper_um3);
        gap = bound->upper_um3 - bound->lower_um3;
        if (gap <= wanted * fmax(bound->upper_um3, floor_voxels) || left < 2)
            return GSN_OK;
        r = cut_round(work, threshold, 0.5 * widest_gap(front), left / 2, front, &cuts, err);
        if (r < 0)
            return r;
        if (cuts == 0)
            return GSN_OK;
        bound->cells += 2 * cuts;
    }
}

static int start_front(const struct work *work, const uint8_t *verdict, size_t t,
                       struct front *front, struct gsn_error *err)
{
    const size_t count = work->overlap->voxel_count;
    gsn_auto_mem(struct cell) voxel = NULL;
    size_t open = 0, above = 0;
    int r;

    for (size_t v = 0; v < count; v++) {
        open += verdict[v * work->thresholds + t] == OPEN;
        above += verdict[v * work->thresholds + t] == ABOVE;
    }
    gsn_sum_add(&front->sure, (double)above);
    front->was_open = open > 0;
    voxel = gsn_alloc_array(open, sizeof *voxel);
    front->cell = gsn_alloc_array(open, sizeof *front->cell);
    if (!voxel || !front->cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", open);
    open = 0;
    for (size_t v = 0; v < count; v++) {
        if (verdict[v * work->thresholds + t] == OPEN)
            voxel[open++] = (struct cell){ .v = v };
    }
    r = measure_all(work, work->threshold[t], voxel, open, err);
    if (r < 0)
        return r;
    drop_decided(front, voxel, open);
    return GSN_OK;
}

static int bound_one(const struct work *work, const uint8_t *verdict, size_t t, double wanted,
                     size_t most_cells, struct gsn_volume_bound *ret_bound, struct gsn_error *err)
{
    const double voxel_um3 = gsn_lattice_voxel_um3(&work->overlap->at);
    const double whole = (double)work->overlap->voxel_count;
    struct gsn_volume_bound bound = { .threshold = work->threshold[t],
                                      .cells = work->overlap->voxel_count };
    struct front front = { 0 };
    int r = start_front(work, verdict, t, &front, err);

    if (r == GSN_OK)
        r = refine_front(work, bound.threshold, wanted, most_cells, &front, &bound, err);
    gsn_free(front.cell);
    if (r < 0)
        return r;
    /* Whole voxels are counted; only what is made of cut cells has rounding to make up for. */
    if (front.was_open) {
        bound.lower_um3 = fmax(0.0, bound.lower_um3 - sum_slack * whole);
        bound.upper_um3 = fmin(whole, bound.upper_um3 + sum_slack * whole);
    }
    bound.lower_um3 *= voxel_um3;
    bound.upper_um3 *= voxel_um3;
    *ret_bound = bound;
    return GSN_OK;
}

static int judge_all(const struct work *work, const struct gsn_level_set_options *options,
                     struct gsn_volume_bound *ret_bounds, struct gsn_error *err)
{
    const double wanted = options->gap > 0.0 ? options->gap : default_gap;
    const size_t most_cells = options->most_cells > 0 ? options->most_cells : default_cells;
    const size_t voxels = work->overlap->voxel_count;
    gsn_auto_mem(uint8_t) verdict = gsn_alloc_array(voxels, work->thresholds);
    struct judging judging = { work, verdict };
    int r;

    if (!verdict)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu voxels", voxels);
    r = gsn_parallel_for((voxels + BATCH - 1) / BATCH, work->threads, judge_batch, &judging, err);
    for (size_t t = 0; r == GSN_OK && t < work->thresholds; t++) {
        gsn_progress_say(options->progress, "volumes", t, work->thresholds);
        r = bound_one(work, verdict, t, wanted, most_cells, &ret_bounds[t], err);
    }
    if (r == GSN_OK)
        gsn_progress_say(options->progress, "volumes", work->thresholds, work->thresholds);
    return r;
}

int gsn_level_set_volume(const struct gsn_spline *spline, const struct gsn_mask *region,
                         const double *thresholds, size_t count,
                         const struct gsn_level_set_options *options,
                         struct gsn_volume_bound *ret_bounds, struct gsn_error *err)
{
    static const struct gsn_level_set_options plain = { 0 };
    gsn_auto(gsn_local_polynomials) pieces = NULL;
    gsn_auto_mem(struct gsn_volume_bound) bound = NULL;
    gsn_auto(gsn_voxel_overlap) overlap = NULL;
    struct work work = { .threshold = thresholds, .thresholds = count };
    int r;

    for (size_t t = 0; t < count; t++) {
        if (!isfinite(thresholds[t]))
            return gsn_fail(err, GSN_E_INPUT, "threshold %zu is not a number", t + 1);
    }
    if (!options)
        options = &plain;
    work.threads = options->threads;
    bound = gsn_alloc_array(count, sizeof *bound);
    if (!bound)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu thresholds", count);
    r = gsn_local_polynomials_new(spline, work.threads, &pieces, err);
    if (r == GSN_OK)
        r = gsn_voxel_overlap_new(region, gsn_spline_space(spline), pieces->piece, &overlap, err);
    if (r < 0)
        return r;
    work.pieces = pieces;
    work.overlap = overlap;
    r = judge_all(&work, options, bound, err);
    if (r < 0)
        return r;
    memcpy(ret_bounds, bound, count * sizeof *bound);
    return GSN_OK;
}
