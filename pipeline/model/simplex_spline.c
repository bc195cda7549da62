/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Simplex splines of the knots of one tetrahedron: values, derivatives, line integrals.
 *
 * Method: Micchelli's recurrence, top down over a table of knot sets that is the same for every
 * tetrahedron, so that functions share what they have computed.
 * Reference: C. A. Micchelli, "On a numerically efficient method for computing multivariate
 * B-splines", 1979; docs/MATH.md, sections 1, 2, 4 and 9.
 *
 * Steps: (1) list all subsets of all V_beta once per degree; (2) per tetrahedron choose for each
 * set the four knots W with the largest determinant; (3) at a point descend only to sets that can
 * hold it, decide sides exactly (orient.h), add up on the way back. A line is a point of the plane
 * that is seen along it, with one degree more.
 *
 * Failure: only the table takes memory. A flat set of four knots counts as 0; determinants that
 * lose digits to cancellation are made again in twice the precision. Cost: at degree 3 at most 691
 * sets a tetrahedron and point, far fewer where planes are clear. */
#include "pipeline/model/simplex_spline.h"

#include "pipeline/model/barycentric.h"
#include "pipeline/model/orient.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* --- the table of knot sets --- */

enum { MASKS = 1 << GSN_SIMPLEX_MAX_KNOTS, ABSENT = UINT16_MAX };

const uint8_t gsn_simplex_raised[10][4] = {
    { 0, 1, 2, 3 },    { 1, 4, 5, 6 },    { 2, 5, 7, 8 },    { 3, 6, 8, 9 },    { 4, 10, 11, 12 },
    { 5, 11, 13, 14 }, { 6, 12, 14, 15 }, { 7, 13, 16, 17 }, { 8, 14, 17, 18 }, { 9, 15, 18, 19 },
};

size_t gsn_simplex_count(unsigned degree)
{
    return (size_t)(degree + 1) * (degree + 2) * (degree + 3) / 6;
}

size_t gsn_simplex_place(const uint8_t beta[4])
{
    const size_t rest = (size_t)beta[1] + beta[2] + beta[3];
    const size_t last = (size_t)beta[2] + beta[3];

    return rest * (rest + 1) * (rest + 2) / 6 + last * (last + 1) / 2 + beta[3];
}

int gsn_simplex_next(uint8_t beta[4])
{
    const uint8_t tail = beta[3];
    int k = 2;

    while (k >= 0 && beta[k] == 0)
        k--;
    if (k < 0)
        return 0;
    beta[3] = 0;
    beta[k]--;
    beta[k + 1] = (uint8_t)(tail + 1);
    return 1;
}

static unsigned count_ones(unsigned mask)
{
    return (unsigned)__builtin_popcount(mask);
}

static unsigned knots_of(unsigned degree, const uint8_t beta[4])
{
    unsigned mask = 0;

    for (unsigned k = 0; k < 4; k++)
        mask |= ((2u << beta[k]) - 1) << (k * (degree + 1));
    return mask;
}

static unsigned corners_of(unsigned degree, const uint8_t beta[4])
{
    unsigned mask = 0;

    for (unsigned k = 0; k < 4; k++)
        mask |= 1u << (k * (degree + 1) + beta[k]);
    return mask;
}

static void describe_set(struct gsn_simplex_set *set, unsigned mask, unsigned degree)
{
    const unsigned cloud = (2u << degree) - 1;

    set->mask = (uint16_t)mask;
    set->size = 0;
    set->missing = 0;
    for (unsigned i = 0; i < GSN_SIMPLEX_MAX_KNOTS; i++) {
        if (!(mask >> i & 1))
            continue;
        set->cloud[set->size] = (uint8_t)(i / (degree + 1));
        set->member[set->size++] = (uint8_t)i;
    }
    for (unsigned k = 0; k < 4; k++) {
        if (!(mask >> (k * (degree + 1)) & cloud))
            set->missing |= (uint8_t)(1u << k);
    }
}

/* Appends a set unless it is there already. */
static uint16_t enter_set(struct gsn_simplex_sets *sets, uint16_t *place, unsigned mask)
{
    if (place[mask] == ABSENT) {
        assert(sets->count < GSN_SIMPLEX_MAX_SETS);
        place[mask] = (uint16_t)sets->count;
        describe_set(&sets->set[sets->count++], mask, sets->degree);
    }
    return place[mask];
}

