/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_refine.h"

#include "pipeline/section_planes.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { PARTS = GSN_REFINE_PARTS, MOST_SIDE = 256, LEAST_SECTIONS = 12, LEAST_SIDE = 24 };

/* What is compared reaches so far beyond the region: farther tissue is bent in other ways, nearer
 * alone has too little that differs from its texture. */
static const double REACH = 1.6;
/* What is finer than a few intervals is another fibre in the next section. */
static const double CELL_INTERVALS = 4.0 / 3;
/* A section is bent where it lies as it is at the marks, where that is part of their scatter: of
 * the shift that this makes at the region, so much is slope across it, and so much bends it and
 * what is compared. */
static const double SLOPE = 1.0 / 3, BEND = 0.375;

static void refine_done(struct gsn_refine_work *w)
{
    gsn_free(w->target);
    gsn_free(w->section);
    gsn_grid_free(w->grid);
    gsn_free(w->prior);
    gsn_free(w->refined);
}

/* ---- What is compared --------------------------------------------------------------------- */

static void place_square(struct gsn_refine_work *w)
{
    const double interval = w->specimen->protocol->interval_um;
    const double n = (double)w->target_count;
    struct gsn_point c = { 0, 0 };
    double most = 0, sum = 0;

    for (size_t i = 0; i < w->target_count; i++) {
        c.x += w->target[i].x / n;
        c.y += w->target[i].y / n;
    }
    for (size_t i = 0; i < w->target_count; i++) {
        const double r = hypot(w->target[i].x - c.x, w->target[i].y - c.y);

        most = fmax(most, r);
        sum += r * r / n;
    }
    w->radius_um = REACH * most;
    w->stack.centre = c;
    w->stack.unit_um = sqrt(sum);
    w->stack.cell_um = fmax(CELL_INTERVALS * interval, 2 * w->radius_um / MOST_SIDE);
    w->stack.side = (size_t)ceil(2 * w->radius_um / w->stack.cell_um);
}

static int make_room(struct gsn_refine_work *w, struct gsn_error *err)
{
    const double cell = w->stack.cell_um, interval = w->specimen->protocol->interval_um;
    const double half = 0.5 * ((double)w->stack.side - 1) * cell;
    const struct gsn_lattice at = {
        .nx = w->stack.side,
        .ny = w->stack.side,
        .nz = w->a->section[w->section[w->stack.count - 1]].seen.serial + (size_t)1,
        .origin_um = { w->stack.centre.x - half, w->stack.centre.y - half, 0.5 * interval },
        .step_um = { cell, cell, interval }
    };

    w->prior = gsn_alloc_array(w->stack.count, sizeof *w->prior);
    w->refined = gsn_alloc_array(w->stack.count, sizeof *w->refined);
    if (!w->prior || !w->refined)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    return gsn_assembly_empty_grid(&at, &w->grid, err);
}

/* ---- What the marks say ------------------------------------------------------------------- */

/* How shift, turn and strain about where the pose has them make the parts of a move. */
static void parts_of_error(const struct gsn_refine_work *w, const struct gsn_pose_error *error,
                           double ret_part[PARTS][PARTS])
{
    const double x = w->stack.centre.x - error->about.x, y = w->stack.centre.y - error->about.y;
    const double unit = w->stack.unit_um;
    const double part[PARTS][PARTS] = { { 1, 0, -y, x, x, y }, { 0, 1, x, y, -y, x },
                                        { 0, 0, unit },        { 0, 0, 0, unit },
                                        { 0, 0, 0, 0, unit },  { 0, 0, 0, 0, 0, unit } };

    memcpy(ret_part, part, sizeof part);
}

static void covariance_of_error(const struct gsn_pose_error *error, double ret_c[PARTS][PARTS])
{
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++) {
            ret_c[i][j] = error->pose[i][j];
            ret_c[3 + i][3 + j] = error->left[i][j];
            ret_c[i][3 + j] = ret_c[3 + j][i] = error->cross[i][j];
        }
}

static void add_even(double shift_um2, double ret_prior[PARTS][PARTS])
{
    for (size_t p = 0; p < PARTS; p++)
        ret_prior[p][p] += p < 2 ? shift_um2 : SLOPE * SLOPE * shift_um2;
}

/* Variance per axis by which a section is bent at the region: as at the marks, and at least what
 * nobody can measure, so that it can be inverted. */
static double bent_um2(const struct gsn_refine_work *w)
{
    return fmax(w->a->summary.fle_um * w->a->summary.fle_um / 2, 0.01);
}

static void state_prior(const struct gsn_refine_work *w, const struct gsn_pose *pose,
                        double ret_prior[PARTS][PARTS])
{
    double part[PARTS][PARTS], c[PARTS][PARTS];

    memset(ret_prior, 0, sizeof c);
    add_even(bent_um2(w), ret_prior);
    /* Laid by tissue alone, a section knows its error over the tissue, and nothing else of it. */
    if (!(pose->error.pose[0][0] > 0)) {
        add_even(pose->tre_um * pose->tre_um / 2, ret_prior);
        return;
    }
    parts_of_error(w, &pose->error, part);
    covariance_of_error(&pose->error, c);
    for (size_t p = 0; p < PARTS; p++)
        for (size_t q = 0; q < PARTS; q++)
            for (size_t i = 0; i < PARTS; i++)
                for (size_t j = 0; j < PARTS; j++)
                    ret_prior[p][q] += part[p][i] * c[i][j] * part[q][j];
}

