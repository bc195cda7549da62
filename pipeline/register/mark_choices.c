/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_choice.h"

#include "pipeline/register/mark_triangle.h"

#include <math.h>

void gsn_mark_choices_keep(struct gsn_mark_choices *choices, const struct gsn_mark_choice *choice)
{
    size_t at = 0;

    if (choices->count < GSN_MARK_CHOICES) {
        choices->item[choices->count++] = *choice;
        return;
    }
    for (size_t i = 1; i < choices->count; i++)
        if (choices->item[i].likelihood < choices->item[at].likelihood)
            at = i;
    if (choice->likelihood > choices->item[at].likelihood)
        choices->item[at] = *choice;
}

static void consider(const struct gsn_mark_candidates *section,
                     const struct gsn_triangle_prior *prior, double torn_pair,
                     struct gsn_mark_choice *choice, struct gsn_mark_choices *choices)
{
    if (gsn_mark_choice_weigh(section, prior, torn_pair, choice))
        gsn_mark_choices_keep(choices, choice);
}

void gsn_mark_choices_add_triples(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior, const int *fine,
                                  struct gsn_mark_choices *choices)
{
    const double reach = prior->learnt ? 3 * GSN_MARK_TORN : 6;
    const double most = reach * gsn_mark_tolerance(prior, section->px_um) / section->px_um;
    const double side = gsn_mark_distance(prior->mark_um[0], prior->mark_um[1]) / section->px_um;
    const int n = (int)section->count;

    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            /* Most triples fail on their first side. */
            if (a == b || !fine[a] || !fine[b] ||
                fabs(gsn_mark_distance(section->mark[a].px, section->mark[b].px) - side) > most)
                continue;
            for (int k = 0; k < 2 * n; k++) {
                struct gsn_mark_choice choice = { .candidate = { a, b, k / 2 }, .mirrored = k % 2 };

                if (k / 2 != a && k / 2 != b && fine[k / 2])
                    consider(section, prior, GSN_MARK_TORN_PAIR, &choice, choices);
            }
        }
    }
}

void gsn_mark_choices_add_pairs(const struct gsn_mark_candidates *section,
                                const struct gsn_triangle_prior *prior, const int *fine,
                                double torn_pair, struct gsn_mark_choices *choices)
{
    const int n = (int)section->count;

    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            if (a == b || !fine[a] || !fine[b])
                continue;
            for (int k = 0; k < 2 * GSN_MARKS; k++) {
                struct gsn_mark_choice choice = { .candidate = { -1, -1, -1 }, .mirrored = k % 2 };

                /* Every pair comes in both orders, so the next mark round is enough. */
                choice.candidate[k / 2] = a;
                choice.candidate[(k / 2 + 1) % GSN_MARKS] = b;
                consider(section, prior, torn_pair, &choice, choices);
            }
        }
    }
}
