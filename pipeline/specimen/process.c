/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One specimen on its way to its report.
 *
 * Three kinds of specimen meet here, and end in the same report:
 *
 *     sections:  panels -> poses -> density stack -> common scale -> analysis -> report
 *     volume:    voxels -> analysis -> report
 *     tile:      picture -> dyes -> collagen map -> report
 *
 * A stage that fails for what the specimen is (too few marks, too little of the region seen, a
 * stain that cannot be read) does not end the run: its sentence becomes the reason why the report
 * has no figure. A stage that fails for the machine (memory, disk, a process) ends it. The caller
 * brings bytes and rows and keeps the result: this file knows no store. Each named region is the
 * same specimen once more with that region alone, so its figures are those of a job that has no
 * other.
 *
 * Each part of the report fills its records of struct gsn_report and adds warnings: sections and
 * registration (report_sections.c), figures and parameters (report_figures.c), stain
 * (report_stain.c), loss (report_loss.c) and where it was lost (loss_map.c), the page of the
 * sections (glass_page.c). Then the verdict:
 * withheld with its reason, warned by the first warning, or fine; then the bytes, and the measures
 * that are kept as rows.
 *
 * Most of the time is spent in the density stack (decoding, masks) and in the fit. */
#include "pipeline/specimen/process.h"

#include "pipeline/decode/apart.h"
#include "pipeline/export/page_model.h"
#include "pipeline/model/model_file.h"
#include "pipeline/register/stack/gap_interpolation.h"
#include "pipeline/specimen/analysis.h"
#include "pipeline/specimen/reconstruction.h"
#include "pipeline/specimen/region.h"
#include "pipeline/specimen/report_builder.h"
#include "pipeline/specimen/tile.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/hue_distribution.h"
#include "pipeline/stain/normalisation.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- the report: order of its parts, verdict, bytes ------------------------------------------ */

static void fill_head(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    static const enum gsn_report_kind kinds[] = { [GSN_KIND_SECTIONS] = GSN_REPORT_SPECIMEN,
                                                  [GSN_KIND_VOLUME] = GSN_REPORT_VOLUME,
                                                  [GSN_KIND_TILE] = GSN_REPORT_TILE };
    const struct gsn_protocol *p = e->specimen->protocol;
    struct gsn_report *r = &d->report;

    r->specimen = e->specimen->part
                      ? gsn_builder_say(d, "%s, region %s", p->specimen, e->specimen->part)
                      : p->specimen;
    r->study = p->study;
    r->group = p->group;
    r->animal = p->animal;
    r->week = isnan(p->week) ? "" : gsn_builder_say(d, "%g", p->week);
    r->kind = kinds[p->kind];
    r->baseline = p->baseline;
    r->baseline_page = e->specimen->baseline.page;
    r->loss_percent = r->loss_points = r->baseline_mean = r->zero_density = NAN;
    r->area_figure = (struct gsn_report_value){ .value = NAN };
    r->region =
        (struct gsn_report_region){ .volume_mm3 = NAN, .mean_density = NAN, .coverage = NAN };
    r->version = GSN_VERSION;
    r->key = e->specimen->key;
    for (size_t i = 0; i < e->specimen->input_count; i++)
        d->input[i] = (struct gsn_report_input){ .name = e->specimen->input[i].name,
                                                 .sha256 = e->specimen->input[i].sha256,
                                                 .size = e->specimen->input[i].size };
    r->inputs = d->input;
    r->input_count = e->specimen->input_count;
}

