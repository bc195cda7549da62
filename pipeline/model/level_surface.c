/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A level of a field on a lattice as few, even triangles.
 *
 * Method: marching tetrahedra, then the surface is divided among seeds and neighbouring seeds are
 * joined (approximated centroidal Voronoi diagrams). Reference: S. Valette, J.-M. Chassery,
 * "Approximated centroidal Voronoi diagrams for uniform polygonal mesh coarsening", 2004,
 * 10.1111/j.1467-8659.2004.00769.x; R. L. Cook, "Stochastic sampling in computer graphics", 1986,
 * 10.1145/7529.8927.
 *
 * Steps: (1) every cube of eight voxels is six tetrahedra, each cut by the level into triangles: a
 * surface without cracks, whatever the values; (2) seeds are vertices drawn by chance, not nearer
 * to each other than a share of the edge wanted; (3) each vertex belongs to the seed that is
 * nearest along the surface, and seeds move to the middle of what is theirs, some times over; (4)
 * where what is three seeds' meets in a triangle they make a facet. Two sides of a thin wall are
 * never joined, for the surface does not lead from one to the other. (5) Facets of different
 * surfaces may cross where those are near and bent; of two such the later one is dropped, for a
 * surface with a hole is still one to follow.
 *
 * Failure: memory. Cost: the triangles of the fine surface, about ten a voxel that it passes. */
#include "pipeline/model/level_surface.h"

#include "pipeline/model/bvh.h"
#include "pipeline/model/orient.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* How often seeds move. */
enum { ROUNDS = 6 };

/* Mean distance of neighbours over least distance, in a maximal Poisson disc sample. */
static const double SPREAD = 1.35;

static int fail_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the triangles of a level");
}

void gsn_triangles_done(struct gsn_triangles *triangles)
{
    gsn_free(triangles->at);
    gsn_free(triangles->normal);
    gsn_free(triangles->facet);
    *triangles = (struct gsn_triangles){ .points = 0 };
}

void gsn_field_gradient(const struct gsn_grid *field, const size_t at[3], double ret[3])
{
    const size_t n[3] = { field->at.nx, field->at.ny, field->at.nz };
    const size_t stride[3] = { 1, n[0], n[0] * n[1] };
    const double step[3] = { field->at.step_um.x, field->at.step_um.y, field->at.step_um.z };
    const float *here = field->value + gsn_lattice_index(&field->at, at[0], at[1], at[2]);

    for (size_t k = 0; k < 3; k++) {
        const bool before = at[k] > 0 && isfinite(here[-(ptrdiff_t)stride[k]]);
        const bool behind = at[k] + 1 < n[k] && isfinite(here[stride[k]]);
        const float low = before ? here[-(ptrdiff_t)stride[k]] : here[0];
        const float high = behind ? here[stride[k]] : here[0];

        ret[k] = before || behind
                     ? ((double)high - (double)low) / (step[k] * ((double)before + (double)behind))
                     : 0;
    }
}

/* --- points by place --- */

/* The finaliser of SplitMix64. */
static uint64_t mix_bits(uint64_t x)
{
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return x ^ x >> 31;
}

struct ticket {
    uint64_t number;
    uint32_t index;
};

static int compare_tickets(const void *a, const void *b)
{
    const struct ticket *left = a, *right = b;

    if (left->number != right->number)
        return left->number < right->number ? -1 : 1;
    return (left->index > right->index) - (left->index < right->index);
}

/* The points taken so far, findable by place: cells of `edge`, chained. */
struct taken {
    size_t count, room;
    double (*at)[3];
    double (*normal)[3];
    uint32_t *next;  /* in the same cell; UINT32_MAX: the last */
    uint32_t *first; /* by cell */
    size_t n[3];
    double low[3], edge;
};

static void taken_done(struct taken *taken)
{
    gsn_free(taken->at);
    gsn_free(taken->normal);
    gsn_free(taken->next);
    gsn_free(taken->first);
}

