/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Builds a report out of what was found: the order of its parts, the verdict, the bytes.
 *
 * Each part fills its records of struct gsn_report and adds warnings: sections and registration
 * (report_sections.c), figures and parameters (report_figures.c), stain (report_stain.c), loss
 * (report_loss.c). Texts live as long as the draft. Memory that runs out is noted once and fails at
 * the end.
 *
 * The headline is the one sentence why a figure is withheld: the first broken link of the chain,
 * never its last consequence. A figure needs, in this order: panels that came; panels that could be
 * used; sections on them; marks; enough of the region. Whoever finds the last of these missing
 * gives the reason, and here what was missing before it is put in front:
 *
 * 1. Panels that give nothing are gathered by cause: not come, lost, and refused or held for one
 *    reason. Sentences about panels differ in numbers and names, so the words without a digit are
 *    what makes two of them one reason.
 * 2. Where no panel gives anything, the panels are the whole sentence.
 * 3. Where some do, the consequence follows behind them.
 * 4. Where all do and none of them shows a section, that is the sentence.
 *
 * The same text is the verdict of the report, the line of `run`, `status` and `top` and that of the
 * journal, so it has at most the bytes that a run's row keeps. */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/normalisation.h"

#include <assert.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static void free_draft(struct gsn_builder *d)
{
    for (size_t i = 0; i < d->text_count; i++)
        gsn_free(d->text[i]);
    gsn_free(d->text);
    gsn_free(d->warning);
    gsn_free(d->cost);
    gsn_free(d->exclusion);
    gsn_free(d->section);
    gsn_free(d->flag);
    gsn_free(d->candidate);
    gsn_free(d->decision);
    gsn_free(d->panel);
    gsn_free(d->input);
}

/* Fails with GSN_E_NOMEM, and then nothing is to be freed. */
static int init_draft(struct gsn_builder *d, size_t sections, size_t panels, size_t inputs,
                      size_t decisions, struct gsn_error *err)
{
    *d = (struct gsn_builder){ .report = { .loss_lower = NAN, .loss_upper = NAN } };
    d->warning = gsn_alloc_array(64 + 12 * panels + decisions, sizeof *d->warning);
    d->cost = gsn_alloc_array(64 + 12 * panels + decisions, sizeof *d->cost);
    d->exclusion = gsn_alloc_array(sections + GSN_DEFECTS + panels + 1, sizeof *d->exclusion);
    d->section = gsn_alloc_array(sections + 1, sizeof *d->section);
    d->flag = gsn_alloc_array(sections + 1, sizeof *d->flag);
    d->candidate = gsn_alloc_array(sections + 1, sizeof *d->candidate);
    d->decision = gsn_alloc_array(decisions + 1, sizeof *d->decision);
    d->panel = gsn_alloc_array(panels + 1, sizeof *d->panel);
    d->input = gsn_alloc_array(inputs + 1, sizeof *d->input);
    if (d->warning && d->cost && d->exclusion && d->section && d->flag && d->candidate &&
        d->decision && d->panel && d->input)
        return GSN_OK;
    free_draft(d);
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a report");
}

const char *gsn_builder_say(struct gsn_builder *d, const char *format, ...)
{
    char line[1024];
    va_list args;
    char *kept;

    va_start(args, format);
    (void)vsnprintf(line, sizeof line, format, args);
    va_end(args);
    if (d->text_count == d->text_room) {
        char **more = gsn_realloc_array(d->text, 2 * d->text_room + 64, sizeof *more);

        if (more) {
            d->text = more;
            d->text_room = 2 * d->text_room + 64;
        }
    }
    kept = d->text_count < d->text_room ? gsn_strdup(line) : NULL;
    if (!kept) {
        d->out_of_memory = 1;
        return "";
    }
    d->text[d->text_count++] = kept;
    return kept;
}

void gsn_builder_warn(struct gsn_builder *d, const char *sentence)
{
    gsn_builder_warn_cost(d, (struct gsn_builder_cost){ 0 }, sentence);
}

static int costs_more(struct gsn_builder_cost a, struct gsn_builder_cost b)
{
    return a.points > b.points || (!(a.points < b.points) && a.sections > b.sections);
}

