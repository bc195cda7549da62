/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Face corrections: what the knot clouds of a face add to the polynomials on its two sides.
 *
 * Method: of our own, from Micchelli's recurrence; docs/MATH.md, section 13, derives it and the
 * header states it. s is the polynomial of the point's tetrahedron, plus, for each face whose knots
 * hold the point, a sum of jump polynomials times simplex splines of at most eight knots. It takes
 * the place of the recurrence over all functions, and gives the same values.
 *
 * Steps: (1) the prism that holds the knots of a face, in axes of its own, and half-spaces that say
 * quickly that a point is not in it; (2) the jump of the two B-patches as monomials in these axes;
 * (3) planes, determinants and weights of all knot sets, filled into one plain structure; (4)
 * kernels over groups of points (face_correction_kernels.py writes them), a sign that floating
 * point cannot decide being done again with exact ones; (5) at single points, the faces that
 * matter. Integrals over cells and polynomials along lines stand in pieces.c.
 *
 * Failure: none; a flat set of knots counts as 0.
 * Cost: a face is made ready once; a point in it costs the pieces that its lines meet. */
#include "pipeline/model/face_correction.h"

#include "pipeline/model/orient.h"
#include "pipeline/model/spline_internal.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "face_correction_orders.inc"
#include "face_correction_tables.inc"

/* --- where the knots of a face lie --- */

/* Where the seam of a face lies. */

/* Room for rounding in tests that only spare work, relative to the size of the face. */
#define SLACK 1e-10

static double smaller_of(double a, double b)
{
    return a < b ? a : b;
}

static double larger_of(double a, double b)
{
    return a > b ? a : b;
}

static void sort_three(uint32_t v[3])
{
    for (int i = 0; i < 3; i++) {
        for (int j = 2; j > 0; j--) {
            if (v[j - 1] > v[j]) {
                const uint32_t larger = v[j - 1];

                v[j - 1] = v[j];
                v[j] = larger;
            }
        }
    }
}

/* The axes of the face. Their exact directions do not matter, only that all is turned alike. */
static void choose_axes(struct gsn_prism *prism, const double *const vertex[3])
{
    double edge[2][3], size;

    gsn_subtract(vertex[1], vertex[0], edge[0]);
    gsn_subtract(vertex[2], vertex[0], edge[1]);
    memcpy(prism->origin, vertex[0], sizeof prism->origin);
    gsn_cross(edge[0], edge[1], prism->turn[2]);
    for (int r = 2; r >= 0; r -= 2) {
        double *axis = prism->turn[r];

        if (r == 0)
            memcpy(axis, edge[0], sizeof edge[0]);
        size = sqrt(gsn_dot(axis, axis));
        for (int c = 0; c < 3; c++)
            axis[c] /= size;
    }
    gsn_cross(prism->turn[2], prism->turn[0], prism->turn[1]);
}

static void turn_knots(const struct gsn_dms *space, struct gsn_prism *prism)
{
    const unsigned per_cloud = prism->top + 1, knots = 3 * per_cloud;

    prism->size = 0;
    for (unsigned i = 0; i < knots; i++) {
        const double *first = space->knot[prism->vertex[i / per_cloud] * (space->degree + 1)];
        double from_origin[3], from_vertex[3], far = 0;

        gsn_subtract(first, prism->origin, from_origin);
        gsn_subtract(first + 3 * (i % per_cloud), first, from_vertex);
        for (int c = 0; c < 3; c++) {
            const double offset = gsn_dot(prism->turn[c], from_vertex);
            const double place = gsn_dot(prism->turn[c], from_origin) + offset;

            prism->at[c][knots + i] = offset;
            prism->at[c][i] = place;
            far += place * place;
        }
        prism->size = larger_of(prism->size, sqrt(far));
    }
}

/* The barycentric coordinates of the projection on the face, as affine functions. */
static void project_face(const struct gsn_prism *prism, double ret_mu[3][4])
{
    const unsigned per_cloud = prism->top + 1;
    const double length = prism->at[0][per_cloud];
    const double x = prism->at[0][2 * per_cloud], y = prism->at[1][2 * per_cloud];

    for (int c = 0; c < 3; c++) {
        ret_mu[2][c] = prism->turn[1][c] / y;
        ret_mu[1][c] = (prism->turn[0][c] - x * ret_mu[2][c]) / length;
        ret_mu[0][c] = -ret_mu[1][c] - ret_mu[2][c];
    }
    ret_mu[0][3] = 1;
    ret_mu[1][3] = ret_mu[2][3] = 0;
}

