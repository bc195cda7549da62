/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary.h"

#include "pipeline/assembly_order.h"
#include "pipeline/assembly_tissue.h"
#include "pipeline/conditions.h"
#include "pipeline/core/hash.h"
#include "pipeline/measure/loss.h"
#include "pipeline/pose_words.h"
#include "pipeline/report/report.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* Below this share of region voxels that were measured, or bridged from the sections beside them, a
 * loss is not printed: the density of a tenth that nobody knows can move the mean by as much as the
 * effects people look for. */
static const double LEAST_KNOWN = 0.9;
/* Of these, at least this share was measured: with every third section gone, what bridging costs
 * can hardly be measured on the rest. */
static const double LEAST_MEASURED = 0.7;
/* More bridged than this is said in the verdict; less are the halos and dust of every stack. */
static const double BRIDGED_UNSAID = 0.02;
/* Texture and what a region's tissue happens to be scatter by about this much in even baths. */
static const double UNEVEN_UNSAID = 0.03;

/* Glass pixels at the highest code hide how bright the glass was. */
static const double MOST_OVEREXPOSED = 0.02;

enum { MOST_ROWS = 48 };

/* Between the dyes and the batch that was stained with them. */
#define IN_BATCH ", batch "

/* The report's records and the texts they borrow. */
struct draft {
    struct gsn_report report;
    char **text; /* owned */
    size_t text_count, text_room;
    const char **warning;
    size_t warning_count;
    struct gsn_report_exclusion *exclusion;
    size_t exclusion_count;
    struct gsn_report_section *section;
    const char *(*flag)[16];
    struct gsn_report_panel *panel;
    struct gsn_report_volume volume[GSN_ACCOUNT_THRESHOLDS];
    struct gsn_report_picture picture[GSN_ACCOUNT_PICTURES];
    struct gsn_report_value measure[MOST_ROWS], parameter[MOST_ROWS];
    struct gsn_report_input *input, output;
    struct gsn_digest colour;
    struct gsn_report_registration registration;
    struct gsn_report_fit fit;
    struct gsn_report_units units;
    struct gsn_report_tile tile;
    double loss_low, loss_high; /* NaN: no interval */
    int linked;                 /* whether untreated tissue tells how the baseline was stained */
    struct gsn_level_link link;
    int out_of_memory;
};

static void draft_done(struct draft *d)
{
    for (size_t i = 0; i < d->text_count; i++)
        gsn_free(d->text[i]);
    gsn_free(d->text);
    gsn_free(d->warning);
    gsn_free(d->exclusion);
    gsn_free(d->section);
    gsn_free(d->flag);
    gsn_free(d->panel);
    gsn_free(d->input);
}

static int draft_init(struct draft *d, size_t sections, size_t panels, size_t inputs,
                      struct gsn_error *err)
{
    *d = (struct draft){ .loss_low = NAN, .loss_high = NAN };
    d->warning = gsn_alloc_array(64 + 5 * panels, sizeof *d->warning);
    d->exclusion = gsn_alloc_array((1 + GSN_DEFECTS) * sections + panels + 1, sizeof *d->exclusion);
    d->section = gsn_alloc_array(sections + 1, sizeof *d->section);
    d->flag = gsn_alloc_array(sections + 1, sizeof *d->flag);
    d->panel = gsn_alloc_array(panels + 1, sizeof *d->panel);
    d->input = gsn_alloc_array(inputs + 1, sizeof *d->input);
    if (d->warning && d->exclusion && d->section && d->flag && d->panel && d->input)
        return GSN_OK;
    draft_done(d);
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a report");
}

/* A text that lives as long as the draft; "" when memory runs out, which is noted. */
static const char *say(struct draft *d, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

static const char *say(struct draft *d, const char *format, ...)
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

static void warn(struct draft *d, const char *sentence)
{
    d->warning[d->warning_count++] = sentence;
}

static void value_row(struct gsn_report_value *rows, size_t *count, const char *name, double value,
                      const char *unit)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = value, .unit = unit };
}

static void text_row(struct gsn_report_value *rows, size_t *count, const char *name,
                     const char *text)
{
    rows[(*count)++] = (struct gsn_report_value){ .name = name, .value = NAN, .text = text };
}

/* ---- head -------------------------------------------------------------------------------- */

static void fill_head(const struct gsn_evidence *e, struct draft *d)
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
    r->week = isnan(p->week) ? "" : say(d, "%g", p->week);
    r->kind = kinds[p->kind];
    r->baseline = p->baseline;
    r->loss_percent = r->loss_points = r->baseline_mean = NAN;
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

/* ---- sections and panels ----------------------------------------------------------------- */

static size_t split_flags(struct draft *d, const char *flags, const char *ret_flag[16])
{
    size_t count = 0;

    for (const char *at = flags; *at && count < 16;) {
        const size_t length = strcspn(at, " ");

        if (length > 0)
            ret_flag[count++] = say(d, "%.*s", (int)length, at);
        at += length + (at[length] == ' ');
    }
    return count;
}

