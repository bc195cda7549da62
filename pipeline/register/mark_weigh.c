/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_choice.h"

#include "pipeline/register/mark_looks.h"
#include "pipeline/register/mark_odds.h"
#include "pipeline/register/mark_triangle.h"

#include <math.h>

/* What the stack has taught of how sections stretch is believed for nine sections in ten, and never
 * to less than this share of the triangle's size, or a pixel: the tenth may be torn. */
static const double ORDINARY = 0.9, STRETCH_LEAST = 0.004;
/* A section swells or shrinks as a whole by this much more than it loses its shape. */
static const double SIZE = 1.5;
/* Of so many sections a tear or a fold moves a mark. */
static const double TORN_SHARE = 0.03;
/* One that is half burnt in is none the less a mark, when it lies where one must be. */
static const double FAINT = 4;
/* exp(-4.5): three standard deviations. */
static const double LIKELIHOOD_LEAST = 0.0111;

struct gsn_mark_moves gsn_mark_choice_moves(const struct gsn_mark_candidates *section,
                                            const struct gsn_triangle_prior *prior)
{
    const double loose = gsn_mark_tolerance(prior, section->px_um);
    const double least =
        fmax(STRETCH_LEAST * gsn_mark_triangle_size(prior->mark_um), section->px_um);

    return (struct gsn_mark_moves){ .ordinary_um = fmin(fmax(prior->stretch_um, least), loose),
                                    .loose_um = loose,
                                    .torn_um = GSN_MARK_TORN * loose,
                                    .ordinary = ORDINARY,
                                    .loose = 1 - ORDINARY - TORN_SHARE,
                                    .torn = TORN_SHARE };
}

/* Normal density of a misfit of `freedom` dimensions, given in tolerances, by this deviation. */
static double normal(double chi2, double tolerance_um, double sd_um, int freedom)
{
    return exp(-0.5 * chi2 * pow(tolerance_um / sd_um, 2)) / pow(sqrt(2 * M_PI) * sd_um, freedom);
}

/* Density of a misfit, whatever befell the section: 1 dimension for two marks, 3 for three, of
 * which the size has a deviation of its own. */
static double fitting(const struct gsn_mark_candidates *section,
                      const struct gsn_triangle_prior *prior, double chi2, int freedom)
{
    const struct gsn_mark_moves m = gsn_mark_choice_moves(section, prior);
    const double size = freedom == 3 ? SIZE : 1;

    if (!prior->learnt || !(prior->stretch_um > 0))
        return normal(chi2, m.loose_um, m.loose_um, freedom) / size;
    return (m.ordinary * normal(chi2, m.loose_um, m.ordinary_um, freedom) +
            m.loose * normal(chi2, m.loose_um, m.loose_um, freedom) +
            m.torn * normal(chi2, m.loose_um, m.torn_um, freedom)) /
           size;
}

static int knows_looks(const struct gsn_triangle_prior *prior)
{
    return prior->learnt && prior->chance[GSN_MARK_CHANCE - 1] > 0 && prior->area_um2 > 0;
}

/* Where spots lie, um^2: as far as was counted, or else a disc over which the section's own spots
 * would spread as they do, and never less than one as large as the triangle. */
static double area_of(const struct gsn_mark_candidates *section,
                      const struct gsn_triangle_prior *prior)
{
    const double n = fmax((double)section->count, 1);
    double x = 0, y = 0, squares = 0;

    if (knows_looks(prior))
        return prior->area_um2;
    for (size_t i = 0; i < section->count; i++) {
        x += section->mark[i].px.x / n;
        y += section->mark[i].px.y / n;
    }
    for (size_t i = 0; i < section->count; i++)
        squares += (pow(section->mark[i].px.x - x, 2) + pow(section->mark[i].px.y - y, 2)) / n;
    return 2 * M_PI *
           fmax(squares * section->px_um * section->px_um,
                pow(gsn_mark_triangle_size(prior->mark_um), 2));
}

/* How much likelier the spots look so and lie somewhere each as marks than as spots that are none:
 * by what the stack taught, or as rare as those of this section that may be marks. */
static double looks_odds(const struct gsn_mark_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         const struct gsn_mark_choice *choice, double area_um2)
{
    double odds = 1, others = 0;

    for (size_t i = 0; i < section->count; i++)
        others += gsn_mark_acceptable(section, i, prior);
    if (!knows_looks(prior))
        odds = exp(-0.5 * gsn_mark_looks(section, prior, choice->candidate, GSN_MARK_UNLIKE_MOST));
    for (int i = 0; i < GSN_MARKS; i++)
        if (choice->candidate[i] >= 0)
            odds *= knows_looks(prior) ? gsn_mark_looks_odds(&section->mark[choice->candidate[i]],
                                                             section->px_um, prior)
                                       : area_um2 / fmax(others, 1);
    return odds;
}

/* The likelihood that the section has its marks there, over that of its having none: the spots
 * would then lie anywhere. A triangle may lie anywhere, turned by any angle and on either face; in
 * coordinates in which each mark counts alike, d^2a d^2b d^2c = 3 sqrt(3) rho d^2centroid dangle
 * d^3shape, and sqrt(2) distance d^2centre dangle dlength for two. */