/* Each named region as its own report has it, and where that has no figure. */
static void fill_named(const struct gsn_report_inputs *e, const struct gsn_specimen_result *result,
                       struct gsn_builder *d)
{
    for (size_t i = 0; i < result->part_count; i++) {
        const struct gsn_specimen_result *part = result->part[i];
        const char *name = e->specimen->protocol->named[i].name;
        const struct gsn_specimen_measure *loss = NULL;

        d->named[i] = (struct gsn_report_named){
            .name = name,
            .region = { .volume_mm3 = gsn_specimen_result_measure(part, "region_volume", NULL),
                        .mean_density = gsn_specimen_result_measure(part, "mean_density", NULL),
                        .coverage = gsn_specimen_result_measure(part, "coverage", NULL),
                        .description = part->region },
            .density_error = gsn_specimen_result_measure(part, "mean_density_error", NULL),
            .loss_percent = gsn_specimen_result_measure(part, "loss", &loss),
            .loss_points = gsn_specimen_result_measure(part, "loss_points", NULL),
            .loss_lower = loss ? loss->lower : (double)NAN,
            .loss_upper = loss ? loss->upper : (double)NAN,
            .loss_interval = part->loss_interval,
            .loss_reason = part->loss_reason,
            .baseline_mean = part->baseline_mean,
            .baseline_volume_mm3 = part->baseline_volume_mm3,
            .verdict_reason = part->withheld ? part->message : NULL,
            .warnings = part->warning_count,
            .page = gsn_builder_say(d, "region-%s.html", name),
        };
        if (part->withheld)
            gsn_builder_warn(d, gsn_builder_say(d, "region %s: %s", name, part->message));
    }
    d->report.named = d->named;
    d->report.named_count = result->part_count;
}

static void judge_verdict(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    struct gsn_report *r = &d->report;
    const int stated = e->specimen->baseline.name[0] != '\0';

    r->warnings = d->warning;
    r->warning_count = d->warning_count;
    r->exclusions = d->exclusion;
    r->exclusion_count = d->exclusion_count;
    r->measures = d->measure;
    r->verdict = GSN_REPORT_FINE;
    r->verdict_reason = "";
    if (e->withheld) {
        r->verdict = GSN_REPORT_WITHHELD;
        r->verdict_reason = gsn_builder_withheld(e, d);
    } else if (stated && isnan(r->loss_percent)) {
        r->verdict = GSN_REPORT_WITHHELD;
        r->verdict_reason = r->loss_reason;
    } else if (d->warning_count > 0) {
        r->verdict = GSN_REPORT_WARNED;
        r->verdict_reason = d->warning[0];
    }
    /* The same words in the report and in the run's row. */
    if (strlen(r->verdict_reason) >= sizeof((struct gsn_specimen_result *)NULL)->message)
        r->verdict_reason = gsn_builder_say(
            d, "%.*s...", (int)sizeof((struct gsn_specimen_result *)NULL)->message - 4,
            r->verdict_reason);
}

static void measure_row(struct gsn_specimen_result *result, const char *name, double value,
                        double lower, double upper, const char *unit)
{
    if (result->measure_count < GSN_SPECIMEN_MEASURES && !isnan(value))
        result->measure[result->measure_count++] = (struct gsn_specimen_measure){
            .name = name, .value = value, .lower = lower, .upper = upper, .unit = unit
        };
}

/* What others need that have this specimen for their baseline. */
static void keep_tissues(const struct gsn_control_tissues *tissues,
                         struct gsn_specimen_result *result)
{
    for (unsigned t = 0; t < GSN_CONTROL_TISSUES; t++) {
        const double value = tissues->value[t], error = gsn_control_tissue_error(tissues, t);

        measure_row(result, gsn_specimen_tissue_measure(t), value, value - 1.96 * error,
                    value + 1.96 * error, "density");
        for (unsigned u = 0; u < t; u++)
            measure_row(result, gsn_specimen_tissues_measure(t, u), tissues->covariance[t][u], NAN,
                        NAN, "density^2");
    }
}

static void keep_measures(const struct gsn_report_inputs *e, const struct gsn_builder *d,
                          struct gsn_specimen_result *result)
{
    static const char *const volumes[GSN_ANALYSIS_THRESHOLDS] = {
        "volume_above_1", "volume_above_2", "volume_above_3", "volume_above_4",
        "volume_above_5", "volume_above_6", "volume_above_7", "volume_above_8"
    };
    const struct gsn_report *r = &d->report;

