/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The density stack: opens every panel and resamples its sections into the block.
 *
 * For each panel, in order:
 * 1. scan, dye vectors (calibration_panel.c), marks of sections that tissue placed, thumbnails;
 * 2. masks of defects and the state of lamp, bath, knife and glass (quality_control.c); clipped
 *    sections are held;
 * 3. the density of each used section into the grid, the reference tissue's grid and the coarse
 * grid, its colour into the colour volume, section by section in parallel: each has planes of its
 * own;
 * 4. held sections as they lie, for the search of double mounts.
 * At the end the candidate sheets are drawn and the order of the sections is examined.
 *
 * Colours are kept as sRGB codes by a table over linear light. Gaps stay gaps (NaN). Most of a
 * run's time is spent here. */
#include "pipeline/specimen/density_stack.h"

#include "pipeline/core/file.h"
#include "pipeline/core/parallel.h"
#include "pipeline/register/order/sequence.h"
#include "pipeline/register/stack/resample.h"
#include "pipeline/register/stack/resample_colour.h"
#include "pipeline/specimen/aligned_pictures.h"
#include "pipeline/specimen/quality_control.h"
#include "pipeline/specimen/section_order.h"
#include "pipeline/specimen/section_pictures.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/staining_uniformity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- colours --------------------------------------------------------------------------------- */

/* By how many voxels the second lattice begins later. */
static size_t voxels_later(double from, double to, double step)
{
    return (size_t)lround((to - from) / step);
}

int gsn_densities_crop_colour(struct gsn_densities *d, struct gsn_error *err)
{
    const struct gsn_lattice *from = &d->colour->at, *to = &d->grid->at;
    const size_t x = voxels_later(from->origin_um.x, to->origin_um.x, to->step_um.x);
    const size_t y = voxels_later(from->origin_um.y, to->origin_um.y, to->step_um.y);
    const size_t z = voxels_later(from->origin_um.z, to->origin_um.z, to->step_um.z);
    gsn_auto(gsn_colour_grid) part = NULL;
    const int r = gsn_colour_grid_new(to, &part, err);

    if (r < 0)
        return r;
    for (size_t v = 0; v < to->ny * to->nz; v++)
        memcpy(part->rgb + 3 * v * to->nx,
               d->colour->rgb + 3 * gsn_lattice_index(from, x, y + v % to->ny, z + v / to->ny),
               3 * to->nx);
    gsn_colour_grid_free(d->colour);
    d->colour = gsn_steal(&part);
    return GSN_OK;
}

int gsn_stack_light_table(enum gsn_light light, unsigned bits,
                          struct gsn_stack_light_table *ret_light, struct gsn_error *err)
{
    /* Codes of which nobody says that they follow a curve are shown as they are, as any viewer
     * shows the scan and the contact sheet does. */
    const enum gsn_light shown = light == GSN_LIGHT_CODES_LINEAR ? light : GSN_LIGHT_SRGB;
    const size_t samples = (size_t)1 << bits, steps = GSN_STACK_FULL_LIGHT / 4 + 1;
    struct gsn_stack_light_table made = { gsn_alloc(samples * sizeof(uint16_t)), gsn_alloc(steps) };

    if (!made.of_sample || !made.code) {
        gsn_stack_light_table_done(&made);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a panel");
    }
    for (unsigned i = 0; i < samples; i++)
        made.of_sample[i] =
            (uint16_t)lround(GSN_STACK_FULL_LIGHT * gsn_light_of_sample(light, i, bits));
    for (size_t i = 0; i < steps; i++) {
        /* The middle of the four lights that share a code. */
        const double middle = fmin((4.0 * (double)i + 1.5) / GSN_STACK_FULL_LIGHT, 1);
        const long code = lround(255 * gsn_light_encode(shown, middle));

        made.code[i] = (uint8_t)(code > 0 ? code : 1);
    }
    *ret_light = made;
    return GSN_OK;
}

void gsn_stack_light_table_done(struct gsn_stack_light_table *light)
{
    gsn_free(light->of_sample);
    gsn_free(light->code);
}

/* A section is seen larger in the page beside the report; MANY of these weigh half a megabyte in
 * the page, and so do more. */
enum { THUMBNAIL_PX = 192, THUMBNAIL_QUALITY = 65, MANY = 60 };

/* A hundredth of the tissue clipped is told; of a fifth the mean of what is left says little, for
 * it is the darkest that is missing. */
