/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whose functions reach where. */
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <string.h>

/* A tetrahedron, home, and those that reach it. */
struct search {
    const struct gsn_dms *space;
    size_t home;
    double corner[4][3];
    struct gsn_box box;
    struct gsn_frame frame;
    struct gsn_ascent *ascent;
};

/* Which corner of a tetrahedron vertex v is; 4 when it is none. The coordinates of shared vertices
 * are exactly 0 and 1, however they round. */
static unsigned corner_of(const struct gsn_tets *mesh, size_t tet, uint32_t v)
{
    const uint32_t *corner = mesh->tet[tet];
    unsigned k = 0;

    while (k < 4 && corner[k] != v)
        k++;
    return k;
}

/* Whether a face plane of home has all knots of the other beyond it, or in it at shared vertices.
 */
static int is_beyond_home(const struct search *search, size_t other, const double (*knot)[3])
{
    const struct gsn_tets *mesh = search->space->mesh;
    const unsigned per_cloud = search->space->degree + 1;
    unsigned beyond = GSN_DMS_ALL;

    for (unsigned c = 0; c < 4; c++) {
        const unsigned shared = corner_of(mesh, search->home, mesh->tet[other][c]);

        if (shared < 4)
            beyond &= ~(1u << shared);
        for (unsigned i = c * per_cloud + (shared < 4); beyond && i < (c + 1) * per_cloud; i++) {
            double lambda[4];

            gsn_frame_at(&search->frame, knot[i], lambda);
            for (unsigned k = 0; k < 4; k++) {
                if (!(lambda[k] < -GSN_DMS_SLACK))
                    beyond &= ~(1u << k);
            }
        }
    }
    return beyond != 0;
}

/* Whether home lies all beyond the knots of the other, seen through one of the other's faces,
 * shared vertices apart where no knot is beyond that face. */
static int is_beyond_other(const struct search *search, size_t other)
{
    const struct gsn_tets *mesh = search->space->mesh;
    struct gsn_dms_shape shape;
    unsigned beyond = GSN_DMS_ALL;

    gsn_dms_shape_of(search->space, other, &shape);
    for (int i = 0; beyond && i < 4; i++) {
        const unsigned shared = corner_of(mesh, other, mesh->tet[search->home][i]);
        double lambda[4];

        gsn_frame_at(&shape.frame, search->corner[i], lambda);
        for (unsigned k = 0; k < 4; k++) {
            const int touches = shared < 4 && shared != k && shape.low[k] == 0;

            if (!touches && !(lambda[k] < shape.low[k] - GSN_DMS_SLACK))
                beyond &= ~(1u << k);
        }
    }
    return beyond != 0;
}

static int consider(void *context, uint32_t other)
{
    struct search *search = context;
    double own[GSN_SIMPLEX_MAX_KNOTS][3];
    const double(*knot)[3] = (const double(*)[3])own;
    struct gsn_box box;

    if (other == search->home)
        return gsn_ascent_add(search->ascent, other);
    gsn_dms_gather(search->space, other, own);
    box = gsn_box_around(knot, 4 * (search->space->degree + 1));
    if (!gsn_box_meets(&box, &search->box) || is_beyond_home(search, other, knot) ||
        is_beyond_other(search, other))
        return 0;
    return gsn_ascent_add(search->ascent, other);
}

void gsn_dms_reaching(const struct gsn_dms *space, size_t home, struct gsn_ascent *ascent)
{
    struct search search = { .space = space, .home = home, .ascent = ascent };

    for (int k = 0; k < 4; k++)
        memcpy(search.corner[k], space->mesh->vertex[space->mesh->tet[home][k]],
               sizeof search.corner[k]);
    search.box = gsn_box_around((const double(*)[3])search.corner, 4);
    gsn_frame_init(&search.frame, search.corner[0], search.corner[1], search.corner[2],
                   search.corner[3]);
    (void)gsn_boxtree_meeting(space->tree, &search.box, consider, &search);
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