    measure_row(result, "mean_density", r->region.mean_density, NAN, NAN, "density");
    measure_row(result, "region_volume", r->region.volume_mm3, NAN, NAN, "mm3");
    measure_row(result, "coverage", r->region.coverage, NAN, NAN, "");
    measure_row(result, "known", e->analysis ? e->analysis->coverage : NAN, NAN, NAN, "");
    if (gsn_builder_density_error(e) > 0)
        measure_row(result, "mean_density_error", gsn_builder_density_error(e), NAN, NAN,
                    "density");
    if (gsn_builder_own_scale_error(e) > 0)
        measure_row(result, "own_scale_error", gsn_builder_own_scale_error(e), NAN, NAN, "density");
    if (e->analysis && isfinite(e->analysis->section_error))
        measure_row(result, "section_error", e->analysis->section_error, NAN, NAN, "density");
    if (e->analysis && isfinite(e->analysis->plane_error))
        measure_row(result, "plane_error", e->analysis->plane_error, NAN, NAN, "density");
    if (e->reconstruction && e->analysis) {
        const struct gsn_vector_scatter *turns = &e->reconstruction->scale.levelling.turns;

        keep_tissues(&e->reconstruction->scale.levelling.tissues, result);
        if (turns->freedom > 0) {
            measure_row(result, "vector_turns", turns->variance, NAN, NAN, "rad^2");
            measure_row(result, "vector_turns_freedom", turns->freedom, NAN, NAN, "");
        }
    }
    measure_row(result, "loss", r->loss_percent, r->loss_lower, r->loss_upper, "%");
    measure_row(result, "loss_points", r->loss_points, NAN, NAN, "points");
    if (e->tile && e->tile->compared)
        measure_row(result, "dice", e->tile->overlap.dice, NAN, NAN, "");
    for (size_t i = 0; i < r->volume_count; i++)
        measure_row(result, volumes[i], 0.5 * (r->volumes[i].lower_mm3 + r->volumes[i].upper_mm3),
                    r->volumes[i].lower_mm3, r->volumes[i].upper_mm3, "mm3");
    if (r->registration)
        measure_row(result, "fle", r->registration->fle_um, NAN, NAN, "um");
}

static int write_report(const struct gsn_report_inputs *e, struct gsn_builder *d,
                        struct gsn_specimen_result *result, struct gsn_error *err)
{
    const struct gsn_report *r = &d->report;
    int code;

    if (d->out_of_memory)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the texts of a report");
    code = gsn_report_json(r, &result->json, &result->json_size, err);
    if (code >= 0)
        code = gsn_report_html(r, &result->html, &result->html_size, err);
    if (code < 0)
        return code;
    result->withheld = r->verdict == GSN_REPORT_WITHHELD;
    (void)snprintf(result->message, sizeof result->message, "%s", r->verdict_reason);
    (void)snprintf(result->definition, sizeof result->definition, "%s", r->density_name);
    (void)snprintf(result->dyes, sizeof result->dyes, "%s", r->density_version);
    (void)snprintf(result->region, sizeof result->region, "%s",
                   r->region.description ? r->region.description : "");
    (void)snprintf(result->loss_reason, sizeof result->loss_reason, "%s",
                   r->loss_reason ? r->loss_reason : "");
    result->loss_interval = r->loss_interval;
    result->baseline_mean = r->baseline_mean;
    result->baseline_volume_mm3 = r->baseline_volume_mm3;
    result->warning_count = r->warning_count;
    keep_measures(e, d, result);
    return GSN_OK;
}

/* The page on paper, which names the other files beside the report. */
static int add_pdf(const struct gsn_builder *d, struct gsn_specimen_result *result,
                   struct gsn_error *err)
{
    struct gsn_specimen_file *const file = &result->file[result->file_count];
    int r;

    assert(result->file_count < GSN_SPECIMEN_FILES);
    if (d->out_of_memory)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the texts of a report");
    r = gsn_report_pdf(&d->report, &file->bytes, &file->size, err);
    if (r < 0)
        return r;
    (void)snprintf(file->name, sizeof file->name, "report.pdf");
    result->file_count++;
    return GSN_OK;
}

