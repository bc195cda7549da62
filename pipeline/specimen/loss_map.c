/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where it was lost: the loss cell by cell on the base mesh.
 *
 * Method: densities and errors of measure/base_cells.h, of this specimen and of each control's kept
 * model; the scale is the loss's own (link to the control's stain, density that no collagen reads
 * as), so that the cells, each by the collagen that the control has in it, add up to the loss.
 *
 * Steps: (1) this specimen's cells; (2) where there is a loss, those of each control; (3) the map,
 * its spread and its pictures; (4) base-cells.csv, with or without a loss.
 *
 * A cell is a piece of the block: that the same tissue lies in it in both animals is what the three
 * laser marks were burnt for, and the page says so. Where there is no map the report says why.
 *
 * Failure: GSN_E_NOMEM and as the parts of render. Cost: one value of each spline a voxel. */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/export/cells_file.h"
#include "pipeline/measure/base_cells.h"
#include "pipeline/model/model_file.h"

#include <math.h>
#include <stdio.h>

/* One side's cells for each control, and this specimen's. */
struct sides {
    size_t count;
    struct gsn_base_side *control; /* their cells owned */
};

static void sides_done(struct sides *sides)
{
    for (size_t i = 0; i < sides->count; i++)
        gsn_base_cells_free((struct gsn_base_cells *)sides->control[i].cells);
    gsn_free(sides->control);
}

/* Why there can be no map of this loss; NULL: there can be one. */
static const char *lacks_map(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_specimen_baseline *const b = &e->specimen->baseline;

    if (e->specimen->part)
        return "a run keeps one model, of its main region: the map is on the page of that";
    for (size_t i = 0; i < b->specimens; i++)
        if (!b->control[i].model || !b->control[i].model->region)
            return b->control[i].model_lacks ? gsn_builder_say(d, "%s", b->control[i].model_lacks)
                                             : "the baseline's run kept no model with its region";
    return NULL;
}

/* sides is to be released whatever comes back. */
static int cells_of_controls(const struct gsn_report_inputs *e, struct sides *sides,
                             struct gsn_error *err)
{
    const struct gsn_specimen_baseline *const b = &e->specimen->baseline;
    int r = GSN_OK;

    sides->control = gsn_alloc_array(b->specimens, sizeof *sides->control);
    if (!sides->control)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a map of the loss");
    while (r >= 0 && sides->count < b->specimens) {
        const struct gsn_specimen_control *const c = &b->control[sides->count];
        struct gsn_base_cells *cells = NULL;

        r = gsn_base_cells_new(c->model->spline, c->model->region, e->threads, &cells, err);
        if (r >= 0)
            sides->control[sides->count++] = (struct gsn_base_side){ cells, c->plane_error };
    }
    return r;
}

static struct gsn_loss_scale scale_of(const struct gsn_builder *d)
{
    const double zero = d->report.zero_density;

    return (struct gsn_loss_scale){ .gain = d->linked ? d->link.gain : 1,
                                    .offset = d->linked ? d->link.offset : 0,
                                    .zero = isfinite(zero) ? zero : 0 };
}

static int draw_map(const struct gsn_report_inputs *e, const struct gsn_loss_scale *scale,
                    const struct gsn_loss_map *map, struct gsn_builder *d, struct gsn_error *err)
{
    const struct gsn_loss_scene scene = { .analysis = e->analysis,
                                          .region = e->region,
                                          .control = e->specimen->baseline.control,
                                          .controls = e->specimen->baseline.specimens,
                                          .scale = scale,
                                          .map = map };
    const int r = gsn_loss_pictures(&scene, e->threads, d->loss_png, err);

    for (size_t i = 0; r >= 0 && i < GSN_LOSS_PICTURES; i++)
        d->loss_picture[i] =
            (struct gsn_report_picture){ .id = d->loss_png[i].id,
                                         .title = d->loss_png[i].title,
                                         .caption = d->loss_png[i].caption,
                                         .png = { d->loss_png[i].png, d->loss_png[i].size,
                                                  d->loss_png[i].width, d->loss_png[i].height } };
    return r;
}

static void describe_map(const struct gsn_loss_map *map, struct gsn_builder *d)
{
    d->loss_map = (struct gsn_report_loss_map){ .edge_um = GSN_BASE_EDGE_UM,
                                                .cells = map->count,
                                                .shared = map->shared,
                                                .low = map->low,
                                                .median = map->median,
                                                .high = map->high,
                                                .noise = map->noise,
                                                .pictures = d->loss_picture,
                                                .picture_count = GSN_LOSS_PICTURES };
    d->report.loss_map = &d->loss_map;
}

/* gives ret_map, NULL where there is none, which the report then says. */
static int make_map(const struct gsn_report_inputs *e, const struct gsn_base_side *own,
                    struct gsn_builder *d, struct gsn_loss_map **ret_map, struct gsn_error *err)
{
    const struct gsn_loss_scale scale = scale_of(d);
    gsn_auto(gsn_loss_map) map = NULL;
    struct sides sides = { 0 };
    struct gsn_error why = { 0 };
    int r;

    d->report.loss_map_reason = lacks_map(e, d);
    if (d->report.loss_map_reason)
        return GSN_OK;
    r = cells_of_controls(e, &sides, &why);
    if (r >= 0)
        r = gsn_loss_map_new(sides.control, sides.count, own, &scale, &map, &why);
    sides_done(&sides);
    if (r == GSN_E_NOMEM) {
        if (err)
            *err = why;
        return r;
    }
    if (r < 0) {
        d->report.loss_map_reason = gsn_builder_say(d, "%s", why.text);
        return GSN_OK;
    }
    r = draw_map(e, &scale, map, d, err);
    if (r < 0)
        return r;
    describe_map(map, d);
    *ret_map = gsn_steal(&map);
    return GSN_OK;
}

int gsn_builder_loss_map(const struct gsn_report_inputs *e, struct gsn_builder *d,
                         struct gsn_specimen_result *result, struct gsn_error *err)
{
    struct gsn_specimen_file *const file = &result->file[result->file_count];
    gsn_auto(gsn_base_cells) cells = NULL;
    gsn_auto(gsn_loss_map) map = NULL;
    struct gsn_base_side own = { .plane_error = e->analysis->plane_error };
    int r = gsn_base_cells_new(e->analysis->spline, e->region, e->threads, &cells, err);

    own.cells = cells;
    if (r >= 0 && isfinite(d->report.loss_percent))
        r = make_map(e, &own, d, &map, err);
    if (r < 0 || e->specimen->part)
        return r;
    r = gsn_base_csv_write(&own, map, &file->bytes, &file->size, err);
    if (r < 0)
        return r;
    (void)snprintf(file->name, sizeof file->name, "base-cells.csv");
    result->file_count++;
    return GSN_OK;
}
