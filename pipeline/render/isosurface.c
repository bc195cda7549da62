/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The isosurface of a spline as a closed triangle mesh, as fine as it has to be.
 *
 * What is marched is the height: s - level, or, where that is less, the distance from the region's
 * border at a fixed rate. It is 0 on the surface of the solid {s >= level} in the region.
 *
 * Method: marching tetrahedra, with crossings on edges found on the spline itself and not by
 * interpolation, on a mesh that is bisected where its triangles are too far from the surface: a
 * chord t between two points whose normals differ by d lies d . t / 8 beside the arc. Bisection
 * keeps the mesh conforming (bisection.h), so the surface is closed across cells of all sizes
 * wherever the level does not leave the domain. References: A. Doi, A. Koide, "An efficient method
 * of triangulating equi-valued surfaces by using tetrahedral cells", IEICE Trans. E74, 1991; M.-C.
 * Rivara 1997.
 *
 * Steps: (1) cells at whose corners every piece of the surface shows (level_cells.h); (2) heights
 * of all corners together; (3) edges that pass the level, once each; (4) roots by false position
 * (the Illinois rule), all edges of a round together, and normals from gradients; (5) triangles,
 * outside to outside; (6) cells whose triangles are too far, or whose edges are too long, are
 * bisected, and again from (2).
 *
 * Failure: GSN_E_LIMIT, GSN_E_NOMEM. It ends at so many cells with what was reached, and says so in
 * error_um. Cost: one value a corner and some eight an edge that passes the level, of all rounds
 * once; and the neighbours of all cells, each round anew. */
#include "pipeline/render/isosurface.h"

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/model/batch.h"
#include "pipeline/model/bisection.h"
#include "pipeline/model/spline.h"
#include "pipeline/render/level_cells.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

struct hash_table {
    uint64_t *hash;
    uint32_t *number;  /* UINT32_MAX: free */
    size_t size, used; /* size is a power of two */
};

/* Whether item number has the key. */
typedef int hash_same(uint32_t number, const void *key, const void *context);

/* What is marched: a mesh, and of each vertex whether it is on the mesh's boundary, and a
 * tetrahedron that has it. */
struct cells {
    struct gsn_tets *mesh; /* owned */
    uint32_t *home;        /* owned */
    uint8_t *outer;        /* owned */
};

/* A spline, the level that counts as zero, the border that closes it, and the cells. borrows. */
struct level_function {
    const struct gsn_spline *spline;
    double level;
    const struct gsn_border *border; /* NULL: none */
    const struct cells *cells;
};

/* --- a hash table of what was met before --- */

static void hash_done(struct hash_table *slots)
{
    gsn_free(slots->hash);
    gsn_free(slots->number);
    slots->hash = NULL;
    slots->number = NULL;
    slots->size = 0;
}

/* A well mixed hash of two numbers. */
static uint64_t hash_mix(uint64_t a, uint64_t b)
{
    /* The finaliser of splitmix64. */
    uint64_t h = a * 0x9e3779b97f4a7c15U + b;

    h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9U;
    h = (h ^ (h >> 27)) * 0x94d049bb133111ebU;
    return h ^ (h >> 31);
}

static int grow_table(struct hash_table *slots, struct gsn_error *err)
{
    const size_t size = slots->size ? 2 * slots->size : 1024;
    uint64_t *hash = gsn_alloc_array(size, sizeof *hash);
    uint32_t *number = gsn_alloc_array(size, sizeof *number);

    if (!hash || !number) {
        gsn_free(hash);
        gsn_free(number);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %zu", size);
    }
    for (size_t i = 0; i < size; i++)
        number[i] = UINT32_MAX;
    for (size_t i = 0; i < slots->size; i++) {
        size_t at = slots->hash[i] & (size - 1);

        if (slots->number[i] == UINT32_MAX)
            continue;
        while (number[at] != UINT32_MAX)
            at = (at + 1) & (size - 1);
        number[at] = slots->number[i];
        hash[at] = slots->hash[i];
    }
    hash_done(slots);
    slots->hash = hash;
    slots->number = number;
    slots->size = size;
    return GSN_OK;
}

