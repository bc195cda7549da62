/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_refine.h"

#include "pipeline/core/file.h"
#include "pipeline/core/parallel.h"
#include "pipeline/register/stack/resample.h"

#include <math.h>

/* The square root of the density: what is fibre rather than tissue varies as the density itself. */
static int gather_section(size_t k, void *context, struct gsn_error *err)
{
    const struct gsn_refine_work *w = context;
    const size_t i = w->section[k];
    const struct gsn_assembly_section *s = &w->a->section[i];
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
    r = gsn_collagen_box(
        w->reader, &(struct gsn_pixel_box){ section.x, section.y, section.width, section.height },
        1, &density, err);
    if (r < 0)
        return r;
    for (size_t p = 0; p < (size_t)density->width * density->height; p++)
        density->value[p] = isnan(density->value[p]) ? NAN : sqrtf(fmaxf(density->value[p], 0));
    gsn_artefact_apply(w->labels, gsn_masking_index(w->a, i), section.x, section.y, density);
    section.density = density;
    section.plane_x = section.x;
    section.plane_y = section.y;
    return gsn_stack_resample(&section, 1, interval, 1, w->grid, err);
}

static int gather_scan(struct gsn_refine_work *w, const struct gsn_specimen_panel *given,
                       const struct gsn_scan *scan, struct gsn_error *err)
{
    struct gsn_assembly_panel panel = { .given = given };
    gsn_auto_mem(struct gsn_artefact_figures) figures =
        gsn_alloc_array(w->a->section_count, sizeof *figures);
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_collagen_reader) reader = NULL;
    gsn_auto(gsn_artefact_labels) labels = NULL;
    int r;

    if (!figures)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to lay sections by their tissue");
    r = gsn_assembly_find_dyes(w->specimen, w->options, scan, w->a, &panel, err);
    if (r >= 0)
        r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);
    if (r >= 0)
        r = gsn_collagen_reader_new(absorber, &panel.stain.fit.dyes, &reader, err);
    if (r >= 0)
        r = gsn_masking_label(scan, &panel.stain.fit.dyes, given->number, w->options->threads, w->a,
                              &labels, figures, err);
    if (r < 0)
        return r;
    w->reader = reader;
    w->labels = labels;
    w->panel = given->number;
    return gsn_parallel_for(w->stack.count, w->options->threads, gather_section, w, err);
}

static int gather_panel(struct gsn_refine_work *w, const struct gsn_specimen_panel *given,
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

int gsn_refine_gather(struct gsn_refine_work *w, struct gsn_error *err)
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
