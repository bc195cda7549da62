/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: voting of triangle shapes (as pose clustering, Stockman 1987): every triple of a
 * section's candidates votes for the triangles of like sides.
 *
 * Steps of gsn_fiducials_vote_triangle(). 1. The triples of each section's strongest candidates,
 * by their ascending sides. 2. The triple that most sections have one like, of equals the one that
 * differs least. 3. It is refused where fewer than three sections or half of them agree, or where
 * as many would by chance (the tail of the binomial distribution times the number of triples). 4.
 * Then all candidates are tried, held to the more alike triangles, as far as agreement of all
 * sections would tell anything. 5. Its sides are the medians of those that agree, its sense of
 * rotation the majority's.
 *
 * Fails when no triangle is common, and when memory runs out. Cost: 20 triples a section against
 * all others; among sixty spots 40 000, of which few are compared with more than half of the
 * sections. */
#include "pipeline/register/fiducial/triangle.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/fiducial/appearance.h"
#include "pipeline/register/fiducial/fiducial.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

double gsn_fiducial_distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

struct gsn_point gsn_fiducial_to_um(struct gsn_point px, double px_um, int mirrored)
{
    return (struct gsn_point){ mirrored ? -px.x * px_um : px.x * px_um, px.y * px_um };
}

double gsn_triangle_size(const struct gsn_point corner[GSN_FIDUCIALS])
{
    double squares = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++)
        squares += pow(gsn_fiducial_distance(corner[i], corner[(i + 1) % GSN_FIDUCIALS]), 2);
    /* The mean squared distance of n points from their centroid is the sum over pairs / n^2. */
    return sqrt(squares) / GSN_FIDUCIALS;
}

double gsn_triangle_tolerance(const struct gsn_triangle_prior *prior, double px_um)
{
    return hypot(GSN_TRIANGLE_STRETCH * gsn_triangle_size(prior->mark_um), 0.5 * px_um);
}

/* Sections that must share a triangle before it is believed. */
enum { FEWEST_SECTIONS = 3 };

/* What a round of the vote looks at: the strongest candidates of each section, and how far a triple
 * may be pulled out of shape. Three marks burnt alike are among the strongest, as long as there are
 * few other spots. Where there are many, all are looked at, of the sections that have the fewest,
 * and triples must be the more alike the more of them there are. */
struct round {
    size_t sections, tried;
    double stretch;
};
static const struct round ROUNDS[] = {
    { SIZE_MAX, 6, GSN_TRIANGLE_STRETCH }, { 16, 64, GSN_TRIANGLE_STRETCH / 2 },
    { 16, 64, GSN_TRIANGLE_STRETCH / 4 },  { 16, 64, GSN_TRIANGLE_STRETCH / 8 },
    { 16, 64, GSN_TRIANGLE_STRETCH / 16 },
};

/* Triangles that chance makes as often as this, among all that were compared, are none. */
static const double MOST_CHANCE = 0.05;

/* An unnumbered triple of one section: its sides by length, and which way round they run. */
struct triple {
    double side[GSN_FIDUCIALS]; /* um, ascending */
    int turn; /* sign of the cross product with the corners numbered by the sides */
};

/* The triples of one section, by their longest sides. */
struct shapes {
    size_t count;
    struct triple *triple; /* owned */
};

/* Numbers the corners by the sides: 1 between the shortest (to 2) and the longest (to 3). */
static struct triple triple_of(const struct gsn_point corner[GSN_FIDUCIALS], double px_um)
{
    struct triple triple = { 0 };
    int by_length[GSN_FIDUCIALS] = { 0, 1, 2 }; /* side i is opposite to corner i */
    double side[GSN_FIDUCIALS];

    for (int i = 0; i < GSN_FIDUCIALS; i++)
        side[i] = gsn_fiducial_distance(corner[(i + 1) % GSN_FIDUCIALS],
                                        corner[(i + 2) % GSN_FIDUCIALS]) *
                  px_um;
    for (int i = 1; i < GSN_FIDUCIALS; i++) {
        for (int k = i; k > 0 && side[by_length[k]] < side[by_length[k - 1]]; k--) {
            const int swap = by_length[k];

            by_length[k] = by_length[k - 1];
            by_length[k - 1] = swap;
        }
    }
    for (int i = 0; i < GSN_FIDUCIALS; i++)
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

static int by_longest(const void *a, const void *b)
{
    const struct triple *p = a, *q = b;

    return (p->side[2] > q->side[2]) - (p->side[2] < q->side[2]);
}

static int list_shapes(const struct gsn_fiducial_candidates *section, size_t tried,
                       struct shapes *ret_shapes)
{
    const struct gsn_triangle_prior nothing = { 0 };
    struct gsn_point blob[GSN_FIDUCIAL_CANDIDATES];
    size_t n = 0;
    struct triple *to;

