/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_order.h"

#include "pipeline/assembly_parts.h"
#include <stdio.h>

static void flag(struct gsn_assembly_section *s, const struct gsn_sequence_finding *finding,
                 unsigned other)
{
    char word[40];

    (void)snprintf(word, sizeof word,
                   finding->kind == GSN_SEQUENCE_SWAP ? "swapped-with-%u?" : "same-as-%u?", other);
    gsn_assembly_flag(s, word);
}

/* Flags the sections of that number that were compared, laid or held. */
static void flag_all(const struct gsn_section_planes *planes, struct gsn_assembly *a,
                     const struct gsn_sequence_finding *finding, int second)
{
    const unsigned serial = second ? finding->b : finding->a;
    const unsigned other = second ? finding->a : finding->b;
    const size_t count = finding->held[second] ? planes->held_count : planes->count;

    for (size_t k = 0; k < count; k++) {
        const size_t i = finding->held[second] ? planes->held[k].section : planes->section[k];

        if (a->section[i].seen.serial == serial)
            flag(&a->section[i], finding, other);
    }
}

static int examine_laid(const struct gsn_section_planes *planes, const struct gsn_assembly *a,
                        struct gsn_sequence_plane *plane, struct gsn_sequence **ret_sequence,
                        struct gsn_error *err)
{
    for (size_t k = 0; k < planes->count; k++)
        plane[k] =
            (struct gsn_sequence_plane){ a->section[planes->section[k]].seen.serial,
                                         planes->density + k * planes->columns * planes->rows };
    return gsn_sequence_examine(plane, planes->count, planes->columns, planes->rows, ret_sequence,
                                err);
}

static int examine_held(const struct gsn_section_planes *planes, const struct gsn_assembly *a,
                        const struct gsn_sequence_plane *plane, struct gsn_sequence *sequence,
                        struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_held) held = gsn_alloc_array(planes->held_count, sizeof *held);

    if (!held)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    for (size_t k = 0; k < planes->held_count; k++) {
        const struct gsn_section_apart *s = &planes->held[k];

        held[k] = (struct gsn_sequence_held){ a->section[s->section].seen.serial, s->columns,
                                              s->rows, s->cell_um / planes->cell_um, s->density };
    }
    return gsn_sequence_examine_held(plane, planes->count, planes->columns, planes->rows, held,
                                     planes->held_count, sequence, err);
}

int gsn_section_order_examine(struct gsn_section_planes *planes, struct gsn_assembly *a,
                              struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_plane) plane = gsn_alloc_array(planes->count, sizeof *plane);
    gsn_auto(gsn_sequence) sequence = NULL;
    int r;

    if (!plane)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    gsn_section_planes_settle(planes);
    r = examine_laid(planes, a, plane, &sequence, err);
    if (r >= 0 && planes->held_count > 0)
        r = examine_held(planes, a, plane, sequence, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < sequence->count; i++)
        for (int second = 0; second < 2; second++)
            flag_all(planes, a, &sequence->finding[i], second);
    *ret_sequence = gsn_steal(&sequence);
    return GSN_OK;
}

static void say_held(const struct gsn_sequence_finding *f, char ret_sentence[GSN_POSE_SENTENCE])
{
    const unsigned held = f->held[0] ? f->a : f->b, used = f->held[0] ? f->b : f->a;
    char what[200];

    if (f->held[0] && f->held[1])
        (void)snprintf(what, sizeof what, "both are held: use one of them at most");
    else
        (void)snprintf(what, sizeof what,
                       "section %u is held and %u is used: if %u is the one that belongs where it "
                       "is, %u lies in the place of another",
                       held, used, held, used);
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "sections %u and %u look like one section, mounted or scanned twice: the best "
                   "quarter of their texture agrees to %.0f %%, that of neighbours to %.0f %%; %s: "
                   "look at both",
                   f->a, f->b, 100 * f->evidence, 100 * f->usual, what);
}

void gsn_section_order_sentence(const struct gsn_sequence_finding *finding,
                                char ret_sentence[GSN_POSE_SENTENCE])
{
    if (finding->kind == GSN_SEQUENCE_SWAP)
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "sections %u and %u look swapped: from one to the other the tissue changes "
                       "against the way it changes around them, by %.1f standard errors where %.1f "
                       "along it are expected; nothing was moved: look at both",
                       finding->a, finding->b, finding->against, finding->foretold);
    else if (finding->kind == GSN_SEQUENCE_HELD_DUPLICATE)
        say_held(finding, ret_sentence);
    else
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "sections %u and %u look like one section, mounted or scanned twice: their "
                       "texture agrees to %.0f %%, that of neighbours to %.0f %%; both are used: "
                       "look at them, and hold the one that is not there",
                       finding->a, finding->b, 100 * finding->evidence, 100 * finding->usual);
}

int gsn_section_order_blind_to_swaps(const struct gsn_sequence *sequence,
                                     char ret_sentence[GSN_POSE_SENTENCE])
{
    const double *shown = sequence->shown;
    char near[160] = "", most[80] = "";

    ret_sentence[0] = '\0';
    if (sequence->reach == 1)
        return 0;
    if (shown[GSN_SEQUENCE_NEAR - 1] > 0)
        (void)snprintf(
            near, sizeof near,
            " (expected to show: %.0f %% of swaps of neighbours, %.0f %% two apart, %.0f "
            "%% three apart)",
            100 * shown[0], 100 * shown[1], 100 * shown[2]);
    if (sequence->unseen > 0)
        (void)snprintf(most, sizeof most,
                       "; it would carry at most %.2g %% of all density to the other place",
                       100 * sequence->unseen);
    if (sequence->reach > 1)
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "a swap of two sections nearer than %u to each other may not show in their "
                       "tissue%s: their order rests on numbers and slots alone%s",
                       sequence->reach, near, most);
    else
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "a swap of two sections may not show in their tissue%s: their order rests "
                       "on numbers and slots alone%s",
                       near, most);
    return 1;
}

int gsn_section_order_blind_to_duplicates(const struct gsn_sequence *sequence,
                                          char ret_sentence[GSN_POSE_SENTENCE])
{
    ret_sentence[0] = '\0';
    if (sequence->twice_told)
        return 0;
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "a section mounted or scanned twice would not show: neighbours share all that "
                   "could set one apart");
    return 1;
}