static const double TOLD_CLIPPED = 0.01, MOST_CLIPPED = 0.2;

/* One panel while its sections are laid into the stack. */
struct panel_work {
    const struct gsn_specimen *specimen;
    const struct gsn_specimen_options *options;
    const struct gsn_scan *scan;
    const struct gsn_od_reader *absorber;
    const struct gsn_collagen_reader *reader;
    const struct gsn_artefact_labels *labels;
    struct gsn_stack_light_table light;
    unsigned panel;                /* 1-based */
    const struct gsn_mask *region; /* or NULL */
    const struct gsn_poses *poses;
    struct gsn_densities *d;
    struct gsn_section_planes *planes;          /* or NULL */
    const struct gsn_aligned_pictures *aligned; /* or NULL */
    size_t count;
    size_t *used; /* the sections to resample */
    double *strength;
};

static void judge_clipped(const struct gsn_poses *poses, unsigned panel, struct gsn_densities *d)
{
    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_panel_section *seen = &poses->section[i].seen;
        struct gsn_section_density *s = &d->section[i];

        if (poses->section[i].panel != panel || seen->width <= 0 || seen->height <= 0)
            continue;
        s->clipped = s->masked.clipped;
        if (s->clipped <= TOLD_CLIPPED)
            continue;
        gsn_flags_add_number(&s->flags, GSN_FLAG_CLIPPED, (unsigned)lrint(100 * s->clipped), 0);
        if (s->clipped > MOST_CLIPPED)
            s->state = GSN_SECTION_HELD;
    }
}

static int draw_thumbnails(const struct gsn_scan *scan, unsigned number,
                           const struct gsn_poses *poses, struct gsn_densities *d,
                           struct gsn_error *err)
{
    const double share = fmin(1, sqrt(MANY / fmax(1, (double)poses->section_count)));

    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_panel_section *seen = &poses->section[i].seen;
        int r;

