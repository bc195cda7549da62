/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/assembly_order.h"
#include "pipeline/candidate_sheet.h"
#include "pipeline/conditions.h"
#include "pipeline/core/file.h"
#include "pipeline/core/parallel.h"
#include "pipeline/evenness.h"
#include "pipeline/masking.h"
#include "pipeline/register/stack/resample_colour.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/stain/error_propagation.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { THUMBNAIL_PX = 132 };

/* A hundredth of the tissue clipped is told; of a fifth the mean of what is left says little, for
 * it is the darkest that is missing. */
static const double TOLD_CLIPPED = 0.01, MOST_CLIPPED = 0.2;

/* Of the white of a panel: test_glass finds it within a tenth of a percent. */
static const double WHITE_ERROR_OD = 0.0005;

/* One panel while its sections are laid into the stack. */
struct work {
    const struct gsn_specimen *specimen;
    const struct gsn_specimen_options *options;
    const struct gsn_scan *scan;
    const struct gsn_od_reader *absorber;
    const struct gsn_collagen_reader *reader;
    const struct gsn_artefact_labels *labels;
    struct gsn_assembly_light light;
    unsigned panel; /* 1-based */
    struct gsn_assembly *a;
    struct gsn_section_planes *planes; /* or NULL */
    size_t count;
    size_t *used; /* the assembly's sections to lay */
    double *strength;
};

static void judge_clipped(struct gsn_assembly *a, unsigned panel)
{
    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        char word[32];

        if (s->panel != panel || s->seen.width <= 0 || s->seen.height <= 0)
            continue;
        s->clipped = s->masked.clipped;
        if (s->clipped <= TOLD_CLIPPED)
            continue;
        (void)snprintf(word, sizeof word, "clipped-%.0f%%", 100 * s->clipped);
        gsn_assembly_flag(s, word);
        if (s->clipped > MOST_CLIPPED)
            s->state = GSN_SECTION_HELD;
    }
}

static int thumbnails(const struct gsn_scan *scan, unsigned number, struct gsn_assembly *a,
                      struct gsn_error *err)
{
    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        int r;

        if (s->panel != number || s->seen.width <= 0 || s->seen.height <= 0)
            continue;
        r = gsn_thumbnail(scan->picture->image, scan->glass.light, s->seen.x, s->seen.y,
                          s->seen.width, s->seen.height, s->seen.mark, THUMBNAIL_PX, &s->thumbnail,
                          err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

/* A serial that an earlier section of the list already fills. */
static int taken(const struct gsn_assembly *a, size_t i)
{
    for (size_t j = 0; j < i; j++)
        if (a->section[j].seen.serial == a->section[i].seen.serial &&
            (a->section[j].state == GSN_SECTION_USED ||
             a->section[j].state == GSN_SECTION_DOUBTFUL))
            return 1;
    return 0;
}

/* Lists the sections to lay. */
static void choose_sections(struct work *work)
{
    struct gsn_assembly *a = work->a;

    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];

        if (s->panel != work->panel ||
            (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL))
            continue;
        if (taken(a, i)) {
            s->state = GSN_SECTION_HELD;
            gsn_assembly_flag(s, "duplicate-serial");
            continue;
        }
        work->used[work->count++] = i;
    }
}

static struct gsn_stack_section stack_section(const struct gsn_assembly_section *s)
{
    return (struct gsn_stack_section){ .serial = s->seen.serial,
                                       .panel_to_block_um = s->pose.panel_to_block_um,
                                       .x = s->seen.x,
                                       .y = s->seen.y,
                                       .width = s->seen.width,
                                       .height = s->seen.height };
}

/* Density of the part of the section that shows in the grid's plane, and nowhere else. */
static int lay_into(const struct work *work, size_t i, struct gsn_grid *grid, struct gsn_error *err)
{
    struct gsn_stack_section section = stack_section(&work->a->section[i]);
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
    gsn_artefact_apply(work->labels, gsn_masking_index(work->a, i), section.x, section.y, density);
    section.density = density;
    section.plane_x = section.x;
    section.plane_y = section.y;
    return gsn_stack_resample(&section, 1, work->specimen->protocol->interval_um, 1, grid, err);
}

/* Colours are kept of all of it, also where defects are masked. */
static int lay_colour(const struct work *work, size_t i, struct gsn_error *err)
{
    const struct gsn_stack_section section = stack_section(&work->a->section[i]);
    const struct gsn_stack_light light = { work->light.of_sample, work->light.code };

    return gsn_stack_resample_colour(&section, work->scan->picture->image, &light,
                                     work->specimen->protocol->interval_um, 1, work->a->colour,
                                     err);
}

