/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Means of simplex splines over a tetrahedral cell.
 *
 * Method: the mean recurrence, equation (9) of the paper as corrected in docs/MATH.md, section 5:
 * the mean over a cell from means of lower degree and means over the cell's faces, edges and
 * corners. Beside it, for knots of which four may lie in one plane, the slow and plain way: cut the
 * cell at all planes of three knots and integrate the polynomial of each piece exactly.
 *
 * Steps: (1) which knots lie beyond the cell's planes, which within; (2) descend over knot sets and
 * faces of the cell at once, remembering every mean; (3) at degree 0 the part of a cell, triangle,
 * edge or corner inside a tetrahedron of knots, with exact decisions on planes that touch.
 *
 * Failure: none; the caller guarantees a cell of positive volume.
 * Cost: the recurrence branches once a knot and degree; the pieces cost far more, so tests alone
 * ask for them. */
#include "pipeline/model/simplex_mean.h"

#include "pipeline/model/barycentric.h"
#include "pipeline/model/orient.h"
#include "pipeline/model/simplex_spline.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* --- by the mean recurrence --- */

enum {
    FACES = 4,
    WHOLE = 15, /* a simplex of the cell has a bit per corner; this is the cell itself */
    MOST_STEPS = 8,
    FAR = 64, /* sum of lambda^2 that is too much */
};

/* As in simplex_spline.c: lambda of member i of a quad is swap[i] * plane value of the others /
 * det. */
static const int swap[4] = { -1, 1, -1, 1 };

enum { UNKNOWN, NO, YES };

/* The plane of a knot triple as seen from the four corners of the cell; 0 is exactly 0. */
struct plane {
    double value[4];
};

/* Everything known so far; E[M(set); simplex] is found in value[simplex][set]. */
struct mean {
    const struct gsn_simplex_sets *sets;
    const double (*knot)[3];
    const uint16_t *pick;
    const struct gsn_simplex_cell *cell;
    uint8_t knows_plane[GSN_SIMPLEX_MAX_TRIPLES];
    double distance2[GSN_SIMPLEX_MAX_KNOTS][4]; /* of a knot from a corner of the cell, squared */
    uint8_t knows_det[GSN_SIMPLEX_MAX_QUADS];
    double det[GSN_SIMPLEX_MAX_QUADS];
    uint8_t beside[GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS]; /* gsn_simplex_cell_misses() */
    unsigned clear[WHOLE + 1];                                     /* of all corners of a simplex */
    uint8_t knows_value[WHOLE + 1][GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS];
    struct plane plane[GSN_SIMPLEX_MAX_TRIPLES];
    double value[WHOLE + 1][GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS];
};

/* What a rounding bound of normal . r is relative to. */
static double relative_uncertainty(const double permanent[3], const double r[3])
{
    return permanent[0] * fabs(r[0]) + permanent[1] * fabs(r[1]) + permanent[2] * fabs(r[2]);
}

static double distance_squared(const double a[3], const double b[3])
{
    double d[3];

    gsn_subtract(a, b, d);
    return gsn_dot(d, d);
}

/* normal . (v - a) for corner v of the cell, a being the knot nearest to it, and exactly 0 or of
 * the exact sign. */
static double exact_height(const struct mean *mean, const struct gsn_simplex_set *set, int v,
                           const double normal[3], const double permanent[3])
{
    const double *corner = mean->cell->corner[v];
    unsigned nearest = set->member[0];
    double r[3], value;
    int sign;

    for (int i = 1; i < 3; i++) {
        if (mean->distance2[set->member[i]][v] < mean->distance2[nearest][v])
            nearest = set->member[i];
    }
    gsn_subtract(corner, mean->knot[nearest], r);
    if (r[0] == 0 && r[1] == 0 && r[2] == 0)
        return 0;
    value = gsn_dot(normal, r);
    if (fabs(value) > GSN_ORIENT_BOUND * relative_uncertainty(permanent, r))
        return value;
    sign = gsn_orient3d(mean->knot[set->member[0]], mean->knot[set->member[1]],
                        mean->knot[set->member[2]], corner);
    return sign ? sign * fmax(sign * value, DBL_MIN) : 0;
}