        if (poses->section[i].panel != number || seen->width <= 0 || seen->height <= 0)
            continue;
        r = gsn_thumbnail(scan->picture->image, scan->glass.light, seen->x, seen->y, seen->width,
                          seen->height, d->marks[i].mark, (unsigned)(share * THUMBNAIL_PX),
                          THUMBNAIL_QUALITY, &d->section[i].thumbnail, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

static int is_used(const struct gsn_densities *d, size_t i)
{
    return d->section[i].state == GSN_SECTION_USED || d->section[i].state == GSN_SECTION_DOUBTFUL;
}

/* A serial that an earlier section of the list already fills. */
static int is_taken(const struct gsn_poses *poses, const struct gsn_densities *d, size_t i)
{
    for (size_t j = 0; j < i; j++)
        if (poses->section[j].seen.serial == poses->section[i].seen.serial && is_used(d, j))
            return 1;
    return 0;
}

/* Lists the sections to resample. */
static void choose_sections(struct panel_work *work)
{
    for (size_t i = 0; i < work->poses->section_count; i++) {
        struct gsn_section_density *s = &work->d->section[i];

        if (work->poses->section[i].panel != work->panel || !is_used(work->d, i))
            continue;
        if (is_taken(work->poses, work->d, i)) {
            s->state = GSN_SECTION_HELD;
            gsn_flags_add(&s->flags, GSN_FLAG_DUPLICATE_SERIAL);
            continue;
        }
        work->used[work->count++] = i;
    }
}

static struct gsn_stack_section stack_section(const struct gsn_section *s)
{
    return (struct gsn_stack_section){ .serial = s->seen.serial,
                                       .panel_to_block_um = s->pose.panel_to_block_um,
                                       .x = s->seen.x,
                                       .y = s->seen.y,
                                       .width = s->seen.width,
                                       .height = s->seen.height };
}

/* Density of the part of the section that shows in the grid's plane, and nowhere else. */
static int resample_density(const struct panel_work *work, size_t i, struct gsn_grid *grid,
                            struct gsn_error *err)
{
    struct gsn_stack_section section = stack_section(&work->poses->section[i]);
    gsn_auto(gsn_plane) density = NULL;
    int r;

    if (!gsn_stack_footprint(&grid->at, work->specimen->protocol->interval_um, &section))
        return GSN_OK;
    r = gsn_collagen_box(
        work->reader,
        &(struct gsn_pixel_box){ section.x, section.y, section.width, section.height }, 1, &density,
        err);
    if (r < 0)
        return r;
    gsn_artefact_apply(work->labels, gsn_masking_index(work->poses, i), section.x, section.y,
                       density);
    section.density = density;
    section.plane_x = section.x;
    section.plane_y = section.y;
    return gsn_stack_resample(&section, 1, work->specimen->protocol->interval_um, 1, grid, err);
}

/* Colours are kept of all of it, also where defects are masked. */
static int resample_colour(const struct panel_work *work, size_t i, struct gsn_error *err)
{
    const struct gsn_stack_section section = stack_section(&work->poses->section[i]);
    const struct gsn_stack_light light = { work->light.of_sample, work->light.code };

    return gsn_stack_resample_colour(&section, work->scan->picture->image, &light,
                                     work->specimen->protocol->interval_um, 1, work->d->colour,
                                     err);
}

/* gives: density of every apart-th row of a whole section, masked. */
static int see_section(const struct panel_work *work, size_t i, unsigned apart,
                       struct gsn_plane **ret_density, struct gsn_error *err)
{
    const struct gsn_panel_section *seen = &work->poses->section[i].seen;
    const struct gsn_pixel_box box = { seen->x, seen->y, seen->width, seen->height };
    gsn_auto(gsn_plane) density = NULL;
    int r = gsn_collagen_box(work->reader, &box, apart, &density, err);

    if (r < 0)
        return r;
    for (uint32_t y = 0; y < density->height; y++) {
        struct gsn_plane row = { density->width, 1, density->value + (size_t)y * density->width };

        gsn_artefact_apply(work->labels, gsn_masking_index(work->poses, i), seen->x,
                           seen->y + (int)(y * apart), &row);
    }
    *ret_density = gsn_steal(&density);
    return GSN_OK;
}

static int measure_strength(const struct panel_work *work, size_t k, struct gsn_error *err)
{
    const struct gsn_panel_section *seen = &work->poses->section[work->used[k]].seen;
    const unsigned apart = gsn_uniformity_rows_apart(seen->width, seen->height);
    gsn_auto(gsn_plane) density = NULL;
    int r = see_section(work, work->used[k], apart, &density, err);

    return r < 0 ? r : gsn_uniformity_of_section(density, &work->strength[k], err);
}

/* Of what is told in coarse cells, rows nearer than half a cell to each other say the same. */
static unsigned rows_apart(const struct panel_work *work)
{
    return (unsigned)fmax(1, floor(GSN_COARSE_UM / 2 / work->scan->px_um));
}

/* What is told from the whole section in coarse cells. */
static int gather_coarse(const struct panel_work *work, size_t i, struct gsn_error *err)
{
    const unsigned apart = rows_apart(work);
    struct gsn_stack_section section = stack_section(&work->poses->section[i]);
    gsn_auto(gsn_plane) density = NULL;
    int r = work->planes || work->d->coarse ? see_section(work, i, apart, &density, err) : GSN_OK;

    if (r < 0 || !density)
        return r;
    gsn_section_planes_add(work->planes, work->poses, i, density, apart);
    section.density = density;
    section.plane_x = section.x;
    section.plane_y = section.y;
    return work->d->coarse ? gsn_coarse_grid_add(work->d->coarse, &section, apart, work->absorber,
                                                 work->specimen->protocol->interval_um, err)
                           : GSN_OK;
}

/* Held sections are seen as they lie: another may be the same one mounted twice. */
static int gather_held(const struct panel_work *work, struct gsn_error *err)
{
    const unsigned apart = rows_apart(work);
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && work->planes && i < work->poses->section_count; i++) {
        const struct gsn_section *s = &work->poses->section[i];
        gsn_auto(gsn_plane) density = NULL;

        if (s->panel != work->panel || work->d->section[i].state != GSN_SECTION_HELD ||
            s->seen.width <= 0 || s->seen.height <= 0)
            continue;
        r = see_section(work, i, apart, &density, err);
        if (r >= 0)
            r = gsn_section_planes_hold(work->planes, i, density, apart, work->scan->px_um, err);
    }
    return r;
}

/* Each section has planes of its own, so the threads cannot matter. */
static int process_section(size_t k, void *context, struct gsn_error *err)
{
    const struct panel_work *work = context;
    const size_t i = work->used[k];
    int r = measure_strength(work, k, err);

    if (r >= 0)
        r = resample_density(work, i, work->d->grid, err);
    if (r >= 0)
        r = resample_colour(work, i, err);
    if (r >= 0 && work->d->tissue_grid)
        r = resample_density(work, i, work->d->tissue_grid, err);
    if (r >= 0)
        r = gather_coarse(work, i, err);
    return r;
}

/* What the dye vectors and the white of a panel leave open. */
static int judge_vectors(const struct gsn_scan *scan, struct gsn_stack_panel *panel,
                         struct gsn_error *err)
{
    const struct gsn_dyes_fit *fit = &panel->stain.fit;
    struct gsn_collagen_mean red;
    int r;

