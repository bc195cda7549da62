/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: exhaustive hypotheses (triples and pairs of candidates, either face), each scored by its
 * likelihood over that of a section without marks, with the tissue's thumbnail as a further
 * witness; the winner is refused where a hypothesis that contradicts it is half as likely.
 *
 * Steps of gsn_fiducials_match(). 1. Triples whose sides are within reach of the prior's are
 * aligned (rigid.h) and scored: misfit under a mixture of ordinary, loose and torn sections,
 * appearance (appearance.h), and the density of blobs that lie anywhere. A triple of which one may
 * as well lie there by chance is dropped. 2. The thumbnails weigh the hypotheses. 3. The best
 * triple is held against pairs that contradict it: the third may be a blob that lies where a mark
 * would, were the section turned. 4. Where no triple is trusted, pairs: as far apart as they should
 * be, or folded ones, for which the thumbnail must speak 20 to 1. 5. The odds that the section has
 * marks at all.
 *
 * Cannot fail; a section whose marks are in doubt gets none. Cost: most triples fail on their first
 * side; some thousand closed-form fits a section with many blobs. */
#include "pipeline/register/fiducial/correspondence.h"

#include "pipeline/register/fiducial/appearance.h"
#include "pipeline/register/fiducial/thumbnail.h"
#include "pipeline/register/fiducial/triangle.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/rigid.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A tear or a fold moves a mark by some tenths of the triangle's size, in some sections in a
 * hundred: this many times the stretch of the others. Believed only of blobs that look like marks;
 * of two, hardly, since other sides of the triangle are as long. */
#define TORN 6.0

#define TORN_PAIR 1.5

/* A second hypothesis with more than this share of the first's likelihood makes both worthless. */
#define RUNNER_UP_MAX 0.5

/* A blob must be a mark, and none that lies there by chance, with these odds. */
#define RATIO_MIN 20.0

enum { HYPOTHESES = 128 };

/* One way to call candidates marks. */
struct hypothesis {
    int candidate[GSN_FIDUCIALS]; /* index, or -1: this mark is not there */
    int mirrored;
    double over_none;  /* likelihood over that of a section without marks, tissue left aside */
    double likelihood; /* the same, with what the tissue says */
    int trusted;       /* nothing about it is beyond what happens to marks */
    int rivalled;      /* three others are marks with a chance that matters */
    int folded;        /* a pair of another length than two marks have */
    struct gsn_rigid motion;
    double unlike; /* the tissue, laid so */
};

/* The likeliest hypotheses of one section. */
struct hypotheses {
    size_t count;
    struct hypothesis item[HYPOTHESES];
};

static int is_triple(const struct hypothesis *hypothesis)
{
    return hypothesis->candidate[0] >= 0 && hypothesis->candidate[1] >= 0 &&
           hypothesis->candidate[2] >= 0;
}

/* ---- one hypothesis by its marks alone ------------------------------------------------------- */

/* What the stack has taught of how sections stretch is believed for nine sections in ten, and never
 * to less than this share of the triangle's size, or a pixel: the tenth may be torn. */
static const double ORDINARY = 0.9, STRETCH_MIN = 0.004;

/* A section swells or shrinks as a whole by this much more than it loses its shape. */
static const double SIZE = 1.5;

/* Of so many sections a tear or a fold moves a mark. */
static const double TORN_SHARE = 0.03;

/* One that is half burnt in is none the less a mark, when it lies where one must be. */
static const double FAINT = 4;

/* exp(-4.5): three standard deviations. */
static const double LIKELIHOOD_MIN = 0.0111;

/* How far the sections of the stack move their marks. The caller guarantees that the prior is
 * learnt. */
static struct gsn_displacement find_displacement(const struct gsn_fiducial_candidates *section,
                                                 const struct gsn_triangle_prior *prior)
{
    const double loose = gsn_triangle_tolerance(prior, section->px_um);
    const double least = fmax(STRETCH_MIN * gsn_triangle_size(prior->mark_um), section->px_um);

    return (struct gsn_displacement){ .ordinary_um = fmin(fmax(prior->stretch_um, least), loose),
                                      .loose_um = loose,
                                      .torn_um = TORN * loose,
                                      .ordinary = ORDINARY,
                                      .loose = 1 - ORDINARY - TORN_SHARE,
                                      .torn = TORN_SHARE };
}

/* Normal density of a misfit of `freedom` dimensions, given in tolerances, by this deviation. */
static double normal_density(double chi2, double tolerance_um, double sd_um, int freedom)
{
    return exp(-0.5 * chi2 * pow(tolerance_um / sd_um, 2)) / pow(sqrt(2 * M_PI) * sd_um, freedom);
}

/* Density of a misfit, whatever befell the section: 1 dimension for two marks, 3 for three, of
 * which the size has a deviation of its own. */