/* What is kept as a file beside the report. */
static int fill_outputs(const struct gsn_specimen_result *result, struct gsn_builder *d,
                        struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < result->file_count; i++) {
        r = gsn_sha256(result->file[i].bytes, result->file[i].size, &d->output_is[i], err);
        d->output[i] = (struct gsn_report_input){ .name = result->file[i].name,
                                                  .sha256 = d->output_is[i].hex,
                                                  .size = result->file[i].size };
    }
    d->report.outputs = d->output;
    d->report.output_count = result->file_count;
    return r;
}

int gsn_report_build(const struct gsn_report_inputs *e, struct gsn_specimen_result *result,
                     struct gsn_error *err)
{
    struct gsn_builder d;
    int r = gsn_builder_init(&d, e->reconstruction ? e->reconstruction->poses.section_count : 0,
                             e->reconstruction ? e->reconstruction->densities.panel_count : 0,
                             e->specimen->input_count, e->specimen->decision_count, err);

    if (r < 0)
        return r;
    fill_head(e, &d);
    if (e->reconstruction) {
        gsn_builder_sections(e, &d);
        gsn_builder_choices(e, &d);
    }
    if (e->analysis) {
        gsn_builder_figures(e, &d);
        gsn_builder_bridge(e, &d);
        gsn_builder_find_link(e, &d);
        gsn_builder_evenness(e, &d);
        gsn_builder_compression(e, &d);
        if (d.linked)
            gsn_builder_link(e, &d);
    }
    if (e->tile)
        gsn_builder_tile(e, &d);
    gsn_builder_definition(e, &d);
    if (e->specimen->protocol->kind == GSN_KIND_SECTIONS || e->specimen->baseline.name[0])
        gsn_builder_loss(e, &d);
    if (e->analysis)
        gsn_builder_check_volumes(e, &d);
    gsn_builder_vectors(e, &d);
    gsn_builder_parameters(e, &d);
    fill_named(e, result, &d);
    judge_verdict(e, &d);
    if (e->analysis && e->region)
        r = gsn_builder_loss_map(e, &d, result, err);
    if (r >= 0 && e->reconstruction && !e->specimen->part)
        r = gsn_builder_glass(e, &d, result, err);
    if (r >= 0)
        r = fill_outputs(result, &d, err);
    if (r >= 0 && !e->specimen->part)
        r = add_pdf(&d, result, err);
    if (r >= 0)
        r = fill_outputs(result, &d, err);
    if (r >= 0)
        r = write_report(e, &d, result, err);
    gsn_builder_done(&d);
    return r;
}

/* ---- from the inputs to the report ----------------------------------------------------------- */

/* What speaks of the inputs, not of the machine: the report is made all the same, without the
 * figure and with the sentence. */
static int is_about_inputs(int code)
{
    return code == GSN_E_WITHHELD || code == GSN_E_STAIN || code == GSN_E_MARKERS ||
           code == GSN_E_INPUT || code == GSN_E_UNSUPPORTED || code == GSN_E_LIMIT;
}

static int keep_poses(const struct gsn_reconstruction *a, struct gsn_specimen_result *result,
                      struct gsn_error *err)
{
    result->pose = gsn_alloc_array(a->poses.section_count, sizeof *result->pose);
    result->stain = gsn_alloc_array(a->densities.panel_count, sizeof *result->stain);
    result->candidates = gsn_alloc_array(a->poses.section_count, sizeof *result->candidates);
    if (!result->pose || !result->stain || !result->candidates)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a specimen");
    for (size_t i = 0; i < a->poses.section_count; i++)
        if (a->poses.section[i].posed)
            result->pose[result->pose_count++] =
                (struct gsn_specimen_pose){ .panel = a->poses.section[i].panel,
                                            .slot = a->poses.section[i].seen.slot,
                                            .serial = a->poses.section[i].seen.serial,
                                            .pose = a->poses.section[i].pose };
    for (size_t i = 0; i < a->poses.section_count; i++)
        if (a->poses.section[i].candidates.count > 0)
            result->candidates[result->candidates_count++] =
                (struct gsn_specimen_candidates){ .panel = a->poses.section[i].panel,
                                                  .slot = a->poses.section[i].seen.slot,
                                                  .list = a->poses.section[i].candidates };
    for (size_t i = 0; i < a->densities.panel_count; i++)
        if (a->densities.panel[i].opened)
            result->stain[result->stain_count++] = a->densities.panel[i].stain;
    return GSN_OK;
}