    for (size_t i = 0; i < section->count && n < tried; i++)
        if (gsn_appearance_acceptable(section, i, &nothing))
            blob[n++] = section->mark[i].px;
    ret_shapes->count = n < 3 ? 0 : n * (n - 1) * (n - 2) / 6;
    ret_shapes->triple = to = gsn_alloc_array(ret_shapes->count + 1, sizeof *to);
    if (!to)
        return 0;
    for (size_t a = 0; a < n; a++)
        for (size_t b = a + 1; b < n; b++)
            for (size_t c = b + 1; c < n; c++) {
                const struct gsn_point corner[GSN_FIDUCIALS] = { blob[a], blob[b], blob[c] };

                *to++ = triple_of(corner, section->px_um);
            }
    qsort(ret_shapes->triple, ret_shapes->count, sizeof *to, by_longest);
    return 1;
}

/* Three tolerances of a side. */
static double reach_of(const struct triple *triple, double stretch)
{
    return 3 * stretch * triple->side[2];
}

/* Squared distance of two triples' sides in reaches; infinite beyond one. */
static double shape_distance(const struct triple *a, const struct triple *b, double reach)
{
    double sum = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const double off = (a->side[i] - b->side[i]) / reach;

        if (!(fabs(off) <= 1))
            return INFINITY;
        sum += off * off;
    }
    return sum;
}

/* The first whose longest side is no shorter. */
static size_t find_first(const struct shapes *shapes, double longest)
{
    size_t from = 0, to = shapes->count;

    while (from < to) {
        const size_t middle = from + (to - from) / 2;

        if (shapes->triple[middle].side[2] < longest)
            from = middle + 1;
        else
            to = middle;
    }
    return from;
}

/* The triple of a section most like the given one, or NULL. */
static const struct triple *find_most_like(const struct shapes *shapes, const struct triple *triple,
                                           double stretch, double *ret_unlike)
{
    const double reach = reach_of(triple, stretch);
    const struct triple *best = NULL;

    *ret_unlike = INFINITY;
    for (size_t i = find_first(shapes, triple->side[2] - reach);
         i < shapes->count && shapes->triple[i].side[2] <= triple->side[2] + reach; i++) {
        const double u = shape_distance(triple, &shapes->triple[i], reach);

        if (u < *ret_unlike) {
            *ret_unlike = u;
            best = &shapes->triple[i];
        }
    }
    return best;
}

/* One round's triples of the sections that it looks at, those with the fewest first. */
struct vote {
    double stretch;
    size_t count, usable; /* sections; those with any triple */
    struct shapes *shapes;
};

/* How well the stack agrees with one triple. */
struct agreement {
    const struct triple *triple;
    size_t sections;
    double unlike;
};

/* No further than so many sections can still agree as must. */
static struct agreement count_agreeing(const struct vote *vote, const struct triple *triple,
                                       size_t must)
{
    struct agreement sum = { .triple = triple };

    for (size_t i = 0; i < vote->count && sum.sections + (vote->count - i) >= must; i++) {
        double u;

        if (!find_most_like(&vote->shapes[i], triple, vote->stretch, &u))
            continue;
        sum.sections++;
        sum.unlike += u;
    }
    return sum;
}

static struct agreement most_agreed(const struct vote *vote)
{
    struct agreement best = { 0 };

    for (size_t i = 0; i < vote->count; i++)
        for (size_t k = 0; k < vote->shapes[i].count; k++) {
            const size_t half = (vote->usable + 1) / 2;
            const struct agreement now = count_agreeing(
                vote, &vote->shapes[i].triple[k], best.sections > half ? best.sections : half);

            if (now.sections > best.sections ||
                (now.sections == best.sections && now.unlike < best.unlike))
                best = now;
        }
    return best;
}

/* How many triangles with so much agreement there would be by chance, of blobs that are no marks.
 * Sides of unrelated triples agree by chance: the two ratios of their sides fill an area of 1/4, of
 * which three tolerances either way cut out a square, and their sizes differ by a factor of two or
 * so. */
static double expected_by_chance(const struct vote *vote, size_t agreeing)
{
    const double by_chance = pow(6 * vote->stretch, 3) / 0.25;
    double triples = 0, tail = 0, term = 1, each;

    for (size_t i = 0; i < vote->count; i++)
        triples += (double)vote->shapes[i].count;
    each = 1 - pow(1 - by_chance, triples / (double)vote->usable);
    /* Binomial: at least agreeing - 1 of the usable - 1 others. */
    for (size_t k = 0; k + 1 <= vote->usable; k++) {
        if (k + 1 >= agreeing)
            tail += term * pow(each, (double)k) * pow(1 - each, (double)(vote->usable - 1 - k));
        term *= (double)(vote->usable - 1 - k) / (double)(k + 1);
    }
    return triples * tail;
}

