/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/simplex_line.h"

#include "pipeline/model/orient.h"

#include <math.h>
#include <string.h>

enum { SIDES = 8, CLOUDS = 4, SEARCH = 4 };

/* A triangle with at least this share of the square of the longest edge in sight is wide. */
#define WIDE 0.05

/* One line: what is known about the knots around the origin. */
struct view {
    const struct gsn_simplex_sets *sets;
    const double (*knot)[2];
    double cross[GSN_SIMPLEX_MAX_KNOTS][GSN_SIMPLEX_MAX_KNOTS]; /* a_x b_y - a_y b_x */
    /* Knots strictly on one side of a line through the origin, eight such half-planes around. A set
     * all in one of them does not hold the origin. */
    unsigned aside[SIDES];
    /* For sets by their missing clouds: the cloud to leave out of W, so that one knot each of the
     * other three makes a wide triangle; SEARCH where no three clouds do. */
    uint8_t spared[1 << CLOUDS];
    uint8_t knows[GSN_SIMPLEX_MAX_SETS];
    double value[GSN_SIMPLEX_MAX_SETS];
};

static double area(const struct view *view, unsigned a, unsigned b, unsigned c)
{
    const double *p = view->knot[a], *q = view->knot[b], *r = view->knot[c];

    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
}

/* Finds the widest triangle of three clouds for every set of missing clouds. */
static void spare(struct view *view)
{
    const unsigned step = view->sets->degree + 1;
    double size[CLOUDS], longest = 0;

    for (unsigned a = 0; a < CLOUDS; a++) {
        for (unsigned b = 0; b < a; b++) {
            const double x = view->knot[a * step][0] - view->knot[b * step][0];
            const double y = view->knot[a * step][1] - view->knot[b * step][1];

            longest = fmax(longest, x * x + y * y);
        }
    }
    for (unsigned out = 0; out < CLOUDS; out++)
        size[out] = fabs(area(view, (out + 1) % CLOUDS * step, (out + 2) % CLOUDS * step,
                              (out + 3) % CLOUDS * step));
    for (unsigned missing = 0; missing < 1 << CLOUDS; missing++) {
        double best = WIDE * longest;

        view->spared[missing] = SEARCH;
        for (uint8_t out = 0; out < CLOUDS; out++) {
            if (!(missing & ~(1u << out)) && size[out] > best) {
                best = size[out];
                view->spared[missing] = out;
            }
        }
    }
}

static void look(struct view *view, const struct gsn_simplex_sets *sets, const double (*knot)[2])
{
    const unsigned knots = 4 * (sets->degree + 1);

    view->sets = sets;
    view->knot = knot;
    memset(view->aside, 0, sizeof view->aside);
    memset(view->knows, 0, sets->count);
    for (unsigned a = 0; a < knots; a++) {
        const double x = knot[a][0], y = knot[a][1];
        const double along[SIDES / 2] = { x, y, x + y, x - y };

        for (int i = 0; i < SIDES / 2; i++) {
            view->aside[2 * i] |= (unsigned)(along[i] > 0) << a;
            view->aside[2 * i + 1] |= (unsigned)(along[i] < 0) << a;
        }
        for (unsigned b = 0; b < knots; b++)
            view->cross[a][b] = x * knot[b][1] - y * knot[b][0];
    }
    spare(view);
}

static int misses(const struct view *view, unsigned mask)
{
    for (int i = 0; i < SIDES; i++) {
        if (!(mask & ~view->aside[i]))
            return 1;
    }
    return 0;
}

/* Which side of the line a b the origin lies on, moved by e (1,0) + e^2 (0,1), e -> 0+. */
static int side(const struct view *view, unsigned a, unsigned b)
{
    const double *p = view->knot[a], *q = view->knot[b];
    const int sign = gsn_orient_cross(p, q);

    if (sign != 0)
        return sign;
    if (p[1] != q[1])
        return p[1] > q[1] ? 1 : -1;
    return (q[0] > p[0]) - (q[0] < p[0]);
}

static double leaf(const struct view *view, const uint8_t *m)
{
    const int first = side(view, m[0], m[1]);
    double size;

    if (first == 0 || side(view, m[1], m[2]) != first || side(view, m[2], m[0]) != first)
        return 0;
    size = fabs(area(view, m[0], m[1], m[2]));
    return size > 0 ? 1 / size : 0;
}

/* The places in a set of the three knots with the largest triangle. */
static void search(const struct view *view, const struct gsn_simplex_set *set, unsigned ret[3])
{
    double best = -1;

    for (unsigned i = 0; i + 2 < set->size; i++) {
        for (unsigned j = i + 1; j + 1 < set->size; j++) {
            const double *from = view->cross[set->member[i]], *to = view->cross[set->member[j]];
            const double base = from[set->member[j]];

            for (unsigned k = j + 1; k < set->size; k++) {
                const double size = fabs(base + to[set->member[k]] - from[set->member[k]]);

                if (size > best) {
                    best = size;
                    ret[0] = i;
                    ret[1] = j;
                    ret[2] = k;
                }
            }
        }
    }
}

/* The places of W in a set: the last knots of three clouds with a wide triangle, which makes many
 * sets share their subsets, or else the three with the largest triangle. */
static void choose(const struct view *view, const struct gsn_simplex_set *set, unsigned ret[3])
{
    const uint8_t spared = view->spared[set->missing];
    unsigned n = 0;

    if (spared == SEARCH) {
        search(view, set, ret);
        return;
    }
    for (unsigned i = 0; i < set->size; i++) {
        const int last = i + 1 == set->size || set->cloud[i + 1] != set->cloud[i];

        if (last && set->cloud[i] != spared)
            ret[n++] = i;
    }
}

static double value_of(struct view *view, size_t s)
{
    const struct gsn_simplex_set *set = &view->sets->set[s];
    double size, sum = 0;
    unsigned w[3] = { 0, 0, 0 };

    if (view->knows[s])
        return view->value[s];
    view->knows[s] = 1;
    view->value[s] = 0;
    if (misses(view, set->mask))
        return 0;
    if (set->size == 3)
        return view->value[s] = leaf(view, set->member);
    choose(view, set, w);
    size = area(view, set->member[w[0]], set->member[w[1]], set->member[w[2]]);
    for (int i = 0; i < 3 && size != 0; i++) {
        const double part = value_of(view, set->without[w[i]]);

        if (part != 0)
            sum +=
                view->cross[set->member[w[(i + 1) % 3]]][set->member[w[(i + 2) % 3]]] / size * part;
    }
    return view->value[s] = sum;
}

int gsn_simplex_line(const struct gsn_simplex_sets *sets, const double (*knot)[2],
                     double *ret_integral)
{
    struct view view;

    look(&view, sets, knot);
    if (misses(&view, (1u << 4 * (sets->degree + 1)) - 1))
        return 0;
    for (size_t f = 0; f < sets->functions; f++)
        ret_integral[f] = value_of(&view, f) / (sets->degree + 1);
    return 1;
}
