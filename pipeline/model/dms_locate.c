/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where a point lies. A walk from tetrahedron to neighbour, always across the face that u is
 * furthest behind, starts at the hint, then, should that be far away, at a tetrahedron of the leaf
 * of the search tree where u is. A walk may go round in circles or end at a notch of the boundary;
 * then all tetrahedra are tried whose box holds u. All signs are exact, so it does not matter who
 * finds the answer. */
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <math.h>

enum {
    STEPS_FROM_HINT = 12,
    STEPS_FROM_LEAF = 64,
    FAR = 3, /* heights behind a face: the tree is quicker than walking there */
    INSIDE = 4,
};

/* A determinant of three vectors has six products, each at most the product of the largest
 * components. */
#define FILTER (6 * GSN_ORIENT_BOUND)

/* The face opposite corner k, in the order that has corner k on its positive side. */
static const uint8_t face_of[4][3] = { { 1, 3, 2 }, { 0, 2, 3 }, { 0, 3, 1 }, { 0, 1, 2 } };

static int is_behind(const struct gsn_tets *mesh, size_t tet, unsigned k, const double u[3])
{
    const uint32_t *v = mesh->tet[tet];
    const uint8_t *f = face_of[k];

    return gsn_orient_side(mesh->vertex[v[f[0]]], mesh->vertex[v[f[1]]], mesh->vertex[v[f[2]]], u) <
           0;
}

/* The determinants of u and three corners, lambda_k times that of the tetrahedron; returns the
 * rounding bound of them all. */
static double heights(const struct gsn_tets *mesh, size_t tet, const double u[3], double ret[4])
{
    double to[4][3], normal[3], bound = FILTER;

    for (int k = 0; k < 4; k++)
        gsn_subtract(mesh->vertex[mesh->tet[tet][k]], u, to[k]);
    for (int c = 0; c < 3; c++) {
        const double a = fabs(to[0][c]), b = fabs(to[1][c]), d = fabs(to[2][c]), e = fabs(to[3][c]);
        const double ab = a > b ? a : b, de = d > e ? d : e;

        bound *= ab > de ? ab : de;
    }
    gsn_cross(to[2], to[3], normal);
    ret[0] = gsn_dot(normal, to[1]);
    ret[1] = -gsn_dot(normal, to[0]);
    gsn_cross(to[0], to[1], normal);
    ret[2] = gsn_dot(normal, to[3]);
    ret[3] = -gsn_dot(normal, to[2]);
    return bound;
}

/* The corner opposite the face that u lies behind, the clearest case; INSIDE when there is none.
 * ret_far: u is far away from the tetrahedron. */
static unsigned behind(const struct gsn_tets *mesh, size_t tet, const double u[3], int *ret_far)
{
    double height[4];
    const double bound = heights(mesh, tet, u, height);
    unsigned least = 0;

    for (unsigned k = 1; k < 4; k++) {
        if (height[k] < height[least])
            least = k;
    }
    *ret_far = height[least] < -FAR * (height[0] + height[1] + height[2] + height[3]);
    if (height[least] < -bound)
        return least;
    for (unsigned k = 0; k < 4; k++) {
        if (!(height[k] > bound) && is_behind(mesh, tet, k, u))
            return k;
    }
    return INSIDE;
}

/* Whether the walk ends in the tetrahedron that holds u. */
static int walk(const struct gsn_tets *mesh, const double u[3], size_t tet, int steps, int anywhere,
                size_t *ret_tet)
{
    for (int step = 0; step < steps; step++) {
        int far;
        const unsigned k = behind(mesh, tet, u, &far);

        if (k == INSIDE) {
            *ret_tet = tet;
            return 1;
        }
        if ((far && !anywhere) || mesh->neighbour[tet][k] < 0)
            return 0;
        tet = (size_t)mesh->neighbour[tet][k];
    }
    return 0;
}

/* What is looked for in the search tree, and found. */
struct search {
    const struct gsn_tets *mesh;
    const double *u;
    size_t found;
};

static int take_first(void *context, uint32_t tet)
{
    ((struct search *)context)->found = tet;
    return 1;
}

static int take_holder(void *context, uint32_t tet)
{
    struct search *search = context;
    int far;

    if (behind(search->mesh, tet, search->u, &far) != INSIDE)
        return 0;
    search->found = tet;
    return 1;
}

int gsn_dms_locate(const struct gsn_dms *space, const double u[3], size_t hint, size_t *ret_tet)
{
    const struct gsn_tets *mesh = space->mesh;
    const struct gsn_box *bounds = gsn_boxtree_bounds(space->tree);
    struct search search = { .mesh = mesh, .u = u };

    for (int c = 0; c < 3; c++) {
        if (!(u[c] >= bounds->low[c] && u[c] <= bounds->high[c]))
            return GSN_DMS_OUTSIDE;
    }
    if (hint < mesh->tet_count && walk(mesh, u, hint, STEPS_FROM_HINT, 0, ret_tet))
        return GSN_OK;
    if (!gsn_boxtree_at(space->tree, u, take_first, &search))
        return GSN_DMS_OUTSIDE;
    if (walk(mesh, u, search.found, STEPS_FROM_LEAF, 1, ret_tet))
        return GSN_OK;
    if (!gsn_boxtree_at(space->tree, u, take_holder, &search))
        return GSN_DMS_OUTSIDE;
    *ret_tet = search.found;
    return GSN_OK;
}