/* The median sides and the majority's turn of what agrees with a triple; scratch holds count. */
static struct triple typical_triple(const struct vote *vote, const struct triple *triple,
                                    double *scratch)
{
    struct triple result = { 0 };

    for (int k = 0; k < GSN_FIDUCIALS; k++) {
        size_t n = 0;
        int turn = 0;

        for (size_t i = 0; i < vote->count; i++) {
            double u;
            const struct triple *like = find_most_like(&vote->shapes[i], triple, vote->stretch, &u);

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
static void corners_of(const struct triple *triple, struct gsn_point ret_corner[GSN_FIDUCIALS])
{
    const double s = triple->side[0], m = triple->side[1], l = triple->side[2];
    const double x = (s * s + l * l - m * m) / (2 * s);

    ret_corner[0] = (struct gsn_point){ 0, 0 };
    ret_corner[1] = (struct gsn_point){ s, 0 };
    ret_corner[2] = (struct gsn_point){ x, triple->turn * sqrt(fmax(l * l - x * x, 0)) };
}

/* The sections with the fewest candidates, by their number. */
static void list_fewest(const struct gsn_fiducial_candidates *sections, size_t count,
                        size_t *ret_at)
{
    for (size_t i = 0; i < count; i++) {
        size_t k = i;

        for (; k > 0 && sections[ret_at[k - 1]].count > sections[i].count; k--)
            ret_at[k] = ret_at[k - 1];
        ret_at[k] = i;
    }
}

/* One round. ret_best: what most agree with; sections 0 where no agreement would tell anything. */
static int hold_vote(const struct gsn_fiducial_candidates *sections, const size_t *at, size_t tried,
                     struct vote *vote, struct agreement *ret_best, struct gsn_error *err)
{
    struct agreement best = { 0 };

    for (size_t i = 0; i < vote->count; i++) {
        if (!list_shapes(&sections[at[i]], tried, &vote->shapes[i]))
            return gsn_fail(err, GSN_E_NOMEM,
                            "out of memory while looking for the marks' triangle");
        vote->usable += vote->shapes[i].count > 0;
    }
    if (vote->usable >= FEWEST_SECTIONS && expected_by_chance(vote, vote->usable) <= MOST_CHANCE)
        best = most_agreed(vote);
    *ret_best = best;
    return GSN_OK;
}

static int is_convincing(const struct vote *vote, const struct agreement *best)
{
    return best->sections >= FEWEST_SECTIONS && 2 * best->sections >= vote->usable &&
           expected_by_chance(vote, best->sections) <= MOST_CHANCE;
}

/* ret_agreed: most sections that agreed, and of how many; sections 0 where none convinces. */
static int run_rounds(const struct gsn_fiducial_candidates *sections, size_t count, size_t *at,
                      struct shapes *shapes, double *scratch, struct triple *ret_triple,
                      size_t *ret_agreed, size_t *ret_usable, struct gsn_error *err)
{
    list_fewest(sections, count, at);
    for (size_t k = 0; k < sizeof ROUNDS / sizeof *ROUNDS; k++) {
        struct vote vote = { .stretch = ROUNDS[k].stretch,
                             .count = count < ROUNDS[k].sections ? count : ROUNDS[k].sections,
                             .shapes = shapes };
        struct agreement best = { 0 };
        const int r = hold_vote(sections, at, ROUNDS[k].tried, &vote, &best, err);
        const int convincing = r >= 0 && is_convincing(&vote, &best);

        if (convincing)
            *ret_triple = typical_triple(&vote, best.triple, scratch);
        for (size_t i = 0; i < vote.count; i++)
            gsn_free(gsn_steal(&shapes[i].triple));
        if (r < 0)
            return r;
        if (k == 0) {
            *ret_agreed = best.sections;
            *ret_usable = vote.usable;
        }
        if (convincing)
            return 1;
    }
    return 0;
}

int gsn_fiducials_vote_triangle(const struct gsn_fiducial_candidates *sections, size_t count,
                                struct gsn_triangle_prior *ret_prior, struct gsn_error *err)
{
    gsn_auto_mem(struct shapes) shapes = gsn_alloc_array(count, sizeof *shapes);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    gsn_auto_mem(size_t) at = gsn_alloc_array(count, sizeof *at);
    struct gsn_triangle_prior prior = { 0 };
    struct triple triple = { 0 };
    size_t agreed = 0, usable = 0;
    int r;

    assert((sections || count == 0) && ret_prior);

    if (!shapes || !scratch || !at)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for the marks' triangle");
    r = run_rounds(sections, count, at, shapes, scratch, &triple, &agreed, &usable, err);
    if (r < 0)
        return r;
    if (r == 0)
        return gsn_fail(err, GSN_E_MARKERS,
                        "no common triangle of marks: of %zu sections with three dark blobs, %zu "
                        "agree; state markers_um in the protocol, or look at the marks",
                        usable, agreed);
    corners_of(&triple, prior.mark_um);
    prior.burn = sections[0].burn;
    *ret_prior = prior;
    return GSN_OK;
}