/* The V_beta, then generation after generation their subsets with one knot less. */
static void descend_sets(struct gsn_simplex_sets *sets, uint16_t *place)
{
    uint8_t beta[4] = { (uint8_t)sets->degree, 0, 0, 0 };

    do {
        const uint16_t function = enter_set(sets, place, knots_of(sets->degree, beta));

        memcpy(sets->beta[function], beta, sizeof beta);
    } while (gsn_simplex_next(beta));
    sets->functions = sets->count;

    sets->first[sets->degree + 4] = 0;
    for (unsigned size = sets->degree + 4; size > 3; size--) {
        const size_t end = sets->count;

        sets->first[size - 1] = end;
        for (size_t s = sets->first[size]; s < end; s++) {
            for (unsigned i = 0; i < size; i++)
                sets->set[s].without[i] =
                    enter_set(sets, place, sets->set[s].mask & ~(1u << sets->set[s].member[i]));
        }
    }
    sets->first[2] = sets->count;
    for (size_t f = 0; f < sets->functions; f++)
        sets->corners[f] = place[corners_of(sets->degree, sets->beta[f])];
}

/* Lists the subsets of four of every larger set; counts them only while quad is NULL. */
static size_t list_quads(struct gsn_simplex_sets *sets, const uint16_t *place)
{
    size_t count = 0;

    for (size_t s = 0; s < sets->first[4]; s++) {
        const struct gsn_simplex_set *set = &sets->set[s];

        sets->quads[s] = count;
        for (unsigned chosen = 0; chosen < 1u << set->size; chosen++) {
            unsigned mask = 0;

            if (count_ones(chosen) != 4)
                continue;
            for (unsigned i = 0; i < set->size; i++)
                mask |= (chosen >> i & 1) << set->member[i];
            if (sets->quad)
                sets->quad[count] = place[mask];
            count++;
        }
    }
    sets->quads[sets->first[4]] = count;
    return count;
}

int gsn_simplex_sets_new(unsigned degree, struct gsn_simplex_sets **ret_sets, struct gsn_error *err)
{
    gsn_auto(gsn_simplex_sets) sets = gsn_alloc_array(1, sizeof *sets);
    gsn_auto_mem(uint16_t) place = gsn_alloc_array(MASKS, sizeof *place);

    assert(degree >= 1 && degree <= GSN_SIMPLEX_MAX_DEGREE);

    if (sets)
        sets->set = gsn_alloc_array(GSN_SIMPLEX_MAX_SETS, sizeof *sets->set);
    if (!sets || !place || !sets->set)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the knot sets");
    for (size_t i = 0; i < MASKS; i++)
        place[i] = ABSENT;
    sets->degree = degree;
    descend_sets(sets, place);

    sets->quads = gsn_alloc_array(sets->first[4] + 1, sizeof *sets->quads);
    if (sets->quads)
        sets->quad = gsn_alloc_array(list_quads(sets, place), sizeof *sets->quad);
    if (!sets->quads || !sets->quad)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the knot sets");
    (void)list_quads(sets, place);
    *ret_sets = gsn_steal(&sets);
    return GSN_OK;
}

void gsn_simplex_sets_free(struct gsn_simplex_sets *sets)
{
    if (!sets)
        return;
    gsn_free(sets->set);
    gsn_free(sets->quads);
    gsn_free(sets->quad);
    gsn_free(sets);
}

/* --- values and derivatives at a point --- */

/* W may have this share of the largest determinant. */
#define NEARLY 0.5

/* A determinant that loses more than this to cancellation is computed in twice the precision. Sets
 * of knots may be as flat as they like: M of degree 0 is 1 / |det|, and where u lies in such a set
 * the coordinate that multiplies it is as small. Rounding relative to the products, not to the
 * determinant, would lose in N as many digits as the set is flat. */
#define CANCELS 0x1p-8

/* The barycentric coordinate of member i of a quad a < b < c < d is swap[i] times the plane value
 * of the other three, ascending, over the quad's determinant. */
static const int swap[4] = { -1, 1, -1, 1 };

/* Row i of the determinant of ascending knots: knot i less the knot before it when both are of one
 * cloud, less the first one otherwise. */
