/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a spot is a mark or lies there by chance.
 *
 * Given two marks, the third is where the triangle puts it, as far as sections stretch and tear; a
 * spot that is no mark lies anywhere. How often a mark looks so unlike the typical one, and how
 * often anything else looks as like it, is counted on the sections whose marks are clear. The odds
 * are those of the two, with how often a mark is seen at all. */
#ifndef GSN_REGISTER_MARK_ODDS_H
#define GSN_REGISTER_MARK_ODDS_H

#include "pipeline/register/markers.h"

#ifdef __cplusplus
extern "C" {
#endif

/* -2 ln of the likelihood that a spot's looks give: burns of one stack are about as strong and as
 * large as each other. The caller guarantees that the prior is learnt. */
double gsn_mark_unlike(const struct gsn_mark *mark, double px_um,
                       const struct gsn_triangle_prior *prior);
/* The same for what the fit leaves unexplained of the picture: dirt that touches the mark. */
double gsn_mark_dirt(const struct gsn_mark *mark);

/* How many times more often a mark looks like this spot than spots that are none do, these per
 * um^2: the odds of its looks, in um^2. The caller guarantees that the prior is learnt. */
double gsn_mark_looks_odds(const struct gsn_mark *mark, double px_um,
                           const struct gsn_triangle_prior *prior);

/* Burns that are seen where one belongs. */
#define GSN_MARK_SEEN 0.95

/* What clear sections show, by classes of unlikeness: each reaches twice as far as the one before,
 * the first to 1, the last to anything. */
struct gsn_mark_counts {
    double marks;
    double alike[GSN_MARK_CHANCE]; /* marks that are at least as unlike as the class begins */
    double seen[GSN_MARK_CHANCE];  /* spots that are none, at most as unlike as the class ends */
    double area_um2;               /* where they were counted: as far as the marks lie */
    double sections;
};

/* Adds one section, its marks and its other spots. borrows: everything. */
void gsn_mark_count(const struct gsn_mark_candidates *section,
                    const struct gsn_mark marks[GSN_MARKS], const struct gsn_triangle_prior *prior,
                    struct gsn_mark_counts *counts);
/* Fills alike and chance of the prior, with 0 where nothing was counted. */
void gsn_mark_learn_looks(const struct gsn_mark_counts *counts, struct gsn_triangle_prior *prior);

/* How far sections of this stack move a mark, one standard deviation per axis. */
struct gsn_mark_moves {
    double ordinary_um, loose_um, torn_um;
    double ordinary, loose, torn; /* shares of the sections; together 1 */
};

/* Odds for a spot that lies away_um from where two marks apart_um from each other put the third,
 * whose place is across_um from their middle. */
double gsn_mark_odds(const struct gsn_mark *spot, double px_um,
                     const struct gsn_triangle_prior *prior, const struct gsn_mark_moves *moves,
                     double away_um, double apart_um, double across_um);
/* The same for one that lies away_um from where something else than marks lays the mark, with this
 * error per axis. */
double gsn_mark_odds_placed(const struct gsn_mark *spot, double px_um,
                            const struct gsn_triangle_prior *prior,
                            const struct gsn_mark_moves *moves, double away_um, double error_um);

#ifdef __cplusplus
}
#endif
#endif