static double over_none(const struct gsn_mark_candidates *section,
                        const struct gsn_triangle_prior *prior,
                        const struct gsn_mark_choice *choice, double chi2)
{
    const double area = area_of(section, prior);
    const double odds = looks_odds(section, prior, choice, area);
    const struct gsn_point *mark = prior->mark_um;

    if (gsn_mark_choice_is_triple(choice))
        return pow(GSN_MARK_SEEN, 3) * odds * fitting(section, prior, chi2, 3) /
               (4 * M_PI * area * 3 * sqrt(3) * gsn_mark_triangle_size(mark));
    for (int i = 0; i < GSN_MARKS; i++)
        if (choice->candidate[i] < 0)
            return pow(GSN_MARK_SEEN, 2) * (1 - GSN_MARK_SEEN) * odds *
                   fitting(section, prior, chi2, 1) /
                   (4 * M_PI * area * M_SQRT2 *
                    gsn_mark_distance(mark[(i + 1) % GSN_MARKS], mark[(i + 2) % GSN_MARKS]));
    return 0;
}

int gsn_mark_choice_is_triple(const struct gsn_mark_choice *choice)
{
    return choice->candidate[0] >= 0 && choice->candidate[1] >= 0 && choice->candidate[2] >= 0;
}

/* Whether a pair is as far apart as its marks are, a torn one's a little more or less. */
static int plausible_pair(double chi2)
{
    return exp(-0.5 * chi2 / (GSN_MARK_TORN_PAIR * GSN_MARK_TORN_PAIR)) >= LIKELIHOOD_LEAST;
}

/* Weighs a choice by its misfit in tolerances; more than three standard deviations of anything are
 * not believed, of a pair's length where torn_pair is its tolerance. */
static void weigh(const struct gsn_mark_candidates *section, const struct gsn_triangle_prior *prior,
                  double chi2, double torn_pair, struct gsn_mark_choice *choice)
{
    const double decency = exp(-0.5 * gsn_mark_looks(section, prior, choice->candidate, FAINT));
    const int pair = !gsn_mark_choice_is_triple(choice);
    const int marks = prior->learnt && gsn_mark_alike(section, prior, choice->candidate);
    const double allowed = !marks ? 1 : pair ? torn_pair : GSN_MARK_TORN;

    choice->likelihood = choice->over_none = over_none(section, prior, choice, chi2);
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
           fmax(fmax(quarter, gsn_mark_triangle_size(prior->mark_um)), 6 * prior->tissue_sd_um);
}

/* How far three marks lie off, root mean square, because all of the section is larger or smaller;
 * 0 for two. */
static double size_misfit(const struct gsn_point *from, const struct gsn_point *onto, size_t count)
{
    return count == GSN_MARKS ? fabs(gsn_mark_triangle_size(from) - gsn_mark_triangle_size(onto))
                              : 0;
}

/* Lays the marks of a choice on the prior's; ret_chi2 is the misfit in tolerances. */
static int lay(const struct gsn_mark_candidates *section, const struct gsn_triangle_prior *prior,
               const struct gsn_mark_choice *choice, struct gsn_rigid *ret_motion, double *ret_chi2)
{
    struct gsn_point from[GSN_MARKS], onto[GSN_MARKS];
    const double sd = gsn_mark_tolerance(prior, section->px_um);
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

/* Odds that one of three spots is a mark and does not lie there by chance, if the two others are
 * marks: motion lays these. */
static double third_odds(const struct gsn_mark_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         const struct gsn_mark_choice *choice, int third,
                         const struct gsn_rigid *motion)
{
    const int a = (third + 1) % GSN_MARKS, b = (third + 2) % GSN_MARKS;
    const struct gsn_point *mark = prior->mark_um;
    const struct gsn_point middle = { 0.5 * (mark[a].x + mark[b].x),
                                      0.5 * (mark[a].y + mark[b].y) };
    const struct gsn_mark *spot = &section->mark[choice->candidate[third]];
    const struct gsn_mark_moves moves = gsn_mark_choice_moves(section, prior);
    const double away = gsn_mark_distance(
        gsn_rigid_apply(motion, gsn_mark_to_um(spot->px, section->px_um, choice->mirrored)),
        mark[third]);

    return gsn_mark_odds(spot, section->px_um, prior, &moves, away,
                         gsn_mark_distance(mark[a], mark[b]),
                         gsn_mark_distance(mark[third], middle));
}

/* Whether one of three spots may as well be there by chance, the two others being the marks. */
static int by_chance(const struct gsn_mark_candidates *section,
                     const struct gsn_triangle_prior *prior, const struct gsn_mark_choice *choice,
                     int third)
{
    struct gsn_mark_choice pair = *choice;
    double chi2;

    pair.candidate[third] = -1;
    return lay(section, prior, &pair, &pair.motion, &chi2) && plausible_pair(chi2) &&
           third_odds(section, prior, choice, third, &pair.motion) < GSN_MARK_ODDS_LEAST;
}

static int any_by_chance(const struct gsn_mark_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         const struct gsn_mark_choice *choice)
{
    int any = 0;

    for (int i = 0; i < GSN_MARKS && prior->learnt && prior->chance[GSN_MARK_CHANCE - 1] > 0; i++)
        any |= by_chance(section, prior, choice, i);
    return any;
}

int gsn_mark_choice_weigh(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior, double torn_pair,
                          struct gsn_mark_choice *choice)
{
    double chi2;

    if (!lay(section, prior, choice, &choice->motion, &chi2) ||
        far_off(section, prior, &choice->motion, choice->mirrored))
        return 0;
    weigh(section, prior, chi2, torn_pair, choice);
    return choice->trusted &&
           !(gsn_mark_choice_is_triple(choice) && any_by_chance(section, prior, choice));
}

int gsn_mark_choice_lies_well(const struct gsn_mark_candidates *section,
                              const struct gsn_triangle_prior *prior,
                              const struct gsn_mark_choice *choice)
{
    struct gsn_rigid motion;
    double chi2;

    return lay(section, prior, choice, &motion, &chi2) && exp(-0.5 * chi2) >= LIKELIHOOD_LEAST;
}
