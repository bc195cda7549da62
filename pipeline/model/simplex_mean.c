/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/simplex_mean.h"

#include "pipeline/model/frame.h"
#include "pipeline/model/orient.h"
#include "pipeline/model/simplex.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { FACES = 4 };

/* As in simplex.c: lambda of member i of a quad is swap[i] * plane value of the others / det. */
static const int swap[4] = { -1, 1, -1, 1 };

/* The plane of a knot triple as seen from the four corners of the cell; 0 is exactly 0. */
struct plane {
    double value[4];
};

/* Everything known so far; E_k is found in value[k]. */
struct mean {
    const struct gsn_simplex_sets *sets;
    const double (*knot)[3];
    const uint16_t *pick;
    const struct gsn_simplex_cell *cell;
    uint8_t knows_plane[GSN_SIMPLEX_MAX_TRIPLES];
    uint8_t knows_value[4][GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS];
    struct plane plane[GSN_SIMPLEX_MAX_TRIPLES];
    double value[4][GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS];
};

static const struct plane *plane_of(struct mean *mean, size_t triple)
{
    const size_t slot = triple - mean->sets->first[3];
    const uint8_t *m = mean->sets->set[triple].member;
    const double *a = mean->knot[m[0]], *b = mean->knot[m[1]], *c = mean->knot[m[2]];
    struct plane *plane = &mean->plane[slot];
    double p[3], q[3], r[3], normal[3];

    if (mean->knows_plane[slot])
        return plane;
    mean->knows_plane[slot] = 1;
    gsn_subtract(b, a, p);
    gsn_subtract(c, a, q);
    gsn_cross(p, q, normal);
    for (int i = 0; i < 4; i++) {
        const int sign = gsn_orient3d(a, b, c, mean->cell->corner[i]);

        gsn_subtract(mean->cell->corner[i], a, r);
        /* The exact sign outranks the rounded value. */
        plane->value[i] = sign ? sign * fmax(sign * gsn_dot(normal, r), DBL_MIN) : 0;
    }
    return plane;
}

/* The share of a simplex of dimension k, corners 0..k, where all cuts are positive: it is halved at
 * an edge that a cut crosses until no cut crosses any. */
static double share(int k, double (*value)[FACES], int cuts)
{
    for (int cut = 0; cut < cuts; cut++) {
        int in = -1, out = -1;
        double half[4][FACES], at, part;

        for (int i = 0; i <= k; i++) {
            in = value[i][cut] > 0 ? i : in;
            out = value[i][cut] < 0 ? i : out;
        }
        if (out < 0)
            continue;
        if (in < 0)
            return 0;
        at = value[in][cut] / (value[in][cut] - value[out][cut]);
        memcpy(half, value, (size_t)(k + 1) * sizeof *value);
        for (int i = 0; i < cuts; i++)
            half[out][i] = value[in][i] + at * (value[out][i] - value[in][i]);
        half[out][cut] = 0;
        part = at * share(k, half, cuts);
        memcpy(half[in], half[out], sizeof *half);
        memcpy(half[out], value[out], sizeof *half);
        return part + (1 - at) * share(k, half, cuts);
    }
    return 1;
}

/* Degree 0: which faces of the knot tetrahedron cut the simplex of corners 3 - k .. 3, and what
 * they leave of it. */
static double leaf(struct mean *mean, int k, size_t quad)
{
    const struct gsn_simplex_set *set = &mean->sets->set[quad];
    const double det = gsn_simplex_det(mean->sets, set, mean->knot);
    double value[4][FACES];
    int cuts = 0;

    if (det == 0)
        return 0;
    for (int i = 0; i < 4; i++) {
        const struct plane *plane = plane_of(mean, set->without[i]);
        const int inner = det > 0 ? swap[i] : -swap[i];
        int in = 0, out = 0, zero = 1;

        for (int v = 0; v <= k; v++) {
            value[v][cuts] = inner * plane->value[3 - k + v];
            in |= value[v][cuts] > 0;
            out |= value[v][cuts] < 0;
        }
        zero = !in && !out;
        /* The whole simplex lies in the plane: pushed towards the corner left out last, and so on;
         * not all four corners lie in one plane. */
        for (int v = 2 - k; zero && v >= 0; v--) {
            in = inner * plane->value[v] > 0;
            out = inner * plane->value[v] < 0;
            zero = !in && !out;
        }
        if (!in)
            return 0;
        cuts += out;
    }
    return share(k, value, cuts) / fabs(det);
}

static double value_of(struct mean *mean, int k, size_t s);

/* The set s less one of its knots. */
static size_t without(const struct gsn_simplex_sets *sets, size_t s, unsigned knot)
{
    const unsigned below = sets->set[s].mask & ((1u << knot) - 1);

    return sets->set[s].without[__builtin_popcount(below)];
}