/* Finds the item with this key, or gives it the number next. *ret_number == next says it is new.
 * Fails with GSN_E_NOMEM. Start with all zero; done releases. */
static int hash_find(struct hash_table *slots, uint64_t hash, const void *key, hash_same *same,
                     const void *context, uint32_t next, uint32_t *ret_number,
                     struct gsn_error *err)
{
    size_t at;

    if (2 * (slots->used + 1) > slots->size) {
        const int r = grow_table(slots, err);

        if (r < 0)
            return r;
    }
    for (at = hash & (slots->size - 1); slots->number[at] != UINT32_MAX;
         at = (at + 1) & (slots->size - 1)) {
        if (slots->hash[at] == hash && same(slots->number[at], key, context)) {
            *ret_number = slots->number[at];
            return GSN_OK;
        }
    }
    slots->hash[at] = hash;
    slots->number[at] = next;
    slots->used++;
    *ret_number = next;
    return GSN_OK;
}

/* The item with this key; UINT32_MAX: there is none. */
static uint32_t hash_look(const struct hash_table *slots, uint64_t hash, const void *key,
                          hash_same *same, const void *context)
{
    for (size_t at = hash & (slots->size - 1); slots->size > 0 && slots->number[at] != UINT32_MAX;
         at = (at + 1) & (slots->size - 1))
        if (slots->hash[at] == hash && same(slots->number[at], key, context))
            return slots->number[at];
    return UINT32_MAX;
}

/* --- cells --- */

static void cells_done(struct cells *cells)
{
    gsn_tets_free(cells->mesh);
    gsn_free(cells->home);
    gsn_free(cells->outer);
}

/* takes: mesh, at any outcome. */
static int cells_init(struct cells *cells, struct gsn_tets *mesh, struct gsn_error *err)
{
    *cells = (struct cells){ .mesh = mesh,
                             .home = gsn_alloc_array(mesh->vertex_count, sizeof *cells->home),
                             .outer = gsn_alloc_array(mesh->vertex_count, sizeof *cells->outer) };
    if (!cells->home || !cells->outer)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", mesh->vertex_count);
    for (size_t t = 0; t < mesh->tet_count; t++)
        for (unsigned k = 0; k < 4; k++) {
            cells->home[mesh->tet[t][k]] = (uint32_t)t;
            for (unsigned c = 0; mesh->neighbour[t][k] < 0 && c < 4; c++)
                cells->outer[mesh->tet[t][c]] |= c != k;
        }
    return GSN_OK;
}

/* --- where edges pass the level --- */

enum {
    CHUNK = 1 << 16, /* points evaluated together */
    MOST_STEPS = 24
};

/* s - level at a point that counts as outside though it is not: taken a little towards the middle
 * of a cell that the point belongs to. */
static double height_beside(const struct level_function *level, const double u[3], uint32_t home,
                            double *ret_gradient)
{
    const struct gsn_tets *mesh = level->cells->mesh;
    double at[3], value = 0.0;
    size_t hint = 0;

    for (double step = 1e-9; step <= 1.0; step *= 1000.0) {
        for (int a = 0; a < 3; a++) {
            double middle = 0.0;

            for (int k = 0; k < 4; k++)
                middle += 0.25 * mesh->vertex[mesh->tet[home][k]][a];
            at[a] = u[a] + step * (middle - u[a]);
        }
        if (gsn_spline_eval(level->spline, at, &hint, &value, ret_gradient) == GSN_OK)
            break;
    }
    return value - level->level;
}

/* Height per um beyond the border. Where s is 0..1, as a density is, any such rate finds the roots
 * as well. */
static const double RATE = 0.01;

/* Takes the border for the height at u where it is less; whether it is. */
static int close_height(const struct level_function *level, const double u[3], double *height,
                        double *gradient)
{
    double slope[3], inward;

    if (!level->border)
        return 0;
    inward = RATE * gsn_border_at(level->border, u, gradient ? slope : NULL);
    if (!(inward < *height))
        return 0;
    *height = inward;
    for (int a = 0; gradient && a < 3; a++)
        gradient[a] = RATE * slope[a];
    return 1;
}

