/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The report's figures, and the parameters that they rest on.
 *
 * Region, volumes above a density, MicroUnits, fit and pictures of an analysis; the share that was
 * bridged between sections; the figures of a tile, each with what it would be if its white, its
 * detail or its dye vectors were otherwise. Volumes are withheld where they cannot be brought to
 * the baseline's scale. Parameters are told as measured, as stated or as assumed. */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/register/order/sequence.h"
#include "pipeline/register/stack/gap_interpolation.h"
#include "pipeline/specimen/section_order.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_sample.h"
#include "pipeline/stain/staining_uniformity.h"
#include "pipeline/stain/tissue_segmentation.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* More bridged than this is said in the verdict; less are the halos and dust of every stack. */
static const double BRIDGED_UNSAID = 0.02;

/* What the model's tetrahedra follow. */
static const char *name_mesh(const struct gsn_analysis *analysis)
{
    switch (analysis->domain.kind) {
    case GSN_DOMAIN_WALLS:
        return "layers along the walls of the density";
    case GSN_DOMAIN_RIM:
        return "the region's rim; no wall is sharp";
    default:
        return "cubes; the mesher refused layers along the walls";
    }
}

static void fill_fit(const struct gsn_analysis *analysis, struct gsn_builder *d)
{
    const struct gsn_fit_report *fit = &analysis->fit.fit;
    const size_t tets = gsn_dms_mesh(analysis->space)->tet_count;

    d->fit = (struct gsn_report_fit){ .tets = tets,
                                      .unknowns = fit->unknowns,
                                      .samples = fit->samples,
                                      .empty_tets = fit->empty_tets,
                                      .tets_in_tolerance =
                                          tets - fit->empty_tets - analysis->over_tolerance,
                                      .rms = fit->rms,
                                      .worst = fit->worst,
                                      .smoothing = fit->jump,
                                      .tolerance = analysis->tolerance,
                                      .degree = gsn_dms_degree(analysis->space) };
    d->report.fit = &d->fit;
    if (analysis->domain.kind == GSN_DOMAIN_CUBES)
        gsn_builder_warn(d,
                         gsn_builder_say(d,
                                         "the model's mesh does not follow walls, and is coarser "
                                         "there: %s",
                                         analysis->domain.why.text));
    if (fit->outside > 0)
        gsn_builder_warn(d, gsn_builder_say(d,
                                            "%zu of %zu voxels of the region lie outside the "
                                            "model's mesh and are not in it",
                                            fit->outside, fit->samples + fit->outside));
    if (fit->unconverged)
        gsn_builder_warn(d, gsn_builder_say(d,
                                            "the solver of the model's equations was stopped after "
                                            "%u steps: the model is less smooth and less exact "
                                            "than it could be (voxels much longer one way than "
                                            "another are the usual cause)",
                                            fit->iterations));
    d->units = (struct gsn_report_units){ .first = analysis->summary.low,
                                          .last = analysis->summary.high,
                                          .bin = analysis->summary.bin,
                                          .bin_count = GSN_UNIT_BINS,
                                          .smallest = analysis->summary.min,
                                          .median = analysis->summary.median,
                                          .largest = analysis->summary.max };
    d->report.units = &d->units;
}

/* Volumes above a density are compared with the baseline's: on one scale, or not at all. Where the
 * dyes were measured the scale is theirs, as it is for the loss. */
void gsn_builder_check_volumes(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_protocol *p = e->specimen->protocol;
    const struct gsn_reconstruction *a = e->reconstruction;

    if (!a || e->specimen->baseline.specimens == 0 || d->linked ||
        !(d->by_colours || d->report.loss_reason) || a->scale.by_standards ||
        (p->reference_tissue.kind != GSN_REGION_NONE && !a->scale.not_comparable[0]))
        return;
    d->report.volume_count = 0;
    gsn_builder_warn(d,
                     gsn_builder_say(d,
                                     "volumes above a density are withheld: too little untreated "
                                     "tissue is alike in this specimen and in %s to bring them to "
                                     "its scale; state \"reference\" in both jobs, or scan a "
                                     "calibration panel with standards",
                                     e->specimen->baseline.name));
}

/* Of the model and of the tissue; the latter only where sections are independent draws of it. */
static struct gsn_report_volume describe_volume(const struct gsn_analysis *analysis, size_t i)
{
    const struct gsn_volume_bound *const bound = &analysis->bound[i];
    const struct gsn_tissue_volume *const tissue = &analysis->tissue.volume[i];
    const int given = analysis->tissue.sigma_z_um > 0 && !analysis->tissue.withheld;

