/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/seam.h"

#include "pipeline/model/orient.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <string.h>

#include "seam_tables.inc"

/* Rounding error of a plane value, in units of size^3: knots and points are turned into the axes of
 * the face with errors of some 8 ulp, products of three lengths up to 2 size follow. */
#define PLANE_ERROR (4096 * DBL_EPSILON / 2)

/* The value of a plane without direction: it decides nothing and is never near 0. */
#define NO_PLANE 1e300

/* The barycentric coordinate of knot i of a leaf is swap[i] times the plane value of the other
 * three, ascending, over the leaf's determinant. */
static const double swap[4] = { -1, 1, -1, 1 };

static void prepare_planes(struct gsn_seam *seam, unsigned from, unsigned to)
{
    const struct gsn_seam_tables *tables = seam->tables;
    const double(*at)[2 * GSN_SEAM_MAX_KNOTS] = seam->prism->at;

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

static void prepare_leaves(struct gsn_seam *seam, unsigned from, unsigned to)
{
    const struct gsn_seam_tables *tables = seam->tables;
    const double(*at)[2 * GSN_SEAM_MAX_KNOTS] = seam->prism->at;

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
static void choose_bases(struct gsn_seam *seam, unsigned from, unsigned to, unsigned leaves)
{
    const struct gsn_seam_tables *tables = seam->tables;

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

static void prepare_weights(struct gsn_seam *seam, unsigned from, unsigned to)
{
    const struct gsn_seam_tables *tables = seam->tables;

    for (unsigned w = from; w < to; w++) {
        const unsigned leaf = seam->base[tables->weight[w].node];
        double *weight = seam->data.weight[w];

        for (int c = 0; c < 4; c++)
            weight[c] = 0;
        for (int i = 0; i < 4; i++) {
            const double *plane = seam->data.plane[tables->leaf_plane[leaf][i]];
            const double by = swap[i] * seam->data.leaf[leaf] * copysign(1, seam->det[leaf]);

            if (tables->leaf[leaf][i] != tables->weight[w].knot || plane[3] == NO_PLANE)
                continue;
            for (int c = 0; c < 4; c++)
                weight[c] = by * plane[c];
        }
    }
}

/* What points clear of all clouds need, or (all = 1) the rest too. A set keeps the W it was given
 * first. */
static void prepare(struct gsn_seam *seam, int all)
{
    const struct gsn_seam_tables *t = seam->tables;

    prepare_planes(seam, all ? t->planes[0] : 0, t->planes[all]);
    prepare_leaves(seam, all ? t->leaves[0] : 0, t->leaves[all]);
    choose_bases(seam, all ? t->nodes[0] : 0, t->nodes[all], t->leaves[all]);
    prepare_weights(seam, all ? t->weights[0] : 0, t->weights[all]);
    seam->all = all;
}

/* A tetrahedron beside the face, its corners in the order of the face's vertices, the one opposite
 * last, in the axes of the face. */
struct beside {
    unsigned degree;
    uint8_t order[4];
    double knot[4][GSN_DMS_MAX_DEGREE][3]; /* those with numbers below the degree */
    double control[GSN_DMS_MAX_FUNCTIONS]; /* by place of the multi-index in that order */
};

/* A polynomial of degree up to 2 in the order of the generated code. */
struct poly {
    double c[10];
};

static void order_corners(const struct gsn_prism *prism, const uint32_t vertex[4],
                          uint8_t ret_order[4])
{
    for (unsigned k = 0; k < 4; k++) {
        unsigned place = 3;

        for (unsigned m = 0; m < 3; m++) {
            if (prism->vertex[m] == vertex[k])
                place = m;
        }
        ret_order[place] = (uint8_t)k;
    }
}

static void into_axes(const struct gsn_prism *prism, const double v[3], double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = gsn_dot(prism->turn[c], v);
}

/* The places of all multi-indices of a degree in one order of the corners, by those in another
 * whose corner j is order[j] of the former. */
static void places_of(unsigned degree, const uint8_t order[4],
                      uint8_t ret_place[GSN_DMS_MAX_FUNCTIONS])
{
    uint8_t lower[10];

    ret_place[0] = 0;
    for (unsigned r = 0; r < degree; r++) {
        const size_t count = gsn_simplex_count(r);

        memcpy(lower, ret_place, count);
        for (size_t p = 0; p < count; p++) {
            for (unsigned j = 0; j < 4; j++)
                ret_place[gsn_simplex_raised[p][j]] = gsn_simplex_raised[lower[p]][order[j]];
        }
    }
}

static void beside_init(struct beside *beside, const struct gsn_dms *space,
                        const struct gsn_prism *prism, size_t tet, const double *control)
{
    const uint32_t *v = space->mesh->tet[tet], *id = gsn_dms_control_ids(space, tet);
    uint8_t place[GSN_DMS_MAX_FUNCTIONS];

    beside->degree = space->degree;
    order_corners(prism, v, beside->order);
    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 0; l < space->degree; l++) {
            double d[3];

            gsn_subtract(space->knot[v[beside->order[k]] * (space->degree + 1) + l], prism->origin,
                         d);
            into_axes(prism, d, beside->knot[k][l]);
        }
    }
    places_of(space->degree, beside->order, place);
    for (size_t f = 0; f < gsn_simplex_count(space->degree); f++)
        beside->control[f] = control[id[place[f]]];
}

/* c_g(u) for |g| = degree - 1, degree - 2: one and two steps of the B-patch recurrence. */
static void step_once(const struct beside *beside, const struct gsn_frame *frame,
                      const uint8_t raised[4], struct poly *ret)
{
    const double *c = beside->control;

    ret->c[0] = c[raised[0]];
    for (int i = 0; i < 3; i++) {
        ret->c[1 + i] = 0;
        for (int j = 1; j < 4; j++)
            ret->c[1 + i] += (c[raised[j]] - c[raised[0]]) * frame->row[j - 1][i];
        ret->c[0] -= ret->c[1 + i] * frame->origin[i];
    }
}

static void frame_of(const struct beside *beside, const uint8_t gamma[4], struct gsn_frame *ret)
{
    gsn_frame_init(ret, beside->knot[0][gamma[0]], beside->knot[1][gamma[1]],
                   beside->knot[2][gamma[2]], beside->knot[3][gamma[3]]);
}

static void affine_of(const struct beside *beside, const uint8_t gamma[4], size_t place,
                      struct poly *ret)
{
    struct gsn_frame frame;

    frame_of(beside, gamma, &frame);
    step_once(beside, &frame, gsn_simplex_raised[place], ret);
}

/* ret += lambda * (a - b), lambda = row . (u - origin). */
static void add_product(struct poly *ret, const double row[3], const double origin[3],
                        const struct poly *a, const struct poly *b)
{
    const double k = -gsn_dot(row, origin);
    double d[4];

    for (int i = 0; i < 4; i++)
        d[i] = a->c[i] - b->c[i];
    ret->c[0] += k * d[0];
    for (int i = 0; i < 3; i++)
        ret->c[1 + i] += row[i] * d[0] + k * d[1 + i];
    ret->c[4] += row[0] * d[1];
    ret->c[5] += row[0] * d[2] + row[1] * d[1];
    ret->c[6] += row[0] * d[3] + row[2] * d[1];
    ret->c[7] += row[1] * d[2];
    ret->c[8] += row[1] * d[3] + row[2] * d[2];
    ret->c[9] += row[2] * d[3];
}

static void quadratic_of(const struct beside *beside, const struct poly *affine,
                         const uint8_t gamma[4], size_t place, struct poly *ret)
{
    const uint8_t *raised = gsn_simplex_raised[place];
    struct gsn_frame frame;

    frame_of(beside, gamma, &frame);
    *ret = affine[raised[0]];
    for (int i = 4; i < 10; i++)
        ret->c[i] = 0;
    for (int j = 1; j < 4; j++)
        add_product(ret, frame.row[j - 1], frame.origin, &affine[raised[j]], &affine[raised[0]]);
}

/* Multi-indices by place, their first member left out; and the places of those on the face, whose
 * last member is 0. */
static const uint8_t index_of[10][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 },
                                         { 2, 0, 0 }, { 1, 1, 0 }, { 1, 0, 1 }, { 0, 2, 0 },
                                         { 0, 1, 1 }, { 0, 0, 2 } };