static int taken_init(struct taken *taken, const struct gsn_lattice *at, double edge,
                      struct gsn_error *err)
{
    const double low[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t n[3] = { at->nx, at->ny, at->nz };
    size_t cells = 1;

    *taken = (struct taken){ .edge = edge };
    for (size_t k = 0; k < 3; k++) {
        taken->low[k] = low[k];
        taken->n[k] = (size_t)((double)n[k] * step[k] / edge) + 1;
        cells *= taken->n[k];
    }
    taken->first = gsn_alloc_array(cells, sizeof *taken->first);
    if (!taken->first)
        return fail_memory(err);
    memset(taken->first, 0xff, cells * sizeof *taken->first);
    return GSN_OK;
}

static size_t find_cell(const struct taken *taken, const double u[3], size_t axis)
{
    const double cell = floor((u[axis] - taken->low[axis]) / taken->edge);

    return cell <= 0 ? 0 : cell >= (double)taken->n[axis] ? taken->n[axis] - 1 : (size_t)cell;
}

/* Points on two sides of a thin wall may come nearer to each other than those beside each other. */
static const double FACING = 0.3, FACING_SHARE = 0.5;

/* Whether a point nearer than `apart` (at most the cells' edge) was taken. */
static bool is_near_taken(const struct taken *taken, const double u[3], const double normal[3],
                          double apart)
{
    size_t cell[3];

    for (size_t k = 0; k < 3; k++)
        cell[k] = find_cell(taken, u, k);
    for (size_t z = cell[2] > 0 ? cell[2] - 1 : 0; z <= cell[2] + 1 && z < taken->n[2]; z++)
        for (size_t y = cell[1] > 0 ? cell[1] - 1 : 0; y <= cell[1] + 1 && y < taken->n[1]; y++)
            for (size_t x = cell[0] > 0 ? cell[0] - 1 : 0; x <= cell[0] + 1 && x < taken->n[0]; x++)
                for (uint32_t i = taken->first[(z * taken->n[1] + y) * taken->n[0] + x];
                     i != UINT32_MAX; i = taken->next[i]) {
                    const double d[3] = { taken->at[i][0] - u[0], taken->at[i][1] - u[1],
                                          taken->at[i][2] - u[2] };
                    const double least =
                        gsn_dot3(taken->normal[i], normal) > FACING ? apart : apart * FACING_SHARE;

                    if (gsn_dot3(d, d) < least * least)
                        return true;
                }
    return false;
}

static int take_point(struct taken *taken, const double u[3], const double normal[3],
                      struct gsn_error *err)
{
    const size_t cell =
        (find_cell(taken, u, 2) * taken->n[1] + find_cell(taken, u, 1)) * taken->n[0] +
        find_cell(taken, u, 0);