    return (struct gsn_report_volume){
        .threshold = bound->threshold,
        .lower_mm3 = 1e-9 * bound->lower_um3,
        .upper_mm3 = 1e-9 * bound->upper_um3,
        .estimate_mm3 = given ? 1e-9 * tissue->estimate_um3 : (double)NAN,
        .interval_lower_mm3 = given ? 1e-9 * tissue->lower_um3 : (double)NAN,
        .interval_upper_mm3 = given ? 1e-9 * tissue->upper_um3 : (double)NAN,
    };
}

/* As the table of volumes has it: of the tissue, else of the model. */
static double volume_of(const struct gsn_report_volume *volume)
{
    return isfinite(volume->estimate_mm3) ? volume->estimate_mm3
                                          : (volume->lower_mm3 + volume->upper_mm3) / 2;
}

/* Under the names and in the units of ASBMR. The share of the region is that of the table of
 * volumes: one quantity, one number. */
static void add_bone(const struct gsn_analysis *analysis, struct gsn_builder *d)
{
    const struct gsn_bone *const b = &analysis->bone;
    const double share = volume_of(&d->volume[analysis->bound_count / 2]) /
                         d->report.region.volume_mm3;
    const char *row_name;
    const struct {
        const char *name;
        double value;
        const char *unit;
    } row[] = { { "BV/TV", 100 * share, "%" },
                { "BS/BV", 1e3 * b->surface_um2 / b->bone_um3, "mm2/mm3" },
                { "Tb.Th", 1e-3 * b->thickness_um, "mm" },
                { "Tb.Th, standard deviation", 1e-3 * b->thickness_sd, "mm" },
                { "Tb.Th, largest", 1e-3 * b->thickness_most, "mm" },
                { "Components", (double)b->components, "" },
                { "Euler number", (double)b->euler, "" } };

    for (size_t i = 0; i < sizeof row / sizeof row[0]; i++)
        gsn_builder_value(d->measure, &d->report.measure_count,
                          gsn_builder_say(d, "%s, of what is denser than %.4g", row[i].name,
                                          analysis->above_threshold),
                          row[i].value, row[i].unit);
    /* Tunnels are counted in one piece: pieces and cavities would be taken off them. */
    row_name = gsn_builder_say(d, "Conn.D, of what is denser than %.4g", analysis->above_threshold);
    if (b->components == 1)
        gsn_builder_value(d->measure, &d->report.measure_count, row_name,
                          (double)(1 - b->euler) / (1e-9 * b->tissue_um3), "1/mm3");
    else
        gsn_builder_text(d->measure, &d->report.measure_count, row_name,
                         gsn_builder_say(d, "withheld: it is of one connected piece, and there are "
                                            "%zu", b->components));
}

