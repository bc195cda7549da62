/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_choice.h"

#include "pipeline/register/mark_triangle.h"

#include <math.h>

/* Three standard deviations, and a hair, of two marks' misfits in one length. */
static const double PAIR_REACH = 3.01 * M_SQRT2;

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

/* Squared lengths that are believed of a distance between two marks. */
struct span {
    double least, most;
};

static struct span span_of(double length, double off)
{
    return (struct span){ pow(fmax(length - off, 0), 2), pow(length + off, 2) };
}

static int spans(const struct span *span, const struct gsn_mark *a, const struct gsn_mark *b)
{
    const double dx = a->px.x - b->px.x, dy = a->px.y - b->px.y;
    const double squares = dx * dx + dy * dy;

    return squares >= span->least && squares <= span->most;
}

/* The sides of the prior's triangle in pixels, from each mark to the next, so many tolerances
 * longer or shorter. */
static void sides_of(const struct gsn_mark_candidates *section,
                     const struct gsn_triangle_prior *prior, double tolerances,
                     struct span ret_side[GSN_MARKS])
{
    const double off = tolerances * gsn_mark_tolerance(prior, section->px_um) / section->px_um;

    for (int i = 0; i < GSN_MARKS; i++)
        ret_side[i] =
            span_of(gsn_mark_distance(prior->mark_um[i], prior->mark_um[(i + 1) % GSN_MARKS]) /
                        section->px_um,
                    off);
}

void gsn_mark_choices_add_triples(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior, const int *fine,
                                  struct gsn_mark_choices *choices)
{
    const struct gsn_mark *mark = section->mark;
    const int n = (int)section->count;
    struct span side[GSN_MARKS];

    sides_of(section, prior, prior->learnt ? 3 * GSN_MARK_TORN : 6, side);
    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            /* Most triples fail on their first side. */
            if (a == b || !fine[a] || !fine[b] || !spans(&side[0], &mark[a], &mark[b]))
                continue;
            for (int k = 0; k < 2 * n; k++) {
                const int c = k / 2;
                struct gsn_mark_choice choice = { .candidate = { a, b, c }, .mirrored = k % 2 };

                if (c != a && c != b && fine[c] && spans(&side[1], &mark[b], &mark[c]) &&
                    spans(&side[2], &mark[c], &mark[a]))
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
    struct span side[GSN_MARKS];

    /* A misfit of a length is shared by two marks. */
    sides_of(section, prior, PAIR_REACH * torn_pair, side);
    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            if (a == b || !fine[a] || !fine[b])
                continue;
            for (int k = 0; k < 2 * GSN_MARKS; k++) {
                struct gsn_mark_choice choice = { .candidate = { -1, -1, -1 }, .mirrored = k % 2 };

                if (!spans(&side[k / 2], &section->mark[a], &section->mark[b]))
                    continue;
                /* Every pair comes in both orders, so the next mark round is enough. */
                choice.candidate[k / 2] = a;
                choice.candidate[(k / 2 + 1) % GSN_MARKS] = b;
                consider(section, prior, torn_pair, &choice, choices);
            }
        }
    }
}