    if (!(fit->deviation_deg[0] > 0))
        return GSN_OK;
    r = gsn_collagen_mean(scan->od, NULL, &fit->dyes, &red, err);
    if (r < 0)
        return r;
    panel->red_error = gsn_collagen_mean_error(&red, fit, GSN_WHITE_ERROR_OD);
    return GSN_OK;
}

static int process_sections(struct panel_work *work, double *ret_strength, struct gsn_error *err)
{
    gsn_auto_mem(size_t) used = gsn_alloc_array(work->poses->section_count, sizeof *used);
    gsn_auto_mem(double) strength = gsn_alloc_array(work->poses->section_count, sizeof *strength);
    int r;

    if (!used || !strength)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the stack");
    work->used = used;
    work->strength = strength;
    choose_sections(work);
    r = gsn_parallel_for(work->count, work->options->threads, process_section, work, err);
    if (r >= 0)
        *ret_strength = gsn_uniformity_of_panel(strength, work->count);
    return r;
}

/* Masks, density and stack of one opened panel. */
static int process_panel(struct panel_work *work, struct gsn_stack_panel *panel,
                         struct gsn_error *err)
{
    const struct gsn_dyes *dyes = &panel->stain.fit.dyes;
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_collagen_reader) reader = NULL;
    gsn_auto(gsn_artefact_labels) labels = NULL;
    int r = gsn_od_reader_new(work->scan->picture->image, &work->scan->glass, &absorber, err);

    if (r >= 0)
        r = gsn_collagen_reader_new(absorber, dyes, &reader, err);
    if (r >= 0)
        r = gsn_masking_find(work->scan, dyes, work->panel, work->options->threads, work->poses,
                             work->d, &labels, err);
    if (r >= 0)
        r = gsn_quality_measure_panel(work->scan, labels, work->poses, panel, work->d, err);
    if (r >= 0)
        r = judge_vectors(work->scan, panel, err);
    if (r < 0)
        return r;
    work->absorber = absorber;
    work->reader = reader;
    work->labels = labels;
    gsn_masking_region(labels, work->panel, work->specimen->protocol->interval_um, work->region,
                       work->poses, work->d);
    judge_clipped(work->poses, work->panel, work->d);
    r = gsn_stack_light_table(work->scan->glass.light, work->scan->picture->image->bits,
                              &work->light, err);
    if (r >= 0)
        r = process_sections(work, &panel->strength, err);
    if (r >= 0)
        r = gather_held(work, err);
    if (r >= 0)
        r = gsn_aligned_pictures_mask(work->aligned, work->poses, labels, work->panel, work->d,
                                      err);
    gsn_stack_light_table_done(&work->light);
    return r;
}

static int open_panel(struct panel_work *work, struct gsn_stack_panel *panel,
                      struct gsn_calibrations *calibrations, struct gsn_candidate_sheet *sheet,
                      struct gsn_aligned_pictures *aligned, struct gsn_error *err)
{
    const struct gsn_specimen *specimen = work->specimen;
    const struct gsn_specimen_options *options = work->options;
    const unsigned number = panel->given->number;
    struct gsn_specimen_stain *stain = &panel->stain;
    gsn_auto_fd picture_fd = -1;
    gsn_auto(gsn_scan) scan = NULL;
    gsn_auto(gsn_image) tissue = NULL;
    int r = specimen->open(specimen->context, panel->given->sha256, &picture_fd, err);

