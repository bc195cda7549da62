/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/pose_words.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>

/* A mean triangle larger or smaller than declared by more than this: the pixel size is wrong. */
static const double SCALE_TOLERANCE = 0.01;

struct list {
    char (*sentence)[GSN_POSE_SENTENCE];
    size_t count;
};

static void say(struct list *list, const char *format, ...) __attribute__((format(printf, 2, 3)));

static void say(struct list *list, const char *format, ...)
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

static void say_axes(const struct gsn_axes *axes, double interval_um, struct list *list)
{
    const double per_mm = 1000 / interval_um;

    if (axes->slanted)
        say(list,
            "the laser's axes are not parallel: against what all three do together, marks 1, 2 and "
            "3 move by %.1f, %.1f and %.1f um for each mm of depth (standard deviation %.1f). The "
            "poses follow them. A tilt that all three share moves no mark against the others: no "
            "section can show it, and it would remain in the volume",
            per_mm * length_of(axes->slope[0]), per_mm * length_of(axes->slope[1]),
            per_mm * length_of(axes->slope[2]), per_mm * axes->slope_sd);
    if (axes->bent)
        say(list,
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
                       struct list *list)
{
    if (!summary->stretches || mode == GSN_STRAIN_RIGID)
        return;
    say(list,
        "the sections of this block differ in shape by more than their marks' errors: standard "
        "deviation %.1f %% in size and %.1f %% between directions. %s",
        100 * summary->strain_sd[0], 200 * hypot(summary->strain_sd[1], summary->strain_sd[2]),
        what_became_of_strain(summary, mode));
}

static void say_panel(const struct gsn_strain_common *panel, struct list *list)
{
    if (!panel->anisotropic)
        return;
    say(list,
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
    struct list list = { ret_sentence, 0 };

    if (!summary->flips_told)
        say(&list,
            "flip not detectable on this block: two sides of the marks' triangle differ by only "
            "%.1f sigma, so a section mounted face down looks like one that is not. Burn a "
            "triangle whose sides differ by more",
            summary->isosceles_sigma);
    if (fabs(summary->scale_vs_declared - 1) > SCALE_TOLERANCE)
        say(&list,
            "the marks' triangle is %.2f times the declared one: the pixel size is wrong, and so "
            "are all volumes",
            summary->scale_vs_declared);
    say_panel(panel, &list);
    say_axes(&summary->axes, interval_um, &list);
    say_strain(summary, mode, &list);
    return list.count;
}

void gsn_by_tissue_sentence(const struct gsn_by_tissue *by_tissue, double worst_um,
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

void gsn_tissue_sentence(const struct gsn_assembly_section *section,
                         char ret_sentence[GSN_POSE_SENTENCE])
{
    const struct gsn_tissue_finding *f = &section->finding;

    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "section %u.%u: what looks like its marks lays it %.0f um from "
                   "where the tissue of its neighbours does%s; up to %.0f um would be usual here. "
                   "%s: look at it, and say with `gieson decide` if they are its marks",
                   section->panel, section->seen.slot + 1, f->apart,
                   f->other_face ? ", and with the other face up" : "", f->limit,
                   section->state == GSN_SECTION_HELD
                       ? "The tissue alone does not lay it, so it is held"
                       : "It was laid by the tissue");
}