static const struct plane *plane_of(struct mean *mean, size_t triple)
{
    const size_t slot = triple - mean->sets->first[3];
    const struct gsn_simplex_set *set = &mean->sets->set[triple];
    struct plane *plane = &mean->plane[slot];
    double normal[3], permanent[3];

    if (mean->knows_plane[slot])
        return plane;
    mean->knows_plane[slot] = 1;
    gsn_simplex_normal(set, mean->knot, normal, permanent);
    for (int v = 0; v < 4; v++)
        plane->value[v] = exact_height(mean, set, v, normal, permanent);
    return plane;
}

static double det_of(struct mean *mean, size_t quad)
{
    const size_t slot = quad - mean->sets->first[4];

    if (!mean->knows_det[slot]) {
        mean->knows_det[slot] = 1;
        mean->det[slot] = gsn_simplex_det(&mean->sets->set[quad], mean->knot);
    }
    return mean->det[slot];
}

/* The share of a simplex of dimension k, corners 0..k, where all cuts are positive: it is halved at
 * an edge that a cut crosses until no cut crosses any. */
static double positive_share(int k, double (*value)[FACES], int cuts)
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
        part = at * positive_share(k, half, cuts);
        memcpy(half[in], half[out], sizeof *half);
        memcpy(half[out], value[out], sizeof *half);
        return part + (1 - at) * positive_share(k, half, cuts);
    }
    return 1;
}

/* Degree 0: which faces of the knot tetrahedron cut the simplex, and what they leave of it. */
static double mean_degree0(struct mean *mean, unsigned simplex, size_t quad)
{
    const struct gsn_simplex_set *set = &mean->sets->set[quad];
    const double det = det_of(mean, quad);
    double value[4][FACES];
    int cuts = 0, corners = 0;

    if (det == 0)
        return 0;
    for (int i = 0; i < 4; i++) {
        const struct plane *plane = plane_of(mean, set->without[i]);
        const int inner = det > 0 ? swap[i] : -swap[i];
        int in = 0, out = 0;

        corners = 0;
        for (int v = 0; v < 4; v++) {
            if (!(simplex >> v & 1))
                continue;
            value[corners][cuts] = inner * plane->value[v];
            in |= value[corners][cuts] > 0;
            out |= value[corners][cuts] < 0;
            corners++;
        }
        /* The whole simplex lies in the plane: pushed towards the first of the other corners that
         * does not. Always the same one first, so that all knot sets see the same push. */
        for (int v = 0; v < 4 && !in && !out; v++) {
            in = inner * plane->value[v] > 0;
            out = inner * plane->value[v] < 0;
            if (out)
                return 0;
        }
        if (!in)
            return 0;
        cuts += out;
    }
    return positive_share(corners - 1, value, cuts) / fabs(det);
}

static double value_of(struct mean *mean, unsigned simplex, size_t s);

/* The recurrence holds for any point y of the simplex, with a boundary term for each face, weighted
 * by the barycentric coordinates of y. Rounding errors grow by the coordinates lambda of y in w,
 * so y is taken where they are small: at a corner if one will do, else where a few steps of Frank
 * and Wolfe's method towards the least sum of squares lead. ret_weight is 0 off the simplex. */
