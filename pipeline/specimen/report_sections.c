/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The report's part about sections, panels and registration, and what a person can decide.
 *
 * 1. What the poses say about the whole stack, in sentences: flips, pixel size, axes, strain,
 * tissue.
 * 2. One row a section, with its flags in words; sections left out are summed up by their reason,
 *    defects by their area, panels that give nothing by their message.
 * 3. Registration figures: residuals, predicted errors, by what the sections were placed.
 * 4. Candidates to choose from, with the command that chooses; decisions and what became of them.
 */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/strain.h"
#include "pipeline/register/tissue/pose_check.h"
#include "pipeline/specimen/quality_control.h"
#include "pipeline/specimen/reconstruction.h"
#include "pipeline/specimen/section_order.h"
#include "pipeline/specimen/section_pictures.h"
#include "pipeline/stain/artefact/detection.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

/* A mean triangle larger or smaller than declared by more than this: the pixel size is wrong. */
static const double SCALE_TOLERANCE = 0.01;

struct sentence_list {
    char (*sentence)[GSN_POSE_SENTENCE];
    size_t count;
};

static void add_line(struct sentence_list *list, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

static void add_line(struct sentence_list *list, const char *format, ...)
{
    va_list args;

    va_start(args, format);
    (void)vsnprintf(list->sentence[list->count++], GSN_POSE_SENTENCE, format, args);
    va_end(args);
}

static double length_of(struct gsn_point p)
{
    return hypot(p.x, p.y);
}

static void say_axes(const struct gsn_axes *axes, double interval_um, struct sentence_list *list)
{
    const double per_mm = 1000 / interval_um;

    if (axes->slanted)
        add_line(
            list,
            "the laser's axes are not parallel: against what all three do together, marks 1, 2 and "
            "3 move by %.1f, %.1f and %.1f um for each mm of depth (standard deviation %.1f). The "
            "poses follow them. A tilt that all three share moves no mark against the others: no "
            "section can show it, and it would remain in the volume",
            per_mm * length_of(axes->slope[0]), per_mm * length_of(axes->slope[1]),
            per_mm * length_of(axes->slope[2]), per_mm * axes->slope_sd);
    if (axes->bent)
        add_line(
            list,
            "the laser's axes are bent: against what all three do together, marks 1, 2 and 3 lie "
            "%.0f, %.0f and %.0f um farther off at the ends of the stack than in its middle "
            "(standard deviation %.0f). The poses follow them",
            length_of(axes->bend[0]), length_of(axes->bend[1]), length_of(axes->bend[2]),
            axes->bend_sd);
}

static const char *what_became_of_strain(const struct gsn_pose_summary *summary,
                                         enum gsn_strain_mode mode)
{
    if (mode != GSN_STRAIN_CORRECTED && mode != GSN_STRAIN_TISSUE)
        return "The poses stay rigid, and the predicted error includes it";
    return summary->as_declared
               ? "Each was stretched back by what its own marks make likely, as the job asks, and "
                 "all of them by what they share against the declared marks"
               : "Each was stretched back by what its own marks make likely, as the job asks";
}

/* The tensor's parts along its own directions differ by twice the deviator. */
static void say_strain(const struct gsn_pose_summary *summary, enum gsn_strain_mode mode,
                       struct sentence_list *list)
{
    if (!summary->stretches || mode == GSN_STRAIN_RIGID)
        return;
    add_line(
        list,
        "the sections of this block differ in shape by more than their marks' errors: standard "
        "deviation %.1f %% in size and %.1f %% between directions. %s",
        100 * summary->strain_sd[0], 200 * hypot(summary->strain_sd[1], summary->strain_sd[2]),
        what_became_of_strain(summary, mode));
}

static void say_panel(const struct gsn_strain_common *panel, struct sentence_list *list)
{
    if (!panel->anisotropic)
        return;
    add_line(
        list,
        "all sections are %.1f %% longer along the scan's x than along its y (standard deviation "
        "%.1f %%), %s: the scan's pixels are not square, such as by a wrong speed of its carriage. "
        "That is the device's fault, not the tissue's; have it looked at and scan again",
        100 * panel->along_x, 100 * panel->sd,
        panel->from_declared ? "measured on the declared triangle"
                             : "whichever way they are turned");
}

size_t gsn_pose_sentences(const struct gsn_pose_summary *summary,
                          const struct gsn_strain_common *panel, enum gsn_strain_mode mode,
                          double interval_um,
                          char ret_sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE])
{
    struct sentence_list list = { ret_sentence, 0 };

    if (!summary->flips_told)
        add_line(
            &list,
            "flip not detectable on this block: two sides of the marks' triangle differ by only "
            "%.1f sigma, so a section mounted face down looks like one that is not. Burn a "
            "triangle whose sides differ by more",
            summary->isosceles_sigma);
    if (fabs(summary->scale_vs_declared - 1) > SCALE_TOLERANCE)
        add_line(
            &list,
            "the marks' triangle is %.2f times the declared one: the pixel size is wrong, and so "
            "are all volumes",
            summary->scale_vs_declared);
    say_panel(panel, &list);
    say_axes(&summary->axes, interval_um, &list);
    say_strain(summary, mode, &list);
    return list.count;
}

