/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/assembly_order.h"
#include "pipeline/conditions.h"
#include "pipeline/evenness.h"
#include "pipeline/masking.h"
#include "pipeline/register/stack.h"
#include "pipeline/stain/spread.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { THUMBNAIL_PX = 132 };

/* Tissue is what absorbs this much in R, G and B together. A hundredth of it clipped is told; of a
 * fifth the mean of what is left says little, for it is the darkest that is missing. */
static const double LEAST_TISSUE_OD = 0.05, TOLD_CLIPPED = 0.01, MOST_CLIPPED = 0.2;

/* Of the white of a panel: test_glass finds it within a tenth of a percent. */
static const double WHITE_ERROR_OD = 0.0005;

/* Defects: their pixels lose their density. */
static int mask_panel(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                      const struct gsn_specimen_stain *stain, struct gsn_plane *density,
                      struct gsn_assembly *a, struct gsn_error *err)
{
    gsn_auto(gsn_image) labels = NULL;
    const int r =
        gsn_masking_find(scan, &stain->fit.dyes, stain->panel, options->threads, a, &labels, err);

    if (r < 0)
        return r;
    gsn_masking_region(labels, stain->panel, specimen->protocol->interval_um, a);
    gsn_mask_apply(labels, density);
    return GSN_OK;
}

/* A sample at either end of its codes only says "or beyond". All three at the top are bare glass.
 */
static int is_clipped(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    const unsigned top = image->bits == 8 ? 255 : 65535;
    unsigned at_top = 0, at_zero = 0;

    for (unsigned c = 0; c < 3; c++) {
        const unsigned sample = gsn_image_at(image, x, y, c);

        at_top += sample == top;
        at_zero += sample == 0;
    }
    return at_zero > 0 || (at_top > 0 && at_top < 3);
}

/* Masks the clipped pixels of a section and says which share of its tissue they are. */
static double mask_clipped(const struct gsn_scan *scan, const struct gsn_panel_section *seen,
                           struct gsn_plane *density)
{
    const struct gsn_image *image = scan->picture->image;
    size_t tissue = 0, clipped = 0;

    for (int y = seen->y; y < seen->y + seen->height; y++)
        for (int x = seen->x; x < seen->x + seen->width; x++) {
            const size_t i = (size_t)y * density->width + (size_t)x;
            const double od = scan->od[0]->value[i] + scan->od[1]->value[i] + scan->od[2]->value[i];

            if (!(od > LEAST_TISSUE_OD))
                continue;
            tissue++;
            if (!is_clipped(image, (uint32_t)x, (uint32_t)y))
                continue;
            clipped++;
            density->value[i] = NAN;
        }
    return tissue ? (double)clipped / (double)tissue : 0;
}

static void judge_clipped(const struct gsn_scan *scan, unsigned number, struct gsn_plane *density,
                          struct gsn_assembly *a)
{
    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        char word[32];

        if (s->panel != number || s->seen.width <= 0 || s->seen.height <= 0)
            continue;
        s->clipped = mask_clipped(scan, &s->seen, density);
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
        r = gsn_thumbnail(scan->picture->image, s->seen.x, s->seen.y, s->seen.width, s->seen.height,
                          s->seen.mark, THUMBNAIL_PX, &s->thumbnail, err);
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

static size_t sections_of_panel(struct gsn_assembly *a, unsigned number,
                                const struct gsn_plane *density, struct gsn_stack_section *sections)
{
    size_t count = 0;

    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];

        if (s->panel != number ||
            (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL))
            continue;
        if (taken(a, i)) {
            s->state = GSN_SECTION_HELD;
            gsn_assembly_flag(s, "duplicate-serial");
            continue;
        }
        sections[count++] =
            (struct gsn_stack_section){ .serial = s->seen.serial,
                                        .density = density,
                                        .panel_to_block_um = s->pose.panel_to_block_um,
                                        .x = s->seen.x,
                                        .y = s->seen.y,
                                        .width = s->seen.width,
                                        .height = s->seen.height };
    }
    return count;
}

static void merge(const struct gsn_grid *from, struct gsn_grid *into)
{
    const size_t total = gsn_lattice_count(&into->at);

    for (size_t i = 0; i < total; i++)
        if (!isnan(from->value[i]))
            into->value[i] = from->value[i];
}

static int resample_into(const struct gsn_stack_section *sections, size_t count, double interval_um,
                         unsigned threads, struct gsn_grid *into, struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = NULL;
    const int r = gsn_stack_resample(sections, count, &into->at, interval_um, threads, &grid, err);

    if (r >= 0)
        merge(grid, into);
    return r;
}