static double misfit_density(const struct gsn_fiducial_candidates *section,
                             const struct gsn_triangle_prior *prior, double chi2, int freedom)
{
    const struct gsn_displacement m = find_displacement(section, prior);
    const double size = freedom == 3 ? SIZE : 1;

    if (!prior->learnt || !(prior->stretch_um > 0))
        return normal_density(chi2, m.loose_um, m.loose_um, freedom) / size;
    return (m.ordinary * normal_density(chi2, m.loose_um, m.ordinary_um, freedom) +
            m.loose * normal_density(chi2, m.loose_um, m.loose_um, freedom) +
            m.torn * normal_density(chi2, m.loose_um, m.torn_um, freedom)) /
           size;
}

static int knows_looks(const struct gsn_triangle_prior *prior)
{
    return prior->learnt && prior->chance[GSN_APPEARANCE_CLASSES - 1] > 0 && prior->area_um2 > 0;
}

/* Where blobs lie, um^2: as far as was counted, or else a disc over which the section's own blobs
 * would spread as they do, and never less than one as large as the triangle. */
static double area_of(const struct gsn_fiducial_candidates *section,
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
                pow(gsn_triangle_size(prior->mark_um), 2));
}

/* How much likelier the blobs look so and lie somewhere each as marks than as blobs that are none:
 * by what the stack taught, or as rare as those of this section that may be marks. */
static double looks_odds(const struct gsn_fiducial_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         const struct hypothesis *hypothesis, double area_um2)
{
    double odds = 1, others = 0;

    for (size_t i = 0; i < section->count; i++)
        others += gsn_appearance_acceptable(section, i, prior);
    if (!knows_looks(prior))
        odds = exp(-0.5 * gsn_appearance_sum(section, prior, hypothesis->candidate,
                                             GSN_APPEARANCE_DISTANCE_MAX));
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (hypothesis->candidate[i] >= 0)
            odds *= knows_looks(prior)
                        ? gsn_appearance_ratio(&section->mark[hypothesis->candidate[i]],
                                               section->px_um, prior)
                        : area_um2 / fmax(others, 1);
    return odds;
}

/* The likelihood that the section has its marks there, over that of its having none: the blobs
 * would then lie anywhere. A triangle may lie anywhere, turned by any angle and on either face; in
 * coordinates in which each mark counts alike, d^2a d^2b d^2c = 3 sqrt(3) rho d^2centroid dangle
 * d^3shape, and sqrt(2) distance d^2centre dangle dlength for two. */
static double over_none(const struct gsn_fiducial_candidates *section,
                        const struct gsn_triangle_prior *prior, const struct hypothesis *hypothesis,
                        double chi2)
{
    const double area = area_of(section, prior);
    const double odds = looks_odds(section, prior, hypothesis, area);
    const struct gsn_point *mark = prior->mark_um;

    if (is_triple(hypothesis))
        return pow(GSN_FIDUCIAL_SEEN, 3) * odds * misfit_density(section, prior, chi2, 3) /
               (4 * M_PI * area * 3 * sqrt(3) * gsn_triangle_size(mark));
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (hypothesis->candidate[i] < 0)
            return pow(GSN_FIDUCIAL_SEEN, 2) * (1 - GSN_FIDUCIAL_SEEN) * odds *
                   misfit_density(section, prior, chi2, 1) /
                   (4 * M_PI * area * M_SQRT2 *
                    gsn_fiducial_distance(mark[(i + 1) % GSN_FIDUCIALS],
                                          mark[(i + 2) % GSN_FIDUCIALS]));
    return 0;
}

/* Whether a pair is as far apart as its marks are, a torn one's a little more or less. */
static int is_plausible_pair(double chi2)
{
    return exp(-0.5 * chi2 / (TORN_PAIR * TORN_PAIR)) >= LIKELIHOOD_MIN;
}

/* Scores a hypothesis by its misfit in tolerances; more than three standard deviations of anything
 * are not believed, of a pair's length where torn_pair is its tolerance. */
static void score_misfit(const struct gsn_fiducial_candidates *section,
                         const struct gsn_triangle_prior *prior, double chi2, double torn_pair,
                         struct hypothesis *hypothesis)
{
    const double decency =
        exp(-0.5 * gsn_appearance_sum(section, prior, hypothesis->candidate, FAINT));
    const int pair = !is_triple(hypothesis);
    const int marks = prior->learnt && gsn_appearance_alike(section, prior, hypothesis->candidate);
    const double allowed = !marks ? 1 : pair ? torn_pair : TORN;

    hypothesis->likelihood = hypothesis->over_none = over_none(section, prior, hypothesis, chi2);
    hypothesis->trusted = exp(-0.5 * chi2 / (allowed * allowed)) * decency >= LIKELIHOOD_MIN;
    hypothesis->folded = pair && !is_plausible_pair(chi2);
    if (pair && !marks)
        hypothesis->trusted = 0;
}