void gsn_builder_figures(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_analysis *analysis = e->analysis;
    char rule[200];
    struct gsn_report *r = &d->report;

    gsn_region_describe(&e->specimen->protocol->region, rule, sizeof rule);
    r->region = (struct gsn_report_region){ .volume_mm3 = 1e-9 * analysis->density.volume_um3,
                                            .mean_density = analysis->density.mean,
                                            .coverage = analysis->coverage,
                                            .description = gsn_builder_say(d, "%s", rule) };
    for (size_t i = 0; i < analysis->bound_count; i++)
        d->volume[i] = describe_volume(analysis, i);
    r->volumes = d->volume;
    r->volume_count = analysis->bound_count;
    if (analysis->tissue.withheld)
        gsn_builder_text(d->measure, &r->measure_count, "Volumes of the tissue above a density",
                         gsn_builder_say(d, "withheld: %s", analysis->tissue.withheld));
    for (size_t i = 0; i < analysis->picture_count; i++)
        d->picture[i] = (struct gsn_report_picture){
            .id = analysis->picture[i].id,
            .title = analysis->picture[i].title,
            .caption = analysis->picture[i].caption,
            .png = { analysis->picture[i].png, analysis->picture[i].size,
                     analysis->picture[i].width, analysis->picture[i].height }
        };
    r->pictures = d->picture;
    r->picture_count = analysis->picture_count;
    if (e->page) {
        d->model = (struct gsn_report_model){ .bytes = e->page->bytes,
                                              .size = e->page->size,
                                              .cells = e->page->cells,
                                              .of = e->page->of,
                                              .apart_um = e->page->apart_um,
                                              .unit = analysis->unit };
        r->model = &d->model;
    }
    r->area_figure =
        (struct gsn_report_value){ .name = gsn_builder_say(d, "share of sampled voxels above %.4g",
                                                           analysis->above_threshold),
                                   .value = 100 * analysis->above_share,
                                   .unit = "%" };
    if (isfinite(analysis->section_error))
        gsn_builder_value(d->measure, &r->measure_count,
                          "Standard error of the mean density by sections",
                          100 * analysis->section_error / analysis->density.mean, "%");
    if (analysis->has_bone && analysis->bone.components > 0)
        add_bone(analysis, d);
    else if (!analysis->has_bone)
        gsn_builder_text(d->measure, &r->measure_count, "Bone morphometry",
                         gsn_builder_say(d,
                                         "withheld: it is done in at most %d voxels, and the grid "
                                         "has more: state a smaller region, or a coarser volume",
                                         (int)GSN_BONE_VOXELS));
    gsn_builder_value(d->measure, &r->measure_count, "Micro-units, lower quartile of density",
                      analysis->summary.quartile1, "density");
    gsn_builder_value(d->measure, &r->measure_count, "Micro-units, upper quartile of density",
                      analysis->summary.quartile3, "density");
    gsn_builder_value(d->measure, &r->measure_count, "Micro-units with data",
                      (double)analysis->summary.ok, "");
    gsn_builder_value(d->measure, &r->measure_count, "Micro-units without data",
                      (double)analysis->summary.no_data, "");
    fill_fit(analysis, d);
}

/* What was measured of the region, and what was bridged. Comes after the figures. */
void gsn_builder_bridge(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_gap_interpolation *b = &e->bridge;
    struct gsn_report *r = &d->report;
    const double share = b->region > 0 ? (double)b->bridged / (double)b->region : 0;

    if (b->region == 0)
        return;
    r->region.coverage = (double)b->measured / (double)b->region;
    gsn_builder_value(d->measure, &r->measure_count, "Region bridged between sections", 100 * share,
                      "%");
    gsn_builder_value(d->measure, &r->measure_count, "Standard error of the mean from bridging",
                      b->error, "density");
    if (share > BRIDGED_UNSAID)
        gsn_builder_warn_cost(
            d, (struct gsn_builder_cost){ .points = 100 * b->error },
            gsn_builder_say(
                d,
                "%.1f %% of the region of interest was not seen and is bridged from the "
                "sections beside it, which makes the mean density uncertain by %.2g",
                100 * share, b->error));
}

/* What the figures of a tile rest on, each as measured, as stated or as assumed. */
static void tell_origin(const struct gsn_tile *t, const struct gsn_protocol *p,
                        struct gsn_builder *d)
{
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;
    const double *white = t->glass.white;
    const char *codes = gsn_builder_say(d, "%.0f, %.0f, %.0f of 255", white[0], white[1], white[2]);

    gsn_builder_text(
        rows, count, "white",
        p->has_white ? gsn_builder_say(d, "%s, as stated in job.json", codes)
        : t->by_palest
            ? gsn_builder_say(d,
                              "%s, the palest %.2g %% of the picture; assumed to be the "
                              "empty slide",
                              codes, 100 * t->palest.share)
            : gsn_builder_say(d, "%s, measured on the glass that is %.0f %% of the picture", codes,
                              100 * t->glass.fraction));
    if (t->px_um > 0)
        gsn_builder_text(rows, count, "pixel size",
                         gsn_builder_say(d, "%g um, as %s states", t->px_um,
                                         p->px_um > 0 ? "job.json" : "the file"));
    else
        gsn_builder_text(rows, count, "pixel size", "not known; no figure here needs it");
    gsn_builder_text(rows, count, "transfer curve",
                     t->light_assumed ? "sRGB, assumed: neither job.json nor the file says"
                     : p->transfer == GSN_PROTOCOL_LINEAR ? "linear, as stated in job.json"
                     : p->transfer == GSN_PROTOCOL_SRGB   ? "sRGB, as stated in job.json"
                                                          : "as the file states");
    gsn_builder_text(
        rows, count, "dye vectors",
        p->dyes == GSN_PROTOCOL_DYES_ESTIMATE
            ? gsn_builder_say(d, "%s, inferred from the picture as job.json asks", t->fit.dyes.name)
            : gsn_builder_say(d, "%s, %s, each %.1f degrees uncertain", t->fit.dyes.name,
                              p->dyes == GSN_PROTOCOL_DYES_BUILTIN ? "as stated in job.json"
                                                                   : "assumed",
                              t->fit.deviation_deg[0]));
}

