/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_odds.h"

#include <assert.h>
#include <math.h>

/* Burns of one stack differ by a third at most in contrast and radius, two standard deviations. */
static const double ALIKE = 0.15;
/* Share of the picture that the fit of a mark explains, and what is lost when dirt touches it. */
static const double EXPLAINED = 0.9, EXPLAINED_SD = 0.15;
/* Marks of which looks say nothing: half burnt in, half under dirt. They stand against spots of any
 * looks. */
static const double DISGUISED = 0.02;
double gsn_mark_unlike(const struct gsn_mark *mark, double px_um,
                       const struct gsn_triangle_prior *prior)
{
    const double contrast = log(mark->contrast / prior->contrast) / ALIKE;
    const double radius = log(mark->radius_px * px_um / prior->radius_um) / ALIKE;

    return 0.5 * (contrast * contrast + radius * radius);
}

double gsn_mark_dirt(const struct gsn_mark *mark)
{
    return pow(fmax(EXPLAINED - mark->score, 0) / EXPLAINED_SD, 2);
}

static int class_of(double unlike)
{
    int k = 0;

    while (k < GSN_MARK_CHANCE - 1 && unlike > ldexp(1, k))
        k++;
    return k;
}

/* Share of burns that are at least so unlike, as far as none was counted. */
static double expected(int k)
{
    return k > 0 ? exp(-0.5 * ldexp(1, k - 1)) : 1;
}

static double unlike_in_all(const struct gsn_mark *mark, double px_um,
                            const struct gsn_triangle_prior *prior)
{
    return gsn_mark_unlike(mark, px_um, prior) + gsn_mark_dirt(mark);
}

static double distance_um(const struct gsn_mark_candidates *section, struct gsn_point px)
{
    return section->px_um * hypot(px.x - section->tissue_px.x, px.y - section->tissue_px.y);
}

static int is_one_of(const struct gsn_mark marks[GSN_MARKS], const struct gsn_mark *spot)
{
    for (int i = 0; i < GSN_MARKS; i++)
        if (marks[i].px.x == spot->px.x && marks[i].px.y == spot->px.y)
            return 1;
    return 0;
}

void gsn_mark_count(const struct gsn_mark_candidates *section,
                    const struct gsn_mark marks[GSN_MARKS], const struct gsn_triangle_prior *prior,
                    struct gsn_mark_counts *counts)
{
    double reach_um = 0;

    assert(section && marks && prior && counts);

    /* Farther out than its marks, a section may show those of its neighbours. */
    for (int i = 0; i < GSN_MARKS; i++) {
        reach_um = fmax(reach_um, distance_um(section, marks[i].px));
        counts->marks += 1;
        for (int k = class_of(unlike_in_all(&marks[i], section->px_um, prior)); k >= 0; k--)
            counts->alike[k] += 1;
    }
    for (size_t i = 0; i < section->count; i++) {
        const struct gsn_mark *spot = &section->mark[i];

        if (distance_um(section, spot->px) > reach_um || is_one_of(marks, spot))
            continue;
        for (int k = class_of(unlike_in_all(spot, section->px_um, prior)); k < GSN_MARK_CHANCE; k++)
            counts->seen[k] += 1;
    }
    counts->area_um2 += M_PI * reach_um * reach_um;
    counts->sections += 1;
}

/* One spot more than was counted, since none may be seen in a small stack. One of the marks that
 * look so may be the one in question, which does not vouch for itself: one that looks as burns may
 * stands for it. */
void gsn_mark_learn_looks(const struct gsn_mark_counts *counts, struct gsn_triangle_prior *prior)
{
    const double area = counts->area_um2;

    assert(counts && prior);

    prior->area_um2 = counts->sections > 0 ? area / counts->sections : 0;
    for (int k = 0; k < GSN_MARK_CHANCE; k++) {
        const double others = fmax(counts->alike[k] - 1, 0);

        prior->alike[k] = area > 0 ? (others + expected(k)) / fmax(counts->marks, 1) : 0;
        prior->chance[k] = area > 0 ? (counts->seen[k] + 1) / area : 0;
    }
}

double gsn_mark_looks_odds(const struct gsn_mark *mark, double px_um,
                           const struct gsn_triangle_prior *prior)
{
    const int k = class_of(unlike_in_all(mark, px_um, prior));

    assert(prior->learnt);

    return fmax(prior->alike[k] / prior->chance[k], DISGUISED / prior->chance[GSN_MARK_CHANCE - 1]);
}

/* Density per um^2 of places so far away, with this variance per axis. */
static double density(double away_um, double variance)
{
    return exp(-0.5 * away_um * away_um / variance) / (2 * M_PI * variance);
}

/* Odds for a spot so far from where a mark belongs. What lays that place has variances of its own,
 * per axis, in an ordinary section and in any other. */
static double odds_of(const struct gsn_mark *spot, double px_um,
                      const struct gsn_triangle_prior *prior, const struct gsn_mark_moves *moves,
                      double away_um, double ordinary, double other)
{
    const double here =
        moves->ordinary * density(away_um, moves->ordinary_um * moves->ordinary_um + ordinary) +
        moves->loose * density(away_um, moves->loose_um * moves->loose_um + other) +
        moves->torn * density(away_um, moves->torn_um * moves->torn_um + other);

    return GSN_MARK_SEEN / (1 - GSN_MARK_SEEN) * here * gsn_mark_looks_odds(spot, px_um, prior);
}

double gsn_mark_odds(const struct gsn_mark *spot, double px_um,
                     const struct gsn_triangle_prior *prior, const struct gsn_mark_moves *moves,
                     double away_um, double apart_um, double across_um)
{
    /* The middle of two has half of their variance; what turns them moves the third by as much more
     * as it is farther away, in one of its two directions. */
    const double carried = 0.5 + pow(across_um / apart_um, 2);

    assert(spot && prior && moves && apart_um > 0);

    return odds_of(spot, px_um, prior, moves, away_um,
                   carried * moves->ordinary_um * moves->ordinary_um,
                   carried * moves->loose_um * moves->loose_um);
}

double gsn_mark_odds_placed(const struct gsn_mark *spot, double px_um,
                            const struct gsn_triangle_prior *prior,
                            const struct gsn_mark_moves *moves, double away_um, double error_um)
{
    assert(spot && prior && moves);

    return odds_of(spot, px_um, prior, moves, away_um, error_um * error_um, error_um * error_um);
}
