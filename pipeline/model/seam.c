/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/seam.h"

#include "pipeline/model/orient.h"
#include "pipeline/model/seam_jump.h"

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
static void prepare(struct gsn_seam *seam, int all)
{
    const struct gsn_seam_tables *t = seam->tables;

    prepare_planes(seam, all ? t->planes[0] : 0, t->planes[all]);
    prepare_leaves(seam, all ? t->leaves[0] : 0, t->leaves[all]);
    choose_bases(seam, all ? t->nodes[0] : 0, t->nodes[all], t->leaves[all]);
    prepare_weights(seam, all ? t->weights[0] : 0, t->weights[all]);
    seam->all = all;
}

void gsn_seam_init(struct gsn_seam *seam, const struct gsn_dms *space,
                   const struct gsn_prism *prism, const double *control)
{
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
    if (control)
        gsn_seam_jumps(space, prism, control, seam->data.poly);
}

void gsn_seam_complete(struct gsn_seam *seam)
{
    if (!seam->all)
        prepare(seam, 1);
}

/* One point that a kernel could not be sure of: the sides of near planes are decided exactly. */
static void run_carefully(const struct gsn_seam *seam, enum gsn_seam_kind kind, unsigned degree,
                          const double u[3], double *ret)
{
    const struct gsn_seam_tables *tables = seam->tables;
    double fixed[GSN_SEAM_MAX_PLANES], d[3], at[3];

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
        gsn_seam_complete(seam);
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

    if (unclear != 0)
        gsn_seam_complete(seam);
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

    if (unclear != 0)
        gsn_seam_complete(seam);
    run_group(seam, GSN_SEAM_WEIGHTS, unclear, at, 1, sets, ret);
    for (size_t i = 0; i < sets; i++)
        ret_weight[i] = ret[i * seam->kernels->lanes];
}