static void fill_masked(const struct gsn_assembly_section *s, struct gsn_report_section *row)
{
    row->outline_mm2 = 1e-6 * s->masked.outline_um2;
    row->masked_mm2 = 1e-6 * s->masked.masked_um2;
    row->region_masked = s->region_masked;
    for (unsigned bit = 0; bit < GSN_DEFECTS; bit++)
        if (s->masked.area_um2[bit] > 0)
            row->masked[row->masked_count++] =
                (struct gsn_report_masked){ .reason = gsn_defect_word(bit),
                                            .area_mm2 = 1e-6 * s->masked.area_um2[bit],
                                            .region_share = s->region_by[bit] };
}

static void fill_section(const struct gsn_assembly_section *s, const struct gsn_protocol *p,
                         int strained, struct draft *d, size_t i)
{
    const struct gsn_layout layout = gsn_protocol_layout(p);
    struct gsn_report_section *row = &d->section[i];

    *row = (struct gsn_report_section){ .serial = s->seen.serial,
                                        .z_um = p->interval_um * (s->seen.serial + 0.5),
                                        .panel = s->panel,
                                        .slot = s->seen.slot,
                                        .state = gsn_assembly_state_name(s->state),
                                        .flipped = s->pose.flipped,
                                        .rotated180 = s->pose.rotated180,
                                        .posed = s->posed,
                                        .panel_to_block_um = s->pose.panel_to_block_um,
                                        .predicted_tre_um = s->posed ? s->pose.tre_um : NAN,
                                        .thumbnail = { .bytes = s->thumbnail.png,
                                                       .size = s->thumbnail.size,
                                                       .width = s->thumbnail.width,
                                                       .height = s->thumbnail.height } };
    if (s->posed && strained) {
        const struct gsn_strain_axes axes = gsn_strain_principal(s->pose.strain);

        row->strained = 1;
        row->strain_percent[0] = 100 * axes.most;
        row->strain_percent[1] = 100 * axes.least;
        row->strain_deg = axes.angle * 180 / M_PI;
    }
    gsn_panel_place(&layout, s->seen.slot, &row->row, &row->column);
    fill_masked(s, row);
    row->flags = d->flag[i];
    row->flag_count = split_flags(d, s->flags, d->flag[i]);
    for (size_t m = 0; m < GSN_MARKS; m++) {
        row->marker_found[m] = s->seen.mark[m].found;
        row->marker_px[m] = s->seen.mark[m].px;
        row->residual_um[m] = s->posed ? s->pose.residual_um[m] : NAN;
    }
}

static void exclude(struct draft *d, const char *what, const char *reason)
{
    d->exclusion[d->exclusion_count++] =
        (struct gsn_report_exclusion){ .what = what, .reason = reason };
}

static const char *reason_of(struct draft *d, const struct gsn_assembly_section *s)
{
    char sentence[GSN_POSE_SENTENCE];

    if (s->state == GSN_SECTION_MISSING)
        return strstr(s->flags, "no-panel") ? "its panel is not there or was refused; the gap is "
                                              "kept at its place"
                                            : "the slot is empty; the gap is kept at its place";
    if (strstr(s->flags, "duplicate-serial"))
        return "another section already has this serial number: rename the panel or approve one";
    if (strstr(s->flags, "clipped"))
        return "too much of it is clipped: scan its panel again with another exposure";
    if (strstr(s->flags, "residual-too-large")) {
        gsn_pose_reason(&s->pose, sentence);
        return say(d, "%s", sentence);
    }
    if (strstr(s->flags, "ambiguous-marks"))
        return "more than one choice of marks fits the triangle: look at it";
    return "fewer than two marks were found: look at it";
}

/* One row for each reason, in words. */
static void exclude_masked(const struct gsn_assembly_section *s, struct draft *d)
{
    for (unsigned bit = 0; bit < GSN_DEFECTS; bit++)
        if (1u << bit != GSN_DEFECT_HALO && s->masked.area_um2[bit] > 0)
            exclude(d,
                    say(d, "%.3g mm2 of section %u (panel %u, slot %u), %.1f %% of its region",
                        1e-6 * s->masked.area_um2[bit], s->seen.serial, s->panel, s->seen.slot,
                        100 * s->region_by[bit]),
                    say(d, "%s: %s", gsn_defect_word(bit), gsn_defect_reason(bit)));
}