static void state_priors(struct gsn_refine_work *w)
{
    const size_t plane = w->stack.side * w->stack.side;

    for (size_t k = 0; k < w->stack.count; k++) {
        const struct gsn_assembly_section *s = &w->a->section[w->section[k]];

        w->prior[k].serial = s->seen.serial;
        w->prior[k].density = w->grid->value + s->seen.serial * plane;
        state_prior(w, &s->pose, w->prior[k].prior);
    }
    w->stack.section = w->prior;
    w->stack.bent_um2 = BEND * BEND * bent_um2(w);
}

/* ---- What comes of it --------------------------------------------------------------------- */

/* Where the move shows a point of the region, beside its place. */
static struct gsn_point moved_at(const struct gsn_refine_work *w, const double move[PARTS],
                                 struct gsn_point at, double ret_row[2][PARTS])
{
    const double u = (at.x - w->stack.centre.x) / w->stack.unit_um;
    const double v = (at.y - w->stack.centre.y) / w->stack.unit_um;
    const double row[2][PARTS] = { { 1, 0, -v, u, u, v }, { 0, 1, u, v, -v, u } };
    struct gsn_point d = { 0, 0 };

    for (size_t p = 0; p < PARTS; p++) {
        d.x += row[0][p] * move[p];
        d.y += row[1][p] * move[p];
    }
    memcpy(ret_row, row, sizeof row);
    return d;
}

/* Mean square over the region of the move, and of its error. */
static void over_region(const struct gsn_refine_work *w, const struct gsn_refined *refined,
                        double *ret_moved, double *ret_error)
{
    double moved = 0, error = 0;

    for (size_t i = 0; i < w->target_count; i++) {
        double row[2][PARTS];
        const struct gsn_point d = moved_at(w, refined->move, w->target[i], row);

        moved += d.x * d.x + d.y * d.y;
        for (size_t p = 0; p < PARTS; p++)
            for (size_t q = 0; q < PARTS; q++)
                error +=
                    (row[0][p] * row[0][q] + row[1][p] * row[1][q]) * refined->covariance[p][q];
    }
    *ret_moved = moved / (double)w->target_count;
    *ret_error = error / (double)w->target_count + 2 * w->stack.bent_um2;
}

static void move_sections(struct gsn_refine_work *w, const struct gsn_refine_summary *summary)
{
    struct gsn_refinement *to = &w->a->refinement;
    const double n = (double)w->stack.count;
    double square = 0, area = 0, area2 = 0;

    for (size_t k = 0; k < w->stack.count; k++) {
        struct gsn_pose *pose = &w->a->section[w->section[k]].pose;
        const double *move = w->refined[k].move;
        const struct gsn_affine map = gsn_refine_map(&w->stack, move);
        const double grown = gsn_affine_det(&map) - 1;
        double moved, error;

        over_region(w, &w->refined[k], &moved, &error);
        pose->panel_to_block_um = gsn_affine_compose(&pose->panel_to_block_um, &map);
        pose->tre_um = sqrt(fmax(error, 0));
        for (size_t i = 0; i < 3; i++)
            pose->strain[i] += move[3 + i] / w->stack.unit_um;
        square += moved / n;
        area += grown / n;
        area2 += grown * grown / n;
    }
    to->done = 1;
    to->compared = summary->compared;
    to->radius_um = w->radius_um;
    to->moved_um = sqrt(square);
    to->area_mean = area;
    to->area_sd = sqrt(fmax(area2 - area * area, 0));
    to->factor[0] = sqrt(summary->prior_factor);
    to->factor[1] = sqrt(summary->comparison_factor);
}

static int cannot(struct gsn_assembly *a, const char *why)
{
    (void)snprintf(a->refinement.why, sizeof a->refinement.why, "%s", why);
    return GSN_OK;
}

static int refine(struct gsn_refine_work *w, struct gsn_error *err)
{
    struct gsn_refine_summary summary;
    int r = gsn_assembly_targets(w->a->region, &w->target, &w->target_count, err);

    if (r < 0)
        return r;
    w->section = gsn_alloc_array(w->a->section_count + 1, sizeof *w->section);
    if (!w->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    w->stack.count = gsn_section_planes_list(w->a, w->section);
    w->a->refinement.sections = w->stack.count;
    if (w->target_count == 0 || w->stack.count < LEAST_SECTIONS)
        return cannot(w->a, "there are too few sections");
    place_square(w);
    if (w->stack.side < LEAST_SIDE)
        return cannot(w->a, "the region is too small for the tissue around it to tell");
    r = make_room(w, err);
    if (r >= 0)
        r = gsn_refine_gather(w, err);
    if (r < 0)
        return r;
    state_priors(w);
    r = gsn_refine_solve(&w->stack, w->options->threads, w->refined, &summary, err);
    if (r < 0)
        return r;
    if (summary.compared == 0)
        return cannot(w->a, "neighbouring sections have too little in common");
    move_sections(w, &summary);
    return GSN_OK;
}

int gsn_assembly_refine(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options, struct gsn_assembly *a,
                        struct gsn_error *err)
{
    struct gsn_refine_work work = { .specimen = specimen, .options = options, .a = a };
    int r;

    if (!a->solved || a->strain_mode != GSN_STRAIN_TISSUE)
        return GSN_OK;
    if (!a->region || !a->grid)
        return cannot(a, "no region is stated before the panels are opened");
    r = refine(&work, err);
    refine_done(&work);
    return r;
}