static inline void determinant_row(const struct gsn_simplex_set *set, unsigned i,
                                   const double (*knot)[3], double ret[3])
{
    const unsigned from = set->cloud[i] == set->cloud[i - 1] ? i - 1 : 0;

    gsn_subtract(knot[set->member[i]], knot[set->member[from]], ret);
}

void gsn_simplex_normal(const struct gsn_simplex_set *triple, const double (*knot)[3],
                        double ret_normal[3], double *ret_permanent)
{
    double p[3], q[3];

    determinant_row(triple, 1, knot, p);
    determinant_row(triple, 2, knot, q);
    gsn_cross(p, q, ret_normal);
    for (int i = 0; ret_permanent && i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;

        ret_permanent[i] = fabs(p[j] * q[k]) + fabs(p[k] * q[j]);
    }
}

double gsn_simplex_det(const struct gsn_simplex_set *quad, const double (*knot)[3])
{
    const uint8_t *m = quad->member;
    double r[3], normal[3], permanent[3], det;

    gsn_simplex_normal(quad, knot, normal, permanent);
    determinant_row(quad, 3, knot, r);
    det = gsn_dot(normal, r);
    for (int c = 0; c < 3; c++)
        r[c] = fabs(r[c]);
    if (fabs(det) > CANCELS * gsn_dot(permanent, r))
        return det;
    return gsn_orient_value(knot[m[0]], knot[m[1]], knot[m[2]], knot[m[3]]);
}

/* |det| of every set of four, from the normals of the triples; returns the least. */
static double measure_quads(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                            double *ret_size)
{
    double normal[GSN_SIMPLEX_MAX_TRIPLES][3], least = INFINITY;

    for (size_t s = sets->first[3]; s < sets->first[2]; s++)
        gsn_simplex_normal(&sets->set[s], knot, normal[s - sets->first[3]], NULL);
    for (size_t s = sets->first[4]; s < sets->first[3]; s++) {
        const struct gsn_simplex_set *quad = &sets->set[s];
        double r[3];

        determinant_row(quad, 3, knot, r);
        *ret_size = fabs(gsn_dot(normal[quad->without[3] - sets->first[3]], r));
        least = *ret_size < least ? *ret_size : least;
        ret_size++;
    }
    return least;
}

double gsn_simplex_pick(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                        uint16_t *ret_pick)
{
    const size_t first = sets->first[4];
    /* Of a set of four its |det|, of a larger one the greatest of its sets of four. */
    double size[GSN_SIMPLEX_MAX_LARGE + GSN_SIMPLEX_MAX_QUADS];
    const double least = measure_quads(sets, knot, &size[first]);

    for (size_t s = first; s-- > 0;) {
        const struct gsn_simplex_set *set = &sets->set[s];
        size_t i = sets->quads[s + 1];
        double largest = size[set->without[0]];

        for (unsigned m = 1; m < set->size; m++)
            largest = size[set->without[m]] > largest ? size[set->without[m]] : largest;
        size[s] = largest;
        /* The last one in the list that is nearly as good: taking away the last knots of clouds
         * leads many sets to the same subsets. */
        do
            i--;
        while (size[sets->quad[i]] < NEARLY * largest);
        ret_pick[s] = sets->quad[i];
    }
    return least;
}

/* Sorts the four clouds by the distance of their first knot from u. */
static void sort_clouds(struct gsn_simplex_at *at)
{
    double far[4];

    for (unsigned k = 0; k < 4; k++) {
        unsigned place = k;
        double d[3], size;

        gsn_subtract(at->u, at->knot[k * (at->sets->degree + 1)], d);
        size = gsn_dot(d, d);
        for (; place > 0 && far[place - 1] > size; place--) {
            far[place] = far[place - 1];
            at->nearest[place] = at->nearest[place - 1];
        }
        far[place] = size;
        at->nearest[place] = (uint8_t)k;
    }
}

/* A knot of the triple from the cloud nearest u: the shorter u - knot, the smaller the rounding of
 * the plane value. */
static const double *near_knot(const struct gsn_simplex_at *at,
                               const struct gsn_simplex_set *triple)
{
    for (int i = 0; i < 3; i++) {
        for (int m = 0; m < 3; m++) {
            if (triple->cloud[m] == at->nearest[i])
                return at->knot[triple->member[m]];
        }
    }
    return at->knot[triple->member[0]];
}

