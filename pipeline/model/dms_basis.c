/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which functions live at a point. */
#include "pipeline/model/bpatch.h"
#include "pipeline/model/dms_internal.h"

#include <assert.h>

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
    gsn_frame_at(&shape.frame, u, lambda);
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
    struct gsn_ascent ascent;
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

        gsn_frame_at(&place->shape.frame, knot[i], lambda);
        for (unsigned k = 0; k < 4; k++) {
            if (lambda[k] > place->shape.high[k])
                apart &= ~(1u << k);
        }
    }
    return apart != 0;
}

static int consider(void *context, uint32_t tet)
{
    struct place *place = context;
    struct gsn_dms_shape shape;
    double lambda[4];

    if (tet != place->home) {
        gsn_dms_shape_of(place->space, tet, &shape);
        gsn_frame_at(&shape.frame, place->u, lambda);
        if (is_beyond(&shape, lambda) || is_apart(place, tet))
            return 0;
    }
    return gsn_ascent_add(&place->ascent, tet);
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
    gsn_frame_at(&place.shape.frame, u, lambda);
    place.clear = gsn_dms_clear(&place.shape, lambda);
    gsn_ascent_begin(&place.ascent);
    do {
        /* In the core of home nothing else lives. */
        if (place.clear == GSN_DMS_ALL)
            (void)gsn_ascent_add(&place.ascent, (uint32_t)home);
        else
            (void)gsn_boxtree_at(space->tree, u, consider, &place);
        for (size_t i = 0; i < place.ascent.count; i++) {
            const uint32_t tet = place.ascent.item[i];

            if (gsn_dms_tet_basis(space, tet, u, value, slopes))
                visit(context, tet, value, (const double(*)[3])slopes);
        }
    } while (gsn_ascent_next(&place.ascent));
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
