/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/isosurface.h"

#include <math.h>
#include <string.h>

#include "pipeline/render/crossing.h"
#include "pipeline/render/slots.h"

void gsn_trimesh_free(struct gsn_trimesh *surface)
{
    if (!surface)
        return;
    gsn_free(surface->vertex);
    gsn_free(surface->normal);
    gsn_free(surface->triangle);
    gsn_free(surface);
}

unsigned gsn_isosurface_subdivision(const struct gsn_tets *mesh, double edge_um)
{
    double volume = 0.0, edge;
    unsigned level = 0;

    for (size_t t = 0; t < mesh->tet_count; t++)
        volume += gsn_tets_volume(mesh, t);
    /* A regular tetrahedron of edge a has the volume a^3 / (6 sqrt 2). */
    edge = cbrt(6.0 * sqrt(2.0) * volume / (double)mesh->tet_count);
    while (level < 2 && edge > edge_um) {
        edge *= 0.5;
        level++;
    }
    return level;
}

struct marching {
    const struct gsn_fine *fine;
    double *height;      /* s - level at the fine mesh's points */
    uint32_t (*edge)[2]; /* of each vertex of the surface: points with height >= 0 and < 0 */
    size_t edge_room;
    size_t triangle_room;
    struct gsn_slots slots;
    struct gsn_trimesh *surface;
};

static int same_edge(uint32_t number, const void *key, const void *context)
{
    const uint32_t(*edges)[2] = context, *edge = key;

    return edges[number][0] == edge[0] && edges[number][1] == edge[1];
}