void gsn_simplex_at_init(struct gsn_simplex_at *at, const struct gsn_simplex_sets *sets,
                         const double (*knot)[3], const uint16_t *pick, const double u[3],
                         unsigned clear)
{
    at->sets = sets;
    at->knot = knot;
    at->pick = pick;
    at->u = u;
    at->clear = clear;
    sort_clouds(at);
    memset(at->knows_plane, 0, sizeof at->knows_plane);
    memset(at->knows_det, 0, sizeof at->knows_det);
    memset(at->knows_value, 0, sizeof at->knows_value);
}

static const struct gsn_simplex_plane *plane_of(struct gsn_simplex_at *at, size_t triple)
{
    const size_t slot = triple - at->sets->first[3];
    const struct gsn_simplex_set *set = &at->sets->set[triple];
    const uint8_t *m = set->member;
    struct gsn_simplex_plane *plane = &at->plane[slot];
    double r[3], permanent[3], all;

    if (at->knows_plane[slot])
        return plane;
    at->knows_plane[slot] = 1;
    gsn_simplex_normal(set, at->knot, plane->normal, permanent);
    gsn_subtract(at->u, near_knot(at, set), r);
    plane->value = gsn_dot(plane->normal, r);
    for (int c = 0; c < 3; c++)
        r[c] = fabs(r[c]);
    all = gsn_dot(permanent, r);
    if (fabs(plane->value) > GSN_ORIENT_BOUND * all)
        plane->side = plane->value > 0 ? 1 : -1;
    else
        plane->side = gsn_orient_side(at->knot[m[0]], at->knot[m[1]], at->knot[m[2]], at->u);
    if (!(fabs(plane->value) > CANCELS * all))
        plane->value = gsn_orient_value(at->knot[m[0]], at->knot[m[1]], at->knot[m[2]], at->u);
    return plane;
}

static double det_of(struct gsn_simplex_at *at, size_t quad)
{
    const size_t slot = quad - at->sets->first[4];

    if (!at->knows_det[slot]) {
        at->knows_det[slot] = 1;
        at->det[slot] = gsn_simplex_det(&at->sets->set[quad], at->knot);
    }
    return at->det[slot];
}

/* Degree 0. u is inside when it lies on the inner side of all four faces, that is when the signs of
 * all four barycentric coordinates agree; a flat set of knots has no inside. */
static double leaf_at_point(struct gsn_simplex_at *at, size_t quad)
{
    const uint16_t *face = at->sets->set[quad].without;
    const int side = swap[0] * plane_of(at, face[0])->side;
    double det;

    if (side == 0)
        return 0;
    for (int i = 1; i < 4; i++) {
        if (swap[i] * plane_of(at, face[i])->side != side)
            return 0;
    }
    det = fabs(det_of(at, quad));
    return det > 0 ? 1 / det : 0;
}

double gsn_simplex_value(struct gsn_simplex_at *at, size_t s)
{
    const struct gsn_simplex_set *set = &at->sets->set[s];
    const struct gsn_simplex_set *w;
    double det, sum = 0;

    if (set->missing & at->clear)
        return 0;
    if (at->knows_value[s])
        return at->value[s];
    at->knows_value[s] = 1;
    if (set->size == 4)
        return at->value[s] = leaf_at_point(at, s);
    w = &at->sets->set[at->pick[s]];
    det = det_of(at, at->pick[s]);
    for (unsigned i = 0, m = 0; i < 4 && det != 0; i++) {
        double part;

        while (set->member[m] != w->member[i])
            m++;
        part = gsn_simplex_value(at, set->without[m]);

        if (part != 0)
            sum += swap[i] * plane_of(at, w->without[i])->value / det * part;
    }
    return at->value[s] = sum;
}