/* What laying a stack by its tissue alone cannot know; worst_um: the largest predicted error. */
static void say_by_tissue(const struct gsn_by_tissue *by_tissue, double worst_um,
                          char ret_sentence[GSN_POSE_SENTENCE])
{
    (void)snprintf(
        ret_sentence, GSN_POSE_SENTENCE,
        "the sections were laid by their tissue alone, one on the next to %.3g um, and the "
        "farthest from the section that is the frame to %.3g um. What all tissue of the "
        "block does alike no comparison shows: a block that is bent or slanted comes out "
        "straight and upright, and where its shape changes along the cut that counts as "
        "how it was mounted. Lengths and volumes hold from one section to the next, not "
        "the course of a structure through the block: marks would show it",
        by_tissue->summary.usual, worst_um);
}

void gsn_refinement_sentence(const struct gsn_refinement *r, char ret_sentence[GSN_POSE_SENTENCE])
{
    if (!r->done) {
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "the sections were not laid by their tissue as the job asks: %s. They lie "
                       "as their marks have them",
                       r->why);
        return;
    }
    (void)snprintf(
        ret_sentence, GSN_POSE_SENTENCE,
        "the sections were laid on by their tissue, as the job asks: %zu of %zu were "
        "compared with up to four on either side, within %.0f um of the region's centre; "
        "they moved by %.1f um (root mean square over the region), and their areas by "
        "%+.2f %% (standard deviation %.2f %%). The marks' errors are %.1f times, the "
        "comparisons' %.1f times what was expected. A slant of the tissue over many "
        "sections is left to the marks",
        r->compared, r->sections, r->radius_um, r->moved_um, 100 * r->area_mean, 100 * r->area_sd,
        r->factor[0], r->factor[1]);
}

void gsn_pose_reason(const struct gsn_pose *pose, char ret_sentence[GSN_POSE_SENTENCE])
{
    const struct gsn_pose_candidate *c = pose->candidate;

    if (pose->state != GSN_POSE_OK) {
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "its two marks are not as far apart as in the other sections: one of them "
                       "is wrong, or the section is folded, torn or stretched; look at it");
        return;
    }
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "its three marks do not fit the stack's triangle: one is wrong, or the section "
                   "is torn or stretched; look at it. Laid on two marks it has three poses: "
                   "without mark 1 (%.0f %% likely by the marks, predicted error %.0f um), without "
                   "mark 2 (%.0f %%, %.0f um), without mark 3 (%.0f %%, %.0f um)",
                   100 * c[0].share, c[0].tre_um, 100 * c[1].share, c[1].tre_um, 100 * c[2].share,
                   c[2].tre_um);
}