/* Heights, their gradients unless that is NULL, and whether they are the border's unless that is
 * NULL, at count points in these cells. */
static int heights_at(const struct level_function *level, const double (*at)[3],
                      const uint32_t *home, size_t count, unsigned threads, double *ret_height,
                      double (*ret_gradient)[3], uint8_t *ret_closing, struct gsn_error *err)
{
    const int r =
        gsn_spline_eval_many(level->spline, at, count, threads, ret_height, ret_gradient, err);

    for (size_t i = 0; r >= 0 && i < count; i++) {
        if (isnan(ret_height[i]))
            ret_height[i] =
                height_beside(level, at[i], home[i], ret_gradient ? ret_gradient[i] : NULL);
        else
            ret_height[i] -= level->level;
        const int closing =
            close_height(level, at[i], &ret_height[i], ret_gradient ? ret_gradient[i] : NULL);

        if (ret_closing)
            ret_closing[i] = (uint8_t)closing;
    }
    return r;
}

/* Heights of the cells' corners from number first on. The half-open rule puts the points of some
 * boundary faces outside; there it is the limit from inside. threads 0: all; the same bytes on any
 * number. Fails with GSN_E_NOMEM. */
static int level_heights(const struct level_function *level, size_t first, unsigned threads,
                         double *ret_height, struct gsn_error *err)
{
    const struct cells *cells = level->cells;
    const size_t points = cells->mesh->vertex_count;
    int r = GSN_OK;

    for (size_t i = first; i < points && r >= 0; i += CHUNK) {
        const size_t left = points - i;

        r = heights_at(level, (const double(*)[3])cells->mesh->vertex + i, cells->home + i,
                       left < CHUNK ? left : CHUNK, threads, ret_height + i, NULL, NULL, err);
    }
    /* Where the domain ends inside the border, by less than a voxel, it closes the region too. */
    for (size_t i = 0; level->border && i < points; i++)
        if (cells->outer[i])
            ret_height[i] = fmin(ret_height[i], -1e-9);
    return r;
}

/* Of an edge, that a vertex on the region's border stays away from its ends: more than single
 * precision tells apart. */
static const double NEAREST = 1e-3;

/* What is known of one crossing: it lies at t0..t1 of the edge, where the heights are f0 >= 0 and
 * f1 < 0 or, where an end has stayed, a part of these. */
struct crossing {
    double t0, t1, f0, f1, t, enough;
    int stayed; /* which end: -1 the far one, 1 the near one */
};

/* Room for a chunk of edges: the crossings, and the points at which s is asked next. */
struct search {
    const struct level_function *level;
    const uint32_t (*edge)[2]; /* of the chunk */
    size_t open;               /* crossings that are still searched */
    struct crossing *crossing;
    uint32_t *which, *home; /* of the open ones: the crossing; a tetrahedron that holds it */
    double (*at)[3], (*gradient)[3], *height;
};

static void search_done(struct search *search)
{
    gsn_free(search->crossing);
    gsn_free(search->which);
    gsn_free(search->home);
    gsn_free(search->at);
    gsn_free(search->gradient);
    gsn_free(search->height);
}

static int search_init(struct search *search, const struct level_function *level, size_t room,
                       struct gsn_error *err)
{
    *search = (struct search){ .level = level,
                               .crossing = gsn_alloc_array(room, sizeof *search->crossing),
                               .which = gsn_alloc_array(room, sizeof *search->which),
                               .home = gsn_alloc_array(room, sizeof *search->home),
                               .at = gsn_alloc_array(room, sizeof *search->at),
                               .gradient = gsn_alloc_array(room, sizeof *search->gradient),
                               .height = gsn_alloc_array(room, sizeof *search->height) };
    if (!search->crossing || !search->which || !search->home || !search->at || !search->gradient ||
        !search->height)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", room);
    return GSN_OK;
}

static void point_of(const struct search *search, size_t i, double ret_at[3])
{
    const struct gsn_tets *mesh = search->level->cells->mesh;
    const double *p = mesh->vertex[search->edge[i][0]], *q = mesh->vertex[search->edge[i][1]];

    for (int a = 0; a < 3; a++)
        ret_at[a] = p[a] + search->crossing[i].t * (q[a] - p[a]);
}

