/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_choose.h"

#include "pipeline/register/mark_density.h"
#include "pipeline/register/mark_map.h"
#include "pipeline/register/mark_odds.h"
#include "pipeline/register/rigid.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* What the stack has taught of that is believed for nine sections in ten, and never to less than
 * this share of the triangle's size, or a pixel: the tenth may be torn. */
static const double ORDINARY = 0.9, STRETCH_LEAST = 0.004;
/* A section swells or shrinks as a whole by this much more than it loses its shape. */
static const double SIZE = 1.5;
/* A tear or a fold moves a mark by some tenths of the triangle's size, in some sections in a
 * hundred, and this many times the stretch of the others. Believed only of spots that look like
 * marks; of two, hardly, since other sides of the triangle are as long. */
static const double TORN = 6, TORN_PAIR = 1.5, TORN_SHARE = 0.03;
/* A fold between two marks takes a quarter of a millimetre of tissue twice. A pair that is so much
 * too short, or too long, is believed only where the picture says so with these odds against all
 * other ways; it is two marks for a person to look at, since no pose fits them. */
static const double FOLDED_PAIR = 3, FOLDED_ODDS = 20;
/* Of a spot that is less alike (-2 ln of its likelihood), looks say nothing more; of marks that are
 * alike, they say less than the second. */
static const double UNLIKE_MOST = 8, ALIKE_MOST = 3;
/* One that is half burnt in is none the less a mark, when it lies where one must be. */
static const double FAINT = 4;
/* The picture's cells go together in patches; so many are witnesses of their own. */
static const double WITNESSES = 20;
/* The tissue's centre moves when a piece is lost. */
static const double TISSUE_SD_LEAST_UM = 100;
/* exp(-4.5): three standard deviations. */
static const double LIKELIHOOD_LEAST = 0.0111;
/* A second choice with more than this share of the first's likelihood makes both worthless. */
static const double RUNNER_UP_MOST = 0.5;
/* The third of three must be a mark, and no spot that lies there by chance, with these odds. */
static const double THIRD_ODDS = 20;
/* Marks that were lost with a piece of the section, or never burnt in. */
static const double THIRD_LOST = 0.05;
/* A spot this much fainter than the third strongest is no mark as long as nothing is learnt... */
static const double FAINTEST = 0.3;
/* ...and afterwards one that differs from the typical mark by more than these factors. A burn may
 * be half burnt in, and half of the rest bleached. */
static const double STRONGER = 2.5, FAINTER = 5, RADIUS_FACTOR = 2;

enum { CHOICES_MOST = 128 };

/* One way to call candidates marks. */
struct choice {
    int candidate[GSN_MARKS]; /* index, or -1: this mark is not there */
    int mirrored;
    double likelihood;
    int trusted; /* nothing about it is beyond what happens to marks */
    int folded;  /* a pair of another length than two marks have */
    struct gsn_rigid motion;
    double unlike; /* the tissue, laid so */
};

/* The likeliest choices of one section. */
struct choices {
    size_t count;
    struct choice item[CHOICES_MOST];
};

struct ranking {
    struct choice first[2]; /* best for an upright and for a mirrored section */
    struct choice other[2]; /* best with other candidates, or other numbers, in the same state */
};

double gsn_mark_distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

struct gsn_point gsn_mark_to_um(struct gsn_point px, double px_um, int mirrored)
{
    return (struct gsn_point){ mirrored ? -px.x * px_um : px.x * px_um, px.y * px_um };
}

/* Root mean square distance of the corners from their centroid. */
static double size_of(const struct gsn_point *corner)
{
    double squares = 0;

    for (int i = 0; i < GSN_MARKS; i++)
        squares += pow(gsn_mark_distance(corner[i], corner[(i + 1) % GSN_MARKS]), 2);
    /* The mean squared distance of n points from their centroid is the sum over pairs / n^2. */
    return sqrt(squares) / GSN_MARKS;
}

static double tolerance(const struct gsn_triangle_prior *prior, double px_um)
{
    return hypot(GSN_MARK_STRETCH * size_of(prior->mark_um), 0.5 * px_um);
}

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
    return fmin(gsn_mark_unlike(mark, px_um, prior), UNLIKE_MOST);
}

