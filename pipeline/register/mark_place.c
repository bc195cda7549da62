/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_choice.h"

#include "pipeline/register/mark_looks.h"
#include "pipeline/register/mark_triangle.h"

#include <assert.h>

/* The spots that could be one mark, the likeliest and the next. */
struct spots {
    size_t best;
    double odds, other;
};

static int is_given(const struct gsn_mark marks[GSN_MARKS], const struct gsn_mark *spot)
{
    for (int i = 0; i < GSN_MARKS; i++)
        if (marks[i].found && marks[i].px.x == spot->px.x && marks[i].px.y == spot->px.y)
            return 1;
    return 0;
}

static struct spots look_for(const struct gsn_mark_candidates *section,
                             const struct gsn_triangle_prior *prior,
                             const struct gsn_affine *panel_to_um, double error_um, int mark)
{
    const struct gsn_mark_moves moves = gsn_mark_choice_moves(section, prior);
    struct spots spots = { 0 };

    for (size_t i = 0; i < section->count; i++) {
        const struct gsn_mark *spot = &section->mark[i];
        const double away =
            gsn_mark_distance(gsn_affine_apply(panel_to_um, spot->px), prior->mark_um[mark]);
        const double odds =
            gsn_mark_odds_placed(spot, section->px_um, prior, &moves, away, error_um);

        if (!gsn_mark_acceptable(section, i, prior))
            continue;
        if (odds > spots.odds) {
            spots.other = spots.odds;
            spots.odds = odds;
            spots.best = i;
        } else if (odds > spots.other) {
            spots.other = odds;
        }
    }
    return spots;
}

void gsn_markers_place(const struct gsn_mark_candidates *section,
                       const struct gsn_triangle_prior *prior, const struct gsn_affine *panel_to_um,
                       double error_um, struct gsn_mark marks[GSN_MARKS])
{
    assert(section && prior && prior->learnt && panel_to_um && marks);

    for (int i = 0; i < GSN_MARKS; i++) {
        struct spots spots;

        if (marks[i].found)
            continue;
        spots = look_for(section, prior, panel_to_um, error_um, i);
        if (spots.odds >= GSN_MARK_ODDS_LEAST &&
            spots.other <= GSN_MARK_RUNNER_UP_MOST * spots.odds &&
            !is_given(marks, &section->mark[spots.best]))
            marks[i] = section->mark[spots.best];
    }
}