    if (taken->count == taken->room) {
        const size_t room = 2 * taken->room + 1024;
        double(*at)[3] = gsn_realloc_array(taken->at, room, sizeof *at);
        double(*normals)[3] = at ? gsn_realloc_array(taken->normal, room, sizeof *normals) : NULL;
        uint32_t *next = normals ? gsn_realloc_array(taken->next, room, sizeof *next) : NULL;

        taken->at = at ? at : taken->at;
        taken->normal = normals ? normals : taken->normal;
        if (!next)
            return fail_memory(err);
        taken->next = next;
        taken->room = room;
    }
    memcpy(taken->at[taken->count], u, 3 * sizeof *u);
    memcpy(taken->normal[taken->count], normal, 3 * sizeof *normal);
    taken->next[taken->count] = taken->first[cell];
    taken->first[cell] = (uint32_t)taken->count++;
    return GSN_OK;
}

/* --- a level as a fine surface --- */

/* Marching tetrahedra: every cube of the lattice is six, around its diagonal (H. W. Kuhn, 1960). A
 * corner of a triangle lies on an edge that goes from a voxel to one of seven others: its key is
 * voxel * 8 + which, the bits of x, y and z. */
static const uint8_t KUHN[6][4] = { { 0, 1, 3, 7 }, { 0, 1, 5, 7 }, { 0, 2, 3, 7 },
                                    { 0, 2, 6, 7 }, { 0, 4, 5, 7 }, { 0, 4, 6, 7 } };

struct fine {
    size_t vertex_count, triangle_count;
    double (*at)[3];
    double (*normal)[3];
    uint32_t (*triangle)[3];
    size_t *first; /* vertex v has the neighbours next[first[v]] .. next[first[v + 1]) */
    uint32_t *next;
};

static void fine_done(struct fine *fine)
{
    gsn_free(fine->at);
    gsn_free(fine->normal);
    gsn_free(fine->triangle);
    gsn_free(fine->first);
    gsn_free(fine->next);
}

struct keys {
    size_t count, room;
    uint64_t *key; /* three a triangle */
};

static int add_triangle(struct keys *keys, uint64_t a, uint64_t b, uint64_t c,
                        struct gsn_error *err)
{
    if (keys->count + 3 > keys->room) {
        const size_t room = 2 * keys->room + 3 * 4096;
        uint64_t *larger = gsn_realloc_array(keys->key, room, sizeof *larger);

        if (!larger)
            return fail_memory(err);
        keys->key = larger;
        keys->room = room;
    }
    keys->key[keys->count++] = a;
    keys->key[keys->count++] = b;
    keys->key[keys->count++] = c;
    return GSN_OK;
}

static uint64_t edge_key(const size_t voxel[8], unsigned a, unsigned b)
{
    return (uint64_t)voxel[a < b ? a : b] * 8 + (a < b ? b - a : a - b);
}

/* What a level cuts out of one tetrahedron: nothing, a triangle or two. corner: places in the cube;
 * Kuhn's are ascending, bit by bit, so that the difference of two is the direction of their edge.
 */
static int cut_tet(const size_t voxel[8], const double off[8], const uint8_t corner[4],
                   struct keys *keys, struct gsn_error *err)
{
    unsigned in[4], out[4], ins = 0, outs = 0;
    int r;

    for (size_t k = 0; k < 4; k++) {
        if (!isfinite(off[corner[k]]))
            return GSN_OK;
        if (off[corner[k]] >= 0)
            in[ins++] = corner[k];
        else
            out[outs++] = corner[k];
    }
    if (ins == 1)
        return add_triangle(keys, edge_key(voxel, in[0], out[0]), edge_key(voxel, in[0], out[1]),
                            edge_key(voxel, in[0], out[2]), err);
    if (outs == 1)
        return add_triangle(keys, edge_key(voxel, out[0], in[0]), edge_key(voxel, out[0], in[1]),
                            edge_key(voxel, out[0], in[2]), err);
    if (ins != 2)
        return GSN_OK;
    r = add_triangle(keys, edge_key(voxel, in[0], out[0]), edge_key(voxel, in[0], out[1]),
                     edge_key(voxel, in[1], out[1]), err);
    return r < 0
               ? r
               : add_triangle(keys, edge_key(voxel, in[0], out[0]), edge_key(voxel, in[1], out[1]),
                              edge_key(voxel, in[1], out[0]), err);
}

static int cut_cubes(const struct gsn_grid *field, double level, const struct gsn_mask *near,
                     struct keys *keys, struct gsn_error *err)
{
    const struct gsn_lattice *at = &field->at;
    int r = GSN_OK;