static double looks(const struct gsn_mark_candidates *section,
                    const struct gsn_triangle_prior *prior, const struct choice *choice,
                    double most)
{
    const double third = third_strength(section);
    double sum = 0;

    for (int i = 0; i < GSN_MARKS; i++) {
        const struct gsn_mark *mark;

        if (choice->candidate[i] < 0)
            continue;
        mark = &section->mark[choice->candidate[i]];
        if (prior->learnt)
            sum += fmin(unlike(mark, section->px_um, prior) + gsn_mark_dirt(mark), most);
        else if (third > 0)
            sum += 2 * fmax(1 - strength(mark) / third, 0);
    }
    return sum;
}

/* Whether all of them look as the stack's marks do. */
static int alike(const struct gsn_mark_candidates *section, const struct gsn_triangle_prior *prior,
                 const struct choice *choice)
{
    for (int i = 0; i < GSN_MARKS; i++)
        if (choice->candidate[i] >= 0 &&
            unlike(&section->mark[choice->candidate[i]], section->px_um, prior) > ALIKE_MOST)
            return 0;
    return 1;
}

static struct gsn_mark_moves moves_of(const struct gsn_mark_candidates *section,
                                      const struct gsn_triangle_prior *prior)
{
    const double loose = tolerance(prior, section->px_um);
    const double least = fmax(STRETCH_LEAST * size_of(prior->mark_um), section->px_um);

    return (struct gsn_mark_moves){ .ordinary_um = fmin(fmax(prior->stretch_um, least), loose),
                                    .loose_um = loose,
                                    .torn_um = TORN * loose,
                                    .ordinary = ORDINARY,
                                    .loose = 1 - ORDINARY - TORN_SHARE,
                                    .torn = TORN_SHARE };
}

/* Of a misfit in tolerances, what is known of the section apart. */
static double fitting(const struct gsn_mark_candidates *section,
                      const struct gsn_triangle_prior *prior, double chi2)
{
    const struct gsn_mark_moves m = moves_of(section, prior);

    if (!prior->learnt || !(prior->stretch_um > 0))
        return exp(-0.5 * chi2);
    return m.ordinary * exp(-0.5 * chi2 * pow(m.loose_um / m.ordinary_um, 2)) +
           m.loose * exp(-0.5 * chi2) + m.torn * exp(-0.5 * chi2 * pow(m.loose_um / m.torn_um, 2));
}

static int is_triple(const struct choice *choice)
{
    return choice->candidate[0] >= 0 && choice->candidate[1] >= 0 && choice->candidate[2] >= 0;
}

/* Whether a pair is as far apart as its marks are, a torn one's a little more or less. */
static int plausible_pair(double chi2)
{
    return exp(-0.5 * chi2 / (TORN_PAIR * TORN_PAIR)) >= LIKELIHOOD_LEAST;
}

/* Weighs a choice by its misfit in tolerances; more than three standard deviations of anything are
 * not believed, of a pair's length where torn_pair is its tolerance. */
static void weigh(const struct gsn_mark_candidates *section, const struct gsn_triangle_prior *prior,
                  double chi2, double torn_pair, struct choice *choice)
{
    const double beauty = exp(-0.5 * looks(section, prior, choice, UNLIKE_MOST));
    const double decency = exp(-0.5 * looks(section, prior, choice, FAINT));
    const int pair = !is_triple(choice);
    const int marks = prior->learnt && alike(section, prior, choice);
    const double allowed = !marks ? 1 : pair ? torn_pair : TORN;

    choice->likelihood = fitting(section, prior, chi2) * beauty;
    choice->trusted = exp(-0.5 * chi2 / (allowed * allowed)) * decency >= LIKELIHOOD_LEAST;
    choice->folded = pair && !plausible_pair(chi2);
    if (pair && !marks)
        choice->trusted = 0;
}

/* Whether a choice would lay the section's tissue where none can be: it is made of a neighbour's
 * marks. The tissue's centre moves by some of its size when a piece is lost or pen is taken for it.
 */