/* gives: density of every apart-th row of a whole section, masked. */
static int see_section(const struct work *work, size_t i, unsigned apart,
                       struct gsn_plane **ret_density, struct gsn_error *err)
{
    const struct gsn_panel_section *seen = &work->a->section[i].seen;
    const struct gsn_pixel_box box = { seen->x, seen->y, seen->width, seen->height };
    gsn_auto(gsn_plane) density = NULL;
    int r = gsn_collagen_box(work->reader, &box, apart, &density, err);

    if (r < 0)
        return r;
    for (uint32_t y = 0; y < density->height; y++) {
        struct gsn_plane row = { density->width, 1, density->value + (size_t)y * density->width };

        gsn_artefact_apply(work->labels, gsn_masking_index(work->a, i), seen->x,
                           seen->y + (int)(y * apart), &row);
    }
    *ret_density = gsn_steal(&density);
    return GSN_OK;
}

static int measure_strength(const struct work *work, size_t k, struct gsn_error *err)
{
    const struct gsn_panel_section *seen = &work->a->section[work->used[k]].seen;
    const unsigned apart = gsn_evenness_apart(seen->width, seen->height);
    gsn_auto(gsn_plane) density = NULL;
    int r = see_section(work, work->used[k], apart, &density, err);

    return r < 0 ? r : gsn_evenness_of_section(density, &work->strength[k], err);
}

/* Of what is told in coarse cells, rows nearer than half a cell to each other say the same. */
static unsigned rows_apart(const struct work *work)
{
    return (unsigned)fmax(1, floor(GSN_COLUMN_UM / 2 / work->scan->px_um));
}

/* What is told from the whole section in coarse cells. */
static int gather(const struct work *work, size_t i, struct gsn_error *err)
{
    const unsigned apart = rows_apart(work);
    struct gsn_stack_section section = stack_section(&work->a->section[i]);
    gsn_auto(gsn_plane) density = NULL;
    int r = work->planes || work->a->columns ? see_section(work, i, apart, &density, err) : GSN_OK;

    if (r < 0 || !density)
        return r;
    gsn_section_planes_add(work->planes, work->a, i, density, apart);
    section.density = density;
    section.plane_x = section.x;
    section.plane_y = section.y;
    return work->a->columns ? gsn_columns_add(work->a->columns, &section, apart, work->absorber,
                                              work->specimen->protocol->interval_um, err)
                            : GSN_OK;
}

/* Held sections are seen as they lie: another may be the same one mounted twice. */
static int gather_held(const struct work *work, struct gsn_error *err)
{
    const unsigned apart = rows_apart(work);
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && work->planes && i < work->a->section_count; i++) {
        const struct gsn_assembly_section *s = &work->a->section[i];
        gsn_auto(gsn_plane) density = NULL;

        if (s->panel != work->panel || s->state != GSN_SECTION_HELD || s->seen.width <= 0 ||
            s->seen.height <= 0)
            continue;
        r = see_section(work, i, apart, &density, err);
        if (r >= 0)
            r = gsn_section_planes_hold(work->planes, i, density, apart, work->scan->px_um, err);
    }
    return r;
}

/* Each section has planes of its own, so the threads cannot matter. */
static int lay_section(size_t k, void *context, struct gsn_error *err)
{
    const struct work *work = context;
    const size_t i = work->used[k];
    int r = measure_strength(work, k, err);

    if (r >= 0)
        r = lay_into(work, i, work->a->grid, err);
    if (r >= 0)
        r = lay_colour(work, i, err);
    if (r >= 0 && work->a->tissue_grid)
        r = lay_into(work, i, work->a->tissue_grid, err);
    if (r >= 0)
        r = gather(work, i, err);
    return r;
}

/* What the dye vectors and the white of a panel leave open. */
static int judge_vectors(const struct gsn_scan *scan, struct gsn_assembly_panel *panel,
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
    panel->red_error = gsn_collagen_mean_error(&red, fit, WHITE_ERROR_OD);
    return GSN_OK;
}

static int lay_sections(struct work *work, double *ret_strength, struct gsn_error *err)
{
    gsn_auto_mem(size_t) used = gsn_alloc_array(work->a->section_count, sizeof *used);
    gsn_auto_mem(double) strength = gsn_alloc_array(work->a->section_count, sizeof *strength);
    int r;

    if (!used || !strength)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the stack");
    work->used = used;
    work->strength = strength;
    choose_sections(work);
    r = gsn_parallel_for(work->count, work->options->threads, lay_section, work, err);
    if (r >= 0)
        *ret_strength = gsn_evenness_of_panel(strength, work->count);
    return r;
}