    for (size_t z = 0; z + 1 < at->nz; z++)
        for (size_t y = 0; y + 1 < at->ny; y++)
            for (size_t x = 0; r >= 0 && x + 1 < at->nx; x++) {
                size_t voxel[8], above = 0, below = 0, seen = 0;
                double off[8];

                for (size_t k = 0; k < 8; k++) {
                    voxel[k] = gsn_lattice_index(at, x + (k & 1), y + (k >> 1 & 1), z + (k >> 2));
                    off[k] = (double)field->value[voxel[k]] - level;
                    above += off[k] >= 0;
                    below += off[k] < 0;
                    seen += near->inside[voxel[k]];
                }
                if (above == 0 || below == 0 || seen == 0)
                    continue;
                for (size_t t = 0; r >= 0 && t < 6; t++)
                    r = cut_tet(voxel, off, KUHN[t], keys, err);
            }
    return r;
}

static int compare_keys(const void *a, const void *b)
{
    const uint64_t left = *(const uint64_t *)a, right = *(const uint64_t *)b;

    return (left > right) - (left < right);
}

static void place_vertex(const struct gsn_grid *field, double level, uint64_t key, double at[3],
                         double normal[3])
{
    const size_t n[2] = { field->at.nx, field->at.ny }, voxel = (size_t)(key / 8);
    const size_t from[3] = { voxel % n[0], voxel / n[0] % n[1], voxel / n[0] / n[1] };
    const size_t to[3] = { from[0] + (key & 1), from[1] + (key >> 1 & 1),
                           from[2] + (key >> 2 & 1) };
    const struct gsn_vec3 u = gsn_lattice_centre(&field->at, from[0], from[1], from[2]),
                          w = gsn_lattice_centre(&field->at, to[0], to[1], to[2]);
    const double a = (double)field->value[voxel] - level;
    const double b =
        (double)field->value[gsn_lattice_index(&field->at, to[0], to[1], to[2])] - level;
    const double share = a / (a - b);
    double slope[2][3], size;

    at[0] = u.x + share * (w.x - u.x);
    at[1] = u.y + share * (w.y - u.y);
    at[2] = u.z + share * (w.z - u.z);
    gsn_field_gradient(field, from, slope[0]);
    gsn_field_gradient(field, to, slope[1]);
    for (size_t k = 0; k < 3; k++)
        normal[k] = slope[0][k] + share * (slope[1][k] - slope[0][k]);
    size = sqrt(gsn_dot3(normal, normal));
    for (size_t k = 0; k < 3; k++)
        normal[k] = size > 0 ? normal[k] / size : (k == 2);
}

static int link_neighbours(struct fine *fine, struct gsn_error *err)
{
    size_t *fill;

    fine->first = gsn_alloc_array(fine->vertex_count + 2, sizeof *fine->first);
    fine->next = gsn_alloc_array(6 * fine->triangle_count, sizeof *fine->next);
    if (!fine->first || !fine->next)
        return fail_memory(err);
    /* each edge twice, for each of its triangles once: a search does not mind */
    for (size_t t = 0; t < fine->triangle_count; t++)
        for (size_t k = 0; k < 3; k++)
            fine->first[fine->triangle[t][k] + 2] += 2;
    for (size_t v = 0; v < fine->vertex_count; v++)
        fine->first[v + 2] += fine->first[v + 1];
    fill = fine->first + 1;
    for (size_t t = 0; t < fine->triangle_count; t++)
        for (size_t k = 0; k < 3; k++) {
            const uint32_t v = fine->triangle[t][k];

            fine->next[fill[v]++] = fine->triangle[t][(k + 1) % 3];
            fine->next[fill[v]++] = fine->triangle[t][(k + 2) % 3];
        }
    return GSN_OK;
}

static size_t find_key(const uint64_t *sorted, size_t count, uint64_t key)
{
    size_t low = 0, high = count;

    while (high - low > 1) {
        const size_t middle = (low + high) / 2;

        if (sorted[middle] <= key)
            low = middle;
        else
            high = middle;
    }
    return low;
}

/* gives: the level as fine triangles, where it passes the region. */
static int make_fine(const struct gsn_grid *field, double level, const struct gsn_mask *near,
                     struct fine *fine, struct gsn_error *err)
{
    struct keys keys = { .count = 0 };
    gsn_auto_mem(uint64_t) sorted = NULL;
    int r = cut_cubes(field, level, near, &keys, err);
    size_t n = 0;