static int far_off(const struct gsn_mark_candidates *section,
                   const struct gsn_triangle_prior *prior, const struct gsn_rigid *motion,
                   int mirrored)
{
    const double quarter = prior->tissue.cell * GSN_MARK_MAP / 4;
    struct gsn_point at;

    if (!prior->learnt)
        return 0;
    at = gsn_rigid_apply(motion, gsn_mark_to_um(section->tissue_px, section->px_um, mirrored));
    return gsn_mark_distance(at, prior->tissue_um) >
           fmax(fmax(quarter, size_of(prior->mark_um)), 6 * prior->tissue_sd_um);
}

/* How far three marks lie off, root mean square, because all of the section is larger or smaller;
 * 0 for two. */
static double size_misfit(const struct gsn_point *from, const struct gsn_point *onto, size_t count)
{
    return count == GSN_MARKS ? fabs(size_of(from) - size_of(onto)) : 0;
}

/* Lays the marks of a choice on the prior's; ret_chi2 is the misfit in tolerances. */
static int lay(const struct gsn_mark_candidates *section, const struct gsn_triangle_prior *prior,
               const struct choice *choice, struct gsn_rigid *ret_motion, double *ret_chi2)
{
    struct gsn_point from[GSN_MARKS], onto[GSN_MARKS];
    const double sd = tolerance(prior, section->px_um);
    size_t count = 0;
    double rms, size;

    for (int i = 0; i < GSN_MARKS; i++) {
        if (choice->candidate[i] < 0)
            continue;
        from[count] = gsn_mark_to_um(section->mark[choice->candidate[i]].px, section->px_um,
                                     choice->mirrored);
        onto[count++] = prior->mark_um[i];
    }
    if (gsn_rigid_fit(from, onto, NULL, count, ret_motion, &rms, NULL) < 0)
        return 0;
    size = size_misfit(from, onto, count);
    *ret_chi2 = (double)count * (rms * rms - size * size * (1 - 1 / (SIZE * SIZE))) / (sd * sd);
    return 1;
}

/* Whether one of three spots may as well be there by chance, the two others being the marks. */
static int by_chance(const struct gsn_mark_candidates *section,
                     const struct gsn_triangle_prior *prior, const struct choice *choice, int third)
{
    const int a = (third + 1) % GSN_MARKS, b = (third + 2) % GSN_MARKS;
    const struct gsn_point *mark = prior->mark_um;
    const struct gsn_point middle = { 0.5 * (mark[a].x + mark[b].x),
                                      0.5 * (mark[a].y + mark[b].y) };
    const struct gsn_mark *spot = &section->mark[choice->candidate[third]];
    const struct gsn_mark_moves moves = moves_of(section, prior);
    struct choice pair = *choice;
    double chi2, away;

    pair.candidate[third] = -1;
    if (!lay(section, prior, &pair, &pair.motion, &chi2) || !plausible_pair(chi2))
        return 0;
    away = gsn_mark_distance(
        gsn_rigid_apply(&pair.motion, gsn_mark_to_um(spot->px, section->px_um, choice->mirrored)),
        mark[third]);
    return gsn_mark_odds(spot, section->px_um, prior, &moves, away,
                         gsn_mark_distance(mark[a], mark[b]),
                         gsn_mark_distance(mark[third], middle)) < THIRD_ODDS;
}

static int any_by_chance(const struct gsn_mark_candidates *section,
                         const struct gsn_triangle_prior *prior, const struct choice *choice)
{
    int any = 0;

    for (int i = 0; i < GSN_MARKS && prior->learnt && prior->chance[GSN_MARK_CHANCE - 1] > 0; i++)
        any |= by_chance(section, prior, choice, i);
    return any;
}

static int same_candidates(const struct choice *a, const struct choice *b)
{
    return memcmp(a->candidate, b->candidate, sizeof a->candidate) == 0;
}

static void rank(struct ranking *ranking, const struct choice *choice)
{
    struct choice *first = &ranking->first[choice->mirrored];
    struct choice *other = &ranking->other[choice->mirrored];

    if (choice->likelihood > first->likelihood) {
        *other = *first;
        *first = *choice;
    } else if (choice->likelihood > other->likelihood && !same_candidates(choice, first)) {
        *other = *choice;
    }
}

/* Whether both call the same spots marks, whatever their numbers. */
static int same_spots(const struct choice *a, const struct choice *b)
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