static const uint8_t on_face[10] = { 0, 1, 2, 4, 5, 7, 10, 11, 13, 16 };

static void gamma_of(unsigned m, size_t place, uint8_t ret_gamma[4])
{
    const uint8_t *index = index_of[place];

    ret_gamma[0] = (uint8_t)(m - index[0] - index[1] - index[2]);
    memcpy(&ret_gamma[1], index, 3);
}

/* Adds sign * c_g of one side to the jumps D_g. */
static void add_side(struct gsn_seam *seam, const struct beside *beside, double sign)
{
    const unsigned n = seam->degree;
    struct poly affine[10], poly = { { 0 } };
    double *to = seam->data.poly;
    uint8_t gamma[4];

    /* Those that the quadratic ones come from have one vertex beyond the face. */
    for (size_t place = 0; n > 1 && place < gsn_simplex_count(n - 1); place++) {
        gamma_of(n - 1, place, gamma);
        if (gamma[3] < n - 1)
            affine_of(beside, gamma, place, &affine[place]);
    }
    for (unsigned m = 1; m <= seam->prism->top; m++) {
        for (size_t i = 0; i < (m + 1) * (m + 2) / 2; i++) {
            const size_t size = gsn_simplex_count(n - m), place = on_face[i];

            if (m == n)
                poly.c[0] = beside->control[place];
            else if (m == n - 1)
                poly = affine[place];
            else {
                gamma_of(m, place, gamma);
                quadratic_of(beside, affine, gamma, place, &poly);
            }
            for (size_t j = 0; j < size; j++)
                *to++ += sign * poly.c[j];
        }
    }
}