    *fine = (struct fine){ .triangle_count = keys.count / 3 };
    if (r >= 0) {
        sorted = gsn_alloc_array(keys.count, sizeof *sorted);
        fine->triangle = gsn_alloc_array(fine->triangle_count, sizeof *fine->triangle);
        r = sorted && fine->triangle ? GSN_OK : fail_memory(err);
    }
    if (r >= 0 && keys.count > 0) {
        memcpy(sorted, keys.key, keys.count * sizeof *sorted);
        qsort(sorted, keys.count, sizeof *sorted, compare_keys);
        for (size_t i = 0; i < keys.count; i++)
            if (n == 0 || sorted[n - 1] != sorted[i])
                sorted[n++] = sorted[i];
        for (size_t i = 0; i < keys.count; i++)
            fine->triangle[i / 3][i % 3] = (uint32_t)find_key(sorted, n, keys.key[i]);
    }
    gsn_free(keys.key);
    if (r < 0)
        return r;
    fine->vertex_count = n;
    fine->at = gsn_alloc_array(n, sizeof *fine->at);
    fine->normal = gsn_alloc_array(n, sizeof *fine->normal);
    if (!fine->at || !fine->normal)
        return fail_memory(err);
    for (size_t v = 0; v < n; v++)
        place_vertex(field, level, sorted[v], fine->at[v], fine->normal[v]);
    return link_neighbours(fine, err);
}

/* --- the same as coarse triangles --- */

/* A vertex that a search may reach: from which seed, and how far that is. */
struct reach {
    double far;
    uint32_t vertex, seed;
};

struct heap {
    size_t count, room;
    struct reach *item;
};

static bool comes_first(const struct reach *a, const struct reach *b)
{
    return a->far < b->far || (a->far == b->far && a->vertex < b->vertex);
}

static int heap_push(struct heap *heap, struct reach one, struct gsn_error *err)
{
    size_t i = heap->count;

    if (heap->count == heap->room) {
        const size_t room = 2 * heap->room + 4096;
        struct reach *larger = gsn_realloc_array(heap->item, room, sizeof *larger);

        if (!larger)
            return fail_memory(err);
        heap->item = larger;
        heap->room = room;
    }
    heap->count++;
    for (; i > 0 && comes_first(&one, &heap->item[(i - 1) / 2]); i = (i - 1) / 2)
        heap->item[i] = heap->item[(i - 1) / 2];
    heap->item[i] = one;
    return GSN_OK;
}

static struct reach heap_pop(struct heap *heap)
{
    const struct reach top = heap->item[0], last = heap->item[--heap->count];
    size_t i = 0;

    while (2 * i + 1 < heap->count) {
        size_t child = 2 * i + 1;

        if (child + 1 < heap->count && comes_first(&heap->item[child + 1], &heap->item[child]))
            child++;
        if (!comes_first(&heap->item[child], &last))
            break;
        heap->item[i] = heap->item[child];
        i = child;
    }
    heap->item[i] = last;
    return top;
}

static double distance_of(const double a[3], const double b[3])
{
    const double d[3] = { a[0] - b[0], a[1] - b[1], a[2] - b[2] };

    return sqrt(gsn_dot3(d, d));
}

/* To which seed each vertex belongs: the nearest that is reached over vertices that are its own, so
 * that what belongs to a seed hangs together. UINT32_MAX: none. */
static int claim_vertices(const struct fine *fine, const uint32_t *seed, size_t seeds,
                          uint32_t *ret_owner, struct gsn_error *err)
{
    struct heap heap = { .count = 0 };
    int r = GSN_OK;

    for (size_t v = 0; v < fine->vertex_count; v++)
        ret_owner[v] = UINT32_MAX;
    for (size_t s = 0; r >= 0 && s < seeds; s++)
        r = heap_push(&heap, (struct reach){ 0, seed[s], (uint32_t)s }, err);
    while (r >= 0 && heap.count > 0) {
        const struct reach here = heap_pop(&heap);

        if (ret_owner[here.vertex] != UINT32_MAX)
            continue;
        ret_owner[here.vertex] = here.seed;
        for (size_t i = fine->first[here.vertex]; r >= 0 && i < fine->first[here.vertex + 1]; i++)
            if (ret_owner[fine->next[i]] == UINT32_MAX)
                r = heap_push(
                    &heap,
                    (struct reach){ distance_of(fine->at[fine->next[i]], fine->at[seed[here.seed]]),
                                    fine->next[i], here.seed },
                    err);
    }
    gsn_free(heap.item);
    return r;
}

/* Moves every seed to that of its vertices which is nearest to their middle. */
static int move_seeds(const struct fine *fine, const uint32_t *owner, size_t seeds, uint32_t *seed,
                      struct gsn_error *err)
{
    double(*middle)[4] __attribute__((cleanup(gsn_auto_release))) =
        gsn_alloc_array(seeds, sizeof *middle);
    gsn_auto_mem(double) best = gsn_alloc_array(seeds, sizeof *best);