static void fill_sections(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_assembly *a = e->assembly;
    size_t doubtful = 0, held = 0, missing = 0;

    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];

        fill_section(s, e->specimen->protocol,
                     a->summary.stretches && a->strain_mode != GSN_STRAIN_RIGID, d, i);
        doubtful += s->state == GSN_SECTION_DOUBTFUL;
        held += s->state == GSN_SECTION_HELD;
        missing += s->state == GSN_SECTION_MISSING;
        if (s->state == GSN_SECTION_HELD || s->state == GSN_SECTION_MISSING)
            exclude(
                d, say(d, "section %u (panel %u, slot %u)", s->seen.serial, s->panel, s->seen.slot),
                reason_of(d, s));
        exclude_masked(s, d);
    }
    doubtful -= gsn_assembly_by_tissue(a);
    if (gsn_assembly_by_tissue(a))
        warn(d, say(d,
                    "%zu section%s no marks to rely on and %s laid by the tissue of the "
                    "neighbours, flagged by-tissue: compare with them",
                    gsn_assembly_by_tissue(a), gsn_assembly_by_tissue(a) == 1 ? " has" : "s have",
                    gsn_assembly_by_tissue(a) == 1 ? "was" : "were"));
    if (doubtful)
        warn(d, say(d, "%zu section%s laid by two marks only: compare with the neighbours",
                    doubtful, doubtful == 1 ? " was" : "s were"));
    if (held)
        warn(d, say(d, "%zu section%s held and not used", held, held == 1 ? " is" : "s are"));
    if (missing)
        warn(d, say(d, "%zu expected section%s missing; nothing was moved up to close the gap",
                    missing, missing == 1 ? " is" : "s are"));
    d->report.sections = d->section;
    d->report.section_count = a->section_count;
}

static void fill_panels(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_assembly *a = e->assembly;

    for (size_t i = 0; i < a->panel_count; i++) {
        const struct gsn_assembly_panel *p = &a->panel[i];
        struct gsn_report_panel *row = &d->panel[i];

        *row =
            (struct gsn_report_panel){ .number = p->given->number,
                                       .file = p->given->file,
                                       .sha256 = p->given->sha256,
                                       .state = p->given->section_count ? "used" : p->given->state,
                                       .message = p->given->message,
                                       .rows = e->specimen->protocol->rows,
                                       .columns = e->specimen->protocol->columns,
                                       .glass = p->opened ? p->glass.fraction : NAN };
        for (size_t c = 0; c < 3; c++)
            row->white[c] = p->opened ? p->glass.white[c] : NAN;
        if (!p->given->section_count) {
            exclude(d, say(d, "panel file %s", p->given->file), p->given->message);
            warn(d, say(d, "%s was not used: %s", p->given->file, p->given->message));
        }
        if (p->note[0])
            warn(d, say(d, "panel %u: %s", p->given->number, p->note));
        if (p->opened && p->glass.overexposed > MOST_OVEREXPOSED)
            warn(d, say(d,
                        "panel %u: %.0f %% of its glass is overexposed, so its white point is a "
                        "guess from below: scan with less exposure",
                        p->given->number, 100 * p->glass.overexposed));
    }
    d->report.panels = d->panel;
    d->report.panel_count = a->panel_count;
}

static void fill_registration(const struct gsn_assembly *a, double interval_um, struct draft *d)
{
    char sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE];
    size_t count;
    struct gsn_report_registration *r = &d->registration;
    double sum = 0, tre = 0;

    *r = (struct gsn_report_registration){ .fle_um = a->summary.fle_um };
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];

        r->sections_expected += s->state != GSN_SECTION_EMPTY;
        if (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL)
            continue;
        r->sections_posed++;
        sum += s->pose.rms_um * s->pose.rms_um;
        tre += s->pose.tre_um;
        r->worst_tre_um = fmax(r->worst_tre_um, s->pose.tre_um);
        for (size_t m = 0; m < GSN_MARKS; m++)
            r->worst_residual_um = fmax(r->worst_residual_um, s->pose.residual_um[m]);
    }
    if (r->sections_posed > 0) {
        r->rms_residual_um = sqrt(sum / r->sections_posed);
        r->mean_tre_um = tre / r->sections_posed;
    }
    count =
        gsn_pose_sentences(&a->summary, &a->panel_stretch, a->strain_mode, interval_um, sentence);
    for (size_t i = 0; i < count; i++)
        warn(d, say(d, "%s", sentence[i]));
    d->report.registration = r;
}

/* What the panels tell of lamp, bath, knife and glass. */
static void fill_conditions(const struct gsn_evidence *e, struct draft *d)
{
    struct gsn_conditions_words words = { 0 };

    if (gsn_conditions_words(e->assembly, e->specimen->protocol, &words) < 0)
        d->out_of_memory = 1;
    for (size_t i = 0; i < words.count; i++)
        warn(d, say(d, "%s", words.sentence[i]));
    gsn_conditions_words_done(&words);
}

/* Sentences; the sections themselves are flagged whatever their number. */
enum { MOST_OUT_OF_ORDER = 16 };

static void fill_order(const struct gsn_assembly *a, struct draft *d)
{
    char sentence[GSN_POSE_SENTENCE];

    for (size_t i = 0; a->sequence && i < a->sequence->count && i < MOST_OUT_OF_ORDER; i++) {
        gsn_section_order_sentence(&a->sequence->finding[i], sentence);
        warn(d, say(d, "%s", sentence));
    }
}