/* False position that halves the weight of an end that stays (Illinois), so that both ends close
 * in. Returns whether this was near enough. */
static int narrow_crossing(struct crossing *crossing, double f)
{
    if (fabs(f) <= crossing->enough || crossing->t1 - crossing->t0 < 1e-12)
        return 1;
    if (f >= 0.0) {
        crossing->t0 = crossing->t;
        crossing->f0 = f;
        crossing->f1 *= crossing->stayed < 0 ? 0.5 : 1.0;
        crossing->stayed = -1;
    } else {
        crossing->t1 = crossing->t;
        crossing->f1 = f;
        crossing->f0 *= crossing->stayed > 0 ? 0.5 : 1.0;
        crossing->stayed = 1;
    }
    return 0;
}

/* Asks for s at all open crossings and keeps those open that are not found. */
static int search_step(struct search *search, unsigned threads, struct gsn_error *err)
{
    size_t open = 0;
    int r;

    for (size_t i = 0; i < search->open; i++) {
        const uint32_t v = search->which[i];
        struct crossing *c = &search->crossing[v];

        c->t = c->t0 + (c->t1 - c->t0) * (c->f0 / (c->f0 - c->f1));
        point_of(search, v, search->at[i]);
        search->home[i] = search->level->cells->home[search->edge[v][0]];
    }
    r = heights_at(search->level, (const double(*)[3])search->at, search->home, search->open,
                   threads, search->height, NULL, NULL, err);
    for (size_t i = 0; i < search->open && r >= 0; i++) {
        if (!narrow_crossing(&search->crossing[search->which[i]], search->height[i]))
            search->which[open++] = search->which[i];
    }
    search->open = open;
    return r;
}

/* Out of the denser side: against the gradient, or along the edge where there is none. */
static void set_normal(const struct search *search, size_t i, float ret_normal[3])
{
    const struct gsn_tets *mesh = search->level->cells->mesh;
    const uint32_t *edge = search->edge[i];
    double n[3], length = 0.0;

    for (int a = 0; a < 3; a++) {
        n[a] = -search->gradient[i][a];
        length += n[a] * n[a];
    }
    if (!(length > 0.0)) {
        length = 0.0;
        for (int a = 0; a < 3; a++) {
            n[a] = mesh->vertex[edge[1]][a] - mesh->vertex[edge[0]][a];
            length += n[a] * n[a];
        }
    }
    for (int a = 0; a < 3; a++)
        ret_normal[a] = (float)(n[a] / sqrt(length));
}

/* Whether the vertex closes the region. Then it is kept off the ends of its edge: where a point of
 * the mesh lies on the border, as they do in planes of voxels, several vertices would be in one
 * place and triangles without area between them. */
static int level_closes(struct search *search, size_t i, uint8_t *closing)
{
    const struct level_function *level = search->level;
    struct crossing *crossing = &search->crossing[i];

    closing[i] |= level->border && level->cells->outer[search->edge[i][1]];
    if (!closing[i])
        return 0;
    crossing->t = fmin(1 - NEAREST, fmax(NEAREST, crossing->t));
    return 1;
}

static int cross_chunk(struct search *search, const double *height, size_t count, unsigned threads,
                       double (*ret_at)[3], float (*ret_normal)[3], uint8_t *ret_closing,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; i < count; i++) {
        const double f0 = height[search->edge[i][0]], f1 = height[search->edge[i][1]];

        search->crossing[i] =
            (struct crossing){ .t1 = 1.0, .f0 = f0, .f1 = f1, .enough = 1e-12 * (f0 - f1) };
        search->which[i] = (uint32_t)i;
    }
    search->open = count;
    for (int step = 0; step < MOST_STEPS && search->open > 0 && r >= 0; step++)
        r = search_step(search, threads, err);
    for (size_t i = 0; i < count && r >= 0; i++) {
        point_of(search, i, ret_at[i]);
        search->home[i] = search->level->cells->home[search->edge[i][0]];
    }
    if (r >= 0)
        r = heights_at(search->level, (const double(*)[3])ret_at, search->home, count, threads,
                       search->height, search->gradient, ret_closing, err);
    for (size_t i = 0; i < count && r >= 0; i++) {
        set_normal(search, i, ret_normal[i]);
        if (level_closes(search, i, ret_closing))
            point_of(search, i, ret_at[i]);
    }
    return r;
}