    if (!middle || !best)
        return fail_memory(err);
    for (size_t v = 0; v < fine->vertex_count; v++)
        if (owner[v] != UINT32_MAX) {
            for (size_t k = 0; k < 3; k++)
                middle[owner[v]][k] += fine->at[v][k];
            middle[owner[v]][3]++;
        }
    for (size_t s = 0; s < seeds; s++) {
        best[s] = INFINITY;
        for (size_t k = 0; k < 3; k++)
            middle[s][k] /= middle[s][3];
    }
    for (size_t v = 0; v < fine->vertex_count; v++) {
        const uint32_t s = owner[v];
        double far;

        if (s == UINT32_MAX)
            continue;
        far = distance_of(fine->at[v], middle[s]);
        if (far < best[s]) {
            best[s] = far;
            seed[s] = (uint32_t)v;
        }
    }
    return GSN_OK;
}

/* gives: the first seeds, a maximal set of vertices `apart` from each other, drawn in an order of
 * chance. */
static int draw_seeds(const struct fine *fine, const struct gsn_lattice *at, double apart,
                      uint32_t **ret_seed, size_t *ret_seeds, struct gsn_error *err)
{
    gsn_auto_mem(struct ticket) order = gsn_alloc_array(fine->vertex_count, sizeof *order);
    gsn_auto_mem(uint32_t) seed = gsn_alloc_array(fine->vertex_count, sizeof *seed);
    struct taken taken;
    size_t seeds = 0;
    int r = taken_init(&taken, at, apart, err);

    if (r >= 0 && (!order || !seed))
        r = fail_memory(err);
    for (size_t v = 0; r >= 0 && v < fine->vertex_count; v++)
        order[v] = (struct ticket){ mix_bits(v), (uint32_t)v };
    if (r >= 0)
        qsort(order, fine->vertex_count, sizeof *order, compare_tickets);
    for (size_t i = 0; r >= 0 && i < fine->vertex_count; i++) {
        const uint32_t v = order[i].index;

        if (is_near_taken(&taken, fine->at[v], fine->normal[v], apart))
            continue;
        seed[seeds++] = v;
        r = take_point(&taken, fine->at[v], fine->normal[v], err);
    }
    taken_done(&taken);
    if (r < 0)
        return r;
    *ret_seed = gsn_steal(&seed);
    *ret_seeds = seeds;
    return GSN_OK;
}

static int compare_facets(const void *a, const void *b)
{
    return memcmp(a, b, 3 * sizeof(uint32_t));
}

static void sort_three(uint32_t v[3])
{
    for (size_t pass = 0; pass < 2; pass++)
        for (size_t k = 0; k < 2; k++)
            if (v[k] > v[k + 1]) {
                const uint32_t swap = v[k];

                v[k] = v[k + 1];
                v[k + 1] = swap;
            }
}

/* Whether a triangle of seeds lies along the surface: by the cosine of the angle to its normals. */
static const double LEAST_ALONG = 0.4;

static bool lies_along(const struct fine *fine, const uint32_t a, const uint32_t b,
                       const uint32_t c)
{
    double p[3], q[3], normal[3], size;

    for (size_t k = 0; k < 3; k++) {
        p[k] = fine->at[b][k] - fine->at[a][k];
        q[k] = fine->at[c][k] - fine->at[a][k];
    }
    gsn_cross3(p, q, normal);
    size = sqrt(gsn_dot3(normal, normal));
    return size > 0 && fabs(gsn_dot3(normal, fine->normal[a])) > LEAST_ALONG * size &&
           fabs(gsn_dot3(normal, fine->normal[b])) > LEAST_ALONG * size &&
           fabs(gsn_dot3(normal, fine->normal[c])) > LEAST_ALONG * size;
}

/* Appends the triangles of seeds whose vertices meet in a fine triangle, each once. */
static int join_seeds(const struct fine *fine, const uint32_t *owner, const uint32_t *seed,
                      struct gsn_triangles *triangles, struct gsn_error *err)
{
    const size_t base = triangles->points;
    size_t most = 0, count = 0, kept = 0;
    uint32_t(*facet)[3];

