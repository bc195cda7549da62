/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/simplex.h"

#include "pipeline/model/frame.h"
#include "pipeline/model/orient.h"

#include <math.h>
#include <string.h>

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
static inline void row(const struct gsn_simplex_set *set, unsigned i, const double (*knot)[3],
                       double ret[3])
{
    const unsigned from = set->cloud[i] == set->cloud[i - 1] ? i - 1 : 0;

    gsn_subtract(knot[set->member[i]], knot[set->member[from]], ret);
}

void gsn_simplex_normal(const struct gsn_simplex_set *triple, const double (*knot)[3],
                        double ret_normal[3], double *ret_permanent)
{
    double p[3], q[3];

    row(triple, 1, knot, p);
    row(triple, 2, knot, q);
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
    row(quad, 3, knot, r);
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

        row(quad, 3, knot, r);
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
static double leaf(struct gsn_simplex_at *at, size_t quad)
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
        return at->value[s] = leaf(at, s);
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
static double doubled(struct gsn_simplex_at *at, size_t s, unsigned t)
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
            part = doubled(at, set->without[m], t);
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
        part =
            w->member[i] == t ? gsn_simplex_value(at, function) : doubled(at, set->without[m], t);
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