static void warn_of_tile(const struct gsn_tile *t, const struct gsn_protocol *p,
                         struct gsn_builder *d)
{
    const int table = p->dyes == GSN_PROTOCOL_DYES_NONE;

    if (t->by_palest || t->light_assumed || table)
        gsn_builder_warn(
            d, gsn_builder_say(d, "assumed, because nobody stated it:%s%s%s%s%s",
                               t->by_palest ? " the palest part of the picture is the empty slide"
                                            : "",
                               t->by_palest && (t->light_assumed || table) ? ";" : "",
                               t->light_assumed ? " samples are coded as sRGB" : "",
                               t->light_assumed && table ? ";" : "",
                               table ? " the dyes are those of the built-in table" : ""));
    if (table && t->fit.apart_deg > GSN_STAIN_APART_DEG)
        gsn_builder_warn(
            d,
            gsn_builder_say(d,
                            "half of the stained pixels lie more than %.0f degrees from every "
                            "mixture of Van Gieson's dyes, as picrosirius does: the density is the "
                            "built-in table's, to be compared with pictures of this stain alone; "
                            "\"dyes\": \"estimate\" in a job.json takes the picture's own",
                            t->fit.apart_deg));
    gsn_builder_warn(d,
                     "how strongly the slide was stained one picture does not tell: a stain 20 % "
                     "stronger reads as 20 % more density and is in no interval; compare pictures "
                     "of one batch, or by the share of the red dye, which it does not change");
    if (t->by_palest && t->palest.clipped > 0.01)
        gsn_builder_warn(
            d, gsn_builder_say(d,
                               "%.0f %% of the samples that stand for white are at the "
                               "highest code: the empty slide may be brighter, expose less",
                               100 * t->palest.clipped));
    if (t->note[0])
        gsn_builder_warn(d, t->note);
}

void gsn_builder_tile(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_protocol *p = e->specimen->protocol;
    const struct gsn_tile *t = e->tile;
    const double pixels = (double)t->overlap.pixels;
    struct gsn_report_value *rows = d->measure;
    size_t *count = &d->report.measure_count;

    d->tile = (struct gsn_report_tile){
        .area_fraction = t->collagen.area_fraction,
        .mean_density = t->density.mean,
        .mean_lower = t->density.mean - 1.96 * t->density.error,
        .mean_upper = t->density.mean + 1.96 * t->density.error,
        .red_share = t->density.red_share,
        .threshold = t->collagen.threshold,
        .compared = t->compared,
        .mask_name = p->reference,
        .dice = t->compared ? t->overlap.dice : NAN,
        .map_fraction = t->compared ? (double)t->overlap.map_px / pixels : NAN,
        .mask_fraction = t->compared ? (double)t->overlap.reference_px / pixels : NAN,
        .false_positive = t->compared ? t->overlap.false_positive : NAN,
        .false_negative = t->compared ? t->overlap.false_negative : NAN,
    };
    d->report.tile = &d->tile;
    d->report.region.mean_density = t->density.mean;
    for (size_t i = 0; i < t->picture_count; i++)
        d->picture[i] =
            (struct gsn_report_picture){ .id = t->picture[i].id,
                                         .title = t->picture[i].title,
                                         .caption = t->picture[i].caption,
                                         .png = { t->picture[i].png, t->picture[i].size,
                                                  t->picture[i].width, t->picture[i].height } };
    d->report.pictures = d->picture;
    d->report.picture_count = t->picture_count;
    gsn_builder_value(rows, count, "Standard error of the mean density by white",
                      t->density.by_white, "density");
    gsn_builder_value(rows, count, "Standard error of the mean density by detail and compression",
                      t->density.by_detail, "density");
    gsn_builder_value(rows, count, "Standard error of the mean density by dye vectors",
                      t->density.by_vectors, "density");
    gsn_builder_value(rows, count, "Red dye in the tissue, mean", t->density.red,
                      "optical density");
    gsn_builder_value(rows, count, "Yellow dye in the tissue, mean", t->density.yellow,
                      "optical density");
    gsn_builder_value(rows, count, "Dark dye in the tissue, mean", t->density.dark,
                      "optical density");
    tell_origin(t, p, d);
    warn_of_tile(t, p, d);
}

