/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/isosurface.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/parallel.h"
#include "pipeline/render/slots.h"
#include "pipeline/render/subdivide.h"

enum { BATCH = 64 };

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
    const struct gsn_spline *spline;
    const struct gsn_fine *fine;
    double level;
    double *value;       /* of s - level at the fine mesh's points */
    uint32_t (*edge)[2]; /* of each vertex of the surface: points with value >= 0 and < 0 */
    size_t edge_room;
    size_t triangle_room;
    struct gsn_slots slots;
    struct gsn_trimesh *surface;
};

/* s - level. The half-open rule puts the points of some boundary faces outside; s has a limit there
 * from inside, taken a little towards the middle of a tetrahedron that the point belongs to. */
static double value_at(const struct marching *marching, const double u[3], uint32_t home,
                       double *ret_gradient)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(marching->spline));
    double step = 1e-9, at[3] = { u[0], u[1], u[2] }, value = 0.0;
    size_t hint = home;

    while (gsn_spline_eval(marching->spline, at, &hint, &value, ret_gradient) != GSN_OK &&
           step <= 1.0) {
        for (int a = 0; a < 3; a++) {
            double middle = 0.0;

            for (int k = 0; k < 4; k++)
                middle += 0.25 * mesh->vertex[mesh->tet[home][k]][a];
            at[a] = u[a] + step * (middle - u[a]);
        }
        step *= 1000.0;
    }
    return value - marching->level;
}

static int evaluate_batch(size_t batch, void *context, struct gsn_error *err)
{
    const struct marching *marching = context;
    const struct gsn_fine *fine = marching->fine;

    (void)err;
    for (size_t i = batch * BATCH; i < fine->point_count && i < (batch + 1) * BATCH; i++)
        marching->value[i] = value_at(marching, fine->point[i], fine->home[i], NULL);
    return GSN_OK;
}

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
        if (marching->value[point[k]] >= 0.0) {
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

/* Where s is at the level between a point inside (f0 >= 0) and one outside (f1 < 0): false position
 * that halves the weight of an end that stays (Illinois), so that both ends close in. */
static void cross_edge(const struct marching *marching, const uint32_t edge[2], double ret_at[3])
{
    const double *p = marching->fine->point[edge[0]], *q = marching->fine->point[edge[1]];
    double t0 = 0.0, t1 = 1.0, f0 = marching->value[edge[0]], f1 = marching->value[edge[1]];
    const double enough = 1e-12 * (f0 - f1);
    double t = 0.0;
    int stayed = 0;

    for (int step = 0; step < 24; step++) {
        double f;

        t = t0 + (t1 - t0) * (f0 / (f0 - f1));
        for (int a = 0; a < 3; a++)
            ret_at[a] = p[a] + t * (q[a] - p[a]);
        f = value_at(marching, ret_at, marching->fine->home[edge[0]], NULL);
        if (fabs(f) <= enough || t1 - t0 < 1e-12)
            return;
        if (f >= 0.0) {
            t0 = t;
            f0 = f;
            f1 *= stayed < 0 ? 0.5 : 1.0;
            stayed = -1;
        } else {
            t1 = t;
            f1 = f;
            f0 *= stayed > 0 ? 0.5 : 1.0;
            stayed = 1;
        }
    }
}

/* Out of the denser side: against the gradient, or along the edge where there is none. */
static void set_normal(const struct marching *marching, size_t v, const double gradient[3])
{
    const uint32_t *edge = marching->edge[v];
    double n[3], length = 0.0;

    for (int a = 0; a < 3; a++) {
        n[a] = -gradient[a];
        length += n[a] * n[a];
    }
    if (!(length > 0.0)) {
        for (int a = 0; a < 3; a++) {
            n[a] = marching->fine->point[edge[1]][a] - marching->fine->point[edge[0]][a];
            length += n[a] * n[a];
        }
    }
    for (int a = 0; a < 3; a++)
        marching->surface->normal[v][a] = (float)(n[a] / sqrt(length));
}

static int place_batch(size_t batch, void *context, struct gsn_error *err)
{
    const struct marching *marching = context;
    struct gsn_trimesh *surface = marching->surface;

    (void)err;
    for (size_t v = batch * BATCH; v < surface->vertex_count && v < (batch + 1) * BATCH; v++) {
        double gradient[3] = { 0.0, 0.0, 0.0 };

        cross_edge(marching, marching->edge[v], surface->vertex[v]);
        (void)value_at(marching, surface->vertex[v], marching->fine->home[marching->edge[v][0]],
                       gradient);
        set_normal(marching, v, gradient);
    }
    return GSN_OK;
}

static int build(struct marching *marching, unsigned threads, struct gsn_error *err)
{
    const size_t points = marching->fine->point_count;
    gsn_auto_mem(double) value = gsn_alloc_array(points, sizeof *value);
    struct gsn_trimesh *surface = marching->surface;
    int r;

    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", points);
    marching->value = value;
    r = gsn_parallel_for((points + BATCH - 1) / BATCH, threads, evaluate_batch, marching, err);
    if (r == GSN_OK)
        r = march(marching, err);
    if (r < 0)
        return r;
    surface->vertex = gsn_alloc_array(surface->vertex_count, sizeof *surface->vertex);
    surface->normal = gsn_alloc_array(surface->vertex_count, sizeof *surface->normal);
    if (!surface->vertex || !surface->normal)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", surface->vertex_count);
    return gsn_parallel_for((surface->vertex_count + BATCH - 1) / BATCH, threads, place_batch,
                            marching, err);
}

int gsn_isosurface(const struct gsn_spline *spline, double level, unsigned subdivision,
                   unsigned threads, struct gsn_trimesh **ret_surface, struct gsn_error *err)
{
    gsn_auto(gsn_fine) fine = NULL;
    gsn_auto(gsn_trimesh) surface = NULL;
    struct marching marching = { .spline = spline, .level = level };
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
    r = build(&marching, threads, err);
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
