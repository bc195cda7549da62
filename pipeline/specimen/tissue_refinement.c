/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Refines the poses of all sections by what neighbouring tissue has in common.
 *
 * 1. The square root of the density of every posed section, masked, is resampled into coarse cells
 * of a square around the region (REACH times its radius).
 * 2. The marks' solution gives each section a prior covariance over shift, turn and strain.
 * 3. Comparisons with up to four sections on either side and the priors are solved together
 *    (register/tissue/refine.h); a slant over many sections stays with the marks.
 * 4. Poses, predicted errors and strains are updated; how far sections moved and whether their
 * areas changed is reported.
 *
 * That it cannot be done (too few sections, too small a region) is a state, with a sentence. It
 * costs a second reading of every panel. */
#include "pipeline/specimen/density_stack.h"

#include "pipeline/core/file.h"
#include "pipeline/core/parallel.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/strain.h"
#include "pipeline/register/pose/tre.h"
#include "pipeline/register/stack/resample.h"
#include "pipeline/register/tissue/refine.h"
#include "pipeline/specimen/quality_control.h"
#include "pipeline/specimen/section_order.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* The sections in cells about the region, while they are gathered and compared. */
struct refinement_job {
    const struct gsn_specimen *specimen;
    const struct gsn_specimen_options *options;
    const struct gsn_mask *region;
    struct gsn_calibrations *calibrations;
    struct gsn_poses *poses;
    struct gsn_section_marks *marks; /* owned */
    struct gsn_point *target;        /* owned, as are the next */
    size_t target_count;
    size_t *section;       /* of the stack: its place in the reconstruction */
    struct gsn_grid *grid; /* one plane for each serial number */
    struct gsn_refine_section *prior;
    struct gsn_refined *refined;
    double radius_um;
    struct gsn_refine_stack stack;
    /* The panel that is open. */
    const struct gsn_collagen_reader *reader;
    const struct gsn_artefact_labels *labels;
    unsigned panel;
};

/* The square root of the density: what is fibre rather than tissue varies as the density itself. */
static int gather_section(size_t k, void *context, struct gsn_error *err)
{
    const struct refinement_job *w = context;
    const size_t i = w->section[k];
    const struct gsn_section *s = &w->poses->section[i];
    const double interval = w->specimen->protocol->interval_um;
    struct gsn_stack_section section = { .serial = s->seen.serial,
                                         .panel_to_block_um = s->pose.panel_to_block_um,
                                         .x = s->seen.x,
                                         .y = s->seen.y,
                                         .width = s->seen.width,
                                         .height = s->seen.height };
    gsn_auto(gsn_plane) density = NULL;
    int r;

    if (s->panel != w->panel || !gsn_stack_footprint(&w->grid->at, interval, &section))
        return GSN_OK;
    r = gsn_collagen_box(w->reader,
                    &(struct gsn_pixel_box){ section.x, section.y, section.width, section.height },
                    1, &density, err);
    if (r < 0)
        return r;
    for (size_t p = 0; p < (size_t)density->width * density->height; p++)
        density->value[p] = isnan(density->value[p]) ? NAN : sqrtf(fmaxf(density->value[p], 0));
    gsn_artefact_apply(w->labels, gsn_masking_index(w->poses, i), section.x, section.y, density);
    section.density = density;
    section.plane_x = section.x;
    section.plane_y = section.y;
    return gsn_stack_resample(&section, 1, interval, 1, w->grid, err);
}

static int gather_scan(struct refinement_job *w, const struct gsn_specimen_panel *given,
                       const struct gsn_scan *scan, struct gsn_error *err)
{
    struct gsn_dyes_fit fit;
    struct gsn_calibrated calibrated;
    gsn_auto_mem(struct gsn_artefact_figures) figures =
        gsn_alloc_array(w->poses->section_count, sizeof *figures);
    gsn_auto(gsn_image) tissue = NULL;
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_collagen_reader) reader = NULL;
    gsn_auto(gsn_artefact_labels) labels = NULL;
    int r;

    if (!figures)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    r = gsn_masking_tissue(scan, given->number, w->poses, w->marks, &tissue, err);
    if (r >= 0)
        r = gsn_calibration_find_dyes(w->specimen, w->options, scan, tissue, given->number,
                                      w->calibrations, &fit, &calibrated, err);
    if (r >= 0)
        r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);
    if (r >= 0)
        r = gsn_collagen_reader_new(absorber, &fit.dyes, &reader, err);
    if (r >= 0)
        r = gsn_masking_label(scan, &fit.dyes, given->number, w->options->threads, w->poses,
                              w->marks, &labels, figures, err);
    if (r < 0)
        return r;
    w->reader = reader;
    w->labels = labels;
    w->panel = given->number;
    return gsn_parallel_for(w->stack.count, w->options->threads, gather_section, w, err);
}

static int gather_panel(struct refinement_job *w, const struct gsn_specimen_panel *given,
                        struct gsn_error *err)
{
    gsn_auto_fd picture_fd = -1;
    gsn_auto(gsn_scan) scan = NULL;
    int r = w->specimen->open(w->specimen->context, given->sha256, &picture_fd, err);

    if (r >= 0)
        r = gsn_scan_open(w->options->decoder, picture_fd, w->specimen->protocol, &given->upright,
                          &scan, err);
    return r < 0 ? r : gather_scan(w, given, scan, err);
}

/* Opens the panels and lays the density of the sections listed into w->grid, whose planes are there
 * and empty. Fails as reading, decoding, unmixing and masking do. */
