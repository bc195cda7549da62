/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_order.h"

#include "pipeline/assembly_parts.h"
#include <stdio.h>

static struct gsn_assembly_section *section_of(const struct gsn_section_planes *planes,
                                               struct gsn_assembly *a, unsigned serial)
{
    for (size_t k = 0; k < planes->count; k++)
        if (a->section[planes->section[k]].seen.serial == serial)
            return &a->section[planes->section[k]];
    return NULL;
}

static void flag(const struct gsn_section_planes *planes, struct gsn_assembly *a,
                 const struct gsn_sequence_finding *finding)
{
    const unsigned serial[2] = { finding->a, finding->b };

    for (int i = 0; i < 2; i++) {
        struct gsn_assembly_section *s = section_of(planes, a, serial[i]);
        char word[40];

        (void)snprintf(word, sizeof word,
                       finding->kind == GSN_SEQUENCE_SWAP ? "swapped-with-%u?" : "same-as-%u?",
                       serial[1 - i]);
        if (s)
            gsn_assembly_flag(s, word);
    }
}

int gsn_section_order_examine(struct gsn_section_planes *planes, struct gsn_assembly *a,
                              struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_sequence_plane) plane = gsn_alloc_array(planes->count, sizeof *plane);
    int r;

    if (!plane)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    gsn_section_planes_settle(planes);
    for (size_t k = 0; k < planes->count; k++)
        plane[k] =
            (struct gsn_sequence_plane){ a->section[planes->section[k]].seen.serial,
                                         planes->density + k * planes->columns * planes->rows };
    r = gsn_sequence_examine(plane, planes->count, planes->columns, planes->rows, ret_sequence,
                             err);
    for (size_t i = 0; r >= 0 && i < (*ret_sequence)->count; i++)
        flag(planes, a, &(*ret_sequence)->finding[i]);
    return r;
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