static int stack_panel(const struct gsn_specimen *specimen,
                       const struct gsn_specimen_options *options, unsigned number,
                       const struct gsn_scan *scan, const struct gsn_plane *density,
                       struct gsn_assembly *a, struct gsn_error *err)
{
    const double interval_um = specimen->protocol->interval_um;
    gsn_auto_mem(struct gsn_stack_section) sections =
        gsn_alloc_array(a->section_count, sizeof *sections);
    size_t count;
    int r;

    if (!sections)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the stack");
    count = sections_of_panel(a, number, density, sections);
    if (count == 0)
        return GSN_OK;
    r = resample_into(sections, count, interval_um, options->threads, a->grid, err);
    if (r >= 0 && a->tissue_grid)
        r = resample_into(sections, count, interval_um, options->threads, a->tissue_grid, err);
    if (r >= 0 && a->columns)
        r = gsn_columns_add(a->columns, sections, count, scan->od, interval_um, err);
    return r;
}

/* What the dye vectors and the white of a panel leave open. */
static int judge_vectors(const struct gsn_scan *scan, struct gsn_assembly_panel *panel,
                         struct gsn_error *err)
{
    const struct gsn_dyes_fit *fit = &panel->stain.fit;
    struct gsn_red_mean red;
    int r;

    if (!(fit->deviation_deg[0] > 0))
        return GSN_OK;
    r = gsn_red_mean(scan->od, NULL, &fit->dyes, &red, err);
    if (r < 0)
        return r;
    red.sampling = 0; /* of the glass beside the tissue it would say nothing */

    const struct gsn_red_side side = { &red, fit, WHITE_ERROR_OD, 1, 0 };

    panel->red_error = gsn_red_half_width(&side) / 1.96 / red.mean;
    return GSN_OK;
}

static int work_panel(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options, struct gsn_assembly_panel *panel,
                      struct gsn_assembly *a, struct gsn_section_order *order,
                      struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto(gsn_scan) scan = NULL;
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_specimen_stain *stain = &panel->stain;
    size_t size;
    int r = specimen->read(specimen->context, panel->given->sha256, &bytes, &size, err);

    if (r >= 0)
        r = gsn_scan_open(options->decoder, bytes, size, specimen->protocol, options->threads,
                          &scan, err);
    if (r >= 0)
        r = gsn_scan_dyes(scan, specimen->protocol, &stain->fit, err);
    if (r >= 0)
        r = thumbnails(scan, panel->given->number, a, err);
    if (r < 0)
        return r;
    panel->opened = 1;
    panel->glass = scan->glass;
    stain->panel = panel->given->number;
    memcpy(stain->white, scan->glass.white, sizeof stain->white);
    (void)snprintf(panel->note, sizeof panel->note, "%s", scan->note);
    if (!a->grid)
        return GSN_OK;
    r = gsn_red(scan->od, &stain->fit.dyes, options->threads, &density, err);
    if (r < 0)
        return r;
    r = mask_panel(specimen, options, scan, stain, density, a, err);
    if (r < 0)
        return r;
    r = gsn_conditions_look(scan, density, panel, a, err);
    if (r >= 0)
        r = judge_vectors(scan, panel, err);
    if (r < 0)
        return r;
    judge_clipped(scan, stain->panel, density, a);
    gsn_section_order_add(order, a, stain->panel, density);
    r = gsn_evenness_of_panel(a, stain->panel, density, &panel->strength, err);
    if (r < 0)
        return r;
    return stack_panel(specimen, options, stain->panel, scan, density, a, err);
}

int gsn_assembly_work_panels(const struct gsn_specimen *specimen,
                             const struct gsn_specimen_options *options, struct gsn_assembly *a,
                             struct gsn_error *err)
{
    gsn_auto(gsn_section_order) order = NULL;
    int r;

    a->panel = gsn_alloc_array(specimen->panel_count, sizeof *a->panel);
    if (!a->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the panels of a specimen");
    a->panel_count = specimen->panel_count;
    r = a->grid ? gsn_section_order_new(a, &order, err) : GSN_OK;
    if (r < 0)
        return r;
    for (size_t i = 0; i < specimen->panel_count; i++) {
        a->panel[i].given = &specimen->panel[i];
        gsn_progress_say(options->progress, "stacking", i, specimen->panel_count);
        if (specimen->panel[i].section_count == 0)
            continue;
        r = work_panel(specimen, options, &a->panel[i], a, order, err);
        if (r < 0)
            return gsn_fail_at(err, "panel %u (%s)", specimen->panel[i].number,
                               specimen->panel[i].file);
    }
    return order ? gsn_section_order_examine(order, a, &a->sequence, err) : GSN_OK;
}