/* Where s is at the level on edges that go from a point whose height is >= 0 to one where it is <
 * 0, to 1e-12 of the edge or of the heights' difference; and the normals of length 1 there, against
 * the gradient, along the edge where there is none. threads and failures as above. */
static int find_crossings(const struct level_function *level, const double *height,
                          const uint32_t (*edge)[2], size_t count, unsigned threads,
                          double (*ret_at)[3], float (*ret_normal)[3], uint8_t *ret_closing,
                          struct gsn_error *err)
{
    struct search search;
    int r = search_init(&search, level, count < CHUNK ? count : CHUNK, err);

    for (size_t i = 0; i < count && r >= 0; i += CHUNK) {
        search.edge = edge + i;
        r = cross_chunk(&search, height, count - i < CHUNK ? count - i : CHUNK, threads, ret_at + i,
                        ret_normal + i, ret_closing + i, err);
    }
    search_done(&search);
    return r;
}

/* --- the surface --- */

void gsn_trimesh_free(struct gsn_trimesh *surface)
{
    if (!surface)
        return;
    gsn_free(surface->vertex);
    gsn_free(surface->normal);
    gsn_free(surface->triangle);
    gsn_free(surface->closing);
    gsn_free(surface);
}

/* A surface on some cells. The next one, on finer cells, takes over what it knows of corners and
 * edges that are still there. */
struct marching {
    const struct gsn_tets *mesh; /* borrowed */
    double *height;              /* s - level at its vertices */
    size_t points;
    uint32_t (*edge)[2]; /* of each vertex of the surface: points with height >= 0 and < 0 */
    size_t edge_room;
    uint32_t *cell; /* that each triangle lies in */
    size_t triangle_room;
    struct hash_table slots;
    struct gsn_trimesh *surface;
};

static void marching_done(struct marching *marching)
{
    gsn_free(marching->height);
    gsn_free(marching->edge);
    gsn_free(marching->cell);
    hash_done(&marching->slots);
    gsn_trimesh_free(marching->surface);
    *marching = (struct marching){ .mesh = NULL };
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
    r = hash_find(&marching->slots, hash_mix(inside, outside), edge, same_edge, marching->edge,
                  next, ret_vertex, err);
    if (r == GSN_OK && *ret_vertex == next) {
        memcpy(marching->edge[next], edge, sizeof edge);
        marching->surface->vertex_count++;
    }
    return r;
}