/* "panel 1: 1.152 +- 0.004 (12 sections), ..." */
static const char *gains_of(const struct gsn_reconstruction *a, struct gsn_builder *d)
{
    const char *unit = a->scale.by_standards ? "standards" : "sections";
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->densities.panel_count && used < sizeof line; i++) {
        const struct gsn_stain_gain *gain = &a->scale.panel[i].gain;
        int n;

        if (!a->densities.panel[i].opened)
            continue;
        n = snprintf(line + used, sizeof line - used, "%spanel %u: %.3f +- %.3f (%u %s)",
                     used ? ", " : "", a->densities.panel[i].stain.panel, gain->gain, gain->error,
                     gain->sections, unit);
        used += n > 0 ? (size_t)n : 0;
    }
    return gsn_builder_say(d, "%s", line);
}

/* "panel 1: glass even to 0.0012, yellow to red 0.54; ..." */
static const char *light_of(const struct gsn_reconstruction *a, struct gsn_builder *d)
{
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->densities.panel_count && used < sizeof line; i++) {
        const struct gsn_stack_panel *p = &a->densities.panel[i];
        const double ratio = gsn_stain_amounts_yellow_to_red(&p->tone);
        int n;

        if (!p->opened)
            continue;
        n = snprintf(line + used, sizeof line - used, "%spanel %u: glass even to ",
                     used ? "; " : "", p->given->number);
        used += n > 0 ? (size_t)n : 0;
        if (used < sizeof line)
            n = isnan(p->lamp.residual) || isnan(ratio)
                    ? snprintf(line + used, sizeof line - used, "? (too little glass or tissue)")
                    : snprintf(line + used, sizeof line - used, "%.4f, yellow to red %.2f",
                               p->lamp.residual, ratio);
        used += n > 0 ? (size_t)n : 0;
    }
    return gsn_builder_say(d, "%s", line);
}

/* "panel 1: x 1.067, -0.004; ..." */
static const char *levels_of(const struct gsn_reconstruction *a, struct gsn_builder *d)
{
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->densities.panel_count && used < sizeof line; i++) {
        const struct gsn_panel_scale *p = &a->scale.panel[i];
        int n;

        if (!p->levelled)
            continue;
        n = snprintf(line + used, sizeof line - used, "%spanel %u: x %.3f, %+.3f", used ? "; " : "",
                     a->densities.panel[i].stain.panel, p->level.gain, p->level.offset);
        used += n > 0 ? (size_t)n : 0;
    }
    return gsn_builder_say(d, "%s", line);
}

/* "dentine 0.567 +- 0.011 (baseline 0.540); ..." */
static const char *tissues_of(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    char line[600] = "";
    size_t used = 0;

    for (size_t k = 0; k < GSN_CONTROL_KINDS && used < sizeof line; k++) {
        const struct gsn_control_tissues *tissues = &e->reconstruction->scale.levelling.tissues;
        char control[48] = "";
        int n;

        if (isnan(tissues->value[k]))
            continue;
        if (d->linked && !isnan(b->tissues.value[k]))
            (void)snprintf(control, sizeof control, " (baseline %.3f)", b->tissues.value[k]);
        n = snprintf(line + used, sizeof line - used, "%s%s %.3f +- %.3f%s", used ? "; " : "",
                     gsn_builder_tissue_name((unsigned)k), tissues->value[k],
                     gsn_control_tissue_error(tissues, k), control);
        used += n > 0 ? (size_t)n : 0;
    }
    return gsn_builder_say(d, "%s", used ? line : "none was found");
}

static void fill_levels(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;

    if (!e->reconstruction || !e->reconstruction->scale.levelling.done)
        return;
    gsn_builder_text(rows, count, "stain of each panel against the panels' mean",
                     levels_of(e->reconstruction, d));
    gsn_builder_value(rows, count, "share of the differences between panels that was taken out",
                      100 * e->reconstruction->scale.levelling.fit.kept, "%");
    if (e->reconstruction->scale.levelling.turns.freedom > 0)
        gsn_builder_value(rows, count, "scatter of the dye vectors from panel to panel, one turn",
                          180 / M_PI * sqrt(e->reconstruction->scale.levelling.turns.variance),
                          "deg");
    gsn_builder_text(rows, count, "untreated tissue, density on the panels' common scale",
                     tissues_of(e, d));
}