void gsn_simplex_gradient(struct gsn_simplex_at *at, size_t s, double ret_gradient[3])
{
    const struct gsn_simplex_set *set = &at->sets->set[s];
    const struct gsn_simplex_set *w;
    double det, weight;

    ret_gradient[0] = ret_gradient[1] = ret_gradient[2] = 0;
    if (set->size == 4 || set->missing & at->clear)
        return;
    w = &at->sets->set[at->pick[s]];
    det = det_of(at, at->pick[s]);
    for (unsigned i = 0, m = 0; i < 4 && det != 0; i++) {
        double part;

        while (set->member[m] != w->member[i])
            m++;
        part = gsn_simplex_value(at, set->without[m]);
        weight = swap[i] * (set->size - 4) * part / det;
        if (part == 0)
            continue;
        for (int c = 0; c < 3; c++)
            ret_gradient[c] += weight * plane_of(at, w->without[i])->normal[c];
    }
}

void gsn_simplex_hessian(struct gsn_simplex_at *at, size_t s, double ret_hessian[6])
{
    const struct gsn_simplex_set *set = &at->sets->set[s];
    const struct gsn_simplex_set *w;
    double det, sum[3][3] = { { 0 } };
    int n = 0;

    memset(ret_hessian, 0, 6 * sizeof *ret_hessian);
    if (set->size <= 5 || set->missing & at->clear)
        return;
    w = &at->sets->set[at->pick[s]];
    det = det_of(at, at->pick[s]);
    for (unsigned i = 0, m = 0; i < 4 && det != 0; i++) {
        const double weight = swap[i] * (set->size - 4) / det;
        const double *normal = plane_of(at, w->without[i])->normal;
        double slope[3];

        while (set->member[m] != w->member[i])
            m++;
        gsn_simplex_gradient(at, set->without[m], slope);
        for (int r = 0; r < 3; r++) {
            for (int c = 0; c < 3; c++)
                sum[r][c] += weight * normal[r] * slope[c];
        }
    }
    for (int r = 0; r < 3; r++) {
        for (int c = r; c < 3; c++)
            ret_hessian[n++] = (sum[r][c] + sum[c][r]) / 2;
    }
}

/* M(u | the set s with its knot t counted twice). Four of these knots that hold t twice are flat:
 * they are never W, and 0 in degree 0. So W is that of s itself; taking t away once leaves s, and
 * below five knots that is all there is. */
static double eval_doubled(struct gsn_simplex_at *at, size_t s, unsigned t)
{
    const struct gsn_simplex_set *set = &at->sets->set[s];
    const size_t pick = set->size > 4 ? at->pick[s] : s;
    const struct gsn_simplex_set *w = &at->sets->set[pick];
    const double det = det_of(at, pick);
    double sum = 0;

    if (set->missing & at->clear)
        return 0;
    for (unsigned i = 0, m = 0; i < 4 && det != 0; i++) {
        double part = 0;

        while (set->member[m] != w->member[i])
            m++;
        if (w->member[i] == t)
            part = gsn_simplex_value(at, s);
        else if (set->size > 4)
            part = eval_doubled(at, set->without[m], t);
        if (part != 0)
            sum += swap[i] * plane_of(at, w->without[i])->value / det * part;
    }
    return sum;
}

/* ret += weight * the gradient of the barycentric coordinate of member i of a quad. */
static void add_slope(struct gsn_simplex_at *at, size_t quad, unsigned i, double weight,
                      double ret[3])
{
    const struct gsn_simplex_set *set = &at->sets->set[quad];
    const double *normal = plane_of(at, set->without[i])->normal;
    const double det = det_of(at, quad);

    for (int c = 0; c < 3 && det != 0; c++)
        ret[c] += swap[i] * weight / det * normal[c];
}

void gsn_simplex_knot_gradient(struct gsn_simplex_at *at, size_t function, unsigned t,
                               double ret_gradient[3])
{
    const struct gsn_simplex_set *set = &at->sets->set[function];
    const struct gsn_simplex_set *w = &at->sets->set[at->pick[function]];
    const size_t corners = at->sets->corners[function];
    const double size = fabs(det_of(at, corners));

    ret_gradient[0] = ret_gradient[1] = ret_gradient[2] = 0;
    if (!(set->mask >> t & 1) || set->missing & at->clear)
        return;
    for (unsigned i = 0, m = 0; i < 4; i++) {
        double part;

        while (set->member[m] != w->member[i])
            m++;
        part = w->member[i] == t ? gsn_simplex_value(at, function)
                                 : eval_doubled(at, set->without[m], t);
        add_slope(at, at->pick[function], i, -size * part, ret_gradient);
    }
    for (unsigned i = 0; i < 4; i++) {
        if (at->sets->set[corners].member[i] == t)
            add_slope(at, corners, i, size * gsn_simplex_value(at, function), ret_gradient);
    }
}