/* Makes room for one more file; the caller fills in its bytes. */
static struct gsn_specimen_file *add_file(struct gsn_specimen_result *result, const char *name)
{
    (void)snprintf(result->file[result->file_count].name, sizeof result->file[0].name, "%s", name);
    return &result->file[result->file_count++];
}

static int keep_colour(const struct gsn_reconstruction *a, struct gsn_specimen_result *result,
                       struct gsn_error *err)
{
    struct gsn_specimen_file *file = add_file(result, "colour.nrrd");

    return gsn_colour_grid_nrrd(a->densities.colour, &file->bytes, &file->size, err);
}

/* What the model's file says of each tetrahedron: the analysis's units, one array a figure. */
static int list_cells(const struct gsn_analysis *analysis, size_t tets, double **ret_density,
                      double **ret_share, struct gsn_error *err)
{
    gsn_auto_mem(double) density = gsn_alloc_array(tets, sizeof *density);
    gsn_auto_mem(double) share = gsn_alloc_array(tets, sizeof *share);

    if (!density || !share)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a model of %zu tetrahedra", tets);
    for (size_t t = 0; t < tets; t++) {
        density[t] = analysis->units[t].mean;
        share[t] = analysis->units[t].inside_share;
    }
    *ret_density = gsn_steal(&density);
    *ret_share = gsn_steal(&share);
    return GSN_OK;
}

/* For the viewer in the report; none where no cell has tissue, or it cannot be made so small. */
static int pack_model(const struct gsn_analysis *analysis, const struct gsn_spline *const *colour,
                      const struct gsn_model_cells *cells, const struct gsn_mask *region,
                      unsigned threads, struct gsn_page_model **ret_page, struct gsn_error *err)
{
    const struct gsn_page_options options = { .region = region,
                                              .low = analysis->low,
                                              .high = analysis->high,
                                              .colour = colour,
                                              .most_bytes = GSN_PAGE_BYTES };
    gsn_auto(gsn_page_model) page = NULL;
    const int r = gsn_page_model_new(analysis->spline, cells, &options, threads, &page, err);

    if (r == GSN_E_LIMIT)
        return GSN_OK;
    if (r >= 0 && page->cells > 0)
        *ret_page = gsn_steal(&page);
    return r;
}

/* The fitted spline as a file, and packed for the report; nothing where there is no fit. */
static int keep_model(const struct gsn_analysis *analysis, const struct gsn_mask *region,
                      const struct gsn_specimen *specimen, unsigned threads,
                      struct gsn_specimen_result *result, struct gsn_page_model **ret_page,
                      struct gsn_error *err)
{
    gsn_auto_mem(double) density = NULL;
    gsn_auto_mem(double) share = NULL;
    gsn_auto_mem(char) parameters = NULL;
    const struct gsn_spline *const *colour;
    struct gsn_model_cells cells;
    struct gsn_specimen_file *file;
    int r;

    if (!analysis)
        return GSN_OK;
    colour = analysis->colour[0] ? (const struct gsn_spline *const *)analysis->colour : NULL;
    r = list_cells(analysis, gsn_dms_mesh(analysis->space)->tet_count, &density, &share, err);
    if (r < 0)
        return r;
    cells = (struct gsn_model_cells){ .density = density,
                                      .inside_share = share,
                                      .residual = analysis->fit.tet_rms,
                                      .samples = analysis->fit.tet_samples };
    r = pack_model(analysis, colour, &cells, region, threads, ret_page, err);
    if (r < 0 || specimen->part)
        return r;
    parameters = gsn_format("{\"key\": \"%s\", \"tolerance\": %.9g, \"smoothing\": %.9g, "
                            "\"rms_residual\": %.9g}",
                            specimen->key, analysis->tolerance, analysis->fit.fit.jump,
                            analysis->fit.fit.rms);
    if (!parameters)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the model's parameters");
    file = add_file(result, "model.vtkhdf");
    return gsn_model_file_write(analysis->spline, colour, &cells, region,
                                &(struct gsn_model_notes){ .name = specimen->protocol->specimen,
                                                           .parameters = parameters,
                                                           .version = GSN_VERSION },
                                &file->bytes, &file->size, err);
}