static int gather_panels(struct refinement_job *w, struct gsn_error *err)
{
    for (size_t i = 0; i < w->specimen->panel_count; i++) {
        const struct gsn_specimen_panel *given = &w->specimen->panel[i];
        int r;

        gsn_progress_say(w->options->progress, "comparing", i, w->specimen->panel_count);
        if (given->section_count == 0)
            continue;
        r = gather_panel(w, given, err);
        if (r < 0)
            return gsn_fail_at(err, "panel %u (%s)", given->number, given->file);
    }
    return GSN_OK;
}

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

static void refine_done(struct refinement_job *w)
{
    gsn_free(w->target);
    gsn_free(w->marks);
    gsn_free(w->section);
    gsn_grid_free(w->grid);
    gsn_free(w->prior);
    gsn_free(w->refined);
}

/* ---- What is compared --------------------------------------------------------------------- */

static void place_square(struct refinement_job *w)
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

static int make_room(struct refinement_job *w, struct gsn_error *err)
{
    const double cell = w->stack.cell_um, interval = w->specimen->protocol->interval_um;
    const double half = 0.5 * ((double)w->stack.side - 1) * cell;
    const struct gsn_lattice at = {
        .nx = w->stack.side,
        .ny = w->stack.side,
        .nz = w->poses->section[w->section[w->stack.count - 1]].seen.serial + (size_t)1,
        .origin_um = { w->stack.centre.x - half, w->stack.centre.y - half, 0.5 * interval },
        .step_um = { cell, cell, interval }
    };

    w->prior = gsn_alloc_array(w->stack.count, sizeof *w->prior);
    w->refined = gsn_alloc_array(w->stack.count, sizeof *w->refined);
    if (!w->prior || !w->refined)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    return gsn_grid_new_unseen(&at, &w->grid, err);
}

/* ---- What the marks say ------------------------------------------------------------------- */

/* How shift, turn and strain about where the pose has them make the parts of a move. */
static void parts_of_error(const struct refinement_job *w, const struct gsn_pose_error *error,
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
static double bent_um2(const struct refinement_job *w)
{
    return fmax(w->poses->summary.fle_um * w->poses->summary.fle_um / 2, 0.01);
}

static void state_prior(const struct refinement_job *w, const struct gsn_pose *pose,
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

static void state_priors(struct refinement_job *w)
{
    const size_t plane = w->stack.side * w->stack.side;

    for (size_t k = 0; k < w->stack.count; k++) {
        const struct gsn_section *s = &w->poses->section[w->section[k]];

        w->prior[k].serial = s->seen.serial;
        w->prior[k].density = w->grid->value + s->seen.serial * plane;
        state_prior(w, &s->pose, w->prior[k].prior);
    }
    w->stack.section = w->prior;
    w->stack.bent_um2 = BEND * BEND * bent_um2(w);
}

/* ---- What comes of it --------------------------------------------------------------------- */

/* Where the move shows a point of the region, beside its place. */
static struct gsn_point moved_at(const struct refinement_job *w, const double move[PARTS],
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
static void over_region(const struct refinement_job *w, const struct gsn_refined *refined,
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

static void move_sections(struct refinement_job *w, const struct gsn_refine_summary *summary)
{
    struct gsn_refinement *to = &w->poses->refinement;
    const double n = (double)w->stack.count;
    double square = 0, area = 0, area2 = 0;

    for (size_t k = 0; k < w->stack.count; k++) {
        struct gsn_pose *pose = &w->poses->section[w->section[k]].pose;
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

static int note_cannot(struct gsn_poses *poses, const char *why)
{
    (void)snprintf(poses->refinement.why, sizeof poses->refinement.why, "%s", why);
    return GSN_OK;
}

static int refine_sections(struct refinement_job *w, struct gsn_error *err)
{
    struct gsn_refine_summary summary;
    int r = gsn_region_targets(w->region, &w->target, &w->target_count, err);

    if (r < 0)
        return r;
    w->section = gsn_alloc_array(w->poses->section_count + 1, sizeof *w->section);
    if (!w->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    w->stack.count = gsn_section_planes_list(w->poses, w->section);
    w->poses->refinement.sections = w->stack.count;
    if (w->target_count == 0 || w->stack.count < LEAST_SECTIONS)
        return note_cannot(w->poses, "there are too few sections");
    place_square(w);
    if (w->stack.side < LEAST_SIDE)
        return note_cannot(w->poses, "the region is too small for the tissue around it to tell");
    r = make_room(w, err);
    if (r >= 0)
        r = gather_panels(w, err);
    if (r < 0)
        return r;
    state_priors(w);
    r = gsn_refine_solve(&w->stack, w->options->threads, w->refined, &summary, err);
    if (r < 0)
        return r;
    if (summary.compared == 0)
        return note_cannot(w->poses, "neighbouring sections have too little in common");
    move_sections(w, &summary);
    return GSN_OK;
}

int gsn_poses_refine(const struct gsn_specimen *specimen,
                     const struct gsn_specimen_options *options, const struct gsn_mask *region,
                     struct gsn_calibrations *calibrations, struct gsn_poses *poses,
                     struct gsn_error *err)
{
    struct refinement_job work = { .specimen = specimen,
                                   .options = options,
                                   .region = region,
                                   .calibrations = calibrations,
                                   .poses = poses };
    int r;

    if (!poses->solved || poses->strain_mode != GSN_STRAIN_TISSUE)
        return GSN_OK;
    if (!region)
        return note_cannot(poses, "no region is stated before the panels are opened");
    r = gsn_poses_marks(poses, &work.marks, err);
    if (r >= 0)
        r = refine_sections(&work, err);
    refine_done(&work);
    return r;
}