/* How far the knots reach along the normal and in the face's barycentric coordinates, the latter
 * by knots of the other clouds (high) and of all (low). */
static void bound_knots(const struct gsn_dms *space, struct gsn_prism *prism)
{
    const unsigned per_cloud = prism->top + 1;
    double mu[3][4], low[3] = { 0 }, high[3] = { 0 }, under = 0, over = 0;

    project_face(prism, mu);
    for (unsigned i = 0; i < 3 * per_cloud; i++) {
        const double *knot =
            space->knot[prism->vertex[i / per_cloud] * (space->degree + 1) + i % per_cloud];
        double d[3];

        gsn_subtract(knot, prism->origin, d);
        under = smaller_of(under, prism->at[2][i]);
        over = larger_of(over, prism->at[2][i]);
        for (unsigned m = 0; m < 3; m++) {
            const double value = gsn_dot(mu[m], d) + mu[m][3];

            low[m] = smaller_of(low[m], value);
            if (m != i / per_cloud)
                high[m] = larger_of(high[m], value);
        }
    }
    for (int m = 0; m < 3; m++) {
        memcpy(prism->inside[m], mu[m], sizeof mu[m]);
        prism->inside[m][3] += SLACK - low[m];
        memcpy(prism->clear[m], mu[m], sizeof mu[m]);
        prism->clear[m][3] -= high[m] + SLACK;
    }
    for (int c = 0; c < 3; c++) {
        prism->inside[3][c] = prism->turn[2][c];
        prism->inside[4][c] = -prism->turn[2][c];
    }
    prism->inside[3][3] = SLACK * prism->size - under;
    prism->inside[4][3] = over + SLACK * prism->size;
}

/* Whether a boundary face has all its knots on or beyond it, seen from inside. */
static int is_outward(const struct gsn_prism *prism)
{
    for (unsigned i = 0; i < 3 * (prism->top + 1); i++) {
        if (prism->side * prism->at[2][i] > SLACK * prism->size)
            return 0;
    }
    return 1;
}

int gsn_prism_init(const struct gsn_dms *space, size_t tet, unsigned corner,
                   struct gsn_prism *ret_prism)
{
    const struct gsn_tets *mesh = space->mesh;
    const double *vertex[3], *apex = mesh->vertex[mesh->tet[tet][corner]];
    double d[3];
    unsigned n = 0;

    ret_prism->tet = tet;
    ret_prism->corner = corner;
    ret_prism->other = mesh->neighbour[tet][corner];
    if (ret_prism->other >= 0 && (size_t)ret_prism->other < tet)
        return 0;
    ret_prism->top = space->sharing == GSN_DMS_SHARED && ret_prism->other >= 0 ? space->degree - 1
                                                                               : space->degree;
    if (ret_prism->top == 0)
        return 0;
    for (unsigned k = 0; k < 4; k++) {
        if (k != corner)
            ret_prism->vertex[n++] = mesh->tet[tet][k];
    }
    sort_three(ret_prism->vertex);
    for (int m = 0; m < 3; m++)
        vertex[m] = mesh->vertex[ret_prism->vertex[m]];
    choose_axes(ret_prism, vertex);
    gsn_subtract(apex, ret_prism->origin, d);
    ret_prism->side = gsn_dot(ret_prism->turn[2], d) > 0 ? 1 : -1;
    turn_knots(space, ret_prism);
    if (ret_prism->other < 0 && is_outward(ret_prism))
        return 0;
    bound_knots(space, ret_prism);
    return 1;
}

int gsn_prism_at(const struct gsn_prism *prism, const double u[3])
{
    double d[3];
    int unclear = 0;

    gsn_subtract(u, prism->origin, d);
    for (int i = 0; i < 5; i++) {
        if (gsn_dot(prism->inside[i], d) + prism->inside[i][3] < 0)
            return -1;
    }
    for (int m = 0; m < 3; m++)
        unclear |= !(gsn_dot(prism->clear[m], d) + prism->clear[m][3] > 0) << m;
    return unclear;
}

/* --- the jump of the polynomials across a face --- */

/* The place of (g_0, g_1, g_2, 0) for |g| = 1, 2, 3, in the order of the jumps. */
static const uint8_t on_face[19] = { 0, 1, 2, 0, 1, 2, 4, 5, 7, 0, 1, 2, 4, 5, 7, 10, 11, 13, 16 };
static const uint8_t first_on_face[4] = { 0, 0, 3, 9 };

