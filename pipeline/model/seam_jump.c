/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/seam_jump.h"

#include <assert.h>
#include <string.h>

#include "seam_orders.inc"

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

static double *add(double *to, double sign, const double *c, size_t count)
{
    for (size_t i = 0; i < count; i++)
        to[i] += sign * c[i];
    return to + count;
}

/* Adds sign c_g of one side. */
static void add_side(const struct beside *beside, unsigned degree, unsigned top, double sign,
                     double *poly)
{
    struct poly affine[9], quadratic;

    if (degree == 3) {
        for (int i = 0; i < 9; i++)
            step_once(beside, &passed[i][1], gsn_simplex_raised[passed[i][0]],
                      &affine[passed[i][0]]);
        for (unsigned corner = 0; corner < 3; corner++) {
            step_again(beside, corner, affine, &quadratic);
            poly = add(poly, sign, quadratic.c, 10);
        }
        for (int i = 3; i < 9; i++)
            poly = add(poly, sign, affine[on_face[i]].c, 4);
    } else if (degree == 2) {
        for (unsigned corner = 0; corner < 3; corner++) {
            const uint8_t gamma[4] = { corner == 0, corner == 1, corner == 2, 0 };

            step_once(beside, gamma, gsn_simplex_raised[corner], &affine[0]);
            poly = add(poly, sign, affine[0].c, 4);
        }
    }
    for (unsigned i = first_on_face[degree]; top == degree && i < gsn_seam_sets(top); i++)
        *poly++ += sign * beside->control[on_face[i]];
}

void gsn_seam_jumps(const struct gsn_dms *space, const struct gsn_prism *prism,
                    const double *control, double *ret_poly)
{
    struct beside beside;

    memset(ret_poly, 0, GSN_SEAM_MAX_POLY * sizeof *ret_poly);
    beside_init(&beside, space, prism, prism->tet, control);
    add_side(&beside, space->degree, prism->top, prism->side, ret_poly);
    if (prism->other < 0)
        return;
    beside_init(&beside, space, prism, (size_t)prism->other, control);
    add_side(&beside, space->degree, prism->top, -prism->side, ret_poly);
}
