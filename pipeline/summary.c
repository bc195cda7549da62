/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary.h"

#include "pipeline/summary_draft.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static void fill_head(const struct gsn_evidence *e, struct gsn_draft *d)
{
    static const enum gsn_report_kind kinds[] = { [GSN_KIND_SECTIONS] = GSN_REPORT_SPECIMEN,
                                                  [GSN_KIND_VOLUME] = GSN_REPORT_VOLUME,
                                                  [GSN_KIND_TILE] = GSN_REPORT_TILE };
    const struct gsn_protocol *p = e->specimen->protocol;
    struct gsn_report *r = &d->report;

    r->specimen = p->specimen;
    r->study = p->study;
    r->group = p->group;
    r->animal = p->animal;
    r->week = isnan(p->week) ? "" : gsn_draft_say(d, "%g", p->week);
    r->kind = kinds[p->kind];
    r->baseline = p->baseline;
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

/* ---- verdict and bytes ------------------------------------------------------------------- */

static void judge(const struct gsn_evidence *e, struct gsn_draft *d)
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
        r->verdict_reason = gsn_draft_withheld(e, d);
    } else if (stated && isnan(r->loss_percent)) {
        r->verdict = GSN_REPORT_WITHHELD;
        r->verdict_reason = r->loss_reason;
    } else if (d->warning_count > 0) {
        r->verdict = GSN_REPORT_WARNED;
        r->verdict_reason = d->warning[0];
    }
    /* The same words in the report and in the run's row. */
    if (strlen(r->verdict_reason) >= sizeof((struct gsn_specimen_result *)NULL)->message)
        r->verdict_reason = gsn_draft_say(
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

static void keep_measures(const struct gsn_evidence *e, const struct gsn_draft *d,
                          struct gsn_specimen_result *result)
{
    static const char *const volumes[GSN_ACCOUNT_THRESHOLDS] = {
        "volume_above_1", "volume_above_2", "volume_above_3", "volume_above_4",
        "volume_above_5", "volume_above_6", "volume_above_7", "volume_above_8"
    };
    const struct gsn_report *r = &d->report;

    measure_row(result, "mean_density", r->region.mean_density, NAN, NAN, "density");
    measure_row(result, "region_volume", r->region.volume_mm3, NAN, NAN, "mm3");
    measure_row(result, "coverage", r->region.coverage, NAN, NAN, "");
    measure_row(result, "known", e->account ? e->account->coverage : NAN, NAN, NAN, "");
    if (gsn_draft_density_error(e) > 0)
        measure_row(result, "mean_density_error", gsn_draft_density_error(e), NAN, NAN, "density");
    if (gsn_draft_own_scale_error(e) > 0)
        measure_row(result, "own_scale_error", gsn_draft_own_scale_error(e), NAN, NAN, "density");
    if (e->assembly && e->account) {
        const struct gsn_vector_scatter *turns = &e->assembly->levelling.turns;

        keep_tissues(&e->assembly->levelling.tissues, result);
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

static int write_report(const struct gsn_evidence *e, struct gsn_draft *d,
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
    keep_measures(e, d, result);
    return GSN_OK;
}

/* What is kept as a file beside the report. */
static int fill_outputs(const struct gsn_specimen_result *result, struct gsn_draft *d,
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

int gsn_summarise(const struct gsn_evidence *e, struct gsn_specimen_result *result,
                  struct gsn_error *err)
{
    struct gsn_draft d;
    int r = gsn_draft_init(&d, e->assembly ? e->assembly->section_count : 0,
                           e->assembly ? e->assembly->panel_count : 0, e->specimen->input_count,
                           e->specimen->decision_count, err);

    if (r < 0)
        return r;
    fill_head(e, &d);
    if (e->assembly) {
        gsn_draft_assembly(e, &d);
        gsn_draft_choices(e, &d);
    }
    if (e->account) {
        gsn_draft_figures(e, &d);
        gsn_draft_bridge(e, &d);
        gsn_draft_find_link(e, &d);
        gsn_draft_evenness(e, &d);
        if (d.linked)
            gsn_draft_link(e, &d);
    }
    if (e->tile)
        gsn_draft_tile(e, &d);
    gsn_draft_definition(e, &d);
    if (e->specimen->protocol->kind == GSN_KIND_SECTIONS || e->specimen->baseline.name[0])
        gsn_draft_loss(e, &d);
    if (e->account)
        gsn_draft_check_volumes(e, &d);
    gsn_draft_vectors(e, &d);
    gsn_draft_parameters(e, &d);
    judge(e, &d);
    r = fill_outputs(result, &d, err);
    if (r >= 0)
        r = write_report(e, &d, result, err);
    gsn_draft_done(&d);
    return r;
}