static void fill_assembly(const struct gsn_evidence *e, struct draft *d)
{
    fill_sections(e, d);
    fill_panels(e, d);
    fill_conditions(e, d);
    fill_order(e->assembly, d);
    if (e->assembly->solved)
        fill_registration(e->assembly, e->specimen->protocol->interval_um, d);
    else
        warn(d, e->assembly->unsolved);
}

/* ---- figures ----------------------------------------------------------------------------- */

static void fill_fit(const struct gsn_account *account, struct draft *d)
{
    const struct gsn_fit_report *fit = &account->fit.fit;
    const size_t tets = gsn_dms_mesh(account->space)->tet_count;

    d->fit = (struct gsn_report_fit){ .tets = tets,
                                      .unknowns = fit->unknowns,
                                      .samples = fit->samples,
                                      .empty_tets = fit->empty_tets,
                                      .tets_in_tolerance = tets - account->over_tolerance,
                                      .rms = fit->rms,
                                      .worst = fit->worst,
                                      .smoothing = account->smoothing,
                                      .tolerance = account->tolerance,
                                      .degree = gsn_dms_degree(account->space) };
    d->report.fit = &d->fit;
    d->units = (struct gsn_report_units){ .first = account->summary.low,
                                          .last = account->summary.high,
                                          .bin = account->summary.bin,
                                          .bin_count = GSN_UNIT_BINS,
                                          .smallest = account->summary.min,
                                          .median = account->summary.median,
                                          .largest = account->summary.max };
    d->report.units = &d->units;
}

static void fill_figures(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_account *account = e->account;
    const struct gsn_protocol *p = e->specimen->protocol;
    struct gsn_report *r = &d->report;

    r->region = (struct gsn_report_region){
        .volume_mm3 = 1e-9 * account->density.volume_um3,
        .mean_density = account->density.mean,
        .coverage = account->coverage,
        .description = p->region.kind == GSN_REGION_MASK   ? p->region.file
                       : p->region.kind == GSN_REGION_NONE ? "the whole volume"
                       : p->region.kind == GSN_REGION_BAND
                           ? say(d, "%g to %g um from the surface of %s%s", p->region.low_um,
                                 p->region.high_um, p->region.file ? "" : "the ",
                                 p->region.file ? p->region.file : gsn_tissue_name(p->region.from))
                           : "a shape stated in job.json"
    };
    for (size_t i = 0; i < account->bound_count; i++)
        d->volume[i] =
            (struct gsn_report_volume){ .threshold = account->bound[i].threshold,
                                        .lower_mm3 = 1e-9 * account->bound[i].lower_um3,
                                        .upper_mm3 = 1e-9 * account->bound[i].upper_um3 };
    r->volumes = d->volume;
    r->volume_count = account->bound_count;
    for (size_t i = 0; i < account->picture_count; i++)
        d->picture[i] =
            (struct gsn_report_picture){ .id = account->picture[i].id,
                                         .title = account->picture[i].title,
                                         .caption = account->picture[i].caption,
                                         .png = { account->picture[i].png, account->picture[i].size,
                                                  account->picture[i].width,
                                                  account->picture[i].height } };
    r->pictures = d->picture;
    r->picture_count = account->picture_count;
    r->area_figure = (struct gsn_report_value){ .name = say(d, "share of sampled voxels above %.4g",
                                                            account->above_threshold),
                                                .value = 100 * account->above_share,
                                                .unit = "%" };
    value_row(d->measure, &r->measure_count, "MicroUnit density, lower quartile",
              account->summary.quartile1, "density");
    value_row(d->measure, &r->measure_count, "MicroUnit density, upper quartile",
              account->summary.quartile3, "density");
    value_row(d->measure, &r->measure_count, "MicroUnits with data", (double)account->summary.ok,
              "");
    value_row(d->measure, &r->measure_count, "MicroUnits without data",
              (double)account->summary.no_data, "");
    fill_fit(account, d);
}

/* What was measured of the region, and what was bridged. Comes after the figures. */
static void fill_bridge(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_bridge *b = &e->bridge;
    struct gsn_report *r = &d->report;
    const double share = b->region > 0 ? (double)b->bridged / (double)b->region : 0;

    if (b->region == 0)
        return;
    r->region.coverage = (double)b->measured / (double)b->region;
    value_row(d->measure, &r->measure_count, "Region bridged between sections", 100 * share, "%");
    value_row(d->measure, &r->measure_count, "Standard error of the mean from bridging", b->error,
              "density");
    if (share > BRIDGED_UNSAID)
        warn(d, say(d,
                    "%.1f %% of the region of interest was not seen and is bridged from the "
                    "sections beside it, which makes the mean density uncertain by %.2g",
                    100 * share, b->error));
}

static const char *const TISSUE_NAMES[GSN_UNTREATED_KINDS] = { "dense tissue (bone)",
                                                               "loose tissue", "dentine" };

