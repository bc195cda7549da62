/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/markers.h"

#include "pipeline/register/median.h"
#include "pipeline/register/rigid.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* How far a mark may lie from where a rigid triangle puts it, one standard deviation: sections
 * stretch and shrink by some per cent of the triangle's size. The error of localisation is far
 * smaller and is dealt with by the joint solution, which knows it. */
static const double STRETCH = 0.02;
/* What the stack has taught of that is believed for nine sections in ten, and never to less than
 * this share of the triangle's size, or a pixel: the tenth may be torn. */
static const double ORDINARY = 0.9, STRETCH_LEAST = 0.004;
/* The tissue's centre moves when a piece is lost. */
static const double TISSUE_SD_LEAST_UM = 100;
/* exp(-4.5): three standard deviations. */
static const double LIKELIHOOD_LEAST = 0.0111;
/* A misfit that one section in a thousand exceeds, over the median one: chi-squared of 3 degrees of
 * freedom, 16.3 and 2.4; three standard deviations are let in, so a third of its root does. The
 * rest is for triangles that stretch unequally. */
static const double STRETCH_TAUGHT = 2;
/* A second choice with more than this share of the first's likelihood makes both worthless. */
static const double RUNNER_UP_MOST = 0.5;
/* A spot this much fainter than the third strongest is no mark as long as nothing is learnt... */
static const double FAINTEST = 0.3;
/* ...and afterwards one that differs from the typical mark by more than these factors. A burn may
 * be half burnt in, and half of the rest bleached. */
static const double STRONGER = 2.5, FAINTER = 5, RADIUS_FACTOR = 2;

/* Sections that must share a triangle before it is believed, and the candidates of each that are
 * tried. */
enum { FEWEST_SECTIONS = 3, TRIED = 6, TRIPLES = 20 };

/* One way to call candidates marks. */
struct choice {
    int candidate[GSN_MARKS]; /* index, or -1: this mark is not there */
    int mirrored;
    double likelihood;
};

struct ranking {
    struct choice first[2]; /* best for an upright and for a mirrored section */
    struct choice other[2]; /* best with other candidates, or other numbers, in the same state */
};

static double distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

static struct gsn_point to_um(struct gsn_point px, double px_um, int mirrored)
{
    return (struct gsn_point){ mirrored ? -px.x * px_um : px.x * px_um, px.y * px_um };
}

/* Root mean square distance of the corners from their centroid. */
static double size_of(const struct gsn_point *corner)
{
    double squares = 0;

    for (int i = 0; i < GSN_MARKS; i++)
        squares += pow(distance(corner[i], corner[(i + 1) % GSN_MARKS]), 2);
    /* The mean squared distance of n points from their centroid is the sum over pairs / n^2. */
    return sqrt(squares) / GSN_MARKS;
}

