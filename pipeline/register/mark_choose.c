/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_choice.h"

#include "pipeline/register/mark_looks.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

/* A fold between two marks takes a quarter of a millimetre of tissue twice. A pair that is so much
 * too short, or too long, is believed only where the picture says so with these odds against all
 * other ways; it is two marks for a person to look at, since no pose fits them. */
static const double FOLDED_PAIR = 3, FOLDED_ODDS = 20;
/* Spots that are the section's marks with no more than this chance, all ways together, are not
 * worth a person's look. */
static const double LISTED_LEAST = 0.05;
/* A pair this much less likely than the three, before the tissue is asked, is not heard. */
static const double UNHEARD = 1e-5;

/* Whether a pair calls nothing else than three do. */
static int contained(const struct gsn_mark_choice *pair, const struct gsn_mark_choice *three)
{
    for (int i = 0; i < GSN_MARKS; i++)
        if (pair->candidate[i] >= 0 && pair->candidate[i] != three->candidate[i])
            return 0;
    return pair->mirrored == three->mirrored;
}

static int calls(const struct gsn_mark_choice *choice, int candidate)
{
    for (int i = 0; i < GSN_MARKS; i++)
        if (choice->candidate[i] == candidate)
            return 1;
    return 0;
}

/* Pairs that contradict the three: all of them where only a tear could have brought the three where
 * they are, or else those of their own spots. */
static void gather_rivals(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior, const int *fine,
                          const struct gsn_mark_choice *three, struct gsn_mark_choices *rivals)
{
    const int torn = !gsn_mark_choice_lies_well(section, prior, three);
    struct gsn_mark_choices all;
    int own[GSN_MARK_CANDIDATES];

    rivals->count = all.count = 0;
    for (size_t i = 0; i < section->count; i++)
        own[i] = fine[i] && (torn || calls(three, (int)i));
    gsn_mark_choices_add_pairs(section, prior, own, GSN_MARK_TORN_PAIR, &all);
    for (size_t i = 0; i < all.count; i++) {
        const struct gsn_mark_choice *pair = &all.item[i];

        if (!contained(pair, three) && pair->likelihood > UNHEARD * three->likelihood)
            gsn_mark_choices_keep(rivals, pair);
    }
}

/* Three against two that have lost the third: a spot that lies where the third would be, if the
 * section lay otherwise than it does, was taken for it. The tissue's picture is the witness. */
static void hear_pairs(const struct gsn_mark_candidates *section,
                       const struct gsn_triangle_prior *prior, const int *fine,
                       struct gsn_mark_choice *three, double *runner_up)
{
    const int pictured = prior->tissue.cell > 0 && section->map.cell > 0;
    struct gsn_mark_choices pairs;
    struct gsn_mark_choice best;
    double other, weight;

    if (!pictured || !(prior->chance[GSN_MARK_CHANCE - 1] > 0))
        return;
    gather_rivals(section, prior, fine, three, &pairs);
    gsn_mark_choices_ask_picture(section, prior, &pairs);
    best = gsn_mark_choices_decide(&pairs, 0, &other);
    if (!best.trusted)
        return;
    gsn_mark_choice_look(section, prior, three);
    gsn_mark_choice_look(section, prior, &best);
    weight = gsn_mark_picture_odds(best.unlike, three->unlike);
    if (weight * best.likelihood <= three->likelihood) {
        *runner_up = fmax(*runner_up, weight * best.likelihood);
        return;
    }
    *runner_up = fmax(other, three->likelihood / weight);
    *three = best;
}

static int trustworthy(const struct gsn_mark_choice *choice, double runner_up)
{
    const double most = choice->folded ? 1 / FOLDED_ODDS : GSN_MARK_RUNNER_UP_MOST;

    return choice->trusted && !choice->rivalled && runner_up <= most * choice->likelihood;
}

/* Odds that the section has marks, and has them there, against its having none: as many of the
 * stack's sections have some. What two lay is held against the tissue, to which three may have been
 * laid by chance and are in its mean. */
static double odds_against_none(const struct gsn_triangle_prior *prior,
                                const struct gsn_mark_choice *choice)
{
    const double stack = prior->marked > 0 ? prior->marked / (1 - prior->marked) : INFINITY;
    const int pictured = !gsn_mark_choice_is_triple(choice) && choice->unlike > 0;

    return stack * choice->over_none * (pictured ? gsn_mark_picture_odds(choice->unlike, 1) : 1);
}

/* Two marks and no third: as far apart as they should be, or else what a fold leaves of them. */
static struct gsn_mark_choice gather_pairs(const struct gsn_mark_candidates *section,
                                           const struct gsn_triangle_prior *prior, const int *fine,
                                           struct gsn_mark_choices *choices, double *ret_runner_up)
{
    struct gsn_mark_choice choice;

    gsn_mark_choices_add_pairs(section, prior, fine, GSN_MARK_TORN_PAIR, choices);
    if (!(prior->tissue.cell > 0 && section->map.cell > 0)) {
        gsn_mark_choices_ask_centre(section, prior, choices);
        return gsn_mark_choices_decide(choices, 0, ret_runner_up);
    }
    gsn_mark_choices_ask_picture(section, prior, choices);
    choice = gsn_mark_choices_decide(choices, 0, ret_runner_up);
    if (trustworthy(&choice, *ret_runner_up))
        return choice;
    choices->count = 0;
    gsn_mark_choices_add_pairs(section, prior, fine, FOLDED_PAIR, choices);
    gsn_mark_choices_ask_picture(section, prior, choices);
    return gsn_mark_choices_decide(choices, 0, ret_runner_up);
}