const char *gsn_specimen_tissue_measure(unsigned tissue)
{
    static const char *const names[GSN_UNTREATED_KINDS] = { "tissue_dense", "tissue_loose",
                                                            "tissue_dentine" };

    return names[tissue];
}

/* How much more the stain of two specimens may differ than that of two panels of one. */
static const double SPECIMENS_OVER_PANELS = 2;

/* How the baseline would read in this specimen's stain, by tissue that nobody treated. */
static void find_link(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    const struct gsn_levelling *l = e->assembly ? &e->assembly->levelling : NULL;
    struct gsn_level spread;

    _Static_assert((int)GSN_UNTREATED_KINDS == (int)GSN_SPECIMEN_TISSUES, "one baseline, one list");
    if (!l || !l->done || !e->account || b->specimens == 0)
        return;
    /* Two specimens are stained on two days, and differ by no less than panels of one day do. */
    spread.gain = SPECIMENS_OVER_PANELS * l->fit.gain_scatter;
    spread.offset = SPECIMENS_OVER_PANELS * l->fit.offset_scatter;
    d->linked =
        gsn_level_between(l->tissue, b->tissue, GSN_UNTREATED_KINDS, &spread, &d->link, NULL) >= 0;
}

/* What the untreated tissues are off the link by, in their errors, when something is wrong. */
static const double DISAGREEING = 2;

static void fill_link(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;

    value_row(d->measure, &d->report.measure_count, "Stain against the baseline's, factor",
              d->link.gain, "");
    value_row(d->measure, &d->report.measure_count, "Stain against the baseline's, added",
              d->link.offset, "density");
    if (d->link.disagreement > DISAGREEING)
        warn(d,
             say(d,
                 "the tissues outside of the region do not agree on how this specimen is stained "
                 "against %s: one of them has changed, or is not what it was taken for",
                 b->name));
}

/* Where no reference tissue is stated, a bath that stained one panel stronger looks like collagen.
 */
static void fill_evenness(const struct gsn_evidence *e, struct draft *d)
{
    struct gsn_report *r = &d->report;
    const char *why;

    if (!e->assembly || !(e->assembly->stain_scatter > 0))
        return;
    value_row(d->measure, &r->measure_count, "Strength of the stain, scatter from panel to panel",
              100 * e->assembly->stain_scatter, "%");
    if (d->linked || e->assembly->stain_scatter <= UNEVEN_UNSAID ||
        (e->assembly->levelling.done && e->specimen->baseline.specimens == 0))
        return;
    why = e->assembly->levelling.done
              ? "which was taken out between the panels, but not against the baseline: too little "
                "tissue outside of the region is alike in both"
              : "and no reference tissue takes that out";
    warn(d, say(d,
                "the panels are stained unequally (their strongest tissue differs by %.0f %%, "
                "standard deviation), %s: the loss is only known to within its interval; state "
                "\"reference\" in job.json",
                100 * e->assembly->stain_scatter, why));
    if (e->assembly->levelling.why[0])
        warn(d, say(d, "the panels were not levelled: %s", e->assembly->levelling.why));
}

/* Why too little of the region is known to give a loss; NULL: enough is. */
static const char *too_little_known(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_report_region *region = &d->report.region;

    if (e->account->coverage < LEAST_KNOWN)
        return say(d, "only %.0f %% of the region of interest has data", 100 * region->coverage);
    if (region->coverage < LEAST_MEASURED)
        return say(d,
                   "only %.0f %% of the region of interest was measured; the rest could only be "
                   "bridged from the sections beside it",
                   100 * region->coverage);
    return NULL;
}

/* The set of dye vectors that the figures stand on: the panels' own, or none. */
static const char *dyes_of(const struct gsn_evidence *e)
{
    if (e->tile)
        return e->tile->fit.dyes.name;
    for (size_t i = 0; e->assembly && i < e->assembly->panel_count; i++)
        if (e->assembly->panel[i].opened)
            return e->assembly->panel[i].stain.fit.dyes.name;
    return "";
}

static void fill_definition(const struct gsn_evidence *e, struct draft *d)
{
    const int volume = e->specimen->protocol->kind == GSN_KIND_VOLUME;

    const struct gsn_protocol *p = e->specimen->protocol;
    const int normalised = p->reference_tissue.kind != GSN_REGION_NONE &&
                           !(e->assembly && e->assembly->not_comparable[0]);

    d->report.density_name =
        volume       ? "voxel value as imported"
        : normalised ? say(d, "collagen-equivalent density (red dye by unmixing, reference %g)",
                           p->reference_density)
                     : "collagen-equivalent density (red dye by unmixing)";
    /* Without a reference the figure is the batch's own. */
    d->report.density_version = volume ? "1"
                                : p->batch[0] && !normalised
                                    ? say(d, "%s" IN_BATCH "%s", dyes_of(e), p->batch)
                                    : dyes_of(e);
}

/* Standard error of the mean density by what the stain leaves open; 0: not known. Of its own scale
 * it leaves out what all panels have in common. */