static double tolerance(const struct gsn_triangle_prior *prior, double px_um)
{
    return hypot(STRETCH * size_of(prior->mark_um), 0.5 * px_um);
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

/* The contrast against which a candidate is held. */
static double reference(const struct gsn_mark_candidates *section,
                        const struct gsn_triangle_prior *prior)
{
    return prior->learnt ? prior->contrast : third_strength(section);
}

static int acceptable(const struct gsn_mark_candidates *section, size_t i,
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

/* -2 ln of the likelihood that looks give: marks are as strong as each other. */
static double looks(const struct gsn_mark_candidates *section,
                    const struct gsn_triangle_prior *prior, const struct choice *choice)
{
    double sum = 0;

    for (int i = 0; i < GSN_MARKS; i++) {
        if (choice->candidate[i] >= 0)
            sum += 2 * fmax(1 - strength(&section->mark[choice->candidate[i]]) /
                                    reference(section, prior),
                            0);
    }
    return sum;
}

/* Of a misfit in tolerances, what is known of the section apart. */
static double fitting(const struct gsn_mark_candidates *section,
                      const struct gsn_triangle_prior *prior, double chi2)
{
    const double loose = tolerance(prior, section->px_um);
    const double least = fmax(STRETCH_LEAST * size_of(prior->mark_um), section->px_um);
    const double tight = fmin(fmax(prior->stretch_um, least), loose);

    if (!prior->learnt || !(prior->stretch_um > 0))
        return exp(-0.5 * chi2);
    return ORDINARY * exp(-0.5 * chi2 * pow(loose / tight, 2)) + (1 - ORDINARY) * exp(-0.5 * chi2);
}

/* Lays the marks of a choice on the prior's; ret_chi2 is the misfit in tolerances. */
static int lay(const struct gsn_mark_candidates *section, const struct gsn_triangle_prior *prior,
               const struct choice *choice, struct gsn_rigid *ret_motion, double *ret_chi2)
{
    struct gsn_point from[GSN_MARKS], onto[GSN_MARKS];
    const double sd = tolerance(prior, section->px_um);
    size_t count = 0;
    double rms;

    for (int i = 0; i < GSN_MARKS; i++) {
        if (choice->candidate[i] < 0)
            continue;
        from[count] =
            to_um(section->mark[choice->candidate[i]].px, section->px_um, choice->mirrored);
        onto[count++] = prior->mark_um[i];
    }
    if (gsn_rigid_fit(from, onto, NULL, count, ret_motion, &rms, NULL) < 0)
        return 0;
    *ret_chi2 = (double)count * rms * rms / (sd * sd);
    return 1;
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

static void weigh_triple(const struct gsn_mark_candidates *section,
                         const struct gsn_triangle_prior *prior, int a, int b, int c,
                         struct ranking *ranking)
{
    const double most = 6 * tolerance(prior, section->px_um) / section->px_um;
    const double side = distance(prior->mark_um[0], prior->mark_um[1]) / section->px_um;

    /* Most triples fail on their first side. */
    if (fabs(distance(section->mark[a].px, section->mark[b].px) - side) > most)
        return;
    for (int mirrored = 0; mirrored < 2; mirrored++) {
        struct choice choice = { .candidate = { a, b, c }, .mirrored = mirrored };
        struct gsn_rigid motion;
        double chi2;

        if (!lay(section, prior, &choice, &motion, &chi2))
            continue;
        choice.likelihood =
            fitting(section, prior, chi2) * exp(-0.5 * looks(section, prior, &choice));
        rank(ranking, &choice);
    }
}

static void rank_triples(const struct gsn_mark_candidates *section,
                         const struct gsn_triangle_prior *prior, struct ranking *ranking)
{
    const int n = (int)section->count;
    int fine[GSN_MARK_CANDIDATES];

    for (int i = 0; i < n; i++)
        fine[i] = acceptable(section, (size_t)i, prior);
    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            for (int c = 0; c < n; c++) {
                if (a != b && b != c && a != c && fine[a] && fine[b] && fine[c])
                    weigh_triple(section, prior, a, b, c, ranking);
            }
        }
    }
}

/* Two marks leave two ways round and two ways up; the tissue's centre tells which. */
static void weigh_pair(const struct gsn_mark_candidates *section,
                       const struct gsn_triangle_prior *prior, struct choice choice,
                       struct ranking *ranking)
{
    const double sd = fmax(prior->tissue_sd_um, TISSUE_SD_LEAST_UM);
    struct gsn_rigid motion;
    struct gsn_point tissue;
    double chi2;

    if (!lay(section, prior, &choice, &motion, &chi2))
        return;
    tissue = gsn_rigid_apply(&motion, to_um(section->tissue_px, section->px_um, choice.mirrored));
    choice.likelihood = fitting(section, prior, chi2) *
                        exp(-0.5 * (pow(distance(tissue, prior->tissue_um) / sd, 2) +
                                    looks(section, prior, &choice)));
    rank(ranking, &choice);
}

static void rank_pairs(const struct gsn_mark_candidates *section,
                       const struct gsn_triangle_prior *prior, struct ranking *ranking)
{
    const int n = (int)section->count;

    for (int a = 0; a < n; a++) {
        for (int b = 0; b < n; b++) {
            if (a == b || !acceptable(section, (size_t)a, prior) ||
                !acceptable(section, (size_t)b, prior))
                continue;
            for (int k = 0; k < 2 * GSN_MARKS; k++) {
                struct choice choice = { .candidate = { -1, -1, -1 }, .mirrored = k % 2 };

                /* Every pair comes in both orders, so the next mark round is enough. */
                choice.candidate[k / 2] = a;
                choice.candidate[(k / 2 + 1) % GSN_MARKS] = b;
                weigh_pair(section, prior, choice, ranking);
            }
        }
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

/* The winner and the likelihood of the best that contradicts it. In a triple, the mirror image of
 * the same three spots contradicts nothing here: whether flips can be told is settled by the joint
 * solution. */
static struct choice decide(const struct ranking *ranking, int triple, double *ret_runner_up)
{
    const struct choice *up = &ranking->first[0], *down = &ranking->first[1];
    const int flipped = RUNNER_UP_MOST * down->likelihood > up->likelihood;
    const struct choice *winner = flipped ? down : up, *loser = flipped ? up : down;
    double runner_up = ranking->other[flipped].likelihood;

    if (!triple || !same_spots(winner, loser))
        runner_up = fmax(runner_up, loser->likelihood);
    *ret_runner_up = runner_up;
    return *winner;
}

static int trustworthy(const struct choice *choice, double runner_up)
{
    return choice->likelihood >= LIKELIHOOD_LEAST &&
           runner_up <= RUNNER_UP_MOST * choice->likelihood;
}

void gsn_markers_choose(const struct gsn_mark_candidates *section,
                        const struct gsn_triangle_prior *prior,
                        struct gsn_mark ret_marks[GSN_MARKS], int *ret_mirrored, double *ret_score,
                        double *ret_runner_up)
{
    struct ranking triples = { 0 }, pairs = { 0 };
    struct choice choice;
    double runner_up;

    assert(section && prior && ret_marks);

    rank_triples(section, prior, &triples);
    choice = decide(&triples, 1, &runner_up);
    /* Two rival triples are a riddle for a person; a pair out of them would be a guess. */
    if (choice.likelihood < LIKELIHOOD_LEAST && prior->learnt) {
        rank_pairs(section, prior, &pairs);
        choice = decide(&pairs, 0, &runner_up);
    }
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

int gsn_markers_find(const struct gsn_plane *red_od, const struct gsn_slot *slot, double px_um,
                     const struct gsn_triangle_prior *prior, struct gsn_mark ret_marks[GSN_MARKS],
                     int *ret_mirrored, double *ret_runner_up, struct gsn_error *err)
{
    struct gsn_mark_candidates candidates;
    const int r = gsn_markers_candidates(red_od, slot, px_um, &candidates, err);

    if (r < 0)
        return r;
    gsn_markers_choose(&candidates, prior, ret_marks, ret_mirrored, NULL, ret_runner_up);
    return GSN_OK;
}

/* What learning gathers: one number per section and kind. */
enum { TISSUE_X, TISSUE_Y, CONTRAST, RADIUS, MISFIT, KINDS };

static int gather(const struct gsn_mark_candidates *section, const struct gsn_triangle_prior *prior,
                  double found[KINDS])
{
    struct gsn_mark marks[GSN_MARKS];
    struct gsn_point from[GSN_MARKS], tissue;
    struct gsn_rigid best = { 0 };
    double least = INFINITY;
    int mirrored = 0;

    gsn_markers_choose(section, prior, marks, NULL, NULL, NULL);
    if (!marks[0].found || !marks[1].found || !marks[2].found)
        return 0;
    for (int k = 0; k < 2; k++) {
        struct gsn_rigid motion;
        double rms;

        for (int i = 0; i < GSN_MARKS; i++)
            from[i] = to_um(marks[i].px, section->px_um, k);
        if (gsn_rigid_fit(from, prior->mark_um, NULL, GSN_MARKS, &motion, &rms, NULL) < 0 ||
            rms >= least)
            continue;
        least = rms;
        best = motion;
        mirrored = k;
    }
    tissue = gsn_rigid_apply(&best, to_um(section->tissue_px, section->px_um, mirrored));
    found[TISSUE_X] = tissue.x;
    found[TISSUE_Y] = tissue.y;
    found[MISFIT] = least;
    found[CONTRAST] = (marks[0].contrast + marks[1].contrast + marks[2].contrast) / GSN_MARKS;
    found[RADIUS] =
        (marks[0].radius_px + marks[1].radius_px + marks[2].radius_px) / GSN_MARKS * section->px_um;
    return 1;
}

/* A robust standard deviation of count values about their median; reorders them. */
static double scatter(double *value, size_t count, double centre)
{
    for (size_t i = 0; i < count; i++)
        value[i] = fabs(value[i] - centre);
    return 1.4826 * gsn_median(value, count);
}

int gsn_markers_learn(const struct gsn_mark_candidates *sections, size_t count,
                      struct gsn_triangle_prior *prior, struct gsn_error *err)
{
    gsn_auto_mem(double) value = gsn_alloc_array(count * KINDS, sizeof *value);
    size_t n = 0;

    assert((sections || count == 0) && prior);

    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while learning what a mark looks like");
    for (size_t i = 0; i < count; i++) {
        double found[KINDS];

        if (!gather(&sections[i], prior, found))
            continue;
        for (size_t k = 0; k < KINDS; k++)
            value[k * count + n] = found[k];
        n++;
    }
    if (n < FEWEST_SECTIONS)
        return GSN_OK;
    prior->tissue_um.x = gsn_median(value + TISSUE_X * count, n);
    prior->tissue_um.y = gsn_median(value + TISSUE_Y * count, n);
    /* Of sections whose marks lie exactly nothing is learnt. */
    prior->stretch_um = STRETCH_TAUGHT * gsn_median(value + MISFIT * count, n);
    prior->contrast = gsn_median(value + CONTRAST * count, n);
    prior->radius_um = gsn_median(value + RADIUS * count, n);
    prior->tissue_sd_um = fmax(scatter(value + TISSUE_X * count, n, prior->tissue_um.x),
                               scatter(value + TISSUE_Y * count, n, prior->tissue_um.y));
    prior->learnt = 1;
    return GSN_OK;
}

/* An unnumbered triple of one section: its sides by length, and which way round they run. */
struct triple {
    double side[GSN_MARKS]; /* um, ascending */
    int turn;               /* sign of the cross product with the corners numbered by the sides */
};

struct shapes {
    size_t count;
    struct triple triple[TRIPLES];
};

/* Numbers the corners by the sides: 1 between the shortest (to 2) and the longest (to 3). */
static struct triple triple_of(const struct gsn_point corner[GSN_MARKS], double px_um)
{
    struct triple triple = { 0 };
    int by_length[GSN_MARKS] = { 0, 1, 2 }; /* side i is opposite to corner i */
    double side[GSN_MARKS];

    for (int i = 0; i < GSN_MARKS; i++)
        side[i] = distance(corner[(i + 1) % GSN_MARKS], corner[(i + 2) % GSN_MARKS]) * px_um;
    for (int i = 1; i < GSN_MARKS; i++) {
        for (int k = i; k > 0 && side[by_length[k]] < side[by_length[k - 1]]; k--) {
            const int swap = by_length[k];

            by_length[k] = by_length[k - 1];
            by_length[k - 1] = swap;
        }
    }
    for (int i = 0; i < GSN_MARKS; i++)
        triple.side[i] = side[by_length[i]];
    /* Mark 3 is opposite to the shortest side, 1 to the middle one, 2 to the longest. */
    {
        const struct gsn_point a = corner[by_length[1]], b = corner[by_length[2]],
                               c = corner[by_length[0]];
        const double cross = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);

        triple.turn = (cross > 0) - (cross < 0);
    }
    return triple;
}

static void shapes_of(const struct gsn_mark_candidates *section, struct shapes *shapes)
{
    const struct gsn_triangle_prior nothing = { 0 };
    struct gsn_point spot[TRIED];
    size_t n = 0;

    for (size_t i = 0; i < section->count && n < TRIED; i++) {
        if (acceptable(section, i, &nothing))
            spot[n++] = section->mark[i].px;
    }
    shapes->count = 0;
    for (size_t a = 0; a < n; a++) {
        for (size_t b = a + 1; b < n; b++) {
            for (size_t c = b + 1; c < n; c++) {
                const struct gsn_point corner[GSN_MARKS] = { spot[a], spot[b], spot[c] };

                shapes->triple[shapes->count++] = triple_of(corner, section->px_um);
            }
        }
    }
}

/* Squared relative distance of two triples' sides; infinite beyond three tolerances. */
static double unlike(const struct triple *a, const struct triple *b)
{
    double sum = 0;

    for (int i = 0; i < GSN_MARKS; i++) {
        const double off = (a->side[i] - b->side[i]) / (3 * STRETCH * a->side[2]);

        if (!(fabs(off) <= 1))
            return INFINITY;
        sum += off * off;
    }
    return sum;
}

/* The triple of a section most like the given one, or NULL. */
static const struct triple *most_like(const struct shapes *shapes, const struct triple *triple,
                                      double *ret_unlike)
{
    const struct triple *best = NULL;

    *ret_unlike = INFINITY;
    for (size_t i = 0; i < shapes->count; i++) {
        const double u = unlike(triple, &shapes->triple[i]);

        if (u < *ret_unlike) {
            *ret_unlike = u;
            best = &shapes->triple[i];
        }
    }
    return best;
}

/* How well the stack agrees with one triple. */
struct agreement {
    const struct triple *triple;
    size_t sections;
    double unlike;
};

static struct agreement agree(const struct shapes *shapes, size_t count,
                              const struct triple *triple)
{
    struct agreement sum = { .triple = triple };

    for (size_t i = 0; i < count; i++) {
        double u;

        if (!most_like(&shapes[i], triple, &u))
            continue;
        sum.sections++;
        sum.unlike += u;
    }
    return sum;
}

static struct agreement most_agreed(const struct shapes *shapes, size_t count)
{
    struct agreement best = { 0 };

    for (size_t i = 0; i < count; i++) {
        for (size_t k = 0; k < shapes[i].count; k++) {
            const struct agreement now = agree(shapes, count, &shapes[i].triple[k]);

            if (now.sections > best.sections ||
                (now.sections == best.sections && now.unlike < best.unlike))
                best = now;
        }
    }
    return best;
}

/* The median sides and the majority's turn of what agrees with a triple; scratch holds count. */
static struct triple typical(const struct shapes *shapes, size_t count, const struct triple *triple,
                             double *scratch)
{
    struct triple result = { 0 };

    for (int k = 0; k < GSN_MARKS; k++) {
        size_t n = 0;
        int turn = 0;

        for (size_t i = 0; i < count; i++) {
            double u;
            const struct triple *like = most_like(&shapes[i], triple, &u);

            if (!like)
                continue;
            scratch[n++] = like->side[k];
            turn += like->turn;
        }
        result.side[k] = gsn_median(scratch, n);
        result.turn = turn < 0 ? -1 : 1;
    }
    return result;
}

/* The corners of a triangle with these sides, mark 1 in the origin and mark 2 along x. */
static void corners_of(const struct triple *triple, struct gsn_point ret_corner[GSN_MARKS])
{
    const double s = triple->side[0], m = triple->side[1], l = triple->side[2];
    const double x = (s * s + l * l - m * m) / (2 * s);

    ret_corner[0] = (struct gsn_point){ 0, 0 };
    ret_corner[1] = (struct gsn_point){ s, 0 };
    ret_corner[2] = (struct gsn_point){ x, triple->turn * sqrt(fmax(l * l - x * x, 0)) };
}

int gsn_markers_consensus(const struct gsn_mark_candidates *sections, size_t count,
                          struct gsn_triangle_prior *ret_prior, struct gsn_error *err)
{
    gsn_auto_mem(struct shapes) shapes = gsn_alloc_array(count, sizeof *shapes);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    struct gsn_triangle_prior prior = { 0 };
    struct agreement best;
    struct triple triple;
    size_t usable = 0;

    assert((sections || count == 0) && ret_prior);

    if (!shapes || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for the marks' triangle");
    for (size_t i = 0; i < count; i++) {
        shapes_of(&sections[i], &shapes[i]);
        usable += shapes[i].count > 0;
    }
    best = most_agreed(shapes, count);
    if (best.sections < FEWEST_SECTIONS || 2 * best.sections < usable)
        return gsn_fail(err, GSN_E_MARKERS,
                        "no common triangle of marks: of %zu sections with three dark spots, %zu "
                        "agree; state markers_um in the protocol, or look at the marks",
                        usable, best.sections);
    triple = typical(shapes, count, best.triple, scratch);
    corners_of(&triple, prior.mark_um);
    *ret_prior = prior;
    return GSN_OK;
}