static int grow_triangles(struct marching *marching, size_t room, struct gsn_error *err)
{
    uint32_t(*triangle)[3] = gsn_realloc_array(marching->surface->triangle, room, sizeof *triangle);
    uint32_t *cell;

    if (!triangle)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu triangles", room);
    marching->surface->triangle = triangle;
    cell = gsn_realloc_array(marching->cell, room, sizeof *cell);
    if (!cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu triangles", room);
    marching->cell = cell;
    marching->triangle_room = room;
    return GSN_OK;
}

static int add_triangle(struct marching *marching, uint32_t cell, uint32_t a, uint32_t b,
                        uint32_t c, struct gsn_error *err)
{
    struct gsn_trimesh *surface = marching->surface;

    if (surface->triangle_count == marching->triangle_room) {
        const int r = grow_triangles(
            marching, marching->triangle_room ? 2 * marching->triangle_room : 1024, err);

        if (r < 0)
            return r;
    }
    marching->cell[surface->triangle_count] = cell;
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

/* Triangles of one cell; seen from the inner corners they turn so
 * that the normal by the right hand points away. */
static int march_cell(struct marching *marching, uint32_t cell, struct gsn_error *err)
{
    const uint32_t *const point = marching->mesh->tet[cell];
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
            r = add_triangle(marching, cell, v[0], v[1], v[2], err);
        if (r == GSN_OK)
            r = add_triangle(marching, cell, v[0], v[2], v[3], err);
        return r;
    }
    for (int k = 0; k < 3 && r == GSN_OK; k++)
        r = count == 1 ? find_vertex(marching, c[0], c[k + 1], &v[k], err)
                       : find_vertex(marching, c[k + 1], c[0], &v[k], err);
    if (r < 0)
        return r;
    return count == 1 ? add_triangle(marching, cell, v[0], v[1], v[2], err)
                      : add_triangle(marching, cell, v[0], v[2], v[1], err);
}

/* Heights at all corners; those that last knows are taken over. */
static int find_heights(struct marching *marching, struct marching *last,
                        const struct level_function *level, unsigned threads, struct gsn_error *err)
{
    marching->points = marching->mesh->vertex_count;
    marching->height = gsn_realloc_array(last->height, marching->points, sizeof *marching->height);
    if (!marching->height)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", marching->points);
    last->height = NULL;
    return level_heights(level, last->points, threads, marching->height, err);
}

/* What is known of some vertices of a surface, in an order of their own. */
struct fresh {
    uint32_t *vertex, (*edge)[2];
    double (*at)[3];
    float (*normal)[3];
    uint8_t *closing;
    size_t count;
};

static void fresh_done(struct fresh *fresh)
{
    gsn_free(fresh->vertex);
    gsn_free(fresh->edge);
    gsn_free(fresh->at);
    gsn_free(fresh->normal);
    gsn_free(fresh->closing);
}

/* Takes over the vertices on edges that last knows; the others are fresh. */
static void take_vertices(struct marching *marching, const struct marching *last,
                          struct fresh *fresh)
{
    struct gsn_trimesh *const surface = marching->surface;

    for (uint32_t v = 0; v < surface->vertex_count; v++) {
        const uint32_t *const edge = marching->edge[v];
        const uint32_t known =
            hash_look(&last->slots, hash_mix(edge[0], edge[1]), edge, same_edge, last->edge);

        if (known == UINT32_MAX) {
            memcpy(fresh->edge[fresh->count], edge, sizeof fresh->edge[0]);
            fresh->vertex[fresh->count++] = v;
            continue;
        }
        memcpy(surface->vertex[v], last->surface->vertex[known], sizeof surface->vertex[v]);
        memcpy(surface->normal[v], last->surface->normal[known], sizeof surface->normal[v]);
        surface->closing[v] = last->surface->closing[known];
    }
}

static int find_fresh(struct marching *marching, const struct marching *last,
                      const struct level_function *level, unsigned threads, struct fresh *fresh,
                      struct gsn_error *err)
{
    struct gsn_trimesh *const surface = marching->surface;
    const size_t room = surface->vertex_count;
    int r;

    *fresh = (struct fresh){ .vertex = gsn_alloc_array(room, sizeof *fresh->vertex),
                             .edge = gsn_alloc_array(room, sizeof *fresh->edge),
                             .at = gsn_alloc_array(room, sizeof *fresh->at),
                             .normal = gsn_alloc_array(room, sizeof *fresh->normal),
                             .closing = gsn_alloc_array(room, sizeof *fresh->closing) };
    if (!fresh->vertex || !fresh->edge || !fresh->at || !fresh->normal || !fresh->closing)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", room);
    take_vertices(marching, last, fresh);
    r = find_crossings(level, marching->height, (const uint32_t(*)[2])fresh->edge, fresh->count,
                       threads, fresh->at, fresh->normal, fresh->closing, err);
    for (size_t i = 0; i < fresh->count && r >= 0; i++) {
        const uint32_t v = fresh->vertex[i];

        memcpy(surface->vertex[v], fresh->at[i], sizeof fresh->at[i]);
        memcpy(surface->normal[v], fresh->normal[i], sizeof fresh->normal[i]);
        surface->closing[v] = fresh->closing[i];
    }
    return r;
}

static int find_vertices(struct marching *marching, const struct marching *last,
                         const struct level_function *level, unsigned threads,
                         struct gsn_error *err)
{
    struct gsn_trimesh *const surface = marching->surface;
    struct fresh fresh;
    int r;

    surface->vertex = gsn_alloc_array(surface->vertex_count, sizeof *surface->vertex);
    surface->normal = gsn_alloc_array(surface->vertex_count, sizeof *surface->normal);
    surface->closing = gsn_alloc_array(surface->vertex_count, sizeof *surface->closing);
    if (!surface->vertex || !surface->normal || !surface->closing)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", surface->vertex_count);
    r = find_fresh(marching, last, level, threads, &fresh, err);
    fresh_done(&fresh);
    return r;
}

/* The surface on the cells into marching, at any outcome to be done with. last: on coarser cells,
 * of which these are a refinement; or all 0. */
static int march(const struct level_function *level, unsigned threads, struct marching *last,
                 struct marching *marching, struct gsn_error *err)
{
    int r;

    *marching = (struct marching){ .mesh = level->cells->mesh,
                                   .surface = gsn_alloc_array(1, sizeof *marching->surface) };
    if (!marching->surface)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a surface");
    r = find_heights(marching, last, level, threads, err);
    for (uint32_t cell = 0; cell < marching->mesh->tet_count && r >= 0; cell++)
        r = march_cell(marching, cell, err);
    return r < 0 ? r : find_vertices(marching, last, level, threads, err);
}

/* --- as fine as asked --- */

/* Beyond this many it ends with what was reached; the rounds are more than halvings can need. */
enum { MOST_CELLS = 1 << 23, MOST_ROUNDS = 24 };

/* A round takes at most an eighth of a cell, three halvings; and at least one. */
static const double LEAST_PART = 0.125, MOST_PART = 0.5;

/* Of the mean edge of the mesh, where nothing is asked for. */
static const double USUAL_ERROR = 0.01;

/* Of the mean edge: closed pieces in cells no larger may be missed. */
static const double LEAST_CELL = 0.125;

/* Of a chord, that it lies beside an arc of its own radius. */
static const double ARC = 0.125;

/* How far the triangle may lie from the surface: a chord t whose ends have normals that differ by d
 * lies d . t / 8 beside an arc that has them. */
static double triangle_error(const struct gsn_trimesh *surface, size_t triangle)
{
    const uint32_t *const corner = surface->triangle[triangle];
    double error = 0;

    for (unsigned k = 0; k < 3; k++) {
        const uint32_t a = corner[k], b = corner[(k + 1) % 3];
        double sum = 0;

        for (unsigned i = 0; i < 3; i++)
            sum += ((double)surface->normal[b][i] - (double)surface->normal[a][i]) *
                   (surface->vertex[b][i] - surface->vertex[a][i]);
        error = fmax(error, fabs(sum) / 8);
    }
    return error;
}

static double mean_edge(const struct gsn_tets *mesh)
{
    double volume = 0;

    for (size_t t = 0; t < mesh->tet_count; t++)
        volume += gsn_tets_volume(mesh, t);
    /* A regular tetrahedron of edge a has the volume a^3 / (6 sqrt 2). */
    return cbrt(6 * sqrt(2) * volume / (double)mesh->tet_count);
}

/* Of a cell's volume, what its pieces may have: errors go with the square of a length. 1: it may
 * stay. */
static double part_of(const struct gsn_isosurface_options *options, double error, double edge)
{
    double part = 1;

    if (options->error_um > 0 && error > options->error_um)
        part = fmin(part, pow(options->error_um / error, 1.5));
    if (options->edge_um > 0 && edge > options->edge_um)
        part = fmin(part, pow(options->edge_um / edge, 3));
    return part < 1 ? fmax(LEAST_PART, fmin(MOST_PART, part)) : 1;
}

/* limit: of each cell's volume, 0 where it may stay. Returns how many may not. */
static size_t limit_cells(const struct gsn_tets *mesh, const struct gsn_trimesh *surface,
                          const uint32_t *cell, const struct gsn_isosurface_options *options,
                          double *limit)
{
    size_t split = 0;

    for (size_t t = 0; t < surface->triangle_count; t++) {
        const double part =
            part_of(options, triangle_error(surface, t), gsn_cell_longest_edge(mesh, cell[t]));
        const double most = part * gsn_tets_volume(mesh, cell[t]);

        if (part == 1)
            continue;
        split += limit[cell[t]] == 0;
        if (limit[cell[t]] == 0 || most < limit[cell[t]])
            limit[cell[t]] = most;
    }
    return split;
}

/* Marches the cells, and makes finer ones where that is not near enough, NULL where it is; marching
 * takes over what it can and has the surface then. */
static int march_round(const struct level_function *level,
                       const struct gsn_isosurface_options *options, struct marching *marching,
                       struct gsn_tets **ret_finer, struct gsn_error *err)
{
    const struct gsn_tets *const mesh = level->cells->mesh;
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);
    struct marching last = *marching;
    int r;

    if (!limit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu cells", mesh->tet_count);
    r = march(level, options->threads, &last, marching, err);
    marching_done(&last);
    if (r < 0 || limit_cells(mesh, marching->surface, marching->cell, options, limit) == 0)
        return r;
    if (mesh->tet_count > options->most_cells)
        return options->edge_um > 0
                   ? gsn_fail(err, GSN_E_LIMIT,
                              "cells with edges of %g um along the whole surface are more than "
                              "can be held: ask for longer ones",
                              options->edge_um)
                   : GSN_OK;
    return gsn_tets_bisect_behind(mesh, limit, ret_finer, err);
}

/* takes: mesh. */
static int march_rounds(const struct gsn_spline *spline, struct gsn_tets *mesh,
                        const struct gsn_isosurface_options *options, struct marching *marching,
                        struct gsn_error *err)
{
    int r = GSN_OK;

    for (int round = 0; mesh && round < MOST_ROUNDS && r >= 0; round++) {
        struct cells cells;
        const struct level_function level = { spline, options->level, options->border, &cells };

        r = cells_init(&cells, gsn_steal(&mesh), err);
        if (r >= 0)
            r = march_round(&level, options, marching, &mesh, err);
        cells_done(&cells);
    }
    gsn_tets_free(mesh);
    for (size_t t = 0; r >= 0 && t < marching->surface->triangle_count; t++)
        marching->surface->error_um =
            fmax(marching->surface->error_um, triangle_error(marching->surface, t));
    return r;
}

int gsn_isosurface(const struct gsn_spline *spline, const struct gsn_isosurface_options *options,
                   struct gsn_trimesh **ret_surface, struct gsn_error *err)
{
    const struct gsn_level solid = { spline, options->level, options->border };
    struct gsn_isosurface_options full = *options;
    struct marching marching = { .mesh = NULL };
    struct gsn_tets *mesh = NULL;
    const double mean = mean_edge(gsn_dms_mesh(gsn_spline_space(spline)));
    int r;

    if (!isfinite(options->level))
        return gsn_fail(err, GSN_E_INPUT, "the level of the surface is not a number");
    if (!(options->error_um >= 0) || !(options->edge_um >= 0))
        return gsn_fail(err, GSN_E_INPUT, "a surface within %g um, of edges of %g um",
                        options->error_um, options->edge_um);
    if (full.error_um == 0 && full.edge_um == 0)
        full.error_um = USUAL_ERROR * mean;
    if (full.most_cells == 0)
        full.most_cells = MOST_CELLS;
    r = gsn_level_cells(&solid, full.error_um > 0 ? full.error_um : ARC * full.edge_um,
                        LEAST_CELL * mean, full.most_cells, &mesh, err);
    if (r >= 0)
        r = march_rounds(spline, mesh, &full, &marching, err);
    if (r >= 0)
        *ret_surface = gsn_steal(&marching.surface);
    marching_done(&marching);
    return r;
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

double gsn_trimesh_area(const struct gsn_trimesh *surface, double *ret_closing)
{
    double area = 0.0, closing = 0.0;

    for (size_t t = 0; t < surface->triangle_count; t++) {
        const uint32_t *corner = surface->triangle[t];
        double n[3], own;

        (void)area_vector(surface, t, n);
        own = 0.5 * sqrt(gsn_dot3(n, n));
        area += own;
        if (surface->closing[corner[0]] && surface->closing[corner[1]] &&
            surface->closing[corner[2]])
            closing += own;
    }
    if (ret_closing)
        *ret_closing = closing;
    return area;
}