static double own_scale_error(const struct gsn_evidence *e)
{
    return e->assembly && e->account ? e->assembly->red_error * e->account->density.mean : 0;
}

static double density_error(const struct gsn_evidence *e)
{
    return e->assembly && e->account
               ? hypot(e->assembly->red_error, e->assembly->common_error) * e->account->density.mean
               : 0;
}

/* Where density 0 lies on the common scale of the panels nobody knows better than the panels agree
 * on it. It moves both sides alike, and the loss by that times what the sides differ by. */
static double zero_error(const struct gsn_evidence *e, double baseline)
{
    const struct gsn_levelling *l = &e->assembly->levelling;

    return l->fit.offset_scatter / sqrt((double)l->panels) *
           fabs(1 - e->account->density.mean / baseline);
}

/* The baseline as it would read in this specimen's stain, and what that leaves open. */
static void link_sides(const struct gsn_evidence *e, const struct draft *d,
                       struct gsn_loss_side *control, struct gsn_loss_side *treated)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;

    control->mean = d->link.gain * b->mean_density + d->link.offset;
    control->standard_error =
        hypot(d->link.gain * b->own_scale_error, gsn_level_link_error(&d->link, b->mean_density));
    treated->standard_error = hypot(own_scale_error(e), zero_error(e, control->mean));
}

static void fill_loss(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    struct gsn_report *r = &d->report;
    struct gsn_loss_side control = { .name = b->name,
                                     .definition = b->definition,
                                     .dyes = b->dyes,
                                     .mean = b->mean_density,
                                     .standard_error = b->mean_density_error,
                                     .volume_um3 = 1e9 * b->volume_mm3 };
    struct gsn_loss_side treated = { .name = r->specimen,
                                     .definition = r->density_name,
                                     .dyes = r->density_version,
                                     .mean = r->region.mean_density,
                                     .standard_error = density_error(e),
                                     .volume_um3 = 1e9 * r->region.volume_mm3 };
    struct gsn_error why = { 0 };
    struct gsn_loss loss;

    if (!b->name[0]) {
        r->loss_reason = "no baseline is stated, so this specimen is its own";
        return;
    }
    if (!e->account) {
        r->loss_reason = e->withheld;
        return;
    }
    if (b->specimens == 0) {
        r->loss_reason = say(d, "the baseline %s has no result yet: import and run it", b->name);
        warn(d, r->loss_reason);
        return;
    }
    if (d->linked)
        link_sides(e, d, &control, &treated);
    r->baseline_mean = control.mean;
    r->loss_reason = too_little_known(e, d);
    if (r->loss_reason) {
        warn(d, r->loss_reason);
        return;
    }
    if (e->assembly && e->assembly->not_comparable[0]) {
        r->loss_reason = e->assembly->not_comparable;
        warn(d, r->loss_reason);
        return;
    }
    if (strcmp(b->dyes, r->density_version) != 0 &&
        (strstr(b->dyes, IN_BATCH) || strstr(r->density_version, IN_BATCH))) {
        r->loss_reason = say(d,
                             "batches not comparable: the control was measured by %s, this "
                             "specimen by %s; state \"reference\" in both jobs",
                             b->dyes, r->density_version);
        warn(d, r->loss_reason);
        return;
    }
    if (gsn_loss(&control, &treated, 0.95, &loss, &why) < 0) {
        r->loss_reason = say(d, "%s", why.text);
        warn(d, r->loss_reason);
        return;
    }
    if (loss.has_interval) {
        d->loss_low = loss.percent_low;
        d->loss_high = loss.percent_high;
        value_row(d->measure, &r->measure_count, "Collagen loss, from (95 %, stain and white)",
                  loss.percent_low, "%");
        value_row(d->measure, &r->measure_count, "Collagen loss, to (95 %, stain and white)",
                  loss.percent_high, "%");
    }
    r->loss_percent = loss.percent;
    r->loss_points = loss.points;
}

static void fill_tile(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_tile *t = e->tile;
    const double pixels = (double)t->overlap.pixels;

    d->tile = (struct gsn_report_tile){
        .area_fraction = t->collagen.area_fraction,
        .mean_density = t->collagen.mean_density,
        .threshold = t->collagen.threshold,
        .compared = t->compared,
        .mask_name = e->specimen->protocol->reference,
        .dice = t->compared ? t->overlap.dice : NAN,
        .map_fraction = t->compared ? (double)t->overlap.map_px / pixels : NAN,
        .mask_fraction = t->compared ? (double)t->overlap.reference_px / pixels : NAN,
        .false_positive = t->compared ? t->overlap.false_positive : NAN,
        .false_negative = t->compared ? t->overlap.false_negative : NAN,
    };
    d->report.tile = &d->tile;
    d->report.region.mean_density = t->collagen.mean_density;
    for (size_t i = 0; i < t->picture_count; i++)
        d->picture[i] =
            (struct gsn_report_picture){ .id = t->picture[i].id,
                                         .title = t->picture[i].title,
                                         .caption = t->picture[i].caption,
                                         .png = { t->picture[i].png, t->picture[i].size,
                                                  t->picture[i].width, t->picture[i].height } };
    d->report.pictures = d->picture;
    d->report.picture_count = t->picture_count;
    if (t->fit.deviation_deg[0] > 0)
        value_row(d->measure, &d->report.measure_count, "red dye direction, uncertainty",
                  t->fit.deviation_deg[0], "deg");
    if (t->note[0])
        warn(d, t->note);
}