/* The multi-indices of degree 2 that two steps from |g| = 1 on the face pass: place, indices. */
static const uint8_t passed[9][5] = { { 0, 2, 0, 0, 0 }, { 1, 1, 1, 0, 0 }, { 2, 1, 0, 1, 0 },
                                      { 3, 1, 0, 0, 1 }, { 4, 0, 2, 0, 0 }, { 5, 0, 1, 1, 0 },
                                      { 6, 0, 1, 0, 1 }, { 7, 0, 0, 2, 0 }, { 8, 0, 0, 1, 1 } };

/* A tetrahedron beside the face, its corners in the order of the face's vertices, the one opposite
 * last, in the axes of the face. */
struct beside {
    double knot[4][GSN_DMS_MAX_DEGREE][3]; /* those with numbers below the degree */
    double control[GSN_DMS_MAX_FUNCTIONS]; /* by place of the multi-index in that order */
};

/* A polynomial of degree up to 2. */
struct poly {
    double c[10];
};

/* The number of a permutation of 0..3 in lexicographic order. */
static unsigned number_of(const unsigned order[4])
{
    const unsigned second = order[1] - (order[1] > order[0]);
    const unsigned third = order[2] - (order[2] > order[0]) - (order[2] > order[1]);

    return 6 * order[0] + 2 * second + third;
}

static unsigned order_corners(const struct gsn_prism *prism, const uint32_t vertex[4],
                              unsigned ret_order[4])
{
    for (unsigned k = 0; k < 4; k++) {
        unsigned place = 3;

        for (unsigned m = 0; m < 3; m++) {
            if (prism->vertex[m] == vertex[k])
                place = m;
        }
        ret_order[place] = k;
    }
    return number_of(ret_order);
}

static void beside_init(struct beside *beside, const struct gsn_dms *space,
                        const struct gsn_prism *prism, size_t tet, const double *control)
{
    const uint32_t *v = space->mesh->tet[tet], *id = gsn_dms_control_ids(space, tet);
    const size_t per_cloud = space->degree + 1, seen = prism->top + 1;
    unsigned order[4];
    const uint8_t *place = turned[space->degree - 1][order_corners(prism, v, order)];

    for (size_t f = 0; f < space->sets->functions; f++)
        beside->control[f] = control[id[place[f]]];
    for (size_t k = 0; k < 3; k++) {
        for (size_t l = 0; l < space->degree; l++) {
            for (int c = 0; c < 3; c++)
                beside->knot[k][l][c] = prism->at[c][k * seen + l];
        }
    }
    for (size_t l = 0; l + 1 < space->degree || l == 0; l++) {
        double d[3];

        gsn_subtract(space->knot[v[order[3]] * per_cloud + l], prism->origin, d);
        for (int c = 0; c < 3; c++)
            beside->knot[3][l][c] = gsn_dot(prism->turn[c], d);
    }
}

/* Rows of barycentric coordinates 1, 2, 3 with respect to X_g, as affine functions. */
static void rows_of(const struct beside *beside, const uint8_t gamma[4], double ret_row[3][4])
{
    const double *origin = beside->knot[0][gamma[0]];
    double edge[3][3], scale;

    for (int k = 0; k < 3; k++)
        gsn_subtract(beside->knot[k + 1][gamma[k + 1]], origin, edge[k]);
    for (int k = 0; k < 3; k++)
        gsn_cross(edge[(k + 1) % 3], edge[(k + 2) % 3], ret_row[k]);
    scale = 1 / gsn_dot(ret_row[0], edge[0]);
    for (int k = 0; k < 3; k++) {
        for (int c = 0; c < 3; c++)
            ret_row[k][c] *= scale;
        ret_row[k][3] = -gsn_dot(ret_row[k], origin);
    }
}

/* One step of the B-patch recurrence from the control points: c_g, |g| = n - 1. */
static void step_once(const struct beside *beside, const uint8_t gamma[4], const uint8_t raised[4],
                      struct poly *ret)
{
    const double *c = beside->control;
    double row[3][4];

    rows_of(beside, gamma, row);
    *ret = (struct poly){ { c[raised[0]] } };
    for (int j = 0; j < 3; j++) {
        const double rise = c[raised[j + 1]] - c[raised[0]];

        ret->c[0] += rise * row[j][3];
        for (int i = 0; i < 3; i++)
            ret->c[1 + i] += rise * row[j][i];
    }
}