/* Whether a hypothesis would lay the section's tissue where none can be: it is made of a
 * neighbour's marks. The tissue's centre moves by some of its size when a piece is lost or pen is
 * taken for it.
 */
static int is_far_off(const struct gsn_fiducial_candidates *section,
                      const struct gsn_triangle_prior *prior, const struct gsn_rigid *motion,
                      int mirrored)
{
    const double quarter = prior->tissue.cell * GSN_THUMBNAIL_SIDE / 4;
    struct gsn_point at;

    if (!prior->learnt)
        return 0;
    at = gsn_rigid_apply(motion, gsn_fiducial_to_um(section->tissue_px, section->px_um, mirrored));
    return gsn_fiducial_distance(at, prior->tissue_um) >
           fmax(fmax(quarter, gsn_triangle_size(prior->mark_um)), 6 * prior->tissue_sd_um);
}

/* How far three marks lie off, root mean square, because all of the section is larger or smaller;
 * 0 for two. */
static double find_size_misfit(const struct gsn_point *from, const struct gsn_point *onto,
                               size_t count)
{
    return count == GSN_FIDUCIALS ? fabs(gsn_triangle_size(from) - gsn_triangle_size(onto)) : 0;
}

/* Aligns the marks of a hypothesis with the prior's; ret_chi2 is the misfit in tolerances. */
static int align_marks(const struct gsn_fiducial_candidates *section,
                       const struct gsn_triangle_prior *prior, const struct hypothesis *hypothesis,
                       struct gsn_rigid *ret_motion, double *ret_chi2)
{
    struct gsn_point from[GSN_FIDUCIALS], onto[GSN_FIDUCIALS];
    const double sd = gsn_triangle_tolerance(prior, section->px_um);
    size_t count = 0;
    double rms, size;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        if (hypothesis->candidate[i] < 0)
            continue;
        from[count] = gsn_fiducial_to_um(section->mark[hypothesis->candidate[i]].px, section->px_um,
                                         hypothesis->mirrored);
        onto[count++] = prior->mark_um[i];
    }
    if (gsn_rigid_fit(from, onto, NULL, count, ret_motion, &rms, NULL) < 0)
        return 0;
    size = find_size_misfit(from, onto, count);
    *ret_chi2 = (double)count * (rms * rms - size * size * (1 - 1 / (SIZE * SIZE))) / (sd * sd);
    return 1;
}

/* Odds that one of three blobs is a mark and does not lie there by chance, if the two others are
 * marks: motion lays these. */
static double third_odds(const struct gsn_fiducial_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         const struct hypothesis *hypothesis, int third,
                         const struct gsn_rigid *motion)
{
    const int a = (third + 1) % GSN_FIDUCIALS, b = (third + 2) % GSN_FIDUCIALS;
    const struct gsn_point *mark = prior->mark_um;
    const struct gsn_point middle = { 0.5 * (mark[a].x + mark[b].x),
                                      0.5 * (mark[a].y + mark[b].y) };
    const struct gsn_fiducial *blob = &section->mark[hypothesis->candidate[third]];
    const struct gsn_displacement moves = find_displacement(section, prior);
    const double away = gsn_fiducial_distance(
        gsn_rigid_apply(motion, gsn_fiducial_to_um(blob->px, section->px_um, hypothesis->mirrored)),
        mark[third]);

    return gsn_third_mark_ratio(blob, section->px_um, prior, &moves, away,
                                gsn_fiducial_distance(mark[a], mark[b]),
                                gsn_fiducial_distance(mark[third], middle));
}

/* Whether one of three blobs may as well be there by chance, the two others being the marks. */
static int is_by_chance(const struct gsn_fiducial_candidates *section,
                        const struct gsn_triangle_prior *prior, const struct hypothesis *hypothesis,
                        int third)
{
    struct hypothesis pair = *hypothesis;
    double chi2;

    pair.candidate[third] = -1;
    return align_marks(section, prior, &pair, &pair.motion, &chi2) && is_plausible_pair(chi2) &&
           third_odds(section, prior, hypothesis, third, &pair.motion) < RATIO_MIN;
}

static int is_any_by_chance(const struct gsn_fiducial_candidates *section,
                            const struct gsn_triangle_prior *prior,
                            const struct hypothesis *hypothesis)
{
    int any = 0;

    for (int i = 0;
         i < GSN_FIDUCIALS && prior->learnt && prior->chance[GSN_APPEARANCE_CLASSES - 1] > 0; i++)
        any |= is_by_chance(section, prior, hypothesis, i);
    return any;
}

/* Aligns the hypothesis and scores it; torn_pair: how many tolerances a pair may be too short or
 * too long. 0: it is beyond what happens to marks, or one of three lies there by chance. */