void gsn_simplex_basis(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                       const uint16_t *pick, const double u[3], unsigned clear, double *ret_value,
                       double (*ret_gradient)[3])
{
    struct gsn_simplex_at at;

    gsn_simplex_at_init(&at, sets, knot, pick, u, clear);
    for (size_t f = 0; f < sets->functions; f++) {
        const double size = fabs(det_of(&at, sets->corners[f]));

        ret_value[f] = size * gsn_simplex_value(&at, f);
        if (!ret_gradient)
            continue;
        gsn_simplex_gradient(&at, f, ret_gradient[f]);
        for (int c = 0; c < 3; c++)
            ret_gradient[f][c] *= size;
    }
}

void gsn_simplex_basis_hessian(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                               const uint16_t *pick, const double u[3], unsigned clear,
                               double (*ret_hessian)[6])
{
    struct gsn_simplex_at at;

    gsn_simplex_at_init(&at, sets, knot, pick, u, clear);
    for (size_t f = 0; f < sets->functions; f++) {
        gsn_simplex_hessian(&at, f, ret_hessian[f]);
        for (int i = 0; i < 6; i++)
            ret_hessian[f][i] *= fabs(det_of(&at, sets->corners[f]));
    }
}

/* --- integrals along a line --- */

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

static double triangle_area(const struct view *view, unsigned a, unsigned b, unsigned c)
{
    const double *p = view->knot[a], *q = view->knot[b], *r = view->knot[c];

    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
}

/* Finds the widest triangle of three clouds for every set of missing clouds. */
static void find_spare(struct view *view)
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
        size[out] = fabs(triangle_area(view, (out + 1) % CLOUDS * step, (out + 2) % CLOUDS * step,
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

static void look_along(struct view *view, const struct gsn_simplex_sets *sets,
                       const double (*knot)[2])
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
    find_spare(view);
}

static int origin_misses(const struct view *view, unsigned mask)
{
    for (int i = 0; i < SIDES; i++) {
        if (!(mask & ~view->aside[i]))
            return 1;
    }
    return 0;
}

/* Which side of the line a b the origin lies on, moved by e (1,0) + e^2 (0,1), e -> 0+. */
static int side_of_line(const struct view *view, unsigned a, unsigned b)
{
    const double *p = view->knot[a], *q = view->knot[b];
    const int sign = gsn_orient_cross(p, q);

    if (sign != 0)
        return sign;
    if (p[1] != q[1])
        return p[1] > q[1] ? 1 : -1;
    return (q[0] > p[0]) - (q[0] < p[0]);
}

static double leaf_on_line(const struct view *view, const uint8_t *m)
{
    const int first = side_of_line(view, m[0], m[1]);
    double size;

    if (first == 0 || side_of_line(view, m[1], m[2]) != first ||
        side_of_line(view, m[2], m[0]) != first)
        return 0;
    size = fabs(triangle_area(view, m[0], m[1], m[2]));
    return size > 0 ? 1 / size : 0;
}

/* The places in a set of the three knots with the largest triangle. */
static void search_widest(const struct view *view, const struct gsn_simplex_set *set,
                          unsigned ret[3])
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
static void choose_triple(const struct view *view, const struct gsn_simplex_set *set,
                          unsigned ret[3])
{
    const uint8_t spared = view->spared[set->missing];
    unsigned n = 0;

    if (spared == SEARCH) {
        search_widest(view, set, ret);
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
    if (origin_misses(view, set->mask))
        return 0;
    if (set->size == 3)
        return view->value[s] = leaf_on_line(view, set->member);
    choose_triple(view, set, w);
    size = triangle_area(view, set->member[w[0]], set->member[w[1]], set->member[w[2]]);
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

    look_along(&view, sets, knot);
    if (origin_misses(&view, (1u << 4 * (sets->degree + 1)) - 1))
        return 0;
    for (size_t f = 0; f < sets->functions; f++)
        ret_integral[f] = value_of(&view, f) / (sets->degree + 1);
    return 1;
}
