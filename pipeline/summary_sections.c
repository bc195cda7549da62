/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include "pipeline/assembly_order.h"
#include "pipeline/assembly_tissue.h"
#include "pipeline/conditions.h"
#include "pipeline/pose_words.h"
#include "pipeline/register/panel/slots.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Glass pixels at the highest code hide how bright the glass was. */
static const double MOST_OVEREXPOSED = 0.02;

static size_t split_flags(struct gsn_draft *d, const char *flags, const char *ret_flag[16])
{
    size_t count = 0;

    for (const char *at = flags; *at && count < 16;) {
        const size_t length = strcspn(at, " ");

        if (length > 0)
            ret_flag[count++] = gsn_draft_say(d, "%.*s", (int)length, at);
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
                         int strained, struct gsn_draft *d, size_t i)
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

static void exclude(struct gsn_draft *d, const char *what, const char *reason)
{
    d->exclusion[d->exclusion_count++] =
        (struct gsn_report_exclusion){ .what = what, .reason = reason };
}

static const char *reason_of(struct gsn_draft *d, const struct gsn_assembly_section *s)
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
        return gsn_draft_say(d, "%s", sentence);
    }
    if (strstr(s->flags, "tissue-unsure"))
        return "its tissue fits its neighbours' in more ways than one, or only that of sections "
               "that "
               "do: look at it and at those beside it";
    if (strstr(s->flags, "no-tissue-fits"))
        return "its tissue fits none of the three sections before and after it: look at it";
    if (s->finding.contradicted)
        return "what looks like its marks lays it elsewhere than its neighbours' tissue does: look "
               "at it";
    if (strstr(s->flags, "ambiguous-marks"))
        return "more than one choice of marks fits the triangle: look at it";
    return "fewer than two marks were found: look at it";
}

/* ---- what is left out, summed up by reason ------------------------------------------------- */

/* "2.1 to 2.12, 4.5": the sections that share the reason of section first. */
static const char *list_sections(const struct gsn_assembly *a, const char *const *reason,
                                 size_t first, size_t *ret_count, struct gsn_draft *d)
{
    const struct gsn_assembly_section *from = NULL, *to = NULL;
    char list[300] = "";
    size_t count = 0, used = 0;

    for (size_t i = first; i <= a->section_count; i++) {
        const int same =
            i < a->section_count && reason[i] && gsn_draft_same_reason(reason[i], reason[first]);
        const struct gsn_assembly_section *s = same ? &a->section[i] : NULL;
        const int goes_on = s && to && s->seen.serial == to->seen.serial + 1;

        if (i < a->section_count && !same)
            continue;
        if (count > 0 && !goes_on && used + 40 < sizeof list) {
            used += (size_t)snprintf(list + used, sizeof list - used, "%s%u.%u", used ? ", " : "",
                                     from->panel, from->seen.slot + 1);
            if (to != from)
                used += (size_t)snprintf(list + used, sizeof list - used, " to %u.%u", to->panel,
                                         to->seen.slot + 1);
        }
        if (!goes_on)
            from = s;
        to = s;
        count += (size_t)same;
    }
    *ret_count = count;
    return gsn_draft_say(d, "%s", list);
}

static void exclude_sections(const struct gsn_assembly *a, struct gsn_draft *d)
{
    gsn_auto_mem(const char *) reason = gsn_alloc_array(a->section_count + 1, sizeof *reason);

    if (!reason) {
        d->out_of_memory = 1;
        return;
    }
    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].state == GSN_SECTION_HELD || a->section[i].state == GSN_SECTION_MISSING)
            reason[i] = reason_of(d, &a->section[i]);
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];
        const char *list;
        size_t count;

        for (size_t k = 0; k < i && reason[i]; k++)
            if (reason[k] && gsn_draft_same_reason(reason[k], reason[i]))
                reason[i] = NULL;
        if (!reason[i])
            continue;
        list = list_sections(a, reason, i, &count, d);
        exclude(d,
                count == 1 ? gsn_draft_say(d, "section %u.%u", s->panel, s->seen.slot + 1)
                           : gsn_draft_say(d, "%zu sections: %s", count, list),
                reason[i]);
    }
}