void gsn_builder_warn_cost(struct gsn_builder *d, struct gsn_builder_cost cost,
                           const char *sentence)
{
    size_t at = d->warning_count++;

    for (; at > 0 && costs_more(cost, d->cost[at - 1]); at--) {
        d->warning[at] = d->warning[at - 1];
        d->cost[at] = d->cost[at - 1];
    }
    d->warning[at] = sentence;
    d->cost[at] = cost;
}

void gsn_builder_value(struct gsn_report_value *rows, size_t *count, const char *name, double value,
                       const char *unit)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = value, .unit = unit };
}

void gsn_builder_text(struct gsn_report_value *rows, size_t *count, const char *name,
                      const char *text)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = NAN, .text = text };
}

/* ---- the headline ---------------------------------------------------------------------------- */

enum { MOST_BYTES = sizeof((struct gsn_specimen_result *)NULL)->message - 1, MOST_CAUSES = 6 };

/* A panel that gives nothing, and how many others do for the same reason. */
struct cause {
    const char *state, *message; /* message: NULL where there is no file */
    const char *file;
    unsigned number;
    size_t count;
};

/* ---- one reason -------------------------------------------------------------------------- */

/* The next word without a digit, from *at on; its length, 0: none is left. */
static size_t next_word(const char **at)
{
    for (;;) {
        size_t length, digits;

        *at += strspn(*at, " ");
        length = strcspn(*at, " ");
        digits = strcspn(*at, "0123456789");
        if (length == 0 || digits >= length)
            return length;
        *at += length;
    }
}

int gsn_builder_same_reason(const char *a, const char *b)
{
    for (;;) {
        const size_t length = next_word(&a);

        if (next_word(&b) != length || strncmp(a, b, length) != 0)
            return 0;
        if (length == 0)
            return 1;
        a += length;
        b += length;
    }
}

/* ---- the panels that give nothing ---------------------------------------------------------- */

static int is_lost(const struct gsn_specimen *specimen, unsigned number)
{
    for (size_t i = 0; i < specimen->decision_count; i++)
        if (specimen->decision[i].panel == number && specimen->decision[i].slot == 0 &&
            strcmp(specimen->decision[i].answer, "lost") == 0)
            return 1;
    return 0;
}

static int is_used(const struct gsn_report_inputs *e, unsigned number)
{
    for (size_t i = 0; e->reconstruction && i < e->reconstruction->poses.section_count; i++)
        if (e->reconstruction->poses.section[i].panel == number &&
            (e->reconstruction->densities.section[i].state == GSN_SECTION_USED ||
             e->reconstruction->densities.section[i].state == GSN_SECTION_DOUBTFUL))
            return 1;
    return 0;
}

/* Why a panel's number gives nothing; state is NULL where it gives something. */
static struct cause cause_of(const struct gsn_report_inputs *e, unsigned number)
{
    const struct gsn_specimen *specimen = e->specimen;
    const struct gsn_specimen_panel *panel = NULL;
    struct cause cause = { .number = number, .count = 1 };

    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number == number && (!panel || specimen->panel[i].section_count > 0))
            panel = &specimen->panel[i];
    if (!panel) {
        cause.state = is_lost(specimen, number) ? "lost" : "not come";
    } else if (panel->section_count == 0) {
        cause.state = strcmp(panel->state, "refused") == 0 ? "refused" : "held";
        cause.message = panel->message;
        cause.file = panel->file;
    } else if (e->reconstruction && e->reconstruction->poses.solved && !is_used(e, number)) {
        cause.state = "without a section that is used";
        cause.file = panel->file;
    }
    return cause;
}

static int is_same(const struct cause *a, const struct cause *b)
{
    return strcmp(a->state, b->state) == 0 &&
           (a->message && b->message ? gsn_builder_same_reason(a->message, b->message)
                                     : !a->message == !b->message);
}

/* In cause, those of most panels first; returns how many panels they are. */
static size_t gather_causes(const struct gsn_report_inputs *e, unsigned panels, struct cause *cause,
                            size_t *ret_causes)
{
    size_t causes = 0, silent = 0;

    for (unsigned number = 1; number <= panels; number++) {
        const struct cause next = cause_of(e, number);
        size_t i = 0;

        if (!next.state)
            continue;
        silent++;
        while (i < causes && !is_same(&cause[i], &next))
            i++;
        if (i == causes)
            cause[causes++] = next;
        else
            cause[i].count++;
        for (; i > 0 && cause[i].count > cause[i - 1].count; i--) {
            const struct cause kept = cause[i];

            cause[i] = cause[i - 1];
            cause[i - 1] = kept;
        }
    }
    *ret_causes = causes;
    return silent;
}