static int score_hypothesis(const struct gsn_fiducial_candidates *section,
                            const struct gsn_triangle_prior *prior, double torn_pair,
                            struct hypothesis *hypothesis)
{
    double chi2;

    if (!align_marks(section, prior, hypothesis, &hypothesis->motion, &chi2) ||
        is_far_off(section, prior, &hypothesis->motion, hypothesis->mirrored))
        return 0;
    score_misfit(section, prior, chi2, torn_pair, hypothesis);
    return hypothesis->trusted &&
           !(is_triple(hypothesis) && is_any_by_chance(section, prior, hypothesis));
}

/* Whether nothing tore or folded: the marks lie as far apart as sections stretch. */
static int fits_well(const struct gsn_fiducial_candidates *section,
                     const struct gsn_triangle_prior *prior, const struct hypothesis *hypothesis)
{
    struct gsn_rigid motion;
    double chi2;

    return align_marks(section, prior, hypothesis, &motion, &chi2) &&
           exp(-0.5 * chi2) >= LIKELIHOOD_MIN;
}

/* ---- all hypotheses of a section; usable: 1 for each candidate that may be a mark ------------ */

/* Three standard deviations, and a hair, of two marks' misfits in one length. */
static const double PAIR_REACH = 3.01 * M_SQRT2;

/* mark_choices.c: all of a section. usable: 1 for each candidate that may be a mark. */

/* Of more than there is room for, the likeliest stay. */
static void keep_likeliest(struct hypotheses *hypotheses, const struct hypothesis *hypothesis)
{
    size_t at = 0;

    if (hypotheses->count < HYPOTHESES) {
        hypotheses->item[hypotheses->count++] = *hypothesis;
        return;
    }
    for (size_t i = 1; i < hypotheses->count; i++)
        if (hypotheses->item[i].likelihood < hypotheses->item[at].likelihood)
            at = i;
    if (hypothesis->likelihood > hypotheses->item[at].likelihood)
        hypotheses->item[at] = *hypothesis;
}

static void add_if_plausible(const struct gsn_fiducial_candidates *section,
                             const struct gsn_triangle_prior *prior, double torn_pair,
                             struct hypothesis *hypothesis, struct hypotheses *hypotheses)
{
    if (score_hypothesis(section, prior, torn_pair, hypothesis))
        keep_likeliest(hypotheses, hypothesis);
}

/* Squared lengths that are believed of a distance between two marks. */
struct span {
    double least, most;
};

static struct span span_of(double length, double off)
{
    return (struct span){ pow(fmax(length - off, 0), 2), pow(length + off, 2) };
}

static int is_in_span(const struct span *span, const struct gsn_fiducial *a,
                      const struct gsn_fiducial *b)
{
    const double dx = a->px.x - b->px.x, dy = a->px.y - b->px.y;
    const double squares = dx * dx + dy * dy;

    return squares >= span->least && squares <= span->most;
}

/* The sides of the prior's triangle in pixels, from each mark to the next, so many tolerances
 * longer or shorter. */
static void sides_of(const struct gsn_fiducial_candidates *section,
                     const struct gsn_triangle_prior *prior, double tolerances,
                     struct span ret_side[GSN_FIDUCIALS])
{
    const double off = tolerances * gsn_triangle_tolerance(prior, section->px_um) / section->px_um;

    for (int i = 0; i < GSN_FIDUCIALS; i++)
        ret_side[i] = span_of(
            gsn_fiducial_distance(prior->mark_um[i], prior->mark_um[(i + 1) % GSN_FIDUCIALS]) /
                section->px_um,
            off);
}

static void add_triples(const struct gsn_fiducial_candidates *section,
                        const struct gsn_triangle_prior *prior, const int *usable,
                        struct hypotheses *hypotheses)
{
    const struct gsn_fiducial *mark = section->mark;
    const int n = (int)section->count;
    struct span side[GSN_FIDUCIALS];

    sides_of(section, prior, prior->learnt ? 3 * TORN : 6, side);
    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            /* Most triples fail on their first side. */
            if (a == b || !usable[a] || !usable[b] || !is_in_span(&side[0], &mark[a], &mark[b]))
                continue;
            for (int k = 0; k < 2 * n; k++) {
                const int c = k / 2;
                struct hypothesis hypothesis = { .candidate = { a, b, c }, .mirrored = k % 2 };

                if (c != a && c != b && usable[c] && is_in_span(&side[1], &mark[b], &mark[c]) &&
                    is_in_span(&side[2], &mark[c], &mark[a]))
                    add_if_plausible(section, prior, TORN_PAIR, &hypothesis, hypotheses);
            }
        }
    }
}

static void add_pairs(const struct gsn_fiducial_candidates *section,
                      const struct gsn_triangle_prior *prior, const int *usable, double torn_pair,
                      struct hypotheses *hypotheses)
{
    const int n = (int)section->count;
    struct span side[GSN_FIDUCIALS];