    if (r >= 0)
        r = gsn_scan_open(options->decoder, picture_fd, specimen->protocol, &panel->given->upright,
                          &scan, err);
    if (r >= 0)
        r = gsn_masking_tissue(scan, number, work->poses, work->d->marks, &tissue, err);
    if (r >= 0)
        r = gsn_calibration_find_dyes(specimen, options, scan, tissue, number, calibrations,
                                      &stain->fit, &panel->calibrated, err);
    if (r >= 0)
        r = gsn_fiducials_by_tissue(specimen, options, scan, number, work->poses, work->d->marks,
                                    err);
    if (r >= 0)
        r = draw_thumbnails(scan, number, work->poses, work->d, err);
    if (r >= 0)
        r = gsn_candidate_sheet_look(sheet, work->poses, scan, number, err);
    if (r >= 0)
        r = gsn_aligned_pictures_look(aligned, work->poses, scan, number, options->threads, work->d,
                                      err);
    if (r < 0)
        return r;
    panel->opened = 1;
    panel->lossy = scan->picture->lossy;
    panel->glass = scan->glass;
    stain->panel = number;
    memcpy(stain->white, scan->glass.white, sizeof stain->white);
    (void)snprintf(panel->note, sizeof panel->note, "%s", scan->note);
    if (!work->d->grid)
        return GSN_OK;
    work->scan = scan;
    work->aligned = aligned;
    work->panel = number;
    return process_panel(work, panel, err);
}

static int open_panels(const struct gsn_specimen *specimen,
                       const struct gsn_specimen_options *options, const struct gsn_mask *region,
                       const struct gsn_poses *poses, struct gsn_calibrations *calibrations,
                       struct gsn_densities *d, struct gsn_error *err)
{
    gsn_auto(gsn_section_planes) planes = NULL;
    gsn_auto(gsn_candidate_sheet) sheet = NULL;
    gsn_auto(gsn_aligned_pictures) aligned = NULL;
    int r = d->grid ? gsn_section_planes_new(poses, GSN_SEQUENCE_CELL_UM, &planes, err) : GSN_OK;

    if (r >= 0)
        r = gsn_candidate_sheet_new(poses, &sheet, err);
    if (r >= 0 && !specimen->part)
        r = gsn_aligned_pictures_new(poses, &aligned, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < specimen->panel_count; i++) {
        struct panel_work work = { .specimen = specimen,
                                   .options = options,
                                   .region = region,
                                   .poses = poses,
                                   .d = d,
                                   .planes = planes };

        d->panel[i].given = &specimen->panel[i];
        gsn_progress_say(options->progress, "stacking", i, specimen->panel_count);
        if (specimen->panel[i].section_count == 0)
            continue;
        r = open_panel(&work, &d->panel[i], calibrations, sheet, aligned, err);
        if (r < 0)
            return gsn_fail_at(err, "panel %u (%s)", specimen->panel[i].number,
                               specimen->panel[i].file);
    }
    r = gsn_candidate_sheet_draw(sheet, poses, d, err);
    if (r >= 0)
        r = gsn_aligned_pictures_code(aligned, d, err);
    if (r < 0)
        return r;
    return planes
               ? gsn_section_order_examine(planes, specimen->protocol, poses, d, &d->sequence, err)
               : GSN_OK;
}

/* ---- the record ------------------------------------------------------------------------------ */

/* A block of more cells than this is a mistake in a pose, not a block. */
static const double MOST_COARSE_CELLS = 1 << 27;

static int make_sections(const struct gsn_specimen *specimen, const struct gsn_poses *poses,
                         struct gsn_densities *d, struct gsn_error *err)
{
    d->section = gsn_alloc_array(poses->section_count, sizeof *d->section);
    d->panel = gsn_alloc_array(specimen->panel_count, sizeof *d->panel);
    if (!d->section || !d->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the panels of a specimen");
    d->section_count = poses->section_count;
    d->panel_count = specimen->panel_count;
    for (size_t i = 0; i < poses->section_count; i++) {
        d->section[i].state = poses->section[i].state;
        d->section[i].flags = poses->section[i].flags;
    }
    return gsn_poses_marks(poses, &d->marks, err);
}

/* The reference tissue, where one is stated. */
static int place_reference(const struct gsn_specimen *specimen, unsigned sections,
                           struct gsn_densities *d, struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->reference_tissue;
    struct gsn_lattice lattice;
    int r;

    if (stated->kind == GSN_REGION_NONE)
        return GSN_OK;
    if (!gsn_region_lattice(gsn_region_box(stated), NULL, gsn_region_voxel_um(specimen),
                            specimen->protocol->interval_um, sections, &lattice))
        return gsn_fail(err, GSN_E_INPUT,
                        "the reference tissue does not lie in this block of %u "
                        "sections",
                        sections);
    r = gsn_region_raster(stated, &lattice, &d->tissue, err);
    return r < 0 ? r : gsn_grid_new_unseen(&lattice, &d->tissue_grid, err);
}

static int place_grids(const struct gsn_specimen *specimen, const struct gsn_lattice *lattice,
                       const struct gsn_poses *poses, struct gsn_densities *d,
                       struct gsn_error *err)
{
    const unsigned sections = gsn_poses_length(poses);
    struct gsn_lattice coarse;
    int r = gsn_grid_new_unseen(lattice, &d->grid, err);

