/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_looks.h"

#include "pipeline/register/mark_odds.h"

#include <math.h>

/* Of marks that are alike, looks say less than this. */
static const double ALIKE_MOST = 3;
/* A spot this much fainter than the third strongest is no mark as long as nothing is learnt... */
static const double FAINTEST = 0.3;
/* ...and afterwards one that differs from the typical mark by more than these factors. A burn may
 * be half burnt in, and half of the rest bleached. */
static const double STRONGER = 2.5, FAINTER = 5, RADIUS_FACTOR = 2;

static double strength(const struct gsn_mark *mark)
{
    return mark->contrast * mark->score;
}

/* The strength that one of three marks burnt alike reaches, in a section with the marks and maybe a
 * blot of ink or two: the third strongest. */
static double third_strength(const struct gsn_mark_candidates *section)
{
    const size_t third = section->count < GSN_MARKS ? section->count : GSN_MARKS;

    return third > 0 ? strength(&section->mark[third - 1]) : 0;
}

int gsn_mark_acceptable(const struct gsn_mark_candidates *section, size_t i,
                        const struct gsn_triangle_prior *prior)
{
    const struct gsn_mark *mark = &section->mark[i];
    const double um = mark->radius_px * section->px_um;

    if (!prior->learnt)
        return strength(mark) >= FAINTEST * third_strength(section);
    return mark->contrast <= STRONGER * prior->contrast &&
           strength(mark) >= prior->contrast / FAINTER && um <= RADIUS_FACTOR * prior->radius_um &&
           um >= prior->radius_um / RADIUS_FACTOR;
}

static double unlike(const struct gsn_mark *mark, double px_um,
                     const struct gsn_triangle_prior *prior)
{
    return fmin(gsn_mark_unlike(mark, px_um, prior), GSN_MARK_UNLIKE_MOST);
}

double gsn_mark_looks(const struct gsn_mark_candidates *section,
                      const struct gsn_triangle_prior *prior, const int candidate[GSN_MARKS],
                      double most)
{
    const double third = third_strength(section);
    double sum = 0;

    for (int i = 0; i < GSN_MARKS; i++) {
        const struct gsn_mark *mark;

        if (candidate[i] < 0)
            continue;
        mark = &section->mark[candidate[i]];
        if (prior->learnt)
            sum += fmin(unlike(mark, section->px_um, prior) + gsn_mark_dirt(mark), most);
        else if (third > 0)
            sum += 2 * fmax(1 - strength(mark) / third, 0);
    }
    return sum;
}

int gsn_mark_alike(const struct gsn_mark_candidates *section,
                   const struct gsn_triangle_prior *prior, const int candidate[GSN_MARKS])
{
    for (int i = 0; i < GSN_MARKS; i++)
        if (candidate[i] >= 0 &&
            unlike(&section->mark[candidate[i]], section->px_um, prior) > ALIKE_MOST)
            return 0;
    return 1;
}