    /* A misfit of a length is shared by two marks. */
    sides_of(section, prior, PAIR_REACH * torn_pair, side);
    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            if (a == b || !usable[a] || !usable[b])
                continue;
            for (int k = 0; k < 2 * GSN_FIDUCIALS; k++) {
                struct hypothesis hypothesis = { .candidate = { -1, -1, -1 }, .mirrored = k % 2 };

                if (!is_in_span(&side[k / 2], &section->mark[a], &section->mark[b]))
                    continue;
                /* Every pair comes in both orders, so the next mark round is enough. */
                hypothesis.candidate[k / 2] = a;
                hypothesis.candidate[(k / 2 + 1) % GSN_FIDUCIALS] = b;
                add_if_plausible(section, prior, torn_pair, &hypothesis, hypotheses);
            }
        }
    }
}

/* ---- one against another, by the tissue that each aligns ------------------------------------- */

/* The picture's cells go together in patches; so many are witnesses of their own. */
static const double WITNESSES = 20;

/* The tissue's centre moves when a piece is lost. */
static const double TISSUE_SD_MIN_UM = 100;

struct ranking {
    struct hypothesis first[2]; /* best for an upright and for a mirrored section */
    /* best with other candidates, or other numbers, in the same state */
    struct hypothesis other[2];
};

static int same_candidates(const struct hypothesis *a, const struct hypothesis *b)
{
    return memcmp(a->candidate, b->candidate, sizeof a->candidate) == 0;
}

static void rank_hypothesis(struct ranking *ranking, const struct hypothesis *hypothesis)
{
    struct hypothesis *first = &ranking->first[hypothesis->mirrored];
    struct hypothesis *other = &ranking->other[hypothesis->mirrored];

    if (hypothesis->likelihood > first->likelihood) {
        *other = *first;
        *first = *hypothesis;
    } else if (hypothesis->likelihood > other->likelihood && !same_candidates(hypothesis, first)) {
        *other = *hypothesis;
    }
}

/* Whether both call the same blobs marks, whatever their numbers. */
static int has_same_blobs(const struct hypothesis *a, const struct hypothesis *b)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        int seen = 0;

        for (int k = 0; k < GSN_FIDUCIALS; k++)
            seen |= a->candidate[i] == b->candidate[k];
        if (!seen)
            return 0;
    }
    return 1;
}

/* Notes how unlike the others' tissue this one's is. */
static void compare_thumbnail(const struct gsn_fiducial_candidates *section,
                              const struct gsn_triangle_prior *prior, struct hypothesis *hypothesis)
{
    hypothesis->unlike =
        fmax(gsn_thumbnail_dissimilarity(section, &prior->tissue, &hypothesis->motion,
                                         hypothesis->mirrored),
             1e-9);
}

/* Odds for a way that lays the tissue so unlike, against another one. */
static double thumbnail_ratio(double unlike, double other)
{
    return pow(other / unlike, 0.5 * WITNESSES);
}

/* Two marks leave two ways round and two ways up, and three may be mixed with a look-alike; the
 * tissue tells. Of three blobs that are the same, it does not say which way up they are. */
static void weigh_by_thumbnail(const struct gsn_fiducial_candidates *section,
                               const struct gsn_triangle_prior *prior,
                               struct hypotheses *hypotheses)
{
    double least = 1;

    if (hypotheses->count < 2)
        return;
    for (size_t i = 0; i < hypotheses->count; i++) {
        struct hypothesis *c = &hypotheses->item[i];

        compare_thumbnail(section, prior, c);
        least = fmin(least, c->unlike);
    }
    for (size_t i = 0; i < hypotheses->count; i++) {
        struct hypothesis *c = &hypotheses->item[i];
        double own = c->unlike;

        for (size_t k = 0; k < hypotheses->count && is_triple(c); k++)
            if (has_same_blobs(c, &hypotheses->item[k]))
                own = fmin(own, hypotheses->item[k].unlike);
        c->likelihood *= thumbnail_ratio(own, least);
    }
}

/* Where there is no picture, a pair is told by the tissue's centre. */
static void weigh_by_centre(const struct gsn_fiducial_candidates *section,
                            const struct gsn_triangle_prior *prior, struct hypotheses *hypotheses)
{
    const double sd = fmax(prior->tissue_sd_um, TISSUE_SD_MIN_UM);

    for (size_t i = 0; i < hypotheses->count; i++) {
        struct hypothesis *c = &hypotheses->item[i];
        const struct gsn_point tissue = gsn_rigid_apply(
            &c->motion, gsn_fiducial_to_um(section->tissue_px, section->px_um, c->mirrored));

        c->likelihood *= exp(-0.5 * pow(gsn_fiducial_distance(tissue, prior->tissue_um) / sd, 2));
    }
}