static struct gsn_analysis_options analysis_options(const struct gsn_specimen_options *options)
{
    return (struct gsn_analysis_options){ .mesher = options->mesher,
                                          .threads = options->threads,
                                          .progress = options->progress };
}

/* Makes the analysis, or says in why what stands against it. */
static int try_analysis(const struct gsn_grid *grid, const struct gsn_mask *region,
                        const struct gsn_specimen *specimen, const struct gsn_analysis_options *how,
                        struct gsn_analysis **ret_analysis, struct gsn_error *why,
                        struct gsn_error *err)
{
    const int r = gsn_analyse(grid, region, specimen->protocol, how, ret_analysis, why);

    if (r < 0 && !is_about_inputs(r)) {
        if (err)
            *err = *why;
        return r;
    }
    return GSN_OK;
}

static int copy_grid(const struct gsn_grid *grid, struct gsn_grid **ret_copy, struct gsn_error *err)
{
    const int r = gsn_grid_new(&grid->at, ret_copy, err);

    if (r >= 0)
        memcpy((*ret_copy)->value, grid->value, gsn_lattice_count(&grid->at) * sizeof *grid->value);
    return r;
}

/* The analysis of a stack whose short gaps are bridged; the cuts show it as it is. */
static int analyse_stack(const struct gsn_reconstruction *stack,
                         const struct gsn_specimen *specimen,
                         const struct gsn_specimen_options *options,
                         struct gsn_analysis **ret_analysis,
                         struct gsn_gap_interpolation *ret_bridge, struct gsn_error *why,
                         struct gsn_error *err)
{
    struct gsn_analysis_options how = analysis_options(options);
    struct gsn_batch_calibration link;
    gsn_auto(gsn_grid) bridged = NULL;
    int r = copy_grid(stack->densities.grid, &bridged, err);

    if (r >= 0)
        r = gsn_gap_interpolate(bridged, stack->region, ret_bridge, err);
    if (r < 0)
        return r;
    how.shown = stack->densities.grid;
    how.colour = stack->densities.colour;
    if (gsn_stain_link(specimen, &stack->scale, &link, NULL) >= 0)
        how.scale = (struct gsn_gain_offset){ link.gain, link.offset };
    return try_analysis(bridged, stack->region, specimen, &how, ret_analysis, why, err);
}

/* Marks whose places in the block nobody stated lie in a frame of their own: its origin and its
 * turn follow from the mounting, and a region of the block lies anywhere in it. By tissue alone the
 * job states the frame's section. */
static int check_frame(const struct gsn_specimen *specimen, const struct gsn_reconstruction *a,
                       struct gsn_error *why)
{
    const struct gsn_protocol *p = specimen->protocol;
    const struct gsn_point *t = a->poses.summary.mean_triangle;
    char unknown[120] = "";

    if (p->has_markers || a->poses.by_tissue.done || !a->poses.solved ||
        !(gsn_region_has_coordinates(&p->region) ||
          gsn_region_has_coordinates(&p->reference_tissue) ||
          gsn_region_has_coordinates(&p->collagen_free)))
        return GSN_OK;
    if (p->unknown)
        (void)snprintf(unknown, sizeof unknown, "; it has keys that are not used: %.80s",
                       p->unknown);
    return gsn_fail(why, GSN_E_WITHHELD,
                    "the region is stated in the block frame, but \"markers_um\" is not stated in "
                    "job.json%s: where the region lies is not known. State where the three marks "
                    "lie in the block; a region that was drawn on this stack has them at "
                    "[[%.0f, %.0f], [%.0f, %.0f], [%.0f, %.0f]]",
                    unknown, t[0].x, t[0].y, t[1].x, t[1].y, t[2].x, t[2].y);
}