/* One row for each defect: what it covers in all sections, and where most of the region. */
static void exclude_masked(const struct gsn_assembly *a, struct gsn_draft *d)
{
    for (unsigned bit = 0; bit < GSN_DEFECTS; bit++) {
        const struct gsn_assembly_section *worst = NULL;
        double area_um2 = 0;
        size_t count = 0;

        for (size_t i = 0; 1u << bit != GSN_DEFECT_HALO && i < a->section_count; i++) {
            const struct gsn_assembly_section *s = &a->section[i];

            if (!(s->masked.area_um2[bit] > 0))
                continue;
            area_um2 += s->masked.area_um2[bit];
            count++;
            if (!worst || s->region_by[bit] > worst->region_by[bit])
                worst = s;
        }
        if (!worst)
            continue;
        exclude(d,
                gsn_draft_say(
                    d, "%.3g mm2 in %zu section%s; most of the region in section %u.%u: %.1f %%",
                    1e-6 * area_um2, count, count == 1 ? "" : "s", worst->panel,
                    worst->seen.slot + 1, 100 * worst->region_by[bit]),
                gsn_draft_say(d, "%s: %s", gsn_defect_word(bit), gsn_defect_reason(bit)));
    }
}

/* Panels that give nothing, each reason once with the files that have it. */
static void exclude_panels(const struct gsn_assembly *a, struct gsn_draft *d)
{
    for (size_t i = 0; i < a->panel_count; i++) {
        const struct gsn_specimen_panel *first = a->panel[i].given;
        char files[300] = "";
        size_t used = 0, count = 0;
        int told = first->section_count > 0;

        for (size_t k = 0; k < i; k++)
            told |= a->panel[k].given->section_count == 0 &&
                    gsn_draft_same_reason(a->panel[k].given->message, first->message);
        for (size_t k = i; !told && k < a->panel_count; k++) {
            const struct gsn_specimen_panel *p = a->panel[k].given;

            if (p->section_count > 0 || !gsn_draft_same_reason(p->message, first->message))
                continue;
            count++;
            if (used + strlen(p->file) + 4 < sizeof files)
                used += (size_t)snprintf(files + used, sizeof files - used, "%s%s",
                                         used ? ", " : "", p->file);
        }
        if (told)
            continue;
        exclude(d,
                count == 1 ? gsn_draft_say(d, "panel file %s", files)
                           : gsn_draft_say(d, "%zu panel files: %s", count, files),
                first->message);
        gsn_draft_warn(d, gsn_draft_say(d, "%s %s not used: %s", files, count == 1 ? "was" : "were",
                                        first->message));
    }
}

static void fill_sections(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_assembly *a = e->assembly;
    size_t doubtful = 0, held = 0, missing = 0;
    char sentence[GSN_POSE_SENTENCE];

    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];

        fill_section(s, e->specimen->protocol,
                     (a->summary.stretches && a->strain_mode != GSN_STRAIN_RIGID) ||
                         a->refinement.done,
                     d, i);
        doubtful += s->state == GSN_SECTION_DOUBTFUL;
        held += s->state == GSN_SECTION_HELD;
        missing += s->state == GSN_SECTION_MISSING;
        if (s->finding.contradicted) {
            gsn_tissue_sentence(s, sentence);
            gsn_draft_warn(d, gsn_draft_say(d, "%s", sentence));
        }
    }
    exclude_sections(a, d);
    exclude_masked(a, d);
    doubtful -= gsn_assembly_by_tissue(a);
    if (gsn_assembly_by_tissue(a))
        gsn_draft_warn(
            d, gsn_draft_say(d,
                             "%zu section%s no marks to rely on and %s laid by the tissue of the "
                             "neighbours, flagged by-tissue: compare with them",
                             gsn_assembly_by_tissue(a),
                             gsn_assembly_by_tissue(a) == 1 ? " has" : "s have",
                             gsn_assembly_by_tissue(a) == 1 ? "was" : "were"));
    if (doubtful)
        gsn_draft_warn(
            d, gsn_draft_say(d, "%zu section%s laid by two marks only: compare with the neighbours",
                             doubtful, doubtful == 1 ? " was" : "s were"));
    if (held)
        gsn_draft_warn(d, gsn_draft_say(d, "%zu section%s held and not used", held,
                                        held == 1 ? " is" : "s are"));
    if (missing)
        gsn_draft_warn(
            d, gsn_draft_say(
                   d, "%zu expected section%s missing; nothing was moved up to close the gap",
                   missing, missing == 1 ? " is" : "s are"));
    d->report.sections = d->section;
    d->report.section_count = a->section_count;
}