    for (size_t t = 0; t < fine->triangle_count; t++) {
        const uint32_t *v = fine->triangle[t];

        most +=
            owner[v[0]] != owner[v[1]] && owner[v[1]] != owner[v[2]] && owner[v[2]] != owner[v[0]];
    }
    facet = gsn_realloc_array(triangles->facet, triangles->facets + most, sizeof *facet);
    if (!facet)
        return fail_memory(err);
    triangles->facet = facet;
    facet += triangles->facets;
    for (size_t t = 0; t < fine->triangle_count; t++) {
        const uint32_t a = owner[fine->triangle[t][0]], b = owner[fine->triangle[t][1]],
                       c = owner[fine->triangle[t][2]];

        if (a == b || b == c || c == a || a == UINT32_MAX || b == UINT32_MAX || c == UINT32_MAX ||
            !lies_along(fine, seed[a], seed[b], seed[c]))
            continue;
        facet[count][0] = (uint32_t)(base + a);
        facet[count][1] = (uint32_t)(base + b);
        facet[count][2] = (uint32_t)(base + c);
        sort_three(facet[count++]);
    }
    qsort(facet, count, sizeof *facet, compare_facets);
    for (size_t i = 0; i < count; i++)
        if (kept == 0 || compare_facets(facet[kept - 1], facet[i]) != 0)
            memcpy(facet[kept++], facet[i], sizeof *facet);
    triangles->facets += kept;
    return GSN_OK;
}

static int append_points(const struct fine *fine, const uint32_t *seed, size_t seeds,
                         struct gsn_triangles *triangles, struct gsn_error *err)
{
    const size_t total = triangles->points + seeds;
    double(*at)[3] = gsn_realloc_array(triangles->at, total, sizeof *at), (*normal)[3];

