/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Points and the functions of a DMS space: where a point lies, and what does not vanish there.
 *
 * Method of locating: a walk through neighbours, always across the face that the point is furthest
 * behind (O. Devillers, S. Pion, M. Teillaud, "Walking in a triangulation", 2002), from a hint,
 * then from a leaf of the search tree, then over all boxes that hold the point. Signs are exact and
 * half-open, so that it does not matter which of the three finds the answer.
 *
 * Method of the basis: in the core of its tetrahedron a point has that tetrahedron's B-patch alone.
 * Elsewhere the tree gives the tetrahedra whose knots reach the point, ascending and in batches of
 * bounded size, and each evaluates its simplex splines.
 *
 * Failure: GSN_DMS_OUTSIDE for a point in no tetrahedron; nothing is allocated.
 * Cost: a walk of a few steps from a good hint; a point in a core one polynomial, one near an edge
 * one a tetrahedron whose knots reach it. */
#include "pipeline/model/bpatch.h"
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <assert.h>
#include <math.h>

/* --- which tetrahedron holds a point --- */

/* Where a point lies. A walk from tetrahedron to neighbour, always across the face that u is
 * furthest behind, starts at the hint, then, should that be far away, at a tetrahedron of the leaf
 * of the search tree where u is. A walk may go round in circles or end at a notch of the boundary;
 * then all tetrahedra are tried whose box holds u. All signs are exact, so it does not matter who
 * finds the answer. */

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
static double find_heights(const struct gsn_tets *mesh, size_t tet, const double u[3],
                           double ret[4])
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
static unsigned find_face_behind(const struct gsn_tets *mesh, size_t tet, const double u[3],
                                 int *ret_far)
{
    double height[4];
    const double bound = find_heights(mesh, tet, u, height);
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
static int walk_to_point(const struct gsn_tets *mesh, const double u[3], size_t tet, int steps,
                         int anywhere, size_t *ret_tet)
{
    for (int step = 0; step < steps; step++) {
        int far;
        const unsigned k = find_face_behind(mesh, tet, u, &far);

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

    if (find_face_behind(search->mesh, tet, search->u, &far) != INSIDE)
        return 0;
    search->found = tet;
    return 1;
}

int gsn_dms_locate(const struct gsn_dms *space, const double u[3], size_t hint, size_t *ret_tet)
{
    const struct gsn_tets *mesh = space->mesh;
    const struct gsn_bvh_box *bounds = gsn_bvh_bounds(space->tree);
    struct search search = { .mesh = mesh, .u = u };

    for (int c = 0; c < 3; c++) {
        if (!(u[c] >= bounds->low[c] && u[c] <= bounds->high[c]))
            return GSN_DMS_OUTSIDE;
    }
    if (hint < mesh->tet_count && walk_to_point(mesh, u, hint, STEPS_FROM_HINT, 0, ret_tet))
        return GSN_OK;
    if (!gsn_bvh_at(space->tree, u, take_first, &search))
        return GSN_DMS_OUTSIDE;
    if (walk_to_point(mesh, u, search.found, STEPS_FROM_LEAF, 1, ret_tet))
        return GSN_OK;
    if (!gsn_bvh_at(space->tree, u, take_holder, &search))
        return GSN_DMS_OUTSIDE;
    *ret_tet = search.found;
    return GSN_OK;
}

/* --- which functions live at a point --- */

static int is_beyond(const struct gsn_dms_shape *shape, const double lambda[4])
{
    for (int k = 0; k < 4; k++) {
        if (lambda[k] < shape->low[k] - GSN_DMS_SLACK)
            return 1;
    }
    return 0;
}

int gsn_dms_tet_basis(const struct gsn_dms *space, size_t tet, const double u[3], double *ret_value,
                      double (*ret_gradient)[3])
{
    double own[GSN_SIMPLEX_MAX_KNOTS][3], lambda[4];
    const double(*knot)[3] = (const double(*)[3])own;
    uint16_t pick[GSN_SIMPLEX_MAX_LARGE];
    struct gsn_dms_shape shape;
    unsigned clear;

    gsn_dms_shape_of(space, tet, &shape);
    gsn_barycentric_at(&shape.frame, u, lambda);
    if (is_beyond(&shape, lambda))
        return 0;
    gsn_dms_gather(space, tet, own);
    clear = gsn_dms_clear(&shape, lambda);
    if (clear == GSN_DMS_ALL) {
        gsn_bpatch_basis(space->degree, knot, u, ret_value, ret_gradient);
        return 1;
    }
    (void)gsn_simplex_pick(space->sets, knot, pick);
    gsn_simplex_basis(space->sets, knot, pick, u, clear, ret_value, ret_gradient);
    return 1;
}

/* A point in its tetrahedron, and those whose functions may live there too. */
struct place {
    const struct gsn_dms *space;
    const double *u;
    size_t home;
    struct gsn_dms_shape shape; /* of home */
    unsigned clear;             /* of u in home */
    struct gsn_sorted_batch ascent;
};

/* Whether some plane lambda_k = high[k] of home has u on one side and all knots of another
 * tetrahedron on the other. */
static int is_apart(const struct place *place, size_t tet)
{
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    unsigned apart = place->clear;

    gsn_dms_gather(place->space, tet, knot);
    for (unsigned i = 0; apart && i < 4 * (place->space->degree + 1); i++) {
        double lambda[4];

        gsn_barycentric_at(&place->shape.frame, knot[i], lambda);
        for (unsigned k = 0; k < 4; k++) {
            if (lambda[k] > place->shape.high[k])
                apart &= ~(1u << k);
        }
    }
    return apart != 0;
}

static int consider_tet(void *context, uint32_t tet)
{
    struct place *place = context;
    struct gsn_dms_shape shape;
    double lambda[4];

    if (tet != place->home) {
        gsn_dms_shape_of(place->space, tet, &shape);
        gsn_barycentric_at(&shape.frame, place->u, lambda);
        if (is_beyond(&shape, lambda) || is_apart(place, tet))
            return 0;
    }
    return gsn_sorted_batch_add(&place->ascent, tet);
}

void gsn_dms_each(const struct gsn_dms *space, size_t home, const double u[3], int with_gradient,
                  void (*visit)(void *context, size_t tet, const double *value,
                                const double (*gradient)[3]),
                  void *context)
{
    double lambda[4], value[GSN_DMS_MAX_FUNCTIONS], gradient[GSN_DMS_MAX_FUNCTIONS][3];
    double(*slopes)[3] = with_gradient ? gradient : NULL;
    struct place place = { .space = space, .u = u, .home = home };

    gsn_dms_shape_of(space, home, &place.shape);
    gsn_barycentric_at(&place.shape.frame, u, lambda);
    place.clear = gsn_dms_clear(&place.shape, lambda);
    gsn_sorted_batch_begin(&place.ascent);
    do {
        /* In the core of home nothing else lives. */
        if (place.clear == GSN_DMS_ALL)
            (void)gsn_sorted_batch_add(&place.ascent, (uint32_t)home);
        else
            (void)gsn_bvh_at(space->tree, u, consider_tet, &place);
        for (size_t i = 0; i < place.ascent.count; i++) {
            const uint32_t tet = place.ascent.item[i];

            if (gsn_dms_tet_basis(space, tet, u, value, slopes))
                visit(context, tet, value, (const double(*)[3])slopes);
        }
    } while (gsn_sorted_batch_next(&place.ascent));
}

/* The caller's array of terms while it fills. */
struct terms {
    const struct gsn_dms *space;
    struct gsn_dms_term *term;
    size_t count, room;
};

static void add_terms(void *context, size_t tet, const double *value, const double (*gradient)[3])
{
    struct terms *terms = context;
    const uint32_t *id = gsn_dms_control_ids(terms->space, tet);

    for (size_t f = 0; f < terms->space->sets->functions; f++) {
        const double *g = gradient ? gradient[f] : NULL;
        struct gsn_dms_term *term;

        if (value[f] == 0 && !(g && (g[0] != 0 || g[1] != 0 || g[2] != 0)))
            continue;
        if (terms->count++ >= terms->room)
            continue;
        term = &terms->term[terms->count - 1];
        term->tet = (uint32_t)tet;
        term->function = (uint32_t)f;
        term->control = id[f];
        term->value = value[f];
        for (int c = 0; g && c < 3; c++)
            term->gradient[c] = g[c];
    }
}

int gsn_dms_basis(const struct gsn_dms *space, const double u[3], int with_gradient, size_t *hint,
                  struct gsn_dms_term *ret_terms, size_t room, size_t *ret_count)
{
    struct terms terms = { .space = space, .term = ret_terms, .room = room };
    size_t tet;

    assert(hint && ret_count && (ret_terms || room == 0));

    *ret_count = 0;
    if (gsn_dms_locate(space, u, *hint, &tet) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    *hint = tet;
    gsn_dms_each(space, tet, u, with_gradient, add_terms, &terms);
    *ret_count = terms.count;
    return GSN_OK;
}