/* ret += row (a - b), all three affine. */
static void add_product(struct poly *ret, const double row[4], const struct poly *a,
                        const struct poly *b)
{
    double d[4];

    for (int i = 0; i < 4; i++)
        d[i] = a->c[i] - b->c[i];
    ret->c[0] += row[3] * d[0];
    for (int i = 0; i < 3; i++)
        ret->c[1 + i] += row[i] * d[0] + row[3] * d[1 + i];
    ret->c[4] += row[0] * d[1];
    ret->c[5] += row[0] * d[2] + row[1] * d[1];
    ret->c[6] += row[0] * d[3] + row[2] * d[1];
    ret->c[7] += row[1] * d[2];
    ret->c[8] += row[1] * d[3] + row[2] * d[2];
    ret->c[9] += row[2] * d[3];
}

/* The next step: c_g, |g| = n - 2 = 1, from those of the one before. */
static void step_again(const struct beside *beside, unsigned corner, const struct poly *affine,
                       struct poly *ret)
{
    const uint8_t gamma[4] = { corner == 0, corner == 1, corner == 2, 0 };
    const uint8_t *raised = gsn_simplex_raised[corner];
    double row[3][4];

    rows_of(beside, gamma, row);
    *ret = affine[raised[0]];
    for (int j = 0; j < 3; j++)
        add_product(ret, row[j], &affine[raised[j + 1]], &affine[raised[0]]);
}

static double *add_scaled(double *to, double sign, const double *c, size_t count)
{
    for (size_t i = 0; i < count; i++)
        to[i] += sign * c[i];
    return to + count;
}

/* Adds sign c_g of one side. */
static void add_side_jump(const struct beside *beside, unsigned degree, unsigned top, double sign,
                          double *poly)
{
    struct poly affine[9], quadratic;

    if (degree == 3) {
        for (int i = 0; i < 9; i++)
            step_once(beside, &passed[i][1], gsn_simplex_raised[passed[i][0]],
                      &affine[passed[i][0]]);
        for (unsigned corner = 0; corner < 3; corner++) {
            step_again(beside, corner, affine, &quadratic);
            poly = add_scaled(poly, sign, quadratic.c, 10);
        }
        for (int i = 3; i < 9; i++)
            poly = add_scaled(poly, sign, affine[on_face[i]].c, 4);
    } else if (degree == 2) {
        for (unsigned corner = 0; corner < 3; corner++) {
            const uint8_t gamma[4] = { corner == 0, corner == 1, corner == 2, 0 };

            step_once(beside, gamma, gsn_simplex_raised[corner], &affine[0]);
            poly = add_scaled(poly, sign, affine[0].c, 4);
        }
    }
    for (unsigned i = first_on_face[degree]; top == degree && i < gsn_face_correction_sets(top);
         i++)
        *poly++ += sign * beside->control[on_face[i]];
}

void gsn_face_correction_jumps(const struct gsn_dms *space, const struct gsn_prism *prism,
                               const double *control, double *ret_poly)
{
    struct beside beside;

    memset(ret_poly, 0, GSN_FACE_CORRECTION_MAX_POLY * sizeof *ret_poly);
    beside_init(&beside, space, prism, prism->tet, control);
    add_side_jump(&beside, space->degree, prism->top, prism->side, ret_poly);
    if (prism->other < 0)
        return;
    beside_init(&beside, space, prism, (size_t)prism->other, control);
    add_side_jump(&beside, space->degree, prism->top, -prism->side, ret_poly);
}

/* --- a face made ready for its kernels --- */

/* Rounding error of a plane value, in units of size^3: knots and points are turned into the axes of
 * the face with errors of some 8 ulp, products of three lengths up to 2 size follow. */
#define PLANE_ERROR (4096 * DBL_EPSILON / 2)

/* The value of a plane without direction: it decides nothing and is never near 0. */
#define NO_PLANE 1e300

/* The barycentric coordinate of knot i of a leaf is swap[i] times the plane value of the other
 * three, ascending, over the leaf's determinant. */
static const double swap[4] = { -1, 1, -1, 1 };

static void prepare_planes(struct gsn_face_correction *seam, unsigned from, unsigned to)
{
    const struct gsn_face_correction_tables *tables = seam->tables;
    const double(*at)[2 * GSN_FACE_CORRECTION_MAX_KNOTS] = seam->prism->at;

    for (unsigned p = from; p < to; p++) {
        double *plane = seam->data.plane[p], row[2][3];
        const unsigned knot = tables->triple[p][0];

        for (int r = 0; r < 2; r++) {
            for (int c = 0; c < 3; c++)
                row[r][c] = at[c][tables->minuend[r][p]] - at[c][tables->subtrahend[r][p]];
        }
        gsn_cross(row[0], row[1], plane);
        plane[3] = -(plane[0] * at[0][knot] + plane[1] * at[1][knot] + plane[2] * at[2][knot]);
        if (plane[0] == 0 && plane[1] == 0 && plane[2] == 0)
            plane[3] = NO_PLANE;
    }
}