static void choose_point(struct mean *mean, unsigned simplex, const struct gsn_simplex_set *w,
                         double det, double ret_weight[4], double ret_lambda[4])
{
    double lambda[4][4], size, least = INFINITY;
    int best = 0;

    for (int v = 0; v < 4; v++) {
        ret_weight[v] = 0;
        if (!(simplex >> v & 1))
            continue;
        size = 0;
        for (int i = 0; i < 4; i++) {
            lambda[v][i] = swap[i] * plane_of(mean, w->without[i])->value[v] / det;
            size += lambda[v][i] * lambda[v][i];
        }
        if (size < least) {
            least = size;
            best = v;
        }
    }
    ret_weight[best] = 1;
    memcpy(ret_lambda, lambda[best], sizeof lambda[best]);
    for (int step = 0; step < MOST_STEPS && least > FAR; step++) {
        double slope = INFINITY, way = 0, by;

        for (int v = 0; v < 4; v++) {
            double along = 0;

            for (int i = 0; simplex >> v & 1 && i < 4; i++)
                along += ret_lambda[i] * (lambda[v][i] - ret_lambda[i]);
            if (along < slope) {
                slope = along;
                best = v;
            }
        }
        for (int i = 0; i < 4; i++)
            way += (lambda[best][i] - ret_lambda[i]) * (lambda[best][i] - ret_lambda[i]);
        if (!(slope < 0) || !(way > 0))
            break;
        by = fmin(1, -slope / way);
        least = 0;
        for (int i = 0; i < 4; i++) {
            ret_weight[i] += by * ((i == best) - ret_weight[i]);
            ret_lambda[i] += by * (lambda[best][i] - ret_lambda[i]);
            least += ret_lambda[i] * ret_lambda[i];
        }
    }
}

static double mean_recurrence(struct mean *mean, unsigned simplex, size_t s)
{
    const struct gsn_simplex_set *set = &mean->sets->set[s];
    const struct gsn_simplex_set *w = &mean->sets->set[mean->pick[s]];
    const double det = det_of(mean, mean->pick[s]);
    const int n = set->size - 4, k = __builtin_popcount(simplex) - 1;
    double sum = 0, weight[4], lambda[4];

    if (det == 0)
        return 0;
    choose_point(mean, simplex, w, det, weight, lambda);
    for (unsigned i = 0, m = 0; i < 4; i++) {
        while (set->member[m] != w->member[i])
            m++;
        if (lambda[i] != 0)
            sum += n * lambda[i] * value_of(mean, simplex, set->without[m]);
    }
    for (int v = 0; v < 4 && k > 0; v++) {
        if (weight[v] != 0)
            sum += k * weight[v] * value_of(mean, simplex & ~(1u << v), s);
    }
    return sum / (n + k);
}

/* n! / (n + 3)!, the integral of M over all of space. */
static double integral_of(int n)
{
    return 1.0 / ((n + 1) * (n + 2) * (n + 3));
}

static int mean_vanishes(struct mean *mean, unsigned simplex, size_t s)
{
    const struct gsn_simplex_set *set = &mean->sets->set[s];

    if (mean->beside[s] == UNKNOWN)
        mean->beside[s] = gsn_simplex_cell_misses(mean->cell, set->mask) ? YES : NO;
    return mean->beside[s] == YES || set->missing & mean->clear[simplex];
}

static double value_of(struct mean *mean, unsigned simplex, size_t s)
{
    const struct gsn_simplex_set *set = &mean->sets->set[s];
    double *value = &mean->value[simplex][s];

    if (mean->knows_value[simplex][s])
        return *value;
    mean->knows_value[simplex][s] = 1;
    if (mean_vanishes(mean, simplex, s))
        *value = 0;
    else if (simplex == WHOLE && !(set->mask & ~mean->cell->within))
        *value = integral_of(set->size - 4) / mean->cell->volume;
    else if (set->size == 4)
        *value = mean_degree0(mean, simplex, s);
    else
        *value = mean_recurrence(mean, simplex, s);
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
    memset(mean.knows_det, 0, sizeof mean.knows_det);
    memset(mean.beside, UNKNOWN, sizeof mean.beside);
    mean.clear[0] = WHOLE;
    for (unsigned simplex = 1; simplex <= WHOLE; simplex++)
        mean.clear[simplex] =
            mean.clear[simplex & (simplex - 1)] & cell->clear[__builtin_ctz(simplex)];
    for (unsigned i = 0; i < 4 * (sets->degree + 1); i++) {
        for (int v = 0; v < 4; v++)
            mean.distance2[i][v] = distance_squared(knot[i], cell->corner[v]);
    }
    memset(mean.knows_value, 0, sizeof mean.knows_value);
    for (size_t f = 0; f < sets->functions; f++)
        ret_mean[f] = value_of(&mean, WHOLE, f);
}