/* Of more than there is room for, the likeliest stay. */
static void keep(struct choices *choices, const struct choice *choice)
{
    size_t at = 0;

    if (choices->count < CHOICES_MOST) {
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
                     struct choice *choice, struct choices *choices)
{
    double chi2;

    if (!lay(section, prior, choice, &choice->motion, &chi2) ||
        far_off(section, prior, &choice->motion, choice->mirrored))
        return;
    weigh(section, prior, chi2, torn_pair, choice);
    if (choice->trusted && !(is_triple(choice) && any_by_chance(section, prior, choice)))
        keep(choices, choice);
}

static void consider_triples(const struct gsn_mark_candidates *section,
                             const struct gsn_triangle_prior *prior, const int *fine,
                             struct choices *choices)
{
    const double reach = prior->learnt ? 3 * TORN : 6;
    const double most = reach * tolerance(prior, section->px_um) / section->px_um;
    const double side = gsn_mark_distance(prior->mark_um[0], prior->mark_um[1]) / section->px_um;
    const int n = (int)section->count;

    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            /* Most triples fail on their first side. */
            if (a == b || !fine[a] || !fine[b] ||
                fabs(gsn_mark_distance(section->mark[a].px, section->mark[b].px) - side) > most)
                continue;
            for (int k = 0; k < 2 * n; k++) {
                struct choice choice = { .candidate = { a, b, k / 2 }, .mirrored = k % 2 };

                if (k / 2 != a && k / 2 != b && fine[k / 2])
                    consider(section, prior, TORN_PAIR, &choice, choices);
            }
        }
    }
}

/* torn_pair: how many tolerances a pair may be too short or too long. */
static void consider_pairs(const struct gsn_mark_candidates *section,
                           const struct gsn_triangle_prior *prior, const int *fine,
                           double torn_pair, struct choices *choices)
{
    const int n = (int)section->count;

    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            if (a == b || !fine[a] || !fine[b])
                continue;
            for (int k = 0; k < 2 * GSN_MARKS; k++) {
                struct choice choice = { .candidate = { -1, -1, -1 }, .mirrored = k % 2 };

                /* Every pair comes in both orders, so the next mark round is enough. */
                choice.candidate[k / 2] = a;
                choice.candidate[(k / 2 + 1) % GSN_MARKS] = b;
                consider(section, prior, torn_pair, &choice, choices);
            }
        }
    }
}

/* Two marks leave two ways round and two ways up, and three may be mixed with a look-alike; the
 * tissue tells. Of three spots that are the same, it does not say which way up they are. */
static void ask_picture(const struct gsn_mark_candidates *section,
                        const struct gsn_triangle_prior *prior, struct choices *choices)
{
    double least = 1;

    if (choices->count < 2)
        return;
    for (size_t i = 0; i < choices->count; i++) {
        struct choice *c = &choices->item[i];

        c->unlike =
            fmax(gsn_mark_map_unlike(section, &prior->tissue, &c->motion, c->mirrored), 1e-9);
        least = fmin(least, c->unlike);
    }
    for (size_t i = 0; i < choices->count; i++) {
        struct choice *c = &choices->item[i];
        double own = c->unlike;

        for (size_t k = 0; k < choices->count && c->candidate[2] >= 0 && c->candidate[0] >= 0 &&
                           c->candidate[1] >= 0;
             k++)
            if (same_spots(c, &choices->item[k]))
                own = fmin(own, choices->item[k].unlike);
        c->likelihood *= pow(least / own, 0.5 * WITNESSES);
    }
}

/* Where there is no picture, a pair is told by the tissue's centre. */
static void ask_centre(const struct gsn_mark_candidates *section,
                       const struct gsn_triangle_prior *prior, struct choices *choices)
{
    const double sd = fmax(prior->tissue_sd_um, TISSUE_SD_LEAST_UM);

    for (size_t i = 0; i < choices->count; i++) {
        struct choice *c = &choices->item[i];
        const struct gsn_point tissue = gsn_rigid_apply(
            &c->motion, gsn_mark_to_um(section->tissue_px, section->px_um, c->mirrored));

        c->likelihood *= exp(-0.5 * pow(gsn_mark_distance(tissue, prior->tissue_um) / sd, 2));
    }
}