    if (!at)
        return fail_memory(err);
    triangles->at = at;
    normal = gsn_realloc_array(triangles->normal, total, sizeof *normal);
    if (!normal)
        return fail_memory(err);
    triangles->normal = normal;
    for (size_t s = 0; s < seeds; s++) {
        memcpy(at[triangles->points], fine->at[seed[s]], sizeof *at);
        memcpy(normal[triangles->points++], fine->normal[seed[s]], sizeof *normal);
    }
    return GSN_OK;
}

int gsn_level_surface_add(const struct gsn_grid *field, double level, const struct gsn_mask *near,
                          double edge_um, struct gsn_triangles *triangles, struct gsn_error *err)
{
    struct fine fine;
    gsn_auto_mem(uint32_t) seed = NULL;
    gsn_auto_mem(uint32_t) owner = NULL;
    size_t seeds = 0;
    int r = make_fine(field, level, near, &fine, err);

    if (r >= 0)
        r = draw_seeds(&fine, &field->at, edge_um / SPREAD, &seed, &seeds, err);
    if (r >= 0) {
        owner = gsn_alloc_array(fine.vertex_count, sizeof *owner);
        r = owner ? GSN_OK : fail_memory(err);
    }
    for (unsigned round = 0; r >= 0 && round < ROUNDS; round++) {
        r = claim_vertices(&fine, seed, seeds, owner, err);
        if (r >= 0)
            r = move_seeds(&fine, owner, seeds, seed, err);
    }
    if (r >= 0)
        r = claim_vertices(&fine, seed, seeds, owner, err);
    if (r >= 0)
        r = join_seeds(&fine, owner, seed, triangles, err);
    if (r >= 0)
        r = append_points(&fine, seed, seeds, triangles, err);
    fine_done(&fine);
    return r;
}

/* --- facets that cross --- */

/* Whether a segment meets a triangle, exactly; a touch counts. */
static bool segment_meets(const double p[3], const double q[3], const double a[3],
                          const double b[3], const double c[3])
{
    const int before = gsn_orient3d(a, b, c, p), behind = gsn_orient3d(a, b, c, q);
    int side[3];

    if (before * behind > 0)
        return false;
    side[0] = gsn_orient3d(p, q, a, b);
    side[1] = gsn_orient3d(p, q, b, c);
    side[2] = gsn_orient3d(p, q, c, a);
    return (side[0] >= 0 && side[1] >= 0 && side[2] >= 0) ||
           (side[0] <= 0 && side[1] <= 0 && side[2] <= 0);
}

static bool has_vertex(const uint32_t facet[3], uint32_t v)
{
    return facet[0] == v || facet[1] == v || facet[2] == v;
}

/* Whether an edge of one goes through the other. Edges that end at a vertex of the other touch it
 * there, and nowhere else but in one plane. */
static bool edges_cross(const double (*at)[3], const uint32_t one[3], const uint32_t other[3])
{
    for (size_t k = 0; k < 3; k++) {
        const uint32_t p = one[k], q = one[(k + 1) % 3];

        if (!has_vertex(other, p) && !has_vertex(other, q) &&
            segment_meets(at[p], at[q], at[other[0]], at[other[1]], at[other[2]]))
            return true;
    }
    return false;
}

struct crossing_search {
    const struct gsn_triangles *triangles;
    uint8_t *dropped;
    uint32_t facet;
};

static int look_for_crossing(void *context, uint32_t other)
{
    const struct crossing_search *search = context;
    const double(*at)[3] = (const double(*)[3])search->triangles->at;
    const uint32_t *one = search->triangles->facet[search->facet];
    const uint32_t *two = search->triangles->facet[other];

    if (other >= search->facet || search->dropped[other])
        return 0;
    if (edges_cross(at, one, two) || edges_cross(at, two, one))
        search->dropped[search->facet] = 1;
    return search->dropped[search->facet];
}

int gsn_triangles_drop_crossings(struct gsn_triangles *triangles, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_bvh_box) box = gsn_alloc_array(triangles->facets, sizeof *box);
    gsn_auto_mem(uint8_t) dropped = gsn_alloc_array(triangles->facets, 1);
    gsn_auto(gsn_bvh) tree = NULL;
    struct crossing_search search = { triangles, dropped, 0 };
    size_t kept = 0;
    int r;

    if (!box || !dropped)
        return fail_memory(err);
    for (size_t f = 0; f < triangles->facets; f++) {
        double corner[3][3];

        for (size_t k = 0; k < 3; k++)
            memcpy(corner[k], triangles->at[triangles->facet[f][k]], sizeof corner[k]);
        box[f] = gsn_bvh_box_around((const double(*)[3])corner, 3);
    }
    if (triangles->facets == 0)
        return GSN_OK;
    r = gsn_bvh_new(box, triangles->facets, &tree, err);
    if (r < 0)
        return r;
    for (size_t f = 0; f < triangles->facets; f++) {
        search.facet = (uint32_t)f;
        (void)gsn_bvh_meeting(tree, &box[f], look_for_crossing, &search);
    }
    for (size_t f = 0; f < triangles->facets; f++)
        if (!dropped[f])
            memmove(triangles->facet[kept++], triangles->facet[f], sizeof *triangles->facet);
    triangles->facets = kept;
    return GSN_OK;
}