static const int others[4][3] = { { 1, 2, 3 }, { 0, 2, 3 }, { 0, 1, 3 }, { 0, 1, 2 } };

/* The plane of a face, for the signs of many points. */
struct face {
    const double *at[3];
    double normal[3], permanent[3];
    int inner; /* side of the fourth corner */
};

static inline int side_of(const struct face *face, const double v[3])
{
    double r[3], value;

    gsn_subtract(v, face->at[0], r);
    value = gsn_dot(face->normal, r);
    if (fabs(value) > GSN_ORIENT_BOUND * relative_uncertainty(face->permanent, r))
        return value > 0 ? 1 : -1;
    for (int i = 0; i < 3; i++) {
        if (v[0] == face->at[i][0] && v[1] == face->at[i][1] && v[2] == face->at[i][2])
            return 0;
    }
    return gsn_orient3d(face->at[0], face->at[1], face->at[2], v);
}

static void face_init(struct face *face, const double *const corner[4], int k)
{
    double p[3], q[3];

    for (int i = 0; i < 3; i++)
        face->at[i] = corner[others[k][i]];
    gsn_subtract(face->at[1], face->at[0], p);
    gsn_subtract(face->at[2], face->at[0], q);
    gsn_cross(p, q, face->normal);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, l = (i + 2) % 3;

        face->permanent[i] = fabs(p[j] * q[l]) + fabs(p[l] * q[j]);
    }
    face->inner = side_of(face, corner[k]);
}

/* Sorts the knots by the planes of the cell's faces. */
static void look_from_cell(struct gsn_simplex_cell *cell, const double (*knot)[3], unsigned knots)
{
    const double *const corner[4] = { cell->corner[0], cell->corner[1], cell->corner[2],
                                      cell->corner[3] };

    for (int k = 0; k < 4; k++) {
        struct face face;

        face_init(&face, corner, k);
        cell->beyond[k] = 0;
        for (unsigned i = 0; i < knots; i++) {
            const int side = face.inner * side_of(&face, knot[i]);

            if (side <= 0)
                cell->beyond[k] |= 1u << i;
            if (side < 0)
                cell->within &= ~(1u << i);
        }
    }
}

/* Sorts the knots by the planes of their own tetrahedron's faces, where the whole cell lies on the
 * outer side of one. */
static void look_from_knots(struct gsn_simplex_cell *cell, const double (*knot)[3], unsigned degree)
{
    const double *const corner[4] = { knot[0], knot[degree + 1], knot[2 * (degree + 1)],
                                      knot[3 * (degree + 1)] };

    for (int k = 0; k < 4; k++) {
        struct face face;
        int apart = 1;

        face_init(&face, corner, k);
        cell->beyond[4 + k] = 0;
        for (int i = 0; i < 4 && apart; i++)
            apart = face.inner * side_of(&face, cell->corner[i]) <= 0;
        for (unsigned i = 0; apart && i < 4 * (degree + 1); i++) {
            if (face.inner * side_of(&face, knot[i]) >= 0)
                cell->beyond[4 + k] |= 1u << i;
        }
    }
}

void gsn_simplex_cell_init(struct gsn_simplex_cell *cell, const double (*corner)[3],
                           const double (*knot)[3], unsigned degree)
{
    const unsigned knots = 4 * (degree + 1);

    memcpy(cell->corner, corner, sizeof cell->corner);
    cell->volume =
        fabs(gsn_det(cell->corner[0], cell->corner[1], cell->corner[2], cell->corner[3])) / 6;
    cell->within = (1u << knots) - 1;
    memset(cell->clear, 0, sizeof cell->clear);
    look_from_cell(cell, knot, knots);
    look_from_knots(cell, knot, degree);
}

int gsn_simplex_cell_misses(const struct gsn_simplex_cell *cell, unsigned mask)
{
    for (int k = 0; k < 8; k++) {
        if (!(mask & ~cell->beyond[k]))
            return 1;
    }
    return 0;
}