/* The winner, and the likelihood of the best that contradicts it. triple: all are of three. */
/* The winner and the likelihood of the best that contradicts it. In a triple, the mirror image of
 * the same three blobs contradicts nothing here: whether flips can be told is settled by the joint
 * solution. */
static struct hypothesis choose_best(const struct hypotheses *hypotheses, int triple,
                                     double *ret_runner_up)
{
    struct ranking ranking = { 0 };
    const struct hypothesis *up = &ranking.first[0], *down = &ranking.first[1];
    const struct hypothesis *winner, *loser;
    int flipped;

    for (size_t i = 0; i < hypotheses->count; i++)
        rank_hypothesis(&ranking, &hypotheses->item[i]);
    flipped = RUNNER_UP_MAX * down->likelihood > up->likelihood;
    winner = flipped ? down : up;
    loser = flipped ? up : down;
    *ret_runner_up = ranking.other[flipped].likelihood;
    if (!triple || !has_same_blobs(winner, loser))
        *ret_runner_up = fmax(*ret_runner_up, loser->likelihood);
    return *winner;
}

/* ---- the match ------------------------------------------------------------------------------- */

/* A fold between two marks takes a quarter of a millimetre of tissue twice. A pair that is so much
 * too short, or too long, is believed only where the picture says so with these odds against all
 * other ways; it is two marks for a person to look at, since no pose fits them. */
static const double FOLDED_PAIR = 3, FOLDED_ODDS = 20;

/* Blobs that are the section's marks with no more than this chance, all ways together, are not
 * worth a person's look. */
static const double LISTED_MIN = 0.05;

/* A pair this much less likely than the three, before the tissue is asked, is not heard. */
static const double UNHEARD = 1e-5;

/* Whether a pair calls nothing else than three do. */
static int is_contained(const struct hypothesis *pair, const struct hypothesis *three)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (pair->candidate[i] >= 0 && pair->candidate[i] != three->candidate[i])
            return 0;
    return pair->mirrored == three->mirrored;
}

static int uses_candidate(const struct hypothesis *hypothesis, int candidate)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (hypothesis->candidate[i] == candidate)
            return 1;
    return 0;
}

/* Pairs that contradict the three: all of them where only a tear could have brought the three where
 * they are, or else those of their own blobs. */
static void find_rivals(const struct gsn_fiducial_candidates *section,
                        const struct gsn_triangle_prior *prior, const int *usable,
                        const struct hypothesis *three, struct hypotheses *rivals)
{
    const int torn = !fits_well(section, prior, three);
    struct hypotheses all;
    int own[GSN_FIDUCIAL_CANDIDATES];

    rivals->count = all.count = 0;
    for (size_t i = 0; i < section->count; i++)
        own[i] = usable[i] && (torn || uses_candidate(three, (int)i));
    add_pairs(section, prior, own, TORN_PAIR, &all);
    for (size_t i = 0; i < all.count; i++) {
        const struct hypothesis *pair = &all.item[i];

        if (!is_contained(pair, three) && pair->likelihood > UNHEARD * three->likelihood)
            keep_likeliest(rivals, pair);
    }
}

/* Three against two that have lost the third: a blob that lies where the third would be, if the
 * section lay otherwise than it does, was taken for it. The tissue's picture is the witness. */
static void compare_with_pairs(const struct gsn_fiducial_candidates *section,
                               const struct gsn_triangle_prior *prior, const int *usable,
                               struct hypothesis *three, double *runner_up)
{
    const int pictured = prior->tissue.cell > 0 && section->map.cell > 0;
    struct hypotheses pairs;
    struct hypothesis best;
    double other, weight;

    if (!pictured || !(prior->chance[GSN_APPEARANCE_CLASSES - 1] > 0))
        return;
    find_rivals(section, prior, usable, three, &pairs);
    weigh_by_thumbnail(section, prior, &pairs);
    best = choose_best(&pairs, 0, &other);
    if (!best.trusted)
        return;
    compare_thumbnail(section, prior, three);
    compare_thumbnail(section, prior, &best);
    weight = thumbnail_ratio(best.unlike, three->unlike);
    if (weight * best.likelihood <= three->likelihood) {
        *runner_up = fmax(*runner_up, weight * best.likelihood);
        return;
    }
    *runner_up = fmax(other, three->likelihood / weight);
    *three = best;
}

static int is_trustworthy(const struct hypothesis *hypothesis, double runner_up)
{
    const double most = hypothesis->folded ? 1 / FOLDED_ODDS : RUNNER_UP_MAX;

    return hypothesis->trusted && !hypothesis->rivalled &&
           runner_up <= most * hypothesis->likelihood;
}

/* Odds that the section has marks, and has them there, against its having none: as many of the
 * stack's sections have some. What two lay is held against the tissue, to which three may have been
 * laid by chance and are in its mean. */
