/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include "pipeline/assembly_order.h"
#include "pipeline/pose_words.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* "panel 1: 1.152 +- 0.004 (12 sections), ..." */
static const char *gains_of(const struct gsn_assembly *a, struct gsn_draft *d)
{
    const char *unit = a->by_standards ? "standards" : "sections";
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->panel_count && used < sizeof line; i++) {
        const struct gsn_stain_gain *gain = &a->panel[i].gain;
        int n;

        if (!a->panel[i].opened)
            continue;
        n = snprintf(line + used, sizeof line - used, "%spanel %u: %.3f +- %.3f (%u %s)",
                     used ? ", " : "", a->panel[i].stain.panel, gain->gain, gain->error,
                     gain->sections, unit);
        used += n > 0 ? (size_t)n : 0;
    }
    return gsn_draft_say(d, "%s", line);
}

/* "panel 1: glass even to 0.0012, yellow to red 0.54; ..." */
static const char *light_of(const struct gsn_assembly *a, struct gsn_draft *d)
{
    char line[1000] = "";
    size_t used = 0;

    for (size_t i = 0; i < a->panel_count && used < sizeof line; i++) {
        const struct gsn_assembly_panel *p = &a->panel[i];
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
    return gsn_draft_say(d, "%s", line);
}

/* "panel 1: x 1.067, -0.004; ..." */
static const char *levels_of(const struct gsn_assembly *a, struct gsn_draft *d)
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
    return gsn_draft_say(d, "%s", line);
}

/* "dentine 0.567 +- 0.011 (baseline 0.540); ..." */
static const char *tissues_of(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    char line[600] = "";
    size_t used = 0;

    for (size_t k = 0; k < GSN_UNTREATED_KINDS && used < sizeof line; k++) {
        const struct gsn_control_tissues *tissues = &e->assembly->levelling.tissues;
        char control[48] = "";
        int n;

        if (isnan(tissues->value[k]))
            continue;
        if (d->linked && !isnan(b->tissues.value[k]))
            (void)snprintf(control, sizeof control, " (baseline %.3f)", b->tissues.value[k]);
        n = snprintf(line + used, sizeof line - used, "%s%s %.3f +- %.3f%s", used ? "; " : "",
                     gsn_draft_tissue_name((unsigned)k), tissues->value[k],
                     gsn_control_tissue_error(tissues, k), control);
        used += n > 0 ? (size_t)n : 0;
    }
    return gsn_draft_say(d, "%s", used ? line : "none was found");
}

static void fill_levels(const struct gsn_evidence *e, struct gsn_draft *d)
{
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;

    if (!e->assembly || !e->assembly->levelling.done)
        return;
    gsn_draft_text(rows, count, "stain of each panel against the panels' mean",
                   levels_of(e->assembly, d));
    gsn_draft_value(rows, count, "share of the differences between panels that was taken out",
                    100 * e->assembly->levelling.fit.kept, "%");
    if (e->assembly->levelling.turns.freedom > 0)
        gsn_draft_value(rows, count, "scatter of the dye vectors from panel to panel, one turn",
                        180 / M_PI * sqrt(e->assembly->levelling.turns.variance), "deg");
    gsn_draft_text(rows, count, "untreated tissue, density on the panels' common scale",
                   tissues_of(e, d));
}

/* What the tissue could not have shown of the sections' order is no fault of this stack, so it is
 * no warning. */
static void fill_blindness(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_sequence *sequence = e->assembly ? e->assembly->sequence : NULL;
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;
    char sentence[GSN_POSE_SENTENCE];

    if (sequence && gsn_section_order_blind_to_swaps(sequence, sentence))
        gsn_draft_text(rows, count, "swapped sections", gsn_draft_say(d, "%s", sentence));
    if (sequence && gsn_section_order_blind_to_duplicates(sequence, sentence))
        gsn_draft_text(rows, count, "sections twice", gsn_draft_say(d, "%s", sentence));
}

/* Where the sections are laid by their tissue alone. */
static const char *frame_of(const struct gsn_assembly *a, struct gsn_draft *d)
{
    const struct gsn_assembly_section *s = &a->section[a->by_tissue.frame];

    return gsn_draft_say(
        d,
        "the upright picture of panel %u, pixels times their size, as section %u in "
        "its slot %u lies there",
        s->panel, s->seen.serial, s->seen.slot + 1);
}

void gsn_draft_parameters(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_protocol *p = e->specimen->protocol;
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;

    if (p->kind == GSN_KIND_SECTIONS) {
        gsn_draft_value(rows, count, "interval", p->interval_um, "um");
        gsn_draft_text(rows, count, "layout",
                       gsn_draft_say(d, "%u rows x %u columns, %s", p->rows, p->columns,
                                     p->order == GSN_STATED_ROW      ? "row by row"
                                     : p->order == GSN_STATED_COLUMN ? "column by column"
                                                                     : "snake"));
        gsn_draft_text(rows, count, "block frame",
                       e->assembly && e->assembly->by_tissue.done ? frame_of(e->assembly, d)
                       : p->registration == GSN_STATED_TISSUE     ? "none"
                       : p->has_markers                           ? "the marks stated in job.json"
                                        : "the stack's own mean triangle");
        fill_blindness(e, d);
        if (p->batch[0])
            gsn_draft_text(rows, count, "stain batch", p->batch);
        if (e->assembly &&
            (e->assembly->by_standards || p->reference_tissue.kind != GSN_REGION_NONE))
            gsn_draft_text(rows, count, "stain gains", gains_of(e->assembly, d));
        if (p->stained[0])
            gsn_draft_text(rows, count, "stained", p->stained);
        if (p->scanned[0])
            gsn_draft_text(rows, count, "scanned", p->scanned);
        if (p->yellow_to_red[0] > 0)
            gsn_draft_text(rows, count, "yellow to red, allowed",
                           gsn_draft_say(d, "%g to %g", p->yellow_to_red[0], p->yellow_to_red[1]));
        if (e->assembly && e->assembly->grid)
            gsn_draft_text(rows, count, "light and bath", light_of(e->assembly, d));
        fill_levels(e, d);
    }
    /* A tile's are told with its figures, as stated or as assumed. */
    if (p->px_um > 0 && !e->tile)
        gsn_draft_value(rows, count, "pixel size, stated", p->px_um, "um");
    if (p->kind != GSN_KIND_VOLUME && !e->tile) {
        gsn_draft_text(rows, count, "transfer curve, stated",
                       p->transfer == GSN_STATED_LINEAR ? "linear"
                       : p->transfer == GSN_STATED_SRGB ? "sRGB"
                                                        : "not stated");
        gsn_draft_text(rows, count, "dye vectors", gsn_draft_dyes(e));
    }
    if (e->account) {
        gsn_draft_value(rows, count, "spline degree", gsn_dms_degree(e->account->space), "");
        gsn_draft_value(rows, count, "fit tolerance", e->account->tolerance, "density");
        gsn_draft_value(rows, count, "smoothing", e->account->smoothing, "");
    }
    if (p->unknown)
        gsn_draft_warn(
            d, gsn_draft_say(d, "job.json has keys that are not known and were not used: %s",
                             p->unknown));
    d->report.parameters = rows;
}
