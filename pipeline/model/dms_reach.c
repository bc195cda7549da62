/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <math.h>
#include <stdlib.h>

/* The growing list of tetrahedra that reach one of them, home. */
struct search {
    struct gsn_dms *space;
    size_t home, count, room;
};

/* Whether a face plane of home has all knots of the other beyond it; if not, the mask of an entry
 * in gsn_dms.reach. */
static int seen_from_home(const struct gsn_dms *space, size_t home, size_t other,
                          unsigned *ret_mask)
{
    const struct gsn_dms_shape *shape = &space->shape[home];
    double knot[GSN_SIMPLEX_MAX_KNOTS][3],
        greatest[4] = { -INFINITY, -INFINITY, -INFINITY, -INFINITY };

    gsn_dms_gather(space, other, knot);
    for (unsigned i = 0; i < 4 * (space->degree + 1); i++) {
        double lambda[4];

        gsn_frame_at(&shape->frame, knot[i], lambda);
        for (int k = 0; k < 4; k++)
            greatest[k] = fmax(greatest[k], lambda[k]);
    }
    *ret_mask = 0;
    for (int k = 0; k < 4; k++) {
        if (greatest[k] < -GSN_DMS_SLACK)
            return 0;
        if (greatest[k] <= shape->high[k])
            *ret_mask |= 1u << k;
    }
    return 1;
}

/* Whether home lies all beyond the knots of the other, seen through one of the other's faces. */
static int beyond_other(const struct gsn_dms *space, size_t home, size_t other)
{
    const struct gsn_dms_shape *shape = &space->shape[other];
    double greatest[4] = { -INFINITY, -INFINITY, -INFINITY, -INFINITY };

    for (int i = 0; i < 4; i++) {
        double lambda[4];

        gsn_frame_at(&shape->frame, space->mesh->vertex[space->mesh->tet[home][i]], lambda);
        for (int k = 0; k < 4; k++)
            greatest[k] = fmax(greatest[k], lambda[k]);
    }
    for (int k = 0; k < 4; k++) {
        if (greatest[k] < shape->low[k] - GSN_DMS_SLACK)
            return 1;
    }
    return 0;
}

static int append(struct search *search, uint32_t entry)
{
    if (search->count == search->room) {
        const size_t room = 2 * search->room;
        uint32_t *larger =
            gsn_realloc_array(search->space->reach, room, sizeof *search->space->reach);

        if (!larger)
            return GSN_E_NOMEM;
        search->space->reach = larger;
        search->room = room;
    }
    search->space->reach[search->count++] = entry;
    return 0;
}

static int consider(void *context, uint32_t other)
{
    struct search *search = context;
    unsigned mask = 0;

    if (other != search->home && (beyond_other(search->space, search->home, other) ||
                                  !seen_from_home(search->space, search->home, other, &mask)))
        return 0;
    return append(search, other << 4 | mask);
}

static int ascending(const void *left, const void *right)
{
    const uint32_t a = *(const uint32_t *)left, b = *(const uint32_t *)right;

    return (a > b) - (a < b);
}

static struct gsn_box box_of_tet(const struct gsn_tets *mesh, size_t tet)
{
    struct gsn_box box = { { INFINITY, INFINITY, INFINITY }, { -INFINITY, -INFINITY, -INFINITY } };

    for (int k = 0; k < 4; k++) {
        for (int c = 0; c < 3; c++) {
            box.low[c] = fmin(box.low[c], mesh->vertex[mesh->tet[tet][k]][c]);
            box.high[c] = fmax(box.high[c], mesh->vertex[mesh->tet[tet][k]][c]);
        }
    }
    return box;
}

int gsn_dms_find_reach(struct gsn_dms *space, struct gsn_error *err)
{
    const size_t count = space->mesh->tet_count;
    struct search search = { .space = space, .room = 64 * count };

    space->reach_start = gsn_alloc_array(count + 1, sizeof *space->reach_start);
    space->reach = gsn_alloc_array(search.room, sizeof *space->reach);
    if (!space->reach_start || !space->reach)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    for (size_t t = 0; t < count; t++) {
        const struct gsn_box box = box_of_tet(space->mesh, t);

        search.home = t;
        if (gsn_bins_meeting(space->bins, &box, consider, &search) != 0)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reach of %zu tetrahedra",
                            count);
        qsort(&space->reach[space->reach_start[t]], search.count - space->reach_start[t],
              sizeof *space->reach, ascending);
        space->reach_start[t + 1] = search.count;
    }
    return GSN_OK;
}

/* Marks the corners of one boundary face that have a knot on its inner side. */
static void mark_leaks(const struct gsn_dms *space, size_t tet, unsigned corner, uint8_t *leaks)
{
    const struct gsn_tets *mesh = space->mesh;
    const size_t per_cloud = space->degree + 1;
    const double *at[4];
    uint32_t face[3];
    unsigned n = 0;
    int inner;

    for (unsigned k = 0; k < 4; k++) {
        if (k == corner)
            continue;
        at[n] = mesh->vertex[mesh->tet[tet][k]];
        face[n++] = mesh->tet[tet][k];
    }
    at[3] = mesh->vertex[mesh->tet[tet][corner]];
    inner = gsn_orient3d(at[0], at[1], at[2], at[3]);
    for (unsigned k = 0; k < 3; k++) {
        for (size_t l = 1; l < per_cloud; l++) {
            const double *knot = space->knot[face[k] * per_cloud + l];

            if (gsn_orient3d(at[0], at[1], at[2], knot) == inner)
                leaks[face[k]] = 1;
        }
    }
}

int gsn_dms_find_whole(struct gsn_dms *space, struct gsn_error *err)
{
    const struct gsn_tets *mesh = space->mesh;
    gsn_auto_mem(uint8_t) leaks = gsn_alloc_array(mesh->vertex_count, sizeof *leaks);

    space->whole = gsn_alloc_array(mesh->tet_count, sizeof *space->whole);
    if (!leaks || !space->whole)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", mesh->tet_count);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++) {
            if (mesh->neighbour[t][k] < 0)
                mark_leaks(space, t, k, leaks);
        }
    }
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const uint32_t *v = mesh->tet[t];

        space->whole[t] = !(leaks[v[0]] || leaks[v[1]] || leaks[v[2]] || leaks[v[3]]);
    }
    return GSN_OK;
}
