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
    const size_t columns = planes->columns / GSN_SEQUENCE_FINER;
    const size_t rows = planes->rows / GSN_SEQUENCE_FINER;
    gsn_auto_mem(float) coarse = gsn_alloc_array(planes->count * rows, columns * sizeof *coarse);
    int r;

    if (!plane || !coarse)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of the sections");
    gsn_section_planes_reduce(planes, GSN_SEQUENCE_FINER, coarse);
    gsn_section_planes_settle(planes);
    for (size_t k = 0; k < planes->count; k++)
        plane[k] =
            (struct gsn_sequence_plane){ a->section[planes->section[k]].seen.serial,
                                         coarse + k * columns * rows,
                                         planes->density + k * planes->columns * planes->rows };
    r = gsn_sequence_examine(plane, planes->count, columns, rows, ret_sequence, err);
    for (size_t i = 0; r >= 0 && i < (*ret_sequence)->count; i++)
        flag(planes, a, &(*ret_sequence)->finding[i]);
    return r;
}

void gsn_section_order_sentence(const struct gsn_sequence_finding *finding,
                                char ret_sentence[GSN_POSE_SENTENCE])
{
    if (finding->kind == GSN_SEQUENCE_SWAP)
        (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                       "sections %u and %u look swapped: in each other's places the stack there "
                       "would be %.0f %% less rough along z; nothing was moved: look at both",
                       finding->a, finding->b, 100 * finding->smoother);
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
    char near[48] = "", most[80] = "";

    ret_sentence[0] = '\0';
    if (sequence->reach == 1)
        return 0;
    if (sequence->reach > 1)
        (void)snprintf(near, sizeof near, " nearer than %u to each other", sequence->reach);
    if (sequence->unseen > 0)
        (void)snprintf(most, sizeof most,
                       "; it would carry at most %.2g %% of all density to the other place",
                       100 * sequence->unseen);
    (void)snprintf(ret_sentence, GSN_POSE_SENTENCE,
                   "a swap of two sections%s may not show in their tissue: their order rests on "
                   "numbers and slots alone%s",
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