static void prepare_leaves(struct gsn_face_correction *seam, unsigned from, unsigned to)
{
    const struct gsn_face_correction_tables *tables = seam->tables;
    const double(*at)[2 * GSN_FACE_CORRECTION_MAX_KNOTS] = seam->prism->at;

    for (unsigned l = from; l < to; l++) {
        const double *normal = seam->data.plane[tables->leaf_plane[l][3]];
        const unsigned head = tables->leaf_row[l][0], tail = tables->leaf_row[l][1];
        double det = 0;

        for (int c = 0; c < 3; c++)
            det += normal[c] * (at[c][head] - at[c][tail]);
        seam->det[l] = det;
        seam->data.leaf[l] = fabs(det) > DBL_MIN ? 1 / fabs(det) : 0;
    }
}

/* W of a set of more than four knots: the leaf of largest |det| among those ready. */
static void choose_bases(struct gsn_face_correction *seam, unsigned from, unsigned to,
                         unsigned leaves)
{
    const struct gsn_face_correction_tables *tables = seam->tables;

    for (unsigned node = from; node < to; node++) {
        double largest = -1;

        for (unsigned i = node ? tables->base_end[node - 1] : 0; i < tables->base_end[node]; i++) {
            const unsigned leaf = tables->base[i];

            if (leaf < leaves && fabs(seam->det[leaf]) > largest) {
                largest = fabs(seam->det[leaf]);
                seam->base[node] = (uint8_t)leaf;
            }
        }
    }
}

static void prepare_weights(struct gsn_face_correction *seam, unsigned from, unsigned to)
{
    const struct gsn_face_correction_tables *tables = seam->tables;

    for (unsigned w = from; w < to; w++) {
        const unsigned leaf = seam->base[tables->weight[w].node], knot = tables->weight[w].knot;
        const unsigned mask = tables->leaf_mask[leaf];
        const int place = __builtin_popcount(mask & ((1u << knot) - 1));
        const double by = mask >> knot & 1
                              ? swap[place & 3] * copysign(seam->data.leaf[leaf], seam->det[leaf])
                              : 0;
        const double *plane = seam->data.plane[tables->leaf_plane[leaf][place & 3]];

        for (int c = 0; c < 4; c++)
            seam->data.weight[w][c] = by * plane[c];
    }
}

/* What points clear of all clouds need, or (all = 1) the rest too. A set keeps the W it was given
 * first. */
static void prepare_part(struct gsn_face_correction *seam, int all)
{
    const struct gsn_face_correction_tables *t = seam->tables;

    prepare_planes(seam, all ? t->planes[0] : 0, t->planes[all]);
    prepare_leaves(seam, all ? t->leaves[0] : 0, t->leaves[all]);
    choose_bases(seam, all ? t->nodes[0] : 0, t->nodes[all], t->leaves[all]);
    prepare_weights(seam, all ? t->weights[0] : 0, t->weights[all]);
    seam->all = all;
}

void gsn_face_correction_init(struct gsn_face_correction *seam, const struct gsn_dms *space,
                              const struct gsn_prism *prism, const double *control)
{
    seam->prism = prism;
    seam->kernels = space->kernels;
    seam->tables = &gsn_face_correction_tables[prism->top - 1];
    seam->degree = space->degree;
    memcpy(seam->data.origin, prism->origin, sizeof prism->origin);
    memcpy(seam->data.turn, prism->turn, sizeof prism->turn);
    seam->data.bound = PLANE_ERROR * prism->size * prism->size * prism->size;
    for (unsigned i = 0; i < seam->tables->knots; i++)
        seam->knot[i] = space->knot[prism->vertex[i / (prism->top + 1)] * (space->degree + 1) +
                                    i % (prism->top + 1)];
    prepare_part(seam, 0);
    if (control)
        gsn_face_correction_jumps(space, prism, control, seam->data.poly);
}

void gsn_face_correction_complete(struct gsn_face_correction *seam)
{
    if (!seam->all)
        prepare_part(seam, 1);
}