static double recur(struct mean *mean, int k, size_t s)
{
    const struct gsn_simplex_sets *sets = mean->sets;
    const struct gsn_simplex_set *w = &sets->set[mean->pick[s]];
    const double det = gsn_simplex_det(sets, w, mean->knot);
    const int n = sets->set[s].size - 4;
    double sum = 0;

    if (det == 0)
        return 0;
    for (int i = 0; i < 4; i++) {
        const double part = value_of(mean, k, without(sets, s, w->member[i]));

        if (part != 0)
            sum += swap[i] * plane_of(mean, w->without[i])->value[3 - k] / det * part;
    }
    sum *= n;
    if (k > 0)
        sum += k * value_of(mean, k - 1, s);
    return sum / (n + k);
}

/* 1 / ((n + 1) (n + 2) (n + 3)), the integral of M over all of space. */
static double integral_of(int n)
{
    return 1.0 / ((n + 1) * (n + 2) * (n + 3));
}

static double value_of(struct mean *mean, int k, size_t s)
{
    const struct gsn_simplex_set *set = &mean->sets->set[s];
    double *value = &mean->value[k][s];

    if (mean->knows_value[k][s])
        return *value;
    mean->knows_value[k][s] = 1;
    if (set->missing & mean->cell->clear || gsn_simplex_cell_misses(mean->cell, set->mask))
        *value = 0;
    else if (k == 3 && !(set->mask & ~mean->cell->within))
        *value = integral_of(set->size - 4) / mean->cell->volume;
    else if (set->size == 4)
        *value = leaf(mean, k, s);
    else
        *value = recur(mean, k, s);
    return *value;
}

void gsn_simplex_mean(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                      const uint16_t *pick, const struct gsn_simplex_cell *cell, double *ret_mean)
{
    struct mean mean;

    mean.sets = sets;
    mean.knot = knot;
    mean.pick = pick;
    mean.cell = cell;
    memset(mean.knows_plane, 0, sizeof mean.knows_plane);
    memset(mean.knows_value, 0, sizeof mean.knows_value);
    for (size_t f = 0; f < sets->functions; f++)
        ret_mean[f] = value_of(&mean, 3, f);
}

static double distance2(const double a[3], const double b[3])
{
    double d[3];

    gsn_subtract(a, b, d);
    return gsn_dot(d, d);
}

/* Corners in the order of their distance from the middle of the knots. */
static void sort_corners(struct gsn_simplex_cell *cell, const double (*corner)[3],
                         const double (*knot)[3], unsigned knots)
{
    double middle[3] = { 0, 0, 0 }, far[4];

    for (unsigned i = 0; i < knots; i++) {
        for (int c = 0; c < 3; c++)
            middle[c] += knot[i][c] / knots;
    }
    for (int k = 0; k < 4; k++) {
        const double size = distance2(corner[k], middle);
        int place = k;

        for (; place > 0 && far[place - 1] > size; place--) {
            far[place] = far[place - 1];
            memcpy(cell->corner[place], cell->corner[place - 1], sizeof *cell->corner);
        }
        far[place] = size;
        memcpy(cell->corner[place], corner[k], sizeof *cell->corner);
    }
}

void gsn_simplex_cell_init(struct gsn_simplex_cell *cell, const double (*corner)[3],
                           const double (*knot)[3], unsigned knots)
{
    static const int others[4][3] = { { 1, 2, 3 }, { 0, 2, 3 }, { 0, 1, 3 }, { 0, 1, 2 } };

    sort_corners(cell, corner, knot, knots);
    cell->volume =
        fabs(gsn_det(cell->corner[0], cell->corner[1], cell->corner[2], cell->corner[3])) / 6;
    cell->within = (1u << knots) - 1;
    cell->clear = 0;
    for (int k = 0; k < 4; k++) {
        const double *a = cell->corner[others[k][0]], *b = cell->corner[others[k][1]],
                     *c = cell->corner[others[k][2]];
        const int inner = gsn_orient3d(a, b, c, cell->corner[k]);

        cell->beyond[k] = 0;
        for (unsigned i = 0; i < knots; i++) {
            const int side = inner * gsn_orient3d(a, b, c, knot[i]);

            if (side <= 0)
                cell->beyond[k] |= 1u << i;
            if (side < 0)
                cell->within &= ~(1u << i);
        }
    }
}

int gsn_simplex_cell_misses(const struct gsn_simplex_cell *cell, unsigned mask)
{
    for (int k = 0; k < 4; k++) {
        if (!(mask & ~cell->beyond[k]))
            return 1;
    }
    return 0;
}