/* --- by pieces, for knots in any position --- */

/* Means over a cell for knots in any position: cut, then integrate polynomial by polynomial. */

/* A plane that passes a corner nearer than this share of the cell's size goes through it. */
#define TOUCH 1e-13

/* One function over the pieces of one cell. */
struct cutting {
    const struct gsn_simplex_sets *sets;
    const double (*knot)[3];
    const uint16_t *pick;
    size_t function;
    double touch;
};

/* The mean over one piece, by a rule that is exact for polynomials of degree 3 (Keast): the middle
 * and four points around it. All lie inside the piece, off every knot plane. */
static double apply_rule(const struct cutting *cutting, const double (*corner)[3])
{
    double sum = 0;

    for (int i = 0; i < 5; i++) {
        struct gsn_simplex_at at;
        double u[3];

        for (int c = 0; c < 3; c++) {
            u[c] = (corner[0][c] + corner[1][c] + corner[2][c] + corner[3][c]) / (i < 4 ? 6 : 4);
            u[c] += i < 4 ? corner[i][c] / 3 : 0;
        }
        gsn_simplex_at_init(&at, cutting->sets, cutting->knot, cutting->pick, u, 0);
        sum += (i < 4 ? 0.45 : -0.8) * gsn_simplex_value(&at, cutting->function);
    }
    return sum;
}

/* How far the corners lie on either side of the plane of a knot triple; 0 when it has none. */
static int see_plane(const struct cutting *cutting, size_t triple, const double (*corner)[3],
                     double ret_value[4])
{
    const uint8_t *m = cutting->sets->set[triple].member;
    double p[3], q[3], r[3], normal[3], size;

    gsn_subtract(cutting->knot[m[1]], cutting->knot[m[0]], p);
    gsn_subtract(cutting->knot[m[2]], cutting->knot[m[0]], q);
    gsn_cross(p, q, normal);
    size = sqrt(gsn_dot(normal, normal));
    if (!(size > 0))
        return 0;
    for (int i = 0; i < 4; i++) {
        gsn_subtract(corner[i], cutting->knot[m[0]], r);
        ret_value[i] = gsn_dot(normal, r) / size;
        if (fabs(ret_value[i]) <= cutting->touch)
            ret_value[i] = 0;
    }
    return 1;
}

/* The mean over a piece that the planes before this one do not cut. */
static double cut_piece(const struct cutting *cutting, size_t triple, const double (*corner)[3])
{
    for (; triple < cutting->sets->first[2]; triple++) {
        double value[4], part[4][3], at, mean;
        int in = -1, out = -1;

        if (cutting->sets->set[triple].mask & ~cutting->sets->set[cutting->function].mask ||
            !see_plane(cutting, triple, corner, value))
            continue;
        for (int i = 0; i < 4; i++) {
            in = value[i] > 0 ? i : in;
            out = value[i] < 0 ? i : out;
        }
        if (in < 0 || out < 0)
            continue;
        at = value[in] / (value[in] - value[out]);
        memcpy(part, corner, sizeof part);
        for (int c = 0; c < 3; c++)
            part[out][c] = corner[in][c] + at * (corner[out][c] - corner[in][c]);
        mean = at * cut_piece(cutting, triple, (const double(*)[3])part);
        memcpy(part[in], part[out], sizeof *part);
        memcpy(part[out], corner[out], sizeof *part);
        return mean + (1 - at) * cut_piece(cutting, triple, (const double(*)[3])part);
    }
    return apply_rule(cutting, corner);
}

double gsn_simplex_mean_by_pieces(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                                  const uint16_t *pick, const struct gsn_simplex_cell *cell,
                                  size_t function)
{
    double edge[3];

    gsn_subtract(cell->corner[3], cell->corner[0], edge);
    return cut_piece(&(struct cutting){ .sets = sets,
                                        .knot = knot,
                                        .pick = pick,
                                        .function = function,
                                        .touch = TOUCH * sqrt(gsn_dot(edge, edge)) },
                     sets->first[3], (const double(*)[3])cell->corner);
}
