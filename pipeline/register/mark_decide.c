/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_choice.h"

#include "pipeline/register/mark_map.h"
#include "pipeline/register/mark_triangle.h"

#include <math.h>
#include <string.h>

/* The picture's cells go together in patches; so many are witnesses of their own. */
static const double WITNESSES = 20;
/* The tissue's centre moves when a piece is lost. */
static const double TISSUE_SD_LEAST_UM = 100;

struct ranking {
    struct gsn_mark_choice first[2]; /* best for an upright and for a mirrored section */
    /* best with other candidates, or other numbers, in the same state */
    struct gsn_mark_choice other[2];
};

static int same_candidates(const struct gsn_mark_choice *a, const struct gsn_mark_choice *b)
{
    return memcmp(a->candidate, b->candidate, sizeof a->candidate) == 0;
}

static void rank(struct ranking *ranking, const struct gsn_mark_choice *choice)
{
    struct gsn_mark_choice *first = &ranking->first[choice->mirrored];
    struct gsn_mark_choice *other = &ranking->other[choice->mirrored];

    if (choice->likelihood > first->likelihood) {
        *other = *first;
        *first = *choice;
    } else if (choice->likelihood > other->likelihood && !same_candidates(choice, first)) {
        *other = *choice;
    }
}

int gsn_mark_choice_same_spots(const struct gsn_mark_choice *a, const struct gsn_mark_choice *b)
{
    for (int i = 0; i < GSN_MARKS; i++) {
        int seen = 0;

        for (int k = 0; k < GSN_MARKS; k++)
            seen |= a->candidate[i] == b->candidate[k];
        if (!seen)
            return 0;
    }
    return 1;
}

void gsn_mark_choice_look(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior, struct gsn_mark_choice *choice)
{
    choice->unlike =
        fmax(gsn_mark_map_unlike(section, &prior->tissue, &choice->motion, choice->mirrored), 1e-9);
}

double gsn_mark_picture_odds(double unlike, double other)
{
    return pow(other / unlike, 0.5 * WITNESSES);
}

/* Two marks leave two ways round and two ways up, and three may be mixed with a look-alike; the
 * tissue tells. Of three spots that are the same, it does not say which way up they are. */
void gsn_mark_choices_ask_picture(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior,
                                  struct gsn_mark_choices *choices)
{
    double least = 1;

    if (choices->count < 2)
        return;
    for (size_t i = 0; i < choices->count; i++) {
        struct gsn_mark_choice *c = &choices->item[i];

        gsn_mark_choice_look(section, prior, c);
        least = fmin(least, c->unlike);
    }
    for (size_t i = 0; i < choices->count; i++) {
        struct gsn_mark_choice *c = &choices->item[i];
        double own = c->unlike;

        for (size_t k = 0; k < choices->count && gsn_mark_choice_is_triple(c); k++)
            if (gsn_mark_choice_same_spots(c, &choices->item[k]))
                own = fmin(own, choices->item[k].unlike);
        c->likelihood *= gsn_mark_picture_odds(own, least);
    }
}

/* Where there is no picture, a pair is told by the tissue's centre. */
void gsn_mark_choices_ask_centre(const struct gsn_mark_candidates *section,
                                 const struct gsn_triangle_prior *prior,
                                 struct gsn_mark_choices *choices)
{
    const double sd = fmax(prior->tissue_sd_um, TISSUE_SD_LEAST_UM);

    for (size_t i = 0; i < choices->count; i++) {
        struct gsn_mark_choice *c = &choices->item[i];
        const struct gsn_point tissue = gsn_rigid_apply(
            &c->motion, gsn_mark_to_um(section->tissue_px, section->px_um, c->mirrored));

        c->likelihood *= exp(-0.5 * pow(gsn_mark_distance(tissue, prior->tissue_um) / sd, 2));
    }
}

/* The winner and the likelihood of the best that contradicts it. In a triple, the mirror image of
 * the same three spots contradicts nothing here: whether flips can be told is settled by the joint
 * solution. */
struct gsn_mark_choice gsn_mark_choices_decide(const struct gsn_mark_choices *choices, int triple,
                                               double *ret_runner_up)
{
    struct ranking ranking = { 0 };
    const struct gsn_mark_choice *up = &ranking.first[0], *down = &ranking.first[1];
    const struct gsn_mark_choice *winner, *loser;
    int flipped;

    for (size_t i = 0; i < choices->count; i++)
        rank(&ranking, &choices->item[i]);
    flipped = GSN_MARK_RUNNER_UP_MOST * down->likelihood > up->likelihood;
    winner = flipped ? down : up;
    loser = flipped ? up : down;
    *ret_runner_up = ranking.other[flipped].likelihood;
    if (!triple || !gsn_mark_choice_same_spots(winner, loser))
        *ret_runner_up = fmax(*ret_runner_up, loser->likelihood);
    return *winner;
}
