/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: voting of triangle shapes (as pose clustering, Stockman 1987): every triple of a
 * section's six strongest candidates votes for the triangles of like sides.
 *
 * Steps of gsn_fiducials_vote_triangle(). 1. The triples of each section, by their ascending
 * sides. 2. The triple that most sections have one like, of equals the one that differs least. 3.
 * It is refused where fewer than three sections or half of them agree, or where as many would by
 * chance (the tail of the binomial distribution times the number of triples). 4. Its sides are the
 * medians of those that agree, its sense of rotation the majority's.
 *
 * Fails when no triangle is common, and when memory runs out. Cost: 20 triples a section against
 * all others: 400 n^2 comparisons. */
#include "pipeline/register/fiducial/triangle.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/fiducial/appearance.h"
#include "pipeline/register/fiducial/fiducial.h"

#include <assert.h>
#include <math.h>

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

/* Sections that must share a triangle before it is believed, and the candidates of each that are
 * tried. */
enum { FEWEST_SECTIONS = 3, TRIED = 6, TRIPLES = 20 };

/* Sides of unrelated triples agree by chance: the two ratios of their sides fill an area of 1/4, of
 * which three tolerances either way cut out a square, and their sizes differ by a factor of two or
 * so. */
static const double BY_CHANCE =
    (6 * GSN_TRIANGLE_STRETCH) * (6 * GSN_TRIANGLE_STRETCH) / 0.25 * (6 * GSN_TRIANGLE_STRETCH);

/* Triangles that chance makes as often as this, among all that were compared, are none. */
static const double MOST_CHANCE = 0.05;

/* An unnumbered triple of one section: its sides by length, and which way round they run. */
struct triple {
    double side[GSN_FIDUCIALS]; /* um, ascending */
    int turn; /* sign of the cross product with the corners numbered by the sides */
};

struct shapes {
    size_t count;
    struct triple triple[TRIPLES];
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

static void shapes_of(const struct gsn_fiducial_candidates *section, struct shapes *shapes)
{
    const struct gsn_triangle_prior nothing = { 0 };
    struct gsn_point blob[TRIED];
    size_t n = 0;

    for (size_t i = 0; i < section->count && n < TRIED; i++) {
        if (gsn_appearance_acceptable(section, i, &nothing))
            blob[n++] = section->mark[i].px;
    }
    shapes->count = 0;
    for (size_t a = 0; a < n; a++) {
        for (size_t b = a + 1; b < n; b++) {
            for (size_t c = b + 1; c < n; c++) {
                const struct gsn_point corner[GSN_FIDUCIALS] = { blob[a], blob[b], blob[c] };

                shapes->triple[shapes->count++] = triple_of(corner, section->px_um);
            }
        }
    }
}

/* Squared relative distance of two triples' sides; infinite beyond three tolerances. */
static double shape_distance(const struct triple *a, const struct triple *b)
{
    double sum = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const double off = (a->side[i] - b->side[i]) / (3 * GSN_TRIANGLE_STRETCH * a->side[2]);

        if (!(fabs(off) <= 1))
            return INFINITY;
        sum += off * off;
    }
    return sum;
}

/* The triple of a section most like the given one, or NULL. */
static const struct triple *find_most_like(const struct shapes *shapes, const struct triple *triple,
                                           double *ret_unlike)
{
    const struct triple *best = NULL;

    *ret_unlike = INFINITY;
    for (size_t i = 0; i < shapes->count; i++) {
        const double u = shape_distance(triple, &shapes->triple[i]);

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

static struct agreement count_agreeing(const struct shapes *shapes, size_t count,
                                       const struct triple *triple)
{
    struct agreement sum = { .triple = triple };

    for (size_t i = 0; i < count; i++) {
        double u;

        if (!find_most_like(&shapes[i], triple, &u))
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
            const struct agreement now = count_agreeing(shapes, count, &shapes[i].triple[k]);

            if (now.sections > best.sections ||
                (now.sections == best.sections && now.unlike < best.unlike))
                best = now;
        }
    }
    return best;
}

/* How many triangles with so much agreement there would be by chance, of blobs that are no marks.
 */
static double expected_by_chance(const struct shapes *shapes, size_t count, size_t usable,
                                 size_t agreeing)
{
    double triples = 0, tail = 0, term = 1, each;

    for (size_t i = 0; i < count; i++)
        triples += (double)shapes[i].count;
    each = 1 - pow(1 - BY_CHANCE, triples / (double)usable);
    /* Binomial: at least agreeing - 1 of the usable - 1 others. */
    for (size_t k = 0; k + 1 <= usable; k++) {
        if (k + 1 >= agreeing)
            tail += term * pow(each, (double)k) * pow(1 - each, (double)(usable - 1 - k));
        term *= (double)(usable - 1 - k) / (double)(k + 1);
    }
    return triples * tail;
}

/* The median sides and the majority's turn of what agrees with a triple; scratch holds count. */
static struct triple typical_triple(const struct shapes *shapes, size_t count,
                                    const struct triple *triple, double *scratch)
{
    struct triple result = { 0 };

    for (int k = 0; k < GSN_FIDUCIALS; k++) {
        size_t n = 0;
        int turn = 0;

        for (size_t i = 0; i < count; i++) {
            double u;
            const struct triple *like = find_most_like(&shapes[i], triple, &u);

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

int gsn_fiducials_vote_triangle(const struct gsn_fiducial_candidates *sections, size_t count,
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
    if (best.sections < FEWEST_SECTIONS || 2 * best.sections < usable ||
        expected_by_chance(shapes, count, usable, best.sections) > MOST_CHANCE)
        return gsn_fail(err, GSN_E_MARKERS,
                        "no common triangle of marks: of %zu sections with three dark blobs, %zu "
                        "agree; state markers_um in the protocol, or look at the marks",
                        usable, best.sections);
    triple = typical_triple(shapes, count, best.triple, scratch);
    corners_of(&triple, prior.mark_um);
    prior.burn = sections[0].burn;
    *ret_prior = prior;
    return GSN_OK;
}