/* What the tissue could not have shown of the sections' order is no fault of this stack, so it is
 * no warning. */
static void fill_blindness(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_sequence *sequence =
        e->reconstruction ? e->reconstruction->densities.sequence : NULL;
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;
    char sentence[GSN_POSE_SENTENCE];

    if (sequence && gsn_section_order_blind_to_swaps(sequence, sentence))
        gsn_builder_text(rows, count, "swapped sections", gsn_builder_say(d, "%s", sentence));
    if (sequence && gsn_section_order_blind_to_duplicates(sequence, sentence))
        gsn_builder_text(rows, count, "sections twice", gsn_builder_say(d, "%s", sentence));
}

/* Where the sections are laid by their tissue alone. */
static const char *frame_of(const struct gsn_reconstruction *a, struct gsn_builder *d)
{
    const struct gsn_section *s = &a->poses.section[a->poses.by_tissue.frame];

    return gsn_builder_say(
        d,
        "the upright picture of panel %u, pixels times their size, as section %u in "
        "its slot %u lies there",
        s->panel, s->seen.serial, s->seen.slot + 1);
}

void gsn_builder_parameters(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_protocol *p = e->specimen->protocol;
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;

    if (e->specimen->region_drawn)
        gsn_builder_text(rows, count, "region", e->specimen->region_drawn);
    if (p->kind == GSN_KIND_SECTIONS) {
        gsn_builder_value(rows, count, "interval", p->interval_um, "um");
        gsn_builder_text(rows, count, "layout",
                         gsn_builder_say(d, "%u rows x %u columns, %s", p->rows, p->columns,
                                         p->order == GSN_PROTOCOL_ROW      ? "row by row"
                                         : p->order == GSN_PROTOCOL_COLUMN ? "column by column"
                                                                           : "snake"));
        gsn_builder_text(rows, count, "block frame",
                         e->reconstruction && e->reconstruction->poses.by_tissue.done
                             ? frame_of(e->reconstruction, d)
                         : p->registration == GSN_PROTOCOL_TISSUE ? "none"
                         : p->has_markers                         ? "the marks stated in job.json"
                                          : "the stack's own mean triangle");
        fill_blindness(e, d);
        if (p->batch[0])
            gsn_builder_text(rows, count, "stain batch", p->batch);
        if (e->reconstruction &&
            (e->reconstruction->scale.by_standards || p->reference_tissue.kind != GSN_REGION_NONE))
            gsn_builder_text(rows, count, "stain gains", gains_of(e->reconstruction, d));
        if (p->stained[0])
            gsn_builder_text(rows, count, "stained", p->stained);
        if (p->scanned[0])
            gsn_builder_text(rows, count, "scanned", p->scanned);
        if (p->yellow_to_red[0] > 0)
            gsn_builder_text(
                rows, count, "yellow to red, allowed",
                gsn_builder_say(d, "%g to %g", p->yellow_to_red[0], p->yellow_to_red[1]));
        if (e->reconstruction && e->reconstruction->densities.grid)
            gsn_builder_text(rows, count, "light and bath", light_of(e->reconstruction, d));
        fill_levels(e, d);
    }
    /* A tile's are told with its figures, as stated or as assumed. */
    if (p->px_um > 0 && !e->tile)
        gsn_builder_value(rows, count, "pixel size, stated", p->px_um, "um");
    if (p->kind != GSN_KIND_VOLUME && !e->tile) {
        gsn_builder_text(rows, count, "transfer curve, stated",
                         p->transfer == GSN_PROTOCOL_LINEAR ? "linear"
                         : p->transfer == GSN_PROTOCOL_SRGB ? "sRGB"
                                                            : "not stated");
        gsn_builder_text(rows, count, "dye vectors", gsn_builder_dyes(e));
    }
    if (e->analysis) {
        gsn_builder_value(rows, count, "spline degree", gsn_dms_degree(e->analysis->space), "");
        gsn_builder_value(rows, count, "fit tolerance", e->analysis->tolerance, "density");
        gsn_builder_value(rows, count, "smoothing", e->analysis->fit.fit.jump, "");
        gsn_builder_text(rows, count, "mesh", name_mesh(e->analysis));
    }
    if (p->unknown)
        gsn_builder_warn(
            d, gsn_builder_say(d, "job.json has keys that are not known and were not used: %s",
                               p->unknown));
    d->report.parameters = rows;
}