/* What specimens that have this one for their baseline need beside its figures. */
static void keep_control(struct gsn_reconstruction *a, struct gsn_specimen_result *result)
{
    result->colours.tissues = a->scale.levelling.tissues;
    memcpy(result->colours.yellow, a->scale.levelling.yellow, sizeof result->colours.yellow);
    memcpy(result->colours.region_od, a->scale.region_od, sizeof result->colours.region_od);
    memcpy(result->colours.free_od, a->scale.free_od, sizeof result->colours.free_od);
    result->colours.free_panels = a->scale.free_panels;
    result->colours.cloud = gsn_steal(&a->scale.cloud);
}

static int process_sections(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options,
                            struct gsn_specimen_result *result, struct gsn_error *err)
{
    gsn_auto(gsn_reconstruction) stack = NULL;
    gsn_auto(gsn_analysis) analysis = NULL;
    gsn_auto(gsn_page_model) page = NULL;
    struct gsn_error why = { 0 };
    struct gsn_report_inputs inputs = { .specimen = specimen };
    int r = gsn_reconstruct(specimen, options, &stack, &why);

    gsn_decoder_rest(options->decoder);

    if (r < 0 && !is_about_inputs(r)) {
        if (err)
            *err = why;
        return r;
    }
    if (r >= 0)
        r = check_frame(specimen, stack, &why);
    if (r >= 0 && stack->densities.misordered[0])
        r = gsn_fail(&why, GSN_E_WITHHELD, "%s", stack->densities.misordered);
    if (r >= 0 && stack->densities.grid)
        r = analyse_stack(stack, specimen, options, &analysis, &inputs.bridge, &why, err);
    else if (r >= 0 && !stack->poses.solved)
        (void)gsn_fail(&why, GSN_E_WITHHELD, "%s", stack->poses.unsolved);
    else if (r >= 0 && stack->no_region[0])
        (void)gsn_fail(&why, GSN_E_WITHHELD, "%s", stack->no_region);
    else if (r >= 0)
        (void)gsn_fail(&why, GSN_E_WITHHELD,
                       "no region of interest is stated: add \"region\" to job.json");
    if (r < 0 && !is_about_inputs(r))
        return r;
    if (stack && (r = keep_poses(stack, result, err)) < 0)
        return r;
    if (stack && stack->densities.grid && !specimen->part &&
        (r = keep_colour(stack, result, err)) < 0)
        return r;
    r = keep_model(analysis, stack ? stack->region : NULL, specimen, options->threads, result,
                   &page, err);
    if (r < 0)
        return r;
    inputs.reconstruction = stack;
    inputs.analysis = analysis;
    inputs.region = stack ? stack->region : NULL;
    inputs.threads = options->threads;
    inputs.page = page;
    inputs.withheld = analysis ? NULL : why.text;
    gsn_progress_say(options->progress, "report", 0, 1);
    r = gsn_report_build(&inputs, result, err);
    if (r >= 0 && stack)
        keep_control(stack, result);
    return r;
}

/* The whole volume, where no region is stated. */
static int mask_whole_volume(const struct gsn_grid *volume, struct gsn_mask **ret_mask,
                             struct gsn_error *err)
{
    const int r = gsn_mask_new(&volume->at, ret_mask, err);

    if (r >= 0)
        memset((*ret_mask)->inside, 1, gsn_lattice_count(&volume->at));
    return r;
}

static int process_volume(const struct gsn_specimen *specimen,
                          const struct gsn_specimen_options *options,
                          struct gsn_specimen_result *result, struct gsn_error *err)
{
    const struct gsn_analysis_options how = analysis_options(options);
    gsn_auto(gsn_mask) made = NULL;
    gsn_auto(gsn_analysis) analysis = NULL;
    gsn_auto(gsn_page_model) page = NULL;
    struct gsn_error why = { 0 };
    struct gsn_report_inputs inputs = { .specimen = specimen };
    int r = GSN_OK;