void gsn_tissue_sentence(const struct gsn_section *section, enum gsn_section_state state,
                         char ret_sentence[GSN_POSE_SENTENCE])
{
    const struct gsn_tissue_finding *f = &section->finding;

    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "section %u.%u: what looks like its marks lays it %.0f um from "
                   "where the tissue of its neighbours does%s; up to %.0f um would be usual here. "
                   "%s: look at it, and say with `gieson decide` if they are its marks",
                   section->panel, section->seen.slot + 1, f->apart,
                   f->other_face ? ", and with the other face up" : "", f->limit,
                   state == GSN_SECTION_HELD ? "The tissue alone does not lay it, so it is held"
                                             : "It was laid by the tissue");
}

/* Glass pixels at the highest code hide how bright the glass was. */
static const double MOST_OVEREXPOSED = 0.02;

static size_t list_flags(struct gsn_builder *d, const struct gsn_section_flags *flags,
                         const char *ret_flag[GSN_BUILDER_FLAGS])
{
    size_t count = 0;

    for (; count < flags->count && count < GSN_BUILDER_FLAGS; count++) {
        char word[GSN_FLAG_WORD];

        gsn_flags_word(flags, count, word);
        ret_flag[count] = gsn_builder_say(d, "%s", word);
    }
    return count;
}

static void fill_masked(const struct gsn_section_density *s, struct gsn_report_section *row)
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

static void fill_section(const struct gsn_reconstruction *a, size_t i, const struct gsn_protocol *p,
                         int strained, struct gsn_builder *d)
{
    const struct gsn_section *s = &a->poses.section[i];
    const struct gsn_section_density *shown = &a->densities.section[i];
    const struct gsn_fiducial *mark = a->densities.marks[i].mark;
    const struct gsn_layout layout = gsn_protocol_layout(p);
    struct gsn_report_section *row = &d->section[i];

    *row = (struct gsn_report_section){
        .serial = s->seen.serial,
        .z_um = p->interval_um * (s->seen.serial + 0.5),
        .panel = s->panel,
        .slot = s->seen.slot,
        .state = gsn_section_state_name(shown->state),
        .flipped = s->pose.flipped,
        .rotated180 = s->pose.rotated180,
        .posed = s->posed,
        .panel_to_block_um = gsn_settled_pose(&s->pose.panel_to_block_um),
        .predicted_tre_um = s->posed ? s->pose.tre_um : NAN,
        .thumbnail = { .bytes = shown->thumbnail.png,
                       .size = shown->thumbnail.size,
                       .width = shown->thumbnail.width,
                       .height = shown->thumbnail.height },
        .aligned = { .bytes = shown->aligned.png,
                     .size = shown->aligned.size,
                     .width = shown->aligned.width,
                     .height = shown->aligned.height },
        .tissue_apart_um = s->finding.compared ? s->finding.apart : NAN,
        .tissue_limit_um = s->finding.compared ? s->finding.limit : NAN
    };
    if (s->posed && strained) {
        const struct gsn_strain_axes axes = gsn_strain_principal(s->pose.strain);

        row->strained = 1;
        row->strain_percent[0] = 100 * axes.most;
        row->strain_percent[1] = 100 * axes.least;
        row->strain_deg = axes.angle * 180 / M_PI;
    }
    gsn_panel_place(&layout, s->seen.slot, &row->row, &row->column);
    fill_masked(shown, row);
    row->flags = d->flag[i];
    row->flag_count = list_flags(d, &shown->flags, d->flag[i]);
    for (size_t m = 0; m < GSN_FIDUCIALS; m++) {
        row->marker_found[m] = mark[m].found;
        row->marker_px[m] = mark[m].px;
        row->residual_um[m] = s->posed ? s->pose.residual_um[m] : NAN;
        row->onto_um[m] =
            s->pose.state != GSN_POSE_NONE ? s->pose.onto_um[m] : (struct gsn_point){ NAN, NAN };
        row->off_um[m] = s->pose.off_um[m];
    }
}