    if (r >= 0)
        r = gsn_colour_grid_new(lattice, &d->colour, err);
    if (r >= 0)
        r = place_reference(specimen, sections, d, err);
    if (r < 0 ||
        gsn_region_place_block(specimen, GSN_COARSE_UM, sections, &poses->extent, &coarse, NULL) <
            0 ||
        (double)coarse.nx * (double)coarse.ny * (double)coarse.nz > MOST_COARSE_CELLS)
        return r;
    return gsn_coarse_grid_new(&coarse, &d->coarse, err);
}

int gsn_densities_stack(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options,
                        const struct gsn_lattice *lattice, const struct gsn_mask *region,
                        const struct gsn_poses *poses, struct gsn_calibrations *calibrations,
                        struct gsn_densities *densities, struct gsn_error *err)
{
    int r = make_sections(specimen, poses, densities, err);

    if (r >= 0 && lattice)
        r = place_grids(specimen, lattice, poses, densities, err);
    if (r >= 0)
        r = open_panels(specimen, options, region, poses, calibrations, densities, err);
    return r < 0 ? r : gsn_quality_judge(specimen, region, poses, densities, err);
}

void gsn_densities_done(struct gsn_densities *d)
{
    for (size_t i = 0; d->section && i < d->section_count; i++) {
        gsn_free(d->section[i].thumbnail.png);
        gsn_free(d->section[i].aligned.png);
        gsn_free(d->section[i].glass.png);
        gsn_free(d->section[i].masked_map.png);
        for (size_t c = 0; c < GSN_CANDIDATES; c++)
            gsn_free(d->section[i].candidate_picture[c].png);
    }
    gsn_free(d->section);
    gsn_free(d->marks);
    gsn_free(d->panel);
    gsn_grid_free(d->grid);
    gsn_colour_grid_free(d->colour);
    gsn_mask_free(d->tissue);
    gsn_grid_free(d->tissue_grid);
    gsn_coarse_grid_free(d->coarse);
    gsn_dust_free(d->dust);
    gsn_free(d->spot);
    gsn_sequence_free(d->sequence);
}

int gsn_densities_find_band(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options,
                            const struct gsn_poses *poses, struct gsn_densities *d,
                            struct gsn_mask **ret_region, char ret_why[480], struct gsn_error *err)
{
    gsn_auto(gsn_mask) region = NULL;
    struct gsn_error why = { 0 };
    int r = gsn_band_region(&specimen->protocol->region, specimen->region, d->grid,
                            options->threads, &region, &why);

    if (r == GSN_E_STAIN || r == GSN_E_INPUT) {
        memcpy(ret_why, why.text, 480);
        gsn_grid_free(d->grid);
        d->grid = NULL;
        return GSN_OK;
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    r = gsn_band_crop(&d->grid, &region, err);
    if (r >= 0)
        r = gsn_densities_crop_colour(d, err);
    if (r < 0)
        return r;
    gsn_masking_gaps(specimen->protocol->interval_um, region, poses, d);
    *ret_region = gsn_steal(&region);
    return GSN_OK;
}

int gsn_panel_of_plane(const struct gsn_poses *poses, const struct gsn_densities *d,
                       const struct gsn_lattice *at, size_t z, double interval_um)
{
    const double serial = round((at->origin_um.z + (double)z * at->step_um.z) / interval_um - 0.5);

    for (size_t i = 0; i < poses->section_count; i++) {
        const struct gsn_section *s = &poses->section[i];

        if (s->seen.serial != serial || !is_used(d, i))
            continue;
        for (size_t p = 0; p < d->panel_count; p++)
            if (d->panel[p].opened && d->panel[p].stain.panel == s->panel)
                return (int)p;
    }
    return -1;
}