/* "panel 1: 1.152 +- 0.004 (12 sections), ..." */
static const char *gains_of(const struct gsn_assembly *a, struct draft *d)
{
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->panel_count && used < sizeof line; i++) {
        const struct gsn_stain_gain *gain = &a->panel[i].gain;
        int n;

        if (!a->panel[i].opened)
            continue;
        n = snprintf(line + used, sizeof line - used, "%spanel %u: %.3f +- %.3f (%u sections)",
                     used ? ", " : "", a->panel[i].stain.panel, gain->gain, gain->error,
                     gain->sections);
        used += n > 0 ? (size_t)n : 0;
    }
    return say(d, "%s", line);
}

/* "panel 1: glass even to 0.0012, yellow to red 0.54; ..." */
static const char *light_of(const struct gsn_assembly *a, struct draft *d)
{
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->panel_count && used < sizeof line; i++) {
        const struct gsn_assembly_panel *p = &a->panel[i];
        const double ratio = gsn_tone_yellow_to_red(&p->tone);
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
    return say(d, "%s", line);
}

/* "panel 1: x 1.067, -0.004; ..." */
static const char *levels_of(const struct gsn_assembly *a, struct draft *d)
{
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->panel_count && used < sizeof line; i++) {
        const struct gsn_assembly_panel *p = &a->panel[i];
        int n;

        if (!p->levelled)
            continue;
        n = snprintf(line + used, sizeof line - used, "%spanel %u: x %.3f, %+.3f", used ? "; " : "",
                     p->stain.panel, p->level.gain, p->level.offset);
        used += n > 0 ? (size_t)n : 0;
    }
    return say(d, "%s", line);
}

/* "dentine 0.567 +- 0.011 (baseline 0.540); ..." */
static const char *tissues_of(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    char line[600] = "";
    size_t used = 0;

    for (size_t k = 0; k < GSN_UNTREATED_KINDS && used < sizeof line; k++) {
        const struct gsn_level_tissue *t = &e->assembly->levelling.tissue[k];
        char control[48] = "";
        int n;

        if (isnan(t->value))
            continue;
        if (d->linked && !isnan(b->tissue[k].value))
            (void)snprintf(control, sizeof control, " (baseline %.3f)", b->tissue[k].value);
        n = snprintf(line + used, sizeof line - used, "%s%s %.3f +- %.3f%s", used ? "; " : "",
                     TISSUE_NAMES[k], t->value, t->error, control);
        used += n > 0 ? (size_t)n : 0;
    }
    return say(d, "%s", used ? line : "none was found");
}

static void fill_levels(const struct gsn_evidence *e, struct draft *d)
{
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;

    if (!e->assembly || !e->assembly->levelling.done)
        return;
    text_row(rows, count, "stain of each panel against the panels' mean",
             levels_of(e->assembly, d));
    value_row(rows, count, "share of the differences between panels that was taken out",
              100 * e->assembly->levelling.fit.kept, "%");
    text_row(rows, count, "untreated tissue, density on the panels' common scale",
             tissues_of(e, d));
}

static void fill_parameters(const struct gsn_evidence *e, struct draft *d)
{
    const struct gsn_protocol *p = e->specimen->protocol;
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;

    if (p->kind == GSN_KIND_SECTIONS) {
        value_row(rows, count, "interval", p->interval_um, "um");
        text_row(rows, count, "layout",
                 say(d, "%u rows x %u columns, %s", p->rows, p->columns,
                     p->order == GSN_STATED_ROW      ? "row by row"
                     : p->order == GSN_STATED_COLUMN ? "column by column"
                                                     : "snake"));
        text_row(rows, count, "block frame",
                 p->has_markers ? "the marks stated in job.json" : "the stack's own mean triangle");
        if (p->batch[0])
            text_row(rows, count, "stain batch", p->batch);
        if (p->reference_tissue.kind != GSN_REGION_NONE && e->assembly)
            text_row(rows, count, "stain gains", gains_of(e->assembly, d));
        if (p->stained[0])
            text_row(rows, count, "stained", p->stained);
        if (p->scanned[0])
            text_row(rows, count, "scanned", p->scanned);
        if (p->yellow_to_red[0] > 0)
            text_row(rows, count, "yellow to red, allowed",
                     say(d, "%g to %g", p->yellow_to_red[0], p->yellow_to_red[1]));
        if (e->assembly && e->assembly->grid)
            text_row(rows, count, "light and bath", light_of(e->assembly, d));
        fill_levels(e, d);
    }
    if (p->px_um > 0)
        value_row(rows, count, "pixel size, stated", p->px_um, "um");
    if (p->kind != GSN_KIND_VOLUME) {
        text_row(rows, count, "transfer curve, stated",
                 p->transfer == GSN_STATED_LINEAR ? "linear"
                 : p->transfer == GSN_STATED_SRGB ? "sRGB"
                                                  : "not stated");
        text_row(rows, count, "dye vectors", dyes_of(e));
    }
    if (e->account) {
        value_row(rows, count, "spline degree", gsn_dms_degree(e->account->space), "");
        value_row(rows, count, "fit tolerance", e->account->tolerance, "density");
        value_row(rows, count, "smoothing", e->account->smoothing, "");
    }
    if (p->unknown)
        warn(d, say(d, "job.json has keys that are not known and were not used: %s", p->unknown));
    d->report.parameters = rows;
}