/* One point that a kernel could not be sure of: the sides of near planes are decided exactly. */
static void run_carefully(const struct gsn_face_correction *seam,
                          enum gsn_face_correction_kind kind, unsigned degree, const double u[3],
                          double *ret)
{
    const struct gsn_face_correction_tables *tables = seam->tables;
    double fixed[GSN_FACE_CORRECTION_MAX_PLANES], d[3], at[3];

    gsn_subtract(u, seam->data.origin, d);
    for (int c = 0; c < 3; c++)
        at[c] = gsn_dot(seam->prism->turn[c], d);
    for (unsigned p = 0; p < tables->planes[1]; p++) {
        const double *plane = seam->data.plane[p];
        const uint8_t *m = tables->triple[p];

        fixed[p] = gsn_dot(plane, at) + plane[3];
        if (!(fabs(fixed[p]) > seam->data.bound))
            fixed[p] = copysign(
                fixed[p], gsn_orient_side(seam->knot[m[0]], seam->knot[m[1]], seam->knot[m[2]], u));
    }
    (void)gsn_kernels_careful()->seam[kind][degree][seam->prism->top][7].run(
        &seam->data, &u[0], &u[1], &u[2], ret, fixed);
}

/* Runs one group of points; ret has a row of the kernels' lanes per number. */
static void run_group(struct gsn_face_correction *seam, enum gsn_face_correction_kind kind,
                      unsigned unclear, const double *const u[3], size_t count, size_t numbers,
                      double *ret)
{
    const size_t lanes = seam->kernels->lanes;
    const unsigned degree = kind == GSN_FACE_CORRECTION_WEIGHTS ? 0 : seam->degree;
    double some[3][GSN_MAX_SIMD_WIDTH], careful[GSN_FACE_CORRECTION_MAX_SETS];
    const double *at[3] = { u[0], u[1], u[2] };
    unsigned unsure;

    for (int c = 0; count < lanes && c < 3; c++) {
        for (size_t i = 0; i < lanes; i++)
            some[c][i] = u[c][i < count ? i : 0];
        at[c] = some[c];
    }
    unsure = seam->kernels->seam[kind][degree][seam->prism->top][unclear].run(
        &seam->data, at[0], at[1], at[2], ret, NULL);
    for (size_t i = 0; unsure != 0 && i < count; i++) {
        if (!(unsure >> i & 1))
            continue;
        gsn_face_correction_complete(seam);
        run_carefully(seam, kind, degree, (const double[3]){ at[0][i], at[1][i], at[2][i] },
                      careful);
        for (size_t j = 0; j < numbers; j++)
            ret[j * lanes + i] = careful[j];
    }
}

void gsn_face_correction_add(struct gsn_face_correction *seam, unsigned unclear,
                             const double *const u[3], size_t count, double *value,
                             double *const slope[3])
{
    const enum gsn_face_correction_kind kind =
        slope ? GSN_FACE_CORRECTION_SLOPE : GSN_FACE_CORRECTION_VALUE;
    const size_t lanes = seam->kernels->lanes;
    double ret[4 * GSN_MAX_SIMD_WIDTH];

    if (unclear != 0)
        gsn_face_correction_complete(seam);
    for (size_t i = 0; i < count; i += lanes) {
        const double *at[3] = { &u[0][i], &u[1][i], &u[2][i] };
        const size_t now = count - i < lanes ? count - i : lanes;

        run_group(seam, kind, unclear, at, now, slope ? 4 : 1, ret);
        for (size_t j = 0; j < now; j++)
            value[i + j] += ret[j];
        for (size_t c = 0; slope && c < 3; c++) {
            for (size_t j = 0; j < now; j++)
                slope[c][i + j] += ret[(1 + c) * lanes + j];
        }
    }
}

size_t gsn_face_correction_sets(unsigned top)
{
    return top == 1 ? 3 : top == 2 ? 9 : 19;
}

void gsn_face_correction_weights(struct gsn_face_correction *seam, unsigned unclear,
                                 const double u[3], double ret_weight[GSN_FACE_CORRECTION_MAX_SETS])
{
    const double *at[3] = { &u[0], &u[1], &u[2] };
    double ret[GSN_FACE_CORRECTION_MAX_SETS * GSN_MAX_SIMD_WIDTH];
    const size_t sets = gsn_face_correction_sets(seam->prism->top);

    if (unclear != 0)
        gsn_face_correction_complete(seam);
    run_group(seam, GSN_FACE_CORRECTION_WEIGHTS, unclear, at, 1, sets, ret);
    for (size_t i = 0; i < sets; i++)
        ret_weight[i] = ret[i * seam->kernels->lanes];
}

/* --- which faces matter at a point --- */

/* A bit per corner of a tetrahedron that is not clear of its cloud at u. */
static unsigned unclear_at(const struct gsn_dms *space, size_t tet, const double u[3])
{
    struct gsn_dms_shape shape;
    double lambda[4];

    gsn_dms_shape_of(space, tet, &shape);
    gsn_barycentric_at(&shape.frame, u, lambda);
    return GSN_DMS_ALL & ~gsn_dms_clear(&shape, lambda);
}