static double odds_against_none(const struct gsn_triangle_prior *prior,
                                const struct hypothesis *hypothesis)
{
    const double stack = prior->marked > 0 ? prior->marked / (1 - prior->marked) : INFINITY;
    const int pictured = !is_triple(hypothesis) && hypothesis->unlike > 0;

    return stack * hypothesis->over_none * (pictured ? thumbnail_ratio(hypothesis->unlike, 1) : 1);
}

/* Two marks and no third: as far apart as they should be, or else what a fold leaves of them. */
static struct hypothesis find_pairs(const struct gsn_fiducial_candidates *section,
                                    const struct gsn_triangle_prior *prior, const int *usable,
                                    struct hypotheses *hypotheses, double *ret_runner_up)
{
    struct hypothesis hypothesis;

    add_pairs(section, prior, usable, TORN_PAIR, hypotheses);
    if (!(prior->tissue.cell > 0 && section->map.cell > 0)) {
        weigh_by_centre(section, prior, hypotheses);
        return choose_best(hypotheses, 0, ret_runner_up);
    }
    weigh_by_thumbnail(section, prior, hypotheses);
    hypothesis = choose_best(hypotheses, 0, ret_runner_up);
    if (is_trustworthy(&hypothesis, *ret_runner_up))
        return hypothesis;
    hypotheses->count = 0;
    add_pairs(section, prior, usable, FOLDED_PAIR, hypotheses);
    weigh_by_thumbnail(section, prior, hypotheses);
    return choose_best(hypotheses, 0, ret_runner_up);
}

/* Finds the hypotheses of a section and chooses. */
static struct hypothesis find_hypotheses(const struct gsn_fiducial_candidates *section,
                                         const struct gsn_triangle_prior *prior,
                                         struct hypotheses *hypotheses, double *ret_runner_up)
{
    int usable[GSN_FIDUCIAL_CANDIDATES];
    struct hypothesis hypothesis;

    hypotheses->count = 0;
    for (size_t i = 0; i < section->count; i++)
        usable[i] = gsn_appearance_acceptable(section, i, prior);
    add_triples(section, prior, usable, hypotheses);
    if (prior->tissue.cell > 0 && section->map.cell > 0)
        weigh_by_thumbnail(section, prior, hypotheses);
    hypothesis = choose_best(hypotheses, 1, ret_runner_up);
    hypothesis.rivalled = RATIO_MIN * *ret_runner_up > hypothesis.likelihood;
    if (hypothesis.trusted && prior->learnt)
        compare_with_pairs(section, prior, usable, &hypothesis, ret_runner_up);
    /* Two rival triples are a riddle for a person; a pair out of them would be a guess. */
    if (!hypothesis.trusted && prior->learnt)
        hypothesis = find_pairs(section, prior, usable, hypotheses, ret_runner_up);
    return hypothesis;
}

void gsn_fiducials_match(const struct gsn_fiducial_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         struct gsn_fiducial ret_marks[GSN_FIDUCIALS], int *ret_mirrored,
                         double *ret_score, double *ret_runner_up)
{
    struct hypotheses hypotheses;
    struct hypothesis hypothesis;
    double runner_up, odds, all;
    int trusted;

    assert(section && prior && ret_marks);

    hypothesis = find_hypotheses(section, prior, &hypotheses, &runner_up);
    odds = hypothesis.likelihood > 0 ? odds_against_none(prior, &hypothesis) : 0;
    /* Two marks are for a person to look at, so that they are rather there than not is enough. */
    trusted =
        is_trustworthy(&hypothesis, runner_up) && odds >= (is_triple(&hypothesis) ? RATIO_MIN : 1);
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        ret_marks[i] = trusted && hypothesis.candidate[i] >= 0
                           ? section->mark[hypothesis.candidate[i]]
                           : (struct gsn_fiducial){ 0 };
    if (ret_mirrored)
        *ret_mirrored = trusted && hypothesis.mirrored;
    all = hypothesis.likelihood > 0 ? hypothesis.likelihood * (1 + 1 / odds) + runner_up : 1;
    if (ret_score)
        *ret_score = hypothesis.likelihood / all;
    if (ret_runner_up)
        *ret_runner_up = runner_up / all;
}

/* The likelier first; of equals the one with the stronger blobs, then the one that lies up. */
static int by_likelihood(const void *left, const void *right)
{
    const struct hypothesis *a = left, *b = right;

    if (a->likelihood != b->likelihood)
        return a->likelihood > b->likelihood ? -1 : 1;
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (a->candidate[i] != b->candidate[i])
            return a->candidate[i] < b->candidate[i] ? -1 : 1;
    return a->mirrored - b->mirrored;
}