/* The winner and the likelihood of the best that contradicts it. In a triple, the mirror image of
 * the same three spots contradicts nothing here: whether flips can be told is settled by the joint
 * solution. */
static struct choice decide(const struct choices *choices, int triple, double *ret_runner_up)
{
    struct ranking ranking = { 0 };
    const struct choice *up = &ranking.first[0], *down = &ranking.first[1];
    const struct choice *winner, *loser;
    int flipped;

    for (size_t i = 0; i < choices->count; i++)
        rank(&ranking, &choices->item[i]);
    flipped = RUNNER_UP_MOST * down->likelihood > up->likelihood;
    winner = flipped ? down : up;
    loser = flipped ? up : down;
    *ret_runner_up = ranking.other[flipped].likelihood;
    if (!triple || !same_spots(winner, loser))
        *ret_runner_up = fmax(*ret_runner_up, loser->likelihood);
    return *winner;
}

static double misfit(const struct gsn_mark_candidates *section,
                     const struct gsn_triangle_prior *prior, const struct choice *choice)
{
    struct gsn_rigid motion;
    double chi2;

    return lay(section, prior, choice, &motion, &chi2) ? chi2 : INFINITY;
}

/* Whether a pair calls nothing else than three do. */
static int contained(const struct choice *pair, const struct choice *three)
{
    for (int i = 0; i < GSN_MARKS; i++)
        if (pair->candidate[i] >= 0 && pair->candidate[i] != three->candidate[i])
            return 0;
    return pair->mirrored == three->mirrored;
}

/* Three that only a tear could have brought where they are, against two that lie as they should and
 * have lost the third: some other spot was taken for it. */
static void hear_pairs(const struct gsn_mark_candidates *section,
                       const struct gsn_triangle_prior *prior, const int *fine,
                       struct choice *three, double *runner_up)
{
    const int pictured = prior->tissue.cell > 0 && section->map.cell > 0;
    struct choices all = { 0 }, pairs = { 0 };
    struct choice best;
    double other, weight;

    if (exp(-0.5 * misfit(section, prior, three)) >= LIKELIHOOD_LEAST || !pictured)
        return;
    consider_pairs(section, prior, fine, TORN_PAIR, &all);
    for (size_t i = 0; i < all.count; i++)
        if (!contained(&all.item[i], three))
            keep(&pairs, &all.item[i]);
    ask_picture(section, prior, &pairs);
    best = decide(&pairs, 0, &other);
    if (!best.trusted)
        return;
    three->unlike =
        fmax(gsn_mark_map_unlike(section, &prior->tissue, &three->motion, three->mirrored), 1e-9);
    best.unlike =
        fmax(gsn_mark_map_unlike(section, &prior->tissue, &best.motion, best.mirrored), 1e-9);
    weight = THIRD_LOST * pow(three->unlike / best.unlike, 0.5 * WITNESSES);
    if (weight * best.likelihood <= three->likelihood) {
        *runner_up = fmax(*runner_up, weight * best.likelihood);
        return;
    }
    *runner_up = fmax(other, three->likelihood / weight);
    *three = best;
}

static int trustworthy(const struct choice *choice, double runner_up)
{
    const double most = choice->folded ? 1 / FOLDED_ODDS : RUNNER_UP_MOST;

    return choice->trusted && runner_up <= most * choice->likelihood;
}

/* Two marks and no third: as far apart as they should be, or else what a fold leaves of them. */
static struct choice gather_pairs(const struct gsn_mark_candidates *section,
                                  const struct gsn_triangle_prior *prior, const int *fine,
                                  struct choices *choices, double *ret_runner_up)
{
    struct choice choice;

    consider_pairs(section, prior, fine, TORN_PAIR, choices);
    if (!(prior->tissue.cell > 0 && section->map.cell > 0)) {
        ask_centre(section, prior, choices);
        return decide(choices, 0, ret_runner_up);
    }
    ask_picture(section, prior, choices);
    choice = decide(choices, 0, ret_runner_up);
    if (trustworthy(&choice, *ret_runner_up))
        return choice;
    choices->count = 0;
    consider_pairs(section, prior, fine, FOLDED_PAIR, choices);
    ask_picture(section, prior, choices);
    return decide(choices, 0, ret_runner_up);
}