/* The greatest |g| of a face. */
static unsigned top_of(const struct gsn_dms *space, size_t tet, unsigned corner)
{
    return space->sharing == GSN_DMS_SHARED && space->mesh->neighbour[tet][corner] >= 0
               ? space->degree - 1
               : space->degree;
}

/* Whether the box around the knots of a face holds u. */
static int box_holds(const struct gsn_dms *space, size_t tet, unsigned corner, unsigned top,
                     const double u[3])
{
    for (int c = 0; c < 3; c++) {
        int below = 0, above = 0;

        for (unsigned k = 0; k < 4; k++) {
            const size_t first = space->mesh->tet[tet][k] * (space->degree + 1);

            for (unsigned l = 0; k != corner && l <= top; l++) {
                below = below || space->knot[first + l][c] <= u[c];
                above = above || space->knot[first + l][c] >= u[c];
            }
        }
        if (!below || !above)
            return 0;
    }
    return 1;
}

static unsigned corner_towards(const struct gsn_tets *mesh, size_t tet, size_t other)
{
    unsigned k = 0;

    while (k < 3 && mesh->neighbour[tet][k] != (int32_t)other)
        k++;
    return k;
}

/* The faces of one tetrahedron that is the one with the smaller number. */
static void each_face(const struct gsn_dms *space, size_t tet, const double u[3],
                      void (*visit)(void *context, size_t tet, unsigned corner), void *context)
{
    for (unsigned k = 0; k < 4; k++) {
        const int64_t other = space->mesh->neighbour[tet][k];
        const unsigned top = top_of(space, tet, k);

        if ((other < 0 || (size_t)other > tet) && top > 0 && box_holds(space, tet, k, top, u))
            visit(context, tet, k);
    }
}

void gsn_face_correction_each(const struct gsn_dms *space, size_t home, const double u[3],
                              void (*visit)(void *context, size_t tet, unsigned corner),
                              void *context)
{
    const struct gsn_tets *mesh = space->mesh;
    const unsigned unclear = unclear_at(space, home, u);
    struct gsn_sorted_batch ascent;

    if (unclear == 0)
        return;
    if ((unclear & (unclear - 1)) == 0) {
        const unsigned corner = (unsigned)__builtin_ctz(unclear);
        const int64_t other = mesh->neighbour[home][corner];
        const unsigned back = other < 0 ? 0 : corner_towards(mesh, (size_t)other, home);

        if (other >= 0 && unclear_at(space, (size_t)other, u) == 1u << back) {
            if (top_of(space, home, corner) > 0)
                visit(context, home < (size_t)other ? home : (size_t)other,
                      home < (size_t)other ? corner : back);
            return;
        }
    }
    gsn_sorted_batch_begin(&ascent);
    do {
        (void)gsn_bvh_at(space->tree, u, gsn_sorted_batch_add, &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            each_face(space, ascent.item[i], u, visit, context);
    } while (gsn_sorted_batch_next(&ascent));
}

struct sum {
    const struct gsn_spline *spline;
    const double *u;
    double *value, *gradient;
};

static void add_face(void *context, size_t tet, unsigned corner)
{
    const struct sum *sum = context;
    const double *const at[3] = { &sum->u[0], &sum->u[1], &sum->u[2] };
    double *slope[3] = { NULL };
    struct gsn_prism prism;
    struct gsn_face_correction seam;
    int unclear;

    if (!gsn_prism_init(sum->spline->space, tet, corner, &prism))
        return;
    unclear = gsn_prism_at(&prism, sum->u);
    if (unclear < 0)
        return;
    for (int c = 0; sum->gradient && c < 3; c++)
        slope[c] = &sum->gradient[c];
    gsn_face_correction_init(&seam, sum->spline->space, &prism, sum->spline->control);
    gsn_face_correction_add(&seam, (unsigned)unclear, at, 1, sum->value,
                            sum->gradient ? slope : NULL);
}

void gsn_spline_add_face_corrections(const struct gsn_spline *spline, size_t home,
                                     const double u[3], double *value, double *gradient)
{
    struct sum sum = { spline, u, value, gradient };

    gsn_face_correction_each(spline->space, home, u, add_face, &sum);
}

/* A row while it grows, ascending. */
struct row {
    const struct gsn_dms *space;
    const double *u;
    size_t room, count;
    uint32_t *control;
    double *value;
    int full;
};

static void put_entry(struct row *row, uint32_t control, double value)
{
    size_t low = 0, high = row->count;

    while (low < high) {
        const size_t middle = (low + high) / 2;

        if (row->control[middle] < control)
            low = middle + 1;
        else
            high = middle;
    }
    if (low < row->count && row->control[low] == control) {
        row->value[low] += value;
        return;
    }
    if (row->count == row->room) {
        row->full = 1;
        return;
    }
    memmove(&row->control[low + 1], &row->control[low], (row->count - low) * sizeof *row->control);
    memmove(&row->value[low + 1], &row->value[low], (row->count - low) * sizeof *row->value);
    row->control[low] = control;
    row->value[low] = value;
    row->count++;
}

/* Derivatives with respect to the c_g of one tetrahedron, by |g| and place. */
struct adjoint {
    double of[GSN_DMS_MAX_DEGREE + 1][GSN_DMS_MAX_FUNCTIONS];
};

/* Hands them down to the control points. */
static void descend_row(struct row *row, size_t tet, struct adjoint *adjoint)
{
    const struct gsn_dms *space = row->space;
    const uint32_t *id = gsn_dms_control_ids(space, tet), *v = space->mesh->tet[tet];
    const size_t per_cloud = space->degree + 1;

    for (unsigned r = 0; r < space->degree; r++) {
        uint8_t gamma[4] = { (uint8_t)r, 0, 0, 0 };

        do {
            const size_t place = gsn_simplex_place(gamma);
            struct gsn_barycentric frame;
            double lambda[4];

            if (adjoint->of[r][place] == 0)
                continue;
            gsn_barycentric_init(&frame, space->knot[v[0] * per_cloud + gamma[0]],
                                 space->knot[v[1] * per_cloud + gamma[1]],
                                 space->knot[v[2] * per_cloud + gamma[2]],
                                 space->knot[v[3] * per_cloud + gamma[3]]);
            gsn_barycentric_at(&frame, row->u, lambda);
            for (unsigned j = 0; j < 4; j++)
                adjoint->of[r + 1][gsn_simplex_raised[place][j]] +=
                    lambda[j] * adjoint->of[r][place];
        } while (gsn_simplex_next(gamma));
    }
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        if (adjoint->of[space->degree][f] != 0)
            put_entry(row, id[f], adjoint->of[space->degree][f]);
    }
}