/* Whether an earlier hypothesis calls the same three blobs marks, the other way up. */
static int is_told(const struct hypotheses *hypotheses, size_t i)
{
    const struct hypothesis *hypothesis = &hypotheses->item[i];

    for (size_t k = 0; k < i && is_triple(hypothesis); k++)
        if (hypotheses->item[k].mirrored != hypothesis->mirrored &&
            has_same_blobs(&hypotheses->item[k], hypothesis))
            return 1;
    return 0;
}

double gsn_hypotheses_over_none(const struct gsn_fiducial_candidates *section,
                                const struct gsn_triangle_prior *prior)
{
    struct hypotheses hypotheses = { .count = 0 };
    int usable[GSN_FIDUCIAL_CANDIDATES];
    double sum = 0;

    for (size_t i = 0; i < section->count; i++)
        usable[i] = gsn_appearance_acceptable(section, i, prior);
    add_triples(section, prior, usable, &hypotheses);
    for (size_t i = 0; i < hypotheses.count; i++)
        sum += hypotheses.item[i].over_none;
    return sum;
}

size_t gsn_fiducials_hypotheses(const struct gsn_fiducial_candidates *section,
                                const struct gsn_triangle_prior *prior,
                                struct gsn_fiducial_hypothesis ret_rivals[GSN_FIDUCIAL_HYPOTHESES])
{
    struct hypotheses hypotheses;
    double runner_up, sum = 0, none = 0;
    size_t count = 0;

    assert(section && prior && ret_rivals);

    (void)find_hypotheses(section, prior, &hypotheses, &runner_up);
    qsort(hypotheses.item, hypotheses.count, sizeof hypotheses.item[0], by_likelihood);
    for (size_t i = 0; i < hypotheses.count && count < GSN_FIDUCIAL_HYPOTHESES; i++) {
        const struct hypothesis *hypothesis = &hypotheses.item[i];
        struct gsn_fiducial_hypothesis *rival = &ret_rivals[count];

        if (!(hypothesis->likelihood > 0) || is_told(&hypotheses, i))
            continue;
        *rival = (struct gsn_fiducial_hypothesis){ .mirrored = hypothesis->mirrored,
                                                   .share = hypothesis->likelihood };
        for (int m = 0; m < GSN_FIDUCIALS; m++)
            if (hypothesis->candidate[m] >= 0)
                rival->mark[m] = section->mark[hypothesis->candidate[m]];
        if (count == 0)
            none = hypothesis->likelihood / odds_against_none(prior, hypothesis);
        sum += rival->share;
        count++;
    }
    for (size_t i = 0; i < count; i++)
        ret_rivals[i].share /= sum + none;
    return sum < LISTED_MIN * (sum + none) ? 0 : count;
}

/* ---- marks where something else than marks has laid the section ------------------------------ */

/* The blobs that could be one mark, the likeliest and the next. */
struct blobs {
    size_t best;
    double odds, other;
};

static int is_given(const struct gsn_fiducial marks[GSN_FIDUCIALS], const struct gsn_fiducial *blob)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (marks[i].found && marks[i].px.x == blob->px.x && marks[i].px.y == blob->px.y)
            return 1;
    return 0;
}

static struct blobs find_blobs_at(const struct gsn_fiducial_candidates *section,
                                  const struct gsn_triangle_prior *prior,
                                  const struct gsn_affine *panel_to_um, double error_um, int mark)
{
    const struct gsn_displacement moves = find_displacement(section, prior);
    struct blobs blobs = { 0 };

    for (size_t i = 0; i < section->count; i++) {
        const struct gsn_fiducial *blob = &section->mark[i];
        const double away =
            gsn_fiducial_distance(gsn_affine_apply(panel_to_um, blob->px), prior->mark_um[mark]);
        const double odds =
            gsn_placed_mark_ratio(blob, section->px_um, prior, &moves, away, error_um);

        if (!gsn_appearance_acceptable(section, i, prior))
            continue;
        if (odds > blobs.odds) {
            blobs.other = blobs.odds;
            blobs.odds = odds;
            blobs.best = i;
        } else if (odds > blobs.other) {
            blobs.other = odds;
        }
    }
    return blobs;
}

void gsn_fiducials_match_placed(const struct gsn_fiducial_candidates *section,
                                const struct gsn_triangle_prior *prior,
                                const struct gsn_affine *panel_to_um, double error_um,
                                struct gsn_fiducial marks[GSN_FIDUCIALS])
{
    assert(section && prior && prior->learnt && panel_to_um && marks);

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        struct blobs blobs;

        if (marks[i].found)
            continue;
        blobs = find_blobs_at(section, prior, panel_to_um, error_um, i);
        if (blobs.odds >= RATIO_MIN && blobs.other <= RUNNER_UP_MAX * blobs.odds &&
            !is_given(marks, &section->mark[blobs.best]))
            marks[i] = section->mark[blobs.best];
    }
}