/* ---- verdict and bytes ------------------------------------------------------------------- */

static void judge(const struct gsn_evidence *e, struct draft *d)
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
        r->verdict_reason = e->withheld;
    } else if (stated && isnan(r->loss_percent)) {
        r->verdict = GSN_REPORT_WITHHELD;
        r->verdict_reason = r->loss_reason;
    } else if (d->warning_count > 0) {
        r->verdict = GSN_REPORT_WARNED;
        r->verdict_reason = d->warning[0];
    }
}

static void measure_row(struct gsn_specimen_result *result, const char *name, double value,
                        double lower, double upper, const char *unit)
{
    if (result->measure_count < GSN_SPECIMEN_MEASURES && !isnan(value))
        result->measure[result->measure_count++] = (struct gsn_specimen_measure){
            .name = name, .value = value, .lower = lower, .upper = upper, .unit = unit
        };
}

static void keep_measures(const struct gsn_evidence *e, const struct draft *d,
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
    if (density_error(e) > 0)
        measure_row(result, "mean_density_error", density_error(e), NAN, NAN, "density");
    if (own_scale_error(e) > 0)
        measure_row(result, "own_scale_error", own_scale_error(e), NAN, NAN, "density");
    for (unsigned t = 0; e->assembly && e->account && t < GSN_UNTREATED_KINDS; t++) {
        const struct gsn_level_tissue *tissue = &e->assembly->levelling.tissue[t];

        measure_row(result, gsn_specimen_tissue_measure(t), tissue->value,
                    tissue->value - 1.96 * tissue->error, tissue->value + 1.96 * tissue->error,
                    "density");
    }
    measure_row(result, "loss", r->loss_percent, d->loss_low, d->loss_high, "%");
    measure_row(result, "loss_points", r->loss_points, NAN, NAN, "points");
    if (e->tile && e->tile->compared)
        measure_row(result, "dice", e->tile->overlap.dice, NAN, NAN, "");
    for (size_t i = 0; i < r->volume_count; i++)
        measure_row(result, volumes[i], 0.5 * (r->volumes[i].lower_mm3 + r->volumes[i].upper_mm3),
                    r->volumes[i].lower_mm3, r->volumes[i].upper_mm3, "mm3");
    if (r->registration)
        measure_row(result, "fle", r->registration->fle_um, NAN, NAN, "um");
}

static int write_report(const struct gsn_evidence *e, struct draft *d,
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

/* Volumes that are kept as files beside the report. */
static int fill_outputs(const struct gsn_specimen_result *result, struct draft *d,
                        struct gsn_error *err)
{
    int r;

    if (!result->colour)
        return GSN_OK;
    r = gsn_sha256(result->colour, result->colour_size, &d->colour, err);
    if (r < 0)
        return r;
    d->output = (struct gsn_report_input){ .name = "colour.nrrd",
                                           .sha256 = d->colour.hex,
                                           .size = result->colour_size };
    d->report.outputs = &d->output;
    d->report.output_count = 1;
    return GSN_OK;
}

int gsn_summarise(const struct gsn_evidence *e, struct gsn_specimen_result *result,
                  struct gsn_error *err)
{
    struct draft d;
    int r = draft_init(&d, e->assembly ? e->assembly->section_count : 0,
                       e->assembly ? e->assembly->panel_count : 0, e->specimen->input_count, err);

    if (r < 0)
        return r;
    fill_head(e, &d);
    if (e->assembly)
        fill_assembly(e, &d);
    if (e->account) {
        fill_figures(e, &d);
        fill_bridge(e, &d);
        find_link(e, &d);
        fill_evenness(e, &d);
        if (d.linked)
            fill_link(e, &d);
    }
    if (e->tile)
        fill_tile(e, &d);
    fill_definition(e, &d);
    if (e->specimen->protocol->kind == GSN_KIND_SECTIONS)
        fill_loss(e, &d);
    fill_parameters(e, &d);
    judge(e, &d);
    r = fill_outputs(result, &d, err);
    if (r >= 0)
        r = write_report(e, &d, result, err);
    draft_done(&d);
    return r;
}