    if (specimen->protocol->region.kind == GSN_REGION_BAND)
        r = gsn_band_region(&specimen->protocol->region, specimen->region, specimen->volume,
                            options->threads, &made, &why);
    else if (specimen->protocol->region.kind > GSN_REGION_MASK)
        r = gsn_region_raster(&specimen->protocol->region, &specimen->volume->at, &made, &why);
    else if (!specimen->region)
        r = mask_whole_volume(specimen->volume, &made, &why);
    if (r < 0 && !is_about_inputs(r)) {
        if (err)
            *err = why;
        return r;
    }
    if (r >= 0)
        r = try_analysis(specimen->volume, made ? made : specimen->region, specimen, &how,
                         &analysis, &why, err);
    if (r < 0 && !is_about_inputs(r))
        return r;
    r = keep_model(analysis, made ? made : specimen->region, specimen, options->threads, result,
                   &page, err);
    if (r < 0)
        return r;
    inputs.analysis = analysis;
    inputs.region = made ? made : specimen->region;
    inputs.threads = options->threads;
    inputs.page = page;
    inputs.withheld = analysis ? NULL : why.text;
    return gsn_report_build(&inputs, result, err);
}

static int process_tile(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options,
                        struct gsn_specimen_result *result, struct gsn_error *err)
{
    gsn_auto(gsn_tile) tile = NULL;
    struct gsn_error why = { 0 };
    struct gsn_report_inputs inputs = { .specimen = specimen };
    const int r = gsn_tile_process(specimen, options, &tile, &why);

    if (r < 0 && !is_about_inputs(r)) {
        if (err)
            *err = why;
        return r;
    }
    inputs.tile = tile;
    inputs.withheld = tile ? NULL : why.text;
    return gsn_report_build(&inputs, result, err);
}

static int process_named(const struct gsn_specimen *specimen,
                         const struct gsn_specimen_options *options, size_t number,
                         struct gsn_specimen_result *result, struct gsn_error *err)
{
    const struct gsn_protocol_region *named = &specimen->protocol->named[number];
    struct gsn_protocol protocol = *specimen->protocol;
    struct gsn_specimen alone = *specimen;
    gsn_auto(gsn_specimen_result) part = NULL;
    char name[sizeof result->file[0].name];
    struct gsn_specimen_file *file;
    int r;

    protocol.region = named->region;
    protocol.named_count = 0;
    alone.protocol = &protocol;
    alone.part = named->name;
    alone.region = specimen->named[number].mask;
    alone.region_drawn = specimen->named[number].drawn;
    alone.baseline = specimen->named[number].baseline;
    r = gsn_specimen_process(&alone, options, &part, err);
    if (r < 0)
        return r;
    (void)snprintf(name, sizeof name, "region-%s.html", named->name);
    file = add_file(result, name);
    file->bytes = (uint8_t *)gsn_steal(&part->html);
    file->size = part->html_size;
    (void)snprintf(name, sizeof name, "region-%s.json", named->name);
    file = add_file(result, name);
    file->bytes = (uint8_t *)gsn_steal(&part->json);
    file->size = part->json_size;
    (void)snprintf(part->name, sizeof part->name, "%s", named->name);
    result->part[result->part_count++] = gsn_steal(&part);
    return GSN_OK;
}

int gsn_specimen_process(const struct gsn_specimen *specimen,
                         const struct gsn_specimen_options *options,
                         struct gsn_specimen_result **ret_result, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_result) result = gsn_alloc_array(1, sizeof *result);
    int r = GSN_OK;

    if (!result)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the result of a specimen");
    for (size_t i = 0; r >= 0 && i < specimen->protocol->named_count; i++)
        r = process_named(specimen, options, i, result, err);
    if (r < 0)
        return r;
    switch (specimen->protocol->kind) {
    case GSN_KIND_VOLUME:
        r = process_volume(specimen, options, result, err);
        break;
    case GSN_KIND_TILE:
        r = process_tile(specimen, options, result, err);
        break;
    default:
        r = process_sections(specimen, options, result, err);
    }
    if (r < 0)
        return r;
    *ret_result = gsn_steal(&result);
    return GSN_OK;
}