/* The weights of a face, times sign, for the tetrahedron on one of its sides. */
static void add_side_row(struct row *row, const struct gsn_prism *prism, size_t tet, double sign,
                         const double *weight)
{
    const uint32_t *v = row->space->mesh->tet[tet];
    struct adjoint adjoint = { { { 0 } } };
    unsigned corner[3] = { 0, 0, 0 };

    for (unsigned m = 0; m < 3; m++) {
        while (v[corner[m]] != prism->vertex[m])
            corner[m]++;
    }
    for (unsigned m = 1; m <= prism->top; m++) {
        uint8_t gamma[4] = { (uint8_t)m, 0, 0, 0 };

        do {
            uint8_t own[4] = { 0 };

            if (gamma[3] != 0)
                continue;
            for (unsigned k = 0; k < 3; k++)
                own[corner[k]] = gamma[k];
            adjoint.of[m][gsn_simplex_place(own)] = sign * *weight++;
        } while (gsn_simplex_next(gamma));
    }
    descend_row(row, tet, &adjoint);
}

static void add_weights(void *context, size_t tet, unsigned corner)
{
    struct row *row = context;
    double weight[GSN_FACE_CORRECTION_MAX_SETS];
    struct gsn_prism prism;
    struct gsn_face_correction seam;
    int unclear;

    if (!gsn_prism_init(row->space, tet, corner, &prism))
        return;
    unclear = gsn_prism_at(&prism, row->u);
    if (unclear < 0)
        return;
    gsn_face_correction_init(&seam, row->space, &prism, NULL);
    gsn_face_correction_weights(&seam, (unsigned)unclear, row->u, weight);
    add_side_row(row, &prism, tet, prism.side, weight);
    if (prism.other >= 0)
        add_side_row(row, &prism, (size_t)prism.other, -prism.side, weight);
}

int gsn_face_correction_row(const struct gsn_dms *space, size_t home, const double u[3],
                            size_t room, uint32_t *ret_control, double *ret_value,
                            size_t *ret_count)
{
    struct row row = {
        .space = space, .u = u, .room = room, .control = ret_control, .value = ret_value
    };
    struct adjoint adjoint = { { { 1 } } };

    descend_row(&row, home, &adjoint);
    gsn_face_correction_each(space, home, u, add_weights, &row);
    *ret_count = row.count;
    return row.full ? GSN_E_LIMIT : GSN_OK;
}