/* Collects the choices of a section in `choices`, which is empty, and decides. */
static struct choice gather(const struct gsn_mark_candidates *section,
                            const struct gsn_triangle_prior *prior, struct choices *choices,
                            double *ret_runner_up)
{
    int fine[GSN_MARK_CANDIDATES];
    struct choice choice;

    for (size_t i = 0; i < section->count; i++)
        fine[i] = gsn_mark_acceptable(section, i, prior);
    consider_triples(section, prior, fine, choices);
    if (prior->tissue.cell > 0 && section->map.cell > 0)
        ask_picture(section, prior, choices);
    choice = decide(choices, 1, ret_runner_up);
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
    struct choices choices = { 0 };
    struct choice choice;
    double runner_up;

    assert(section && prior && ret_marks);

    choice = gather(section, prior, &choices, &runner_up);
    for (int i = 0; i < GSN_MARKS; i++) {
        const int found = trustworthy(&choice, runner_up) && choice.candidate[i] >= 0;

        ret_marks[i] = found ? section->mark[choice.candidate[i]] : (struct gsn_mark){ 0 };
    }
    if (ret_mirrored)
        *ret_mirrored = trustworthy(&choice, runner_up) && choice.mirrored;
    if (ret_score)
        *ret_score = choice.likelihood;
    if (ret_runner_up)
        *ret_runner_up = runner_up;
}

/* The likelier first; of equals the one with the stronger spots, then the one that lies up. */
static int by_likelihood(const void *left, const void *right)
{
    const struct choice *a = left, *b = right;

    if (a->likelihood != b->likelihood)
        return a->likelihood > b->likelihood ? -1 : 1;
    for (int i = 0; i < GSN_MARKS; i++)
        if (a->candidate[i] != b->candidate[i])
            return a->candidate[i] < b->candidate[i] ? -1 : 1;
    return a->mirrored - b->mirrored;
}

/* Whether an earlier choice calls the same three spots marks, the other way up. */
static int is_told(const struct choices *choices, size_t i)
{
    const struct choice *choice = &choices->item[i];

    for (size_t k = 0; k < i && is_triple(choice); k++)
        if (choices->item[k].mirrored != choice->mirrored && same_spots(&choices->item[k], choice))
            return 1;
    return 0;
}

size_t gsn_markers_rivals(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior,
                          struct gsn_mark_rival ret_rivals[GSN_MARK_RIVALS])
{
    struct choices choices = { 0 };
    double runner_up, sum = 0;
    size_t count = 0;

    assert(section && prior && ret_rivals);

    (void)gather(section, prior, &choices, &runner_up);
    qsort(choices.item, choices.count, sizeof choices.item[0], by_likelihood);
    for (size_t i = 0; i < choices.count && count < GSN_MARK_RIVALS; i++) {
        const struct choice *choice = &choices.item[i];
        struct gsn_mark_rival *rival = &ret_rivals[count];

        if (!(choice->likelihood > 0) || is_told(&choices, i))
            continue;
        *rival =
            (struct gsn_mark_rival){ .mirrored = choice->mirrored, .share = choice->likelihood };
        for (int m = 0; m < GSN_MARKS; m++)
            if (choice->candidate[m] >= 0)
                rival->mark[m] = section->mark[choice->candidate[m]];
        sum += rival->share;
        count++;
    }
    for (size_t i = 0; i < count; i++)
        ret_rivals[i].share /= sum;
    return count;
}

int gsn_markers_find(const struct gsn_plane *red_od, const struct gsn_slot *slot, double px_um,
                     const struct gsn_triangle_prior *prior, struct gsn_mark ret_marks[GSN_MARKS],
                     int *ret_mirrored, double *ret_runner_up, struct gsn_error *err)
{
    const struct gsn_mark_density density = gsn_mark_density_of(red_od);
    struct gsn_mark_candidates candidates;
    const int r = gsn_markers_candidates(&density, slot, px_um, &candidates, err);

    if (r < 0)
        return r;
    gsn_markers_choose(&candidates, prior, ret_marks, ret_mirrored, NULL, ret_runner_up);
    return GSN_OK;
}