static void fill_panels(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_assembly *a = e->assembly;

    exclude_panels(a, d);
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
        if (p->note[0])
            gsn_draft_warn(d, gsn_draft_say(d, "panel %u: %s", p->given->number, p->note));
        if (p->opened && p->glass.overexposed > MOST_OVEREXPOSED)
            gsn_draft_warn(
                d, gsn_draft_say(
                       d,
                       "panel %u: %.0f %% of its glass is overexposed, so its white point is a "
                       "guess from below: scan with less exposure",
                       p->given->number, 100 * p->glass.overexposed));
    }
    d->report.panels = d->panel;
    d->report.panel_count = a->panel_count;
}

static void fill_registration(const struct gsn_assembly *a, const struct gsn_protocol *protocol,
                              struct gsn_draft *d)
{
    static const char *const by[] = { [GSN_STATED_MARKS] = "marks",
                                      [GSN_STATED_TISSUE] = "tissue",
                                      [GSN_STATED_MARKS_AND_TISSUE] = "marks+tissue" };
    char sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE];
    size_t count;
    struct gsn_report_registration *r = &d->registration;
    double sum = 0, tre = 0;

    *r = (struct gsn_report_registration){ .fle_um = a->summary.fle_um,
                                           .by = by[protocol->registration],
                                           .comparison_um = NAN };
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
    d->report.registration = r;
    if (a->by_tissue.done) {
        r->fle_um = r->rms_residual_um = r->worst_residual_um = NAN;
        r->comparison_um = a->by_tissue.summary.usual;
        gsn_by_tissue_sentence(&a->by_tissue, r->worst_tre_um, sentence[0]);
        gsn_draft_warn(d, gsn_draft_say(d, "%s", sentence[0]));
        return;
    }
    count = gsn_pose_sentences(&a->summary, &a->panel_stretch, a->strain_mode,
                               protocol->interval_um, sentence);
    for (size_t i = 0; i < count; i++)
        gsn_draft_warn(d, gsn_draft_say(d, "%s", sentence[i]));
    if (a->strain_mode == GSN_STRAIN_TISSUE) {
        gsn_refinement_sentence(&a->refinement, sentence[0]);
        gsn_draft_warn(d, gsn_draft_say(d, "%s", sentence[0]));
    }
}

/* What the panels tell of lamp, bath, knife and glass. */
static void fill_conditions(const struct gsn_evidence *e, struct gsn_draft *d)
{
    struct gsn_conditions_words words = { 0 };

    if (gsn_conditions_words(e->assembly, e->specimen->protocol, &words) < 0)
        d->out_of_memory = 1;
    for (size_t i = 0; i < words.count; i++)
        gsn_draft_warn(d, gsn_draft_say(d, "%s", words.sentence[i]));
    gsn_conditions_words_done(&words);
}

/* Sentences; the sections themselves are flagged whatever their number. */
enum { MOST_OUT_OF_ORDER = 16 };

static void fill_order(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_assembly *a = e->assembly;
    char sentence[GSN_POSE_SENTENCE];

    for (size_t i = 0; a->sequence && i < a->sequence->count && i < MOST_OUT_OF_ORDER; i++) {
        gsn_section_order_sentence(&a->sequence->finding[i],
                                   e->specimen->protocol->rows * e->specimen->protocol->columns,
                                   sentence);
        gsn_draft_warn(d, gsn_draft_say(d, "%s", sentence));
    }
}

void gsn_draft_assembly(const struct gsn_evidence *e, struct gsn_draft *d)
{
    fill_sections(e, d);
    fill_panels(e, d);
    fill_conditions(e, d);
    fill_order(e, d);
    if (e->assembly->solved)
        fill_registration(e->assembly, e->specimen->protocol, d);
    else
        gsn_draft_warn(d, e->assembly->unsolved);
}