void gsn_seam_init(struct gsn_seam *seam, const struct gsn_dms *space,
                   const struct gsn_prism *prism, const double *control)
{
    struct beside beside;

    seam->prism = prism;
    seam->kernels = space->kernels;
    seam->tables = &gsn_seam_tables[prism->top - 1];
    seam->degree = space->degree;
    memcpy(seam->data.origin, prism->origin, sizeof prism->origin);
    memcpy(seam->data.turn, prism->turn, sizeof prism->turn);
    seam->data.bound = PLANE_ERROR * prism->size * prism->size * prism->size;
    for (unsigned i = 0; i < seam->tables->knots; i++)
        seam->knot[i] = space->knot[prism->vertex[i / (prism->top + 1)] * (space->degree + 1) +
                                    i % (prism->top + 1)];
    prepare(seam, 0);
    if (!control)
        return;
    memset(seam->data.poly, 0, sizeof seam->data.poly);
    beside_init(&beside, space, prism, prism->tet, control);
    add_side(seam, &beside, prism->side);
    if (prism->other < 0)
        return;
    beside_init(&beside, space, prism, (size_t)prism->other, control);
    add_side(seam, &beside, -prism->side);
}

/* One point that a kernel could not be sure of: the sides of near planes are decided exactly. */
static void run_carefully(const struct gsn_seam *seam, enum gsn_seam_kind kind, unsigned degree,
                          const double u[3], double *ret)
{
    const struct gsn_seam_tables *tables = seam->tables;
    double fixed[GSN_SEAM_MAX_PLANES], d[3], at[3];

    gsn_subtract(u, seam->data.origin, d);
    into_axes(seam->prism, d, at);
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
static void run_group(struct gsn_seam *seam, enum gsn_seam_kind kind, unsigned unclear,
                      const double *const u[3], size_t count, size_t numbers, double *ret)
{
    const size_t lanes = seam->kernels->lanes;
    const unsigned degree = kind == GSN_SEAM_WEIGHTS ? 0 : seam->degree;
    double some[3][GSN_MOST_LANES], careful[GSN_SEAM_MAX_SETS];
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
        if (!seam->all)
            prepare(seam, 1);
        run_carefully(seam, kind, degree, (const double[3]){ at[0][i], at[1][i], at[2][i] },
                      careful);
        for (size_t j = 0; j < numbers; j++)
            ret[j * lanes + i] = careful[j];
    }
}

void gsn_seam_add(struct gsn_seam *seam, unsigned unclear, const double *const u[3], size_t count,
                  double *value, double *const slope[3])
{
    const enum gsn_seam_kind kind = slope ? GSN_SEAM_SLOPE : GSN_SEAM_VALUE;
    const size_t lanes = seam->kernels->lanes;
    double ret[4 * GSN_MOST_LANES];

    if (unclear != 0 && !seam->all)
        prepare(seam, 1);
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

size_t gsn_seam_sets(unsigned top)
{
    return top == 1 ? 3 : top == 2 ? 9 : 19;
}

void gsn_seam_weights(struct gsn_seam *seam, unsigned unclear, const double u[3],
                      double ret_weight[GSN_SEAM_MAX_SETS])
{
    const double *at[3] = { &u[0], &u[1], &u[2] };
    double ret[GSN_SEAM_MAX_SETS * GSN_MOST_LANES];
    const size_t sets = gsn_seam_sets(seam->prism->top);

    if (unclear != 0 && !seam->all)
        prepare(seam, 1);
    run_group(seam, GSN_SEAM_WEIGHTS, unclear, at, 1, sets, ret);
    for (size_t i = 0; i < sets; i++)
        ret_weight[i] = ret[i * seam->kernels->lanes];
}