/* Masks, density and stack of one opened panel. */
static int lay_panel(struct work *work, struct gsn_assembly_panel *panel, struct gsn_error *err)
{
    const struct gsn_dyes *dyes = &panel->stain.fit.dyes;
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_collagen_reader) reader = NULL;
    gsn_auto(gsn_artefact_labels) labels = NULL;
    int r = gsn_od_reader_new(work->scan->picture->image, &work->scan->glass, &absorber, err);

    if (r >= 0)
        r = gsn_collagen_reader_new(absorber, dyes, &reader, err);
    if (r >= 0)
        r = gsn_masking_find(work->scan, dyes, work->panel, work->options->threads, work->a,
                             &labels, err);
    if (r >= 0)
        r = gsn_conditions_look(work->scan, labels, panel, work->a, err);
    if (r >= 0)
        r = judge_vectors(work->scan, panel, err);
    if (r < 0)
        return r;
    work->absorber = absorber;
    work->reader = reader;
    work->labels = labels;
    gsn_masking_region(labels, work->panel, work->specimen->protocol->interval_um, work->a);
    judge_clipped(work->a, work->panel);
    r = gsn_assembly_light(work->scan->glass.light, work->scan->picture->image->bits, &work->light,
                           err);
    if (r >= 0)
        r = lay_sections(work, &panel->strength, err);
    if (r >= 0)
        r = gather_held(work, err);
    gsn_assembly_light_done(&work->light);
    return r;
}

static int work_panel(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options, struct gsn_assembly_panel *panel,
                      struct gsn_assembly *a, struct gsn_section_planes *planes,
                      struct gsn_candidate_sheet *sheet, struct gsn_error *err)
{
    gsn_auto_fd picture_fd = -1;
    gsn_auto(gsn_scan) scan = NULL;
    struct gsn_specimen_stain *stain = &panel->stain;
    struct work work = { .specimen = specimen, .options = options, .a = a, .planes = planes };
    int r = specimen->open(specimen->context, panel->given->sha256, &picture_fd, err);

    if (r >= 0)
        r = gsn_scan_open(options->decoder, picture_fd, specimen->protocol, &panel->given->upright,
                          &scan, err);
    if (r >= 0)
        r = gsn_assembly_find_dyes(specimen, options, scan, a, panel, err);
    if (r >= 0)
        r = gsn_assembly_seek_marks(specimen, options, scan, panel->given->number, a, err);
    if (r >= 0)
        r = thumbnails(scan, panel->given->number, a, err);
    if (r >= 0)
        r = gsn_candidate_sheet_look(sheet, a, scan, panel->given->number, err);
    if (r < 0)
        return r;
    panel->opened = 1;
    panel->lossy = strcmp(scan->picture->kind, "JPEG") == 0;
    panel->glass = scan->glass;
    stain->panel = panel->given->number;
    memcpy(stain->white, scan->glass.white, sizeof stain->white);
    (void)snprintf(panel->note, sizeof panel->note, "%s", scan->note);
    if (!a->grid)
        return GSN_OK;
    work.scan = scan;
    work.panel = stain->panel;
    return lay_panel(&work, panel, err);
}

int gsn_assembly_work_panels(const struct gsn_specimen *specimen,
                             const struct gsn_specimen_options *options, struct gsn_assembly *a,
                             struct gsn_error *err)
{
    gsn_auto(gsn_section_planes) planes = NULL;
    gsn_auto(gsn_candidate_sheet) sheet = NULL;
    int r;

    a->panel = gsn_alloc_array(specimen->panel_count, sizeof *a->panel);
    if (!a->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the panels of a specimen");
    a->panel_count = specimen->panel_count;
    r = a->grid ? gsn_section_planes_new(a, GSN_SEQUENCE_CELL_UM, &planes, err) : GSN_OK;
    if (r >= 0)
        r = gsn_candidate_sheet_new(a, &sheet, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < specimen->panel_count; i++) {
        a->panel[i].given = &specimen->panel[i];
        gsn_progress_say(options->progress, "stacking", i, specimen->panel_count);
        if (specimen->panel[i].section_count == 0)
            continue;
        r = work_panel(specimen, options, &a->panel[i], a, planes, sheet, err);
        if (r < 0)
            return gsn_fail_at(err, "panel %u (%s)", specimen->panel[i].number,
                               specimen->panel[i].file);
    }
    r = gsn_candidate_sheet_draw(sheet, a, err);
    if (r < 0)
        return r;
    return planes ? gsn_section_order_examine(planes, specimen->protocol, a, &a->sequence, err)
                  : GSN_OK;
}
