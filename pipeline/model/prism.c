/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where the seam of a face lies. */
#include "pipeline/model/seam.h"

#include <math.h>
#include <string.h>

/* Room for rounding in tests that only spare work, relative to the size of the face. */
#define SLACK 1e-10

static double least(double a, double b)
{
    return a < b ? a : b;
}

static double greatest(double a, double b)
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
        prism->size = greatest(prism->size, sqrt(far));
    }
}

/* The barycentric coordinates of the projection on the face, as affine functions. */
static void project(const struct gsn_prism *prism, double ret_mu[3][4])
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
static void bound(const struct gsn_dms *space, struct gsn_prism *prism)
{
    const unsigned per_cloud = prism->top + 1;
    double mu[3][4], low[3] = { 0 }, high[3] = { 0 }, under = 0, over = 0;

    project(prism, mu);
    for (unsigned i = 0; i < 3 * per_cloud; i++) {
        const double *knot =
            space->knot[prism->vertex[i / per_cloud] * (space->degree + 1) + i % per_cloud];
        double d[3];

        gsn_subtract(knot, prism->origin, d);
        under = least(under, prism->at[2][i]);
        over = greatest(over, prism->at[2][i]);
        for (unsigned m = 0; m < 3; m++) {
            const double value = gsn_dot(mu[m], d) + mu[m][3];

            low[m] = least(low[m], value);
            if (m != i / per_cloud)
                high[m] = greatest(high[m], value);
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
    bound(space, ret_prism);
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