static void add_exclusion(struct gsn_builder *d, const char *what, const char *reason)
{
    d->exclusion[d->exclusion_count++] =
        (struct gsn_report_exclusion){ .what = what, .reason = reason };
}

static const char *reason_of(struct gsn_builder *d, const struct gsn_section *s,
                             const struct gsn_section_density *shown)
{
    char sentence[GSN_POSE_SENTENCE];

    if (shown->state == GSN_SECTION_MISSING)
        return gsn_flags_has(&shown->flags, GSN_FLAG_NO_PANEL)
                   ? gsn_flag_reason(GSN_FLAG_NO_PANEL)
                   : "the slot is empty; the gap is kept at its place";
    if (gsn_flags_has(&shown->flags, GSN_FLAG_DUPLICATE_SERIAL))
        return gsn_flag_reason(GSN_FLAG_DUPLICATE_SERIAL);
    if (gsn_flags_has(&shown->flags, GSN_FLAG_CLIPPED))
        return gsn_flag_reason(GSN_FLAG_CLIPPED);
    if (gsn_flags_has(&shown->flags, GSN_FLAG_RESIDUAL)) {
        gsn_pose_reason(&s->pose, sentence);
        return gsn_builder_say(d, "%s", sentence);
    }
    if (gsn_flags_has(&shown->flags, GSN_FLAG_TISSUE_UNSURE))
        return gsn_flag_reason(GSN_FLAG_TISSUE_UNSURE);
    if (gsn_flags_has(&shown->flags, GSN_FLAG_NO_TISSUE_FITS))
        return gsn_flag_reason(GSN_FLAG_NO_TISSUE_FITS);
    if (s->finding.contradicted)
        return "what looks like its marks lays it elsewhere than its neighbours' tissue does: look "
               "at it";
    if (gsn_flags_has(&shown->flags, GSN_FLAG_AMBIGUOUS_MARKS))
        return gsn_flag_reason(GSN_FLAG_AMBIGUOUS_MARKS);
    return "fewer than two marks were found: look at it";
}

/* ---- what is left out, summed up by reason ------------------------------------------------- */

