/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where a point lies, and which functions live there. */
#include "pipeline/model/bpatch.h"
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <assert.h>

enum { MOST_STEPS = 32 }; /* of a walk before the bins are quicker */

/* The face opposite corner k, in the order that has corner k on its positive side. */
static const uint8_t face_of[4][3] = { { 1, 3, 2 }, { 0, 2, 3 }, { 0, 3, 1 }, { 0, 1, 2 } };

/* The first corner whose opposite face u lies behind; 4 when u is inside. */
static unsigned behind(const struct gsn_tets *mesh, size_t tet, const double u[3])
{
    const uint32_t *v = mesh->tet[tet];

    for (unsigned k = 0; k < 4; k++) {
        const uint8_t *f = face_of[k];

        if (gsn_orient_side(mesh->vertex[v[f[0]]], mesh->vertex[v[f[1]]], mesh->vertex[v[f[2]]],
                            u) < 0)
            return k;
    }
    return 4;
}

int gsn_dms_locate(const struct gsn_dms *space, const double u[3], size_t hint, size_t *ret_tet)
{
    const struct gsn_tets *mesh = space->mesh;
    size_t tet = hint < mesh->tet_count ? hint : 0;
    const uint32_t *list;
    const size_t count = gsn_bins_at(space->bins, u, &list);

    if (count == 0)
        return GSN_DMS_OUTSIDE;
    for (int step = 0; step < MOST_STEPS; step++) {
        const unsigned k = behind(mesh, tet, u);

        if (k == 4) {
            *ret_tet = tet;
            return GSN_OK;
        }
        if (mesh->neighbour[tet][k] < 0)
            break;
        tet = (size_t)mesh->neighbour[tet][k];
    }
    /* Far away, a cycle, a notch in the boundary, or outside: try all that can hold u. */
    for (size_t i = 0; i < count; i++) {
        if (behind(mesh, list[i], u) == 4) {
            *ret_tet = list[i];
            return GSN_OK;
        }
    }
    return GSN_DMS_OUTSIDE;
}

int gsn_dms_tet_basis(const struct gsn_dms *space, size_t tet, const double u[3], double *ret_value,
                      double (*ret_gradient)[3])
{
    const struct gsn_dms_shape *shape = &space->shape[tet];
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], lambda[4];
    unsigned clear;

    gsn_frame_at(&shape->frame, u, lambda);
    for (int k = 0; k < 4; k++) {
        if (lambda[k] < shape->low[k] - GSN_DMS_SLACK)
            return 0;
    }
    gsn_dms_gather(space, tet, knot);
    clear = gsn_dms_clear(shape, lambda);
    if (clear == GSN_DMS_ALL)
        gsn_bpatch_basis(space->degree, (const double(*)[3])knot, u, ret_value, ret_gradient);
    else
        gsn_simplex_basis(space->sets, (const double(*)[3])knot, gsn_dms_pick_of(space, tet), u,
                          clear, ret_value, ret_gradient);
    return 1;
}

void gsn_dms_each(const struct gsn_dms *space, size_t home, const double u[3], int with_gradient,
                  void (*visit)(void *context, size_t tet, const double *value,
                                const double (*gradient)[3]),
                  void *context)
{
    double lambda[4], value[GSN_DMS_MAX_FUNCTIONS], gradient[GSN_DMS_MAX_FUNCTIONS][3];
    double(*slopes)[3] = with_gradient ? gradient : NULL;
    unsigned clear;

    gsn_frame_at(&space->shape[home].frame, u, lambda);
    clear = gsn_dms_clear(&space->shape[home], lambda);
    for (size_t i = space->reach_start[home]; i < space->reach_start[home + 1]; i++) {
        const size_t tet = space->reach[i] >> 4;

        /* In the core of home nothing else lives. */
        if (tet != home && (clear == GSN_DMS_ALL || space->reach[i] & clear))
            continue;
        if (gsn_dms_tet_basis(space, tet, u, value, slopes))
            visit(context, tet, value, (const double(*)[3])slopes);
    }
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