/* The surface's vertex on the edge from a point inside to one outside. */
static int find_vertex(struct marching *marching, uint32_t inside, uint32_t outside,
                       uint32_t *ret_vertex, struct gsn_error *err)
{
    const uint32_t edge[2] = { inside, outside };
    const uint32_t next = (uint32_t)marching->surface->vertex_count;
    int r;

    if (next == marching->edge_room) {
        const size_t room = next ? 2 * (size_t)next : 1024;
        uint32_t(*grown)[2] = gsn_realloc_array(marching->edge, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", room);
        marching->edge = grown;
        marching->edge_room = room;
    }
    r = gsn_slots_find(&marching->slots, gsn_slots_mix(inside, outside), edge, same_edge,
                       marching->edge, next, ret_vertex, err);
    if (r == GSN_OK && *ret_vertex == next) {
        memcpy(marching->edge[next], edge, sizeof edge);
        marching->surface->vertex_count++;
    }
    return r;
}

static int add_triangle(struct marching *marching, uint32_t a, uint32_t b, uint32_t c,
                        struct gsn_error *err)
{
    struct gsn_trimesh *surface = marching->surface;

    if (surface->triangle_count == marching->triangle_room) {
        const size_t room = marching->triangle_room ? 2 * marching->triangle_room : 1024;
        uint32_t(*grown)[3] = gsn_realloc_array(surface->triangle, room, sizeof *grown);

        if (!grown)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu triangles", room);
        surface->triangle = grown;
        marching->triangle_room = room;
    }
    surface->triangle[surface->triangle_count][0] = a;
    surface->triangle[surface->triangle_count][1] = b;
    surface->triangle[surface->triangle_count][2] = c;
    surface->triangle_count++;
    return GSN_OK;
}

/* Even permutations of the corners that put the corners of a set first, by the set's bits. For
 * three inside, the one outside comes first. */
static const uint8_t order_of[16][4] = {
    [1] = { 0, 1, 2, 3 },  [2] = { 1, 0, 3, 2 },  [4] = { 2, 0, 1, 3 },  [8] = { 3, 0, 2, 1 },
    [3] = { 0, 1, 2, 3 },  [5] = { 0, 2, 3, 1 },  [9] = { 0, 3, 1, 2 },  [6] = { 1, 2, 0, 3 },
    [10] = { 1, 3, 2, 0 }, [12] = { 2, 3, 0, 1 }, [14] = { 0, 1, 2, 3 }, [13] = { 1, 0, 3, 2 },
    [11] = { 2, 0, 1, 3 }, [7] = { 3, 0, 2, 1 },
};

/* Triangles of one small, positively oriented tetrahedron; seen from the inner corners they turn so
 * that the normal by the right hand points away. */
static int march_part(struct marching *marching, const uint32_t point[4], struct gsn_error *err)
{
    unsigned set = 0, count = 0;
    uint32_t c[4], v[4];
    int r = GSN_OK;

    for (unsigned k = 0; k < 4; k++) {
        if (marching->height[point[k]] >= 0.0) {
            set |= 1U << k;
            count++;
        }
    }
    if (count == 0 || count == 4)
        return GSN_OK;
    for (int k = 0; k < 4; k++)
        c[k] = point[order_of[set][k]];
    if (count == 2) {
        static const uint8_t quad[4][2] = { { 0, 2 }, { 0, 3 }, { 1, 3 }, { 1, 2 } };

        for (int k = 0; k < 4 && r == GSN_OK; k++)
            r = find_vertex(marching, c[quad[k][0]], c[quad[k][1]], &v[k], err);
        if (r == GSN_OK)
            r = add_triangle(marching, v[0], v[1], v[2], err);
        if (r == GSN_OK)
            r = add_triangle(marching, v[0], v[2], v[3], err);
        return r;
    }
    for (int k = 0; k < 3 && r == GSN_OK; k++)
        r = count == 1 ? find_vertex(marching, c[0], c[k + 1], &v[k], err)
                       : find_vertex(marching, c[k + 1], c[0], &v[k], err);
    if (r < 0)
        return r;
    return count == 1 ? add_triangle(marching, v[0], v[1], v[2], err)
                      : add_triangle(marching, v[0], v[2], v[1], err);
}

static int march(struct marching *marching, struct gsn_error *err)
{
    const struct gsn_fine *fine = marching->fine;

    for (size_t t = 0; t < fine->tet_count; t++) {
        const uint32_t *place = fine->place + t * fine->places;

        for (unsigned p = 0; p < fine->parts; p++) {
            const uint32_t point[4] = { place[fine->part[p][0]], place[fine->part[p][1]],
                                        place[fine->part[p][2]], place[fine->part[p][3]] };
            const int r = march_part(marching, point, err);

            if (r < 0)
                return r;
        }
    }
    return GSN_OK;
}

static int build(struct marching *marching, const struct gsn_level *level, unsigned threads,
                 struct gsn_error *err)
{
    const size_t points = marching->fine->point_count;
    gsn_auto_mem(double) height = gsn_alloc_array(points, sizeof *height);
    struct gsn_trimesh *surface = marching->surface;
    int r;

    if (!height)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", points);
    marching->height = height;
    r = gsn_level_heights(level, threads, height, err);
    if (r == GSN_OK)
        r = march(marching, err);
    if (r < 0)
        return r;
    surface->vertex = gsn_alloc_array(surface->vertex_count, sizeof *surface->vertex);
    surface->normal = gsn_alloc_array(surface->vertex_count, sizeof *surface->normal);
    if (!surface->vertex || !surface->normal)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", surface->vertex_count);
    return gsn_level_crossings(level, height, (const uint32_t(*)[2])marching->edge,
                               surface->vertex_count, threads, surface->vertex, surface->normal,
                               err);
}

int gsn_isosurface(const struct gsn_spline *spline, double level, unsigned subdivision,
                   unsigned threads, struct gsn_trimesh **ret_surface, struct gsn_error *err)
{
    gsn_auto(gsn_fine) fine = NULL;
    gsn_auto(gsn_trimesh) surface = NULL;
    struct marching marching = { .edge = NULL };
    int r;

    if (!isfinite(level))
        return gsn_fail(err, GSN_E_INPUT, "the level of the surface is not a number");
    if (subdivision > GSN_ISOSURFACE_MOST_SUBDIVISION)
        return gsn_fail(err, GSN_E_INPUT, "subdivision %u is above %d", subdivision,
                        GSN_ISOSURFACE_MOST_SUBDIVISION);
    r = gsn_fine_new(gsn_dms_mesh(gsn_spline_space(spline)), subdivision, &fine, err);
    if (r < 0)
        return r;
    surface = gsn_alloc_array(1, sizeof *surface);
    if (!surface)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a surface");
    marching.fine = fine;
    marching.surface = surface;
    r = build(&marching, &(struct gsn_level){ spline, level, fine }, threads, err);
    gsn_slots_done(&marching.slots);
    gsn_free(marching.edge);
    if (r < 0)
        return r;
    *ret_surface = gsn_steal(&surface);
    return GSN_OK;
}

/* Twice the area vector of a triangle, and its first corner. */
static const double *area_vector(const struct gsn_trimesh *surface, size_t triangle, double ret[3])
{
    const double *a = surface->vertex[surface->triangle[triangle][0]];
    const double *b = surface->vertex[surface->triangle[triangle][1]];
    const double *c = surface->vertex[surface->triangle[triangle][2]];

    for (int k = 0; k < 3; k++) {
        const int m = (k + 1) % 3, n = (k + 2) % 3;

        ret[k] = (b[m] - a[m]) * (c[n] - a[n]) - (b[n] - a[n]) * (c[m] - a[m]);
    }
    return a;
}

double gsn_trimesh_area(const struct gsn_trimesh *surface)
{
    double area = 0.0;

    for (size_t t = 0; t < surface->triangle_count; t++) {
        double n[3];

        (void)area_vector(surface, t, n);
        area += 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    }
    return area;
}

double gsn_trimesh_volume(const struct gsn_trimesh *surface)
{
    const double *origin = surface->vertex_count > 0 ? surface->vertex[0] : NULL;
    double volume = 0.0;

    /* Signed tetrahedra to a vertex of the surface itself: nothing large cancels. */
    for (size_t t = 0; t < surface->triangle_count; t++) {
        double n[3];
        const double *a = area_vector(surface, t, n);

        for (int k = 0; k < 3; k++)
            volume += n[k] * (a[k] - origin[k]) / 6.0;
    }
    return volume;
}