/* Collects the choices of a section and decides. */
static struct gsn_mark_choice gather(const struct gsn_mark_candidates *section,
                                     const struct gsn_triangle_prior *prior,
                                     struct gsn_mark_choices *choices, double *ret_runner_up)
{
    int fine[GSN_MARK_CANDIDATES];
    struct gsn_mark_choice choice;

    choices->count = 0;
    for (size_t i = 0; i < section->count; i++)
        fine[i] = gsn_mark_acceptable(section, i, prior);
    gsn_mark_choices_add_triples(section, prior, fine, choices);
    if (prior->tissue.cell > 0 && section->map.cell > 0)
        gsn_mark_choices_ask_picture(section, prior, choices);
    choice = gsn_mark_choices_decide(choices, 1, ret_runner_up);
    choice.rivalled = GSN_MARK_ODDS_LEAST * *ret_runner_up > choice.likelihood;
    if (choice.trusted && prior->learnt)
        hear_pairs(section, prior, fine, &choice, ret_runner_up);
    /* Two rival triples are a riddle for a person; a pair out of them would be a guess. */
    if (!choice.trusted && prior->learnt)
        choice = gather_pairs(section, prior, fine, choices, ret_runner_up);
    return choice;
}

void gsn_markers_choose(const struct gsn_mark_candidates *section,
                        const struct gsn_triangle_prior *prior,
                        struct gsn_mark ret_marks[GSN_MARKS], int *ret_mirrored, double *ret_score,
                        double *ret_runner_up)
{
    struct gsn_mark_choices choices;
    struct gsn_mark_choice choice;
    double runner_up, odds, all;
    int trusted;

    assert(section && prior && ret_marks);

    choice = gather(section, prior, &choices, &runner_up);
    odds = choice.likelihood > 0 ? odds_against_none(prior, &choice) : 0;
    /* Two marks are for a person to look at, so that they are rather there than not is enough. */
    trusted = trustworthy(&choice, runner_up) &&
              odds >= (gsn_mark_choice_is_triple(&choice) ? GSN_MARK_ODDS_LEAST : 1);
    for (int i = 0; i < GSN_MARKS; i++)
        ret_marks[i] = trusted && choice.candidate[i] >= 0 ? section->mark[choice.candidate[i]]
                                                           : (struct gsn_mark){ 0 };
    if (ret_mirrored)
        *ret_mirrored = trusted && choice.mirrored;
    all = choice.likelihood > 0 ? choice.likelihood * (1 + 1 / odds) + runner_up : 1;
    if (ret_score)
        *ret_score = choice.likelihood / all;
    if (ret_runner_up)
        *ret_runner_up = runner_up / all;
}

/* The likelier first; of equals the one with the stronger spots, then the one that lies up. */
static int by_likelihood(const void *left, const void *right)
{
    const struct gsn_mark_choice *a = left, *b = right;

    if (a->likelihood != b->likelihood)
        return a->likelihood > b->likelihood ? -1 : 1;
    for (int i = 0; i < GSN_MARKS; i++)
        if (a->candidate[i] != b->candidate[i])
            return a->candidate[i] < b->candidate[i] ? -1 : 1;
    return a->mirrored - b->mirrored;
}

/* Whether an earlier choice calls the same three spots marks, the other way up. */
static int is_told(const struct gsn_mark_choices *choices, size_t i)
{
    const struct gsn_mark_choice *choice = &choices->item[i];

    for (size_t k = 0; k < i && gsn_mark_choice_is_triple(choice); k++)
        if (choices->item[k].mirrored != choice->mirrored &&
            gsn_mark_choice_same_spots(&choices->item[k], choice))
            return 1;
    return 0;
}

double gsn_mark_choices_over_none(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior)
{
    struct gsn_mark_choices choices = { .count = 0 };
    int fine[GSN_MARK_CANDIDATES];
    double sum = 0;

    for (size_t i = 0; i < section->count; i++)
        fine[i] = gsn_mark_acceptable(section, i, prior);
    gsn_mark_choices_add_triples(section, prior, fine, &choices);
    for (size_t i = 0; i < choices.count; i++)
        sum += choices.item[i].over_none;
    return sum;
}

size_t gsn_markers_rivals(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior,
                          struct gsn_mark_rival ret_rivals[GSN_MARK_RIVALS])
{
    struct gsn_mark_choices choices;
    double runner_up, sum = 0, none = 0;
    size_t count = 0;

    assert(section && prior && ret_rivals);

    (void)gather(section, prior, &choices, &runner_up);
    qsort(choices.item, choices.count, sizeof choices.item[0], by_likelihood);
    for (size_t i = 0; i < choices.count && count < GSN_MARK_RIVALS; i++) {
        const struct gsn_mark_choice *choice = &choices.item[i];
        struct gsn_mark_rival *rival = &ret_rivals[count];

        if (!(choice->likelihood > 0) || is_told(&choices, i))
            continue;
        *rival =
            (struct gsn_mark_rival){ .mirrored = choice->mirrored, .share = choice->likelihood };
        for (int m = 0; m < GSN_MARKS; m++)
            if (choice->candidate[m] >= 0)
                rival->mark[m] = section->mark[choice->candidate[m]];
        if (count == 0)
            none = choice->likelihood / odds_against_none(prior, choice);
        sum += rival->share;
        count++;
    }
    for (size_t i = 0; i < count; i++)
        ret_rivals[i].share /= sum + none;
    return sum < LISTED_LEAST * (sum + none) ? 0 : count;
}