static unsigned panels_of(const struct gsn_specimen *specimen)
{
    unsigned panels = specimen->protocol->panels;

    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number > panels)
            panels = specimen->panel[i].number;
    return panels;
}

/* ---- the sentence ------------------------------------------------------------------------ */

struct line {
    char text[MOST_BYTES + 1];
    size_t used;
};

static void add_text(struct line *line, const char *text)
{
    const int put = snprintf(line->text + line->used, sizeof line->text - line->used, "%s", text);

    line->used += (size_t)put;
    if (line->used >= sizeof line->text) {
        line->used = sizeof line->text - 1;
        memcpy(line->text + line->used - 3, "...", 3);
    }
}

static void add_cause(struct line *line, const struct cause *cause, unsigned panels,
                      struct gsn_builder *d)
{
    const char *glue = line->used ? "; " : "";

    if (cause->count == 1 && panels > 1)
        add_text(line, gsn_builder_say(d, "%spanel %u of %u %s%s%s%s", glue, cause->number, panels,
                                       cause->state, cause->file ? " (" : "",
                                       cause->file ? cause->file : "", cause->file ? ")" : ""));
    else
        add_text(line, gsn_builder_say(d, "%s%zu of %u panels %s", glue, cause->count, panels,
                                       cause->state));
    if (cause->message && cause->message[0]) {
        add_text(line, ": ");
        add_text(line, cause->message);
    } else if (strcmp(cause->state, "not come") == 0) {
        add_text(line, ": import what is missing, or say `gieson decide SPECIMEN PANEL lost`");
    }
}

static size_t count_sections(const struct gsn_reconstruction *a)
{
    size_t count = 0;

    for (size_t i = 0; i < a->poses.section_count; i++)
        count += a->densities.section[i].state != GSN_SECTION_EMPTY &&
                 a->densities.section[i].state != GSN_SECTION_MISSING;
    return count;
}

const char *gsn_builder_headline(const struct gsn_report_inputs *e, struct gsn_builder *d,
                                 const char *why)
{
    const unsigned panels = panels_of(e->specimen);
    gsn_auto_mem(struct cause) cause = NULL;
    struct line line = { .used = 0 };
    size_t silent, causes;

    if (e->specimen->protocol->kind != GSN_KIND_SECTIONS ||
        (e->analysis && (!e->reconstruction || !e->reconstruction->densities.grid)))
        return why;
    if (e->specimen->panel_count == 0)
        return "no panel has come: put the pictures of the panels beside job.json and import the "
               "folder again";
    cause = gsn_alloc_array(panels + 1, sizeof *cause);
    if (!cause) {
        d->out_of_memory = 1;
        return why;
    }
    silent = gather_causes(e, panels, cause, &causes);
    for (size_t i = 0; i < causes && i < MOST_CAUSES; i++)
        add_cause(&line, &cause[i], panels, d);
    if (silent == panels && causes > 0 && !e->analysis)
        return gsn_builder_say(d, "%s", line.text);
    if (e->reconstruction && count_sections(e->reconstruction) == 0)
        why = "no section was found on any panel: look at them, and at \"layout\" and \"px_um\" in "
              "job.json";
    add_text(&line, causes > 0 ? "; so " : "");
    add_text(&line, why);
    return gsn_builder_say(d, "%s", line.text);
}

const char *gsn_builder_withheld(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    return e->withheld ? gsn_builder_headline(e, d, e->withheld) : NULL;
}

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

/* ---- verdict and bytes ------------------------------------------------------------------- */

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
    int r = init_draft(&d, e->reconstruction ? e->reconstruction->poses.section_count : 0,
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
    r = fill_outputs(result, &d, err);
    if (r >= 0 && !e->specimen->part)
        r = add_pdf(&d, result, err);
    if (r >= 0)
        r = fill_outputs(result, &d, err);
    if (r >= 0)
        r = write_report(e, &d, result, err);
    free_draft(&d);
    return r;
}