/* "2.1 to 2.12, 4.5": the sections that share the reason of section first. */
static const char *list_sections(const struct gsn_reconstruction *a, const char *const *reason,
                                 size_t first, size_t *ret_count, struct gsn_builder *d)
{
    const struct gsn_section *from = NULL, *to = NULL;
    char list[300] = "";
    size_t count = 0, used = 0;

    for (size_t i = first; i <= a->poses.section_count; i++) {
        const int same = i < a->poses.section_count && reason[i] &&
                         gsn_builder_same_reason(reason[i], reason[first]);
        const struct gsn_section *s = same ? &a->poses.section[i] : NULL;
        const int goes_on = s && to && s->seen.serial == to->seen.serial + 1;

        if (i < a->poses.section_count && !same)
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
    return gsn_builder_say(d, "%s", list);
}

static void exclude_sections(const struct gsn_reconstruction *a, struct gsn_builder *d)
{
    gsn_auto_mem(const char *) reason = gsn_alloc_array(a->poses.section_count + 1, sizeof *reason);

    if (!reason) {
        d->out_of_memory = 1;
        return;
    }
    for (size_t i = 0; i < a->poses.section_count; i++)
        if (a->densities.section[i].state == GSN_SECTION_HELD ||
            a->densities.section[i].state == GSN_SECTION_MISSING)
            reason[i] = reason_of(d, &a->poses.section[i], &a->densities.section[i]);
    for (size_t i = 0; i < a->poses.section_count; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const char *list;
        size_t count;

        for (size_t k = 0; k < i && reason[i]; k++)
            if (reason[k] && gsn_builder_same_reason(reason[k], reason[i]))
                reason[i] = NULL;
        if (!reason[i])
            continue;
        list = list_sections(a, reason, i, &count, d);
        add_exclusion(d,
                      count == 1 ? gsn_builder_say(d, "section %u.%u", s->panel, s->seen.slot + 1)
                                 : gsn_builder_say(d, "%zu sections: %s", count, list),
                      reason[i]);
    }
}

/* One row for each defect: what it covers in all sections, and where most of the region. */
static void exclude_masked(const struct gsn_reconstruction *a, struct gsn_builder *d)
{
    for (unsigned bit = 0; bit < GSN_DEFECTS; bit++) {
        const struct gsn_section_density *worst = NULL;
        const struct gsn_section *where = NULL;
        double area_um2 = 0;
        size_t count = 0;

        for (size_t i = 0; 1u << bit != GSN_DEFECT_HALO && i < a->poses.section_count; i++) {
            const struct gsn_section_density *s = &a->densities.section[i];

            if (!(s->masked.area_um2[bit] > 0))
                continue;
            area_um2 += s->masked.area_um2[bit];
            count++;
            if (!worst || s->region_by[bit] > worst->region_by[bit]) {
                worst = s;
                where = &a->poses.section[i];
            }
        }
        if (!worst)
            continue;
        add_exclusion(d,
                      gsn_builder_say(
                          d,
                          "%.3g mm2 in %zu section%s; most of the region in section %u.%u: %.1f %%",
                          1e-6 * area_um2, count, count == 1 ? "" : "s", where->panel,
                          where->seen.slot + 1, 100 * worst->region_by[bit]),
                      gsn_builder_say(d, "%s: %s", gsn_defect_word(bit), gsn_defect_reason(bit)));
    }
}

/* Panels that give nothing, each reason once with the files that have it. */
static void exclude_panels(const struct gsn_reconstruction *a, size_t slots, struct gsn_builder *d)
{
    for (size_t i = 0; i < a->densities.panel_count; i++) {
        const struct gsn_specimen_panel *first = a->densities.panel[i].given;
        char files[300] = "";
        size_t used = 0, count = 0;
        int told = first->section_count > 0;

        for (size_t k = 0; k < i; k++)
            told |= a->densities.panel[k].given->section_count == 0 &&
                    gsn_builder_same_reason(a->densities.panel[k].given->message, first->message);
        for (size_t k = i; !told && k < a->densities.panel_count; k++) {
            const struct gsn_specimen_panel *p = a->densities.panel[k].given;

            if (p->section_count > 0 || !gsn_builder_same_reason(p->message, first->message))
                continue;
            count++;
            if (used + strlen(p->file) + 4 < sizeof files)
                used += (size_t)snprintf(files + used, sizeof files - used, "%s%s",
                                         used ? ", " : "", p->file);
        }
        if (told)
            continue;
        add_exclusion(d,
                      count == 1 ? gsn_builder_say(d, "panel file %s", files)
                                 : gsn_builder_say(d, "%zu panel files: %s", count, files),
                      first->message);
        gsn_builder_warn_cost(d, (struct gsn_builder_cost){ .sections = count * slots },
                              gsn_builder_say(d, "%s %s not used: %s", files,
                                              count == 1 ? "was" : "were", first->message));
    }
}

static void fill_sections(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_reconstruction *a = e->reconstruction;
    size_t doubtful = 0, held = 0, missing = 0;
    char sentence[GSN_POSE_SENTENCE];

    for (size_t i = 0; i < a->poses.section_count; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const enum gsn_section_state state = a->densities.section[i].state;

        fill_section(a, i, e->specimen->protocol,
                     (a->poses.summary.stretches && a->poses.strain_mode != GSN_STRAIN_RIGID) ||
                         a->poses.refinement.done,
                     d);
        doubtful += state == GSN_SECTION_DOUBTFUL;
        held += state == GSN_SECTION_HELD;
        missing += state == GSN_SECTION_MISSING;
        if (s->finding.contradicted) {
            gsn_tissue_sentence(s, state, sentence);
            gsn_builder_warn(d, gsn_builder_say(d, "%s", sentence));
        }
    }
    exclude_sections(a, d);
    exclude_masked(a, d);
    doubtful -= gsn_poses_count_by_tissue(&a->poses);
    if (gsn_poses_count_by_tissue(&a->poses))
        gsn_builder_warn(
            d, gsn_builder_say(d,
                               "%zu section%s no marks to rely on and %s laid by the tissue of the "
                               "neighbours, flagged by-tissue: compare with them",
                               gsn_poses_count_by_tissue(&a->poses),
                               gsn_poses_count_by_tissue(&a->poses) == 1 ? " has" : "s have",
                               gsn_poses_count_by_tissue(&a->poses) == 1 ? "was" : "were"));
    if (doubtful)
        gsn_builder_warn(
            d,
            gsn_builder_say(d, "%zu section%s laid by two marks only: compare with the neighbours",
                            doubtful, doubtful == 1 ? " was" : "s were"));
    if (held)
        gsn_builder_warn_cost(d, (struct gsn_builder_cost){ .sections = held },
                              gsn_builder_say(d, "%zu section%s held and not used", held,
                                              held == 1 ? " is" : "s are"));
    if (missing)
        gsn_builder_warn_cost(
            d, (struct gsn_builder_cost){ .sections = missing },
            gsn_builder_say(d,
                            "%zu expected section%s missing; nothing was moved up to close the gap",
                            missing, missing == 1 ? " is" : "s are"));
    d->report.sections = d->section;
    d->report.section_count = a->poses.section_count;
}

static void fill_panels(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_reconstruction *a = e->reconstruction;

    exclude_panels(a, (size_t)e->specimen->protocol->rows * e->specimen->protocol->columns, d);
    for (size_t i = 0; i < a->densities.panel_count; i++) {
        const struct gsn_stack_panel *p = &a->densities.panel[i];
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
            gsn_builder_warn(d, gsn_builder_say(d, "panel %u: %s", p->given->number, p->note));
        if (p->opened && p->glass.overexposed > MOST_OVEREXPOSED)
            gsn_builder_warn(
                d, gsn_builder_say(
                       d,
                       "panel %u: %.0f %% of its glass is overexposed, so its white point is a "
                       "guess from below: scan with less exposure",
                       p->given->number, 100 * p->glass.overexposed));
    }
    d->report.panels = d->panel;
    d->report.panel_count = a->densities.panel_count;
}

static void fill_registration(const struct gsn_reconstruction *a,
                              const struct gsn_protocol *protocol, struct gsn_builder *d)
{
    static const char *const by[] = { [GSN_PROTOCOL_MARKS] = "marks",
                                      [GSN_PROTOCOL_TISSUE] = "tissue",
                                      [GSN_PROTOCOL_MARKS_AND_TISSUE] = "marks+tissue" };
    char sentence[GSN_POSE_SENTENCES][GSN_POSE_SENTENCE];
    size_t count;
    struct gsn_report_registration *r = &d->registration;
    double sum = 0, tre = 0;

    *r = (struct gsn_report_registration){ .fle_um = a->poses.summary.fle_um,
                                           .by = by[protocol->registration],
                                           .comparison_um = NAN };
    for (size_t i = 0; i < a->poses.section_count; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const enum gsn_section_state state = a->densities.section[i].state;

        r->sections_expected += state != GSN_SECTION_EMPTY;
        if (state != GSN_SECTION_USED && state != GSN_SECTION_DOUBTFUL)
            continue;
        r->sections_posed++;
        sum += s->pose.rms_um * s->pose.rms_um;
        tre += s->pose.tre_um;
        r->worst_tre_um = fmax(r->worst_tre_um, s->pose.tre_um);
        for (size_t m = 0; m < GSN_FIDUCIALS; m++)
            r->worst_residual_um = fmax(r->worst_residual_um, s->pose.residual_um[m]);
    }
    if (r->sections_posed > 0) {
        r->rms_residual_um = sqrt(sum / r->sections_posed);
        r->mean_tre_um = tre / r->sections_posed;
    }
    d->report.registration = r;
    if (a->poses.by_tissue.done) {
        r->fle_um = r->rms_residual_um = r->worst_residual_um = NAN;
        r->comparison_um = a->poses.by_tissue.summary.usual;
        say_by_tissue(&a->poses.by_tissue, r->worst_tre_um, sentence[0]);
        gsn_builder_warn(d, gsn_builder_say(d, "%s", sentence[0]));
        return;
    }
    count = gsn_pose_sentences(&a->poses.summary, &a->poses.panel_stretch, a->poses.strain_mode,
                               protocol->interval_um, sentence);
    for (size_t i = 0; i < count; i++)
        gsn_builder_warn(d, gsn_builder_say(d, "%s", sentence[i]));
    if (a->poses.strain_mode == GSN_STRAIN_TISSUE) {
        gsn_refinement_sentence(&a->poses.refinement, sentence[0]);
        gsn_builder_warn(d, gsn_builder_say(d, "%s", sentence[0]));
    }
}

/* What the panels tell of lamp, bath, knife and glass. */
static void fill_conditions(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    struct gsn_quality_sentences words = { 0 };

    if (gsn_quality_sentences(&e->reconstruction->poses, &e->reconstruction->densities,
                              e->specimen->protocol, &words) < 0)
        d->out_of_memory = 1;
    for (size_t i = 0; i < words.count; i++)
        gsn_builder_warn(d, gsn_builder_say(d, "%s", words.sentence[i]));
    gsn_quality_sentences_done(&words);
}

/* Sentences; the sections themselves are flagged whatever their number. */
enum { MOST_OUT_OF_ORDER = 16 };

static void fill_order(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_reconstruction *a = e->reconstruction;
    char sentence[GSN_POSE_SENTENCE];

    for (size_t i = 0;
         a->densities.sequence && i < a->densities.sequence->count && i < MOST_OUT_OF_ORDER; i++) {
        gsn_section_order_sentence(&a->densities.sequence->finding[i],
                                   e->specimen->protocol->rows * e->specimen->protocol->columns,
                                   sentence);
        gsn_builder_warn(d, gsn_builder_say(d, "%s", sentence));
    }
}

void gsn_builder_sections(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_densities *shown = &e->reconstruction->densities;

    fill_sections(e, d);
    d->aligned = (struct gsn_report_aligned){ .corner_um = shown->aligned_corner,
                                              .um_per_px = shown->aligned_um_per_px };
    d->report.aligned = shown->aligned_um_per_px > 0 ? &d->aligned : NULL;
    fill_panels(e, d);
    fill_conditions(e, d);
    fill_order(e, d);
    if (e->reconstruction->poses.solved)
        fill_registration(e->reconstruction, e->specimen->protocol, d);
    else
        gsn_builder_warn(d, e->reconstruction->poses.unsolved);
}

static struct gsn_report_candidate candidate_of(const struct gsn_candidate *c,
                                                const struct gsn_png_picture *picture)
{
    struct gsn_report_candidate row = { .flipped = c->flipped,
                                        .rotated180 = c->rotated180,
                                        .share = c->share,
                                        .laid = c->laid,
                                        .panel_to_block_um =
                                            gsn_settled_pose(&c->panel_to_block_um),
                                        .predicted_tre_um = c->error_um,
                                        .differs = c->differs,
                                        .picture = { .bytes = picture->png,
                                                     .size = picture->size,
                                                     .width = picture->width,
                                                     .height = picture->height } };

    for (size_t m = 0; m < GSN_FIDUCIALS; m++) {
        row.marker_found[m] = c->mark[m].found;
        row.marker_px[m] = c->mark[m].px;
    }
    return row;
}

/* A name that a shell takes as it is, or in quotes. */
static const char *command_of(const struct gsn_report_inputs *e, const struct gsn_section *s,
                              struct gsn_builder *d)
{
    static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-";
    const char *name = e->specimen->protocol->specimen;
    const char *quote = name[strspn(name, plain)] ? "'" : "";

    return gsn_builder_say(d, "gieson decide %s%s%s %u.%u pose", quote, name, quote, s->panel,
                           s->seen.slot + 1);
}

static void fill_candidates(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_reconstruction *a = e->reconstruction;
    size_t open = 0;

    for (size_t i = 0; i < a->poses.section_count; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const struct gsn_section_density *shown = &a->densities.section[i];
        struct gsn_report_section *row = &d->section[i];

        if (s->candidates.count == 0)
            continue;
        for (size_t c = 0; c < s->candidates.count; c++)
            d->candidate[i][c] = candidate_of(&s->candidates.at[c], &shown->candidate_picture[c]);
        row->candidates = d->candidate[i];
        row->candidate_count = s->candidates.count;
        row->chosen = s->candidates.chosen;
        row->compared_with = shown->compared_with;
        row->command = command_of(e, s, d);
        open += !s->candidates.chosen;
    }
    if (open)
        gsn_builder_warn(
            d, gsn_builder_say(d,
                               "%zu section%s to choose from: look at them and say which, "
                               "with `gieson decide`",
                               open, open == 1 ? " has poses" : "s have poses"));
}

static const char *time_of(struct gsn_builder *d, int64_t seconds)
{
    const time_t then = (time_t)seconds;
    struct tm utc;

    if (!gmtime_r(&then, &utc))
        return "";
    return gsn_builder_say(d, "%04d-%02d-%02d %02d:%02d UTC", utc.tm_year + 1900, utc.tm_mon + 1,
                           utc.tm_mday, utc.tm_hour, utc.tm_min);
}

/* The index of a slot's section; the number of sections when there is none. */
static size_t section_at(const struct gsn_poses *poses, unsigned panel, unsigned slot)
{
    size_t i = 0;

    while (i < poses->section_count &&
           !(poses->section[i].panel == panel && poses->section[i].seen.slot + 1 == slot))
        i++;
    return i;
}

/* What became of a pose that was chosen. */
static const char *effect_of(const struct gsn_reconstruction *a,
                             const struct gsn_specimen_decision *from)
{
    const size_t i = section_at(&a->poses, from->panel, from->slot);
    const struct gsn_section *s = &a->poses.section[i];

    if (i == a->poses.section_count || gsn_flags_has(&s->flags, GSN_FLAG_NO_PANEL))
        return "not used: its panel is not there";
    if (!s->candidates.chosen && gsn_flags_has(&s->flags, GSN_FLAG_DECIDED))
        return "not used: those marks do not fit the stack; choose again";
    if (!s->candidates.chosen)
        return "not used: nothing that is found there has those marks; choose again";
    if (a->densities.section[i].state == GSN_SECTION_HELD)
        return "not used: the section is held for another reason";
    return s->pose.gross ? "used, though those marks do not fit the stack" : "used";
}

static void fill_decisions(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    for (size_t i = 0; i < e->specimen->decision_count; i++) {
        const struct gsn_specimen_decision *from = &e->specimen->decision[i];
        struct gsn_report_decision *row = &d->decision[i];

        *row = (struct gsn_report_decision){ .panel = from->panel,
                                             .slot = from->slot,
                                             .answer = from->answer,
                                             .actor = from->actor,
                                             .reason = from->reason,
                                             .time = time_of(d, from->time),
                                             .effect = "" };
        if (!from->is_pose)
            continue;
        row->effect = effect_of(e->reconstruction, from);
        if (strncmp(row->effect, "used", 4) != 0)
            gsn_builder_warn(
                d, gsn_builder_say(d, "panel %u, slot %u: the pose that %s chose on %s is %s",
                                   from->panel, from->slot, from->actor, row->time, row->effect));
    }
    d->report.decisions = d->decision;
    d->report.decision_count = e->specimen->decision_count;
}

void gsn_builder_choices(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    fill_candidates(e, d);
    fill_decisions(e, d);
}
