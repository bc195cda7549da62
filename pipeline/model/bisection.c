/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A finer mesh of the same domain: longest-edge bisection.
 *
 * Method: a tetrahedron that is too large is halved at the middle of its longest edge. So that the
 * mesh stays conforming, all tetrahedra around that edge are halved with it; where one of them has
 * an edge that is longer still, that edge comes first, and so on, until an edge is the longest of
 * all tetrahedra around it (the longest-edge propagation path). Only midpoints are added: the
 * domain stays to the last bit of its faces, and no angle falls far below the smallest of before.
 * Reference: M.-C. Rivara, "New longest-edge algorithms for the refinement and/or improvement of
 * unstructured triangulations", Int. J. Numer. Methods Eng. 40, 3313-3324, 1997.
 *
 * Steps: (1) each vertex lists its tetrahedra; (2) tetrahedra in order, new ones behind the old,
 * each until it keeps its limit; (3) the mesh is sorted in space (domain_internal.h).
 *
 * Failure: GSN_E_INPUT, GSN_E_LIMIT, GSN_E_NOMEM. Cost: linear in the tetrahedra that come out.
 * Edges of one length are ordered by their vertices, so that the same mesh gives the same bytes. */
#include "pipeline/model/bisection.h"

#include "pipeline/model/domain_internal.h"

#include <math.h>
#include <string.h>

enum { MOST_TETS = 1 << 24 };

/* Relative to a limit: rounding of a volume. */
static const double SLACK = 1e-9;

static const uint32_t NONE = UINT32_MAX;

/* The mesh while it grows. Corner c of tetrahedron t is node 4 t + c; each vertex heads a list of
 * the nodes that stand on it. */
struct growing {
    struct gsn_soup *soup; /* its counts are of what is in use */
    double *limit;
    uint32_t *next, *head;
    size_t tet_room, vertex_room;
};

struct edge {
    uint32_t a, b; /* a < b */
    double squared;
};

/* --- memory --- */

static void growing_done(struct growing *g)
{
    gsn_soup_free(g->soup);
    gsn_free(g->limit);
    gsn_free(g->next);
    gsn_free(g->head);
}

static int fail_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory while refining a mesh");
}

/* Arrays grow one after the other: what has grown is kept, and freed at the end, where the next
 * finds no memory. */
static int grow_vertices(struct growing *g, size_t room, struct gsn_error *err)
{
    double(*vertex)[3] = gsn_realloc_array(g->soup->vertex, room, sizeof *vertex);
    uint32_t *head;

    if (!vertex)
        return fail_memory(err);
    g->soup->vertex = vertex;
    head = gsn_realloc_array(g->head, room, sizeof *head);
    if (!head)
        return fail_memory(err);
    g->head = head;
    g->vertex_room = room;
    return GSN_OK;
}

static int grow_tets(struct growing *g, size_t room, struct gsn_error *err)
{
    uint32_t(*tet)[4] = gsn_realloc_array(g->soup->tet, room, sizeof *tet);
    double *limit;
    uint32_t *next;

    if (!tet)
        return fail_memory(err);
    g->soup->tet = tet;
    limit = gsn_realloc_array(g->limit, room, sizeof *limit);
    if (!limit)
        return fail_memory(err);
    g->limit = limit;
    next = gsn_realloc_array(g->next, 4 * room, sizeof *next);
    if (!next)
        return fail_memory(err);
    g->next = next;
    g->tet_room = room;
    return GSN_OK;
}

/* Room for one more vertex and for so many more tetrahedra. */
static int need_room(struct growing *g, size_t more, struct gsn_error *err)
{
    const size_t tets = g->soup->tet_count + more;
    int r = GSN_OK;

    if (tets > MOST_TETS)
        return gsn_fail(err, GSN_E_LIMIT, "a refinement of more than %d tetrahedra", MOST_TETS);
    if (g->soup->vertex_count == g->vertex_room)
        r = grow_vertices(g, 2 * g->vertex_room, err);
    return r < 0 || tets <= g->tet_room ? r : grow_tets(g, 2 * tets, err);
}

/* --- lists --- */

static void put_on(struct growing *g, uint32_t node)
{
    const uint32_t vertex = g->soup->tet[node / 4][node % 4];

    g->next[node] = g->head[vertex];
    g->head[vertex] = node;
}

static void take_off(struct growing *g, uint32_t node)
{
    uint32_t *link = &g->head[g->soup->tet[node / 4][node % 4]];

    while (*link != node)
        link = &g->next[*link];
    *link = g->next[node];
}

/* The corner at which a tetrahedron has this vertex; NONE: it has not. */
static uint32_t corner_of(const struct growing *g, uint32_t tet, uint32_t vertex)
{
    for (uint32_t c = 0; c < 4; c++)
        if (g->soup->tet[tet][c] == vertex)
            return c;
    return NONE;
}

/* --- edges --- */

static struct edge edge_of(const struct growing *g, uint32_t p, uint32_t q)
{
    const double *u = g->soup->vertex[p], *v = g->soup->vertex[q];
    const double x = u[0] - v[0], y = u[1] - v[1], z = u[2] - v[2];

    return (struct edge){ p < q ? p : q, p < q ? q : p, x * x + y * y + z * z };
}

static int is_longer(const struct edge *one, const struct edge *other)
{
    if (one->squared != other->squared)
        return one->squared > other->squared;
    return one->b != other->b ? one->b > other->b : one->a > other->a;
}

static struct edge longest_of(const struct growing *g, uint32_t tet)
{
    const uint32_t *v = g->soup->tet[tet];
    struct edge longest = edge_of(g, v[0], v[1]);

    for (unsigned c = 0; c < 3; c++)
        for (unsigned d = c + 1; d < 4; d++) {
            const struct edge other = edge_of(g, v[c], v[d]);

            if (is_longer(&other, &longest))
                longest = other;
        }
    return longest;
}

/* The edge at the end of a tetrahedron's path, the longest of all tetrahedra around it, and how
 * many these are. */
static struct edge end_of_path(const struct growing *g, uint32_t tet, size_t *ret_around)
{
    struct edge end = longest_of(g, tet), seen;

    do {
        seen = end;
        *ret_around = 0;
        for (uint32_t node = g->head[seen.a]; node != NONE; node = g->next[node])
            if (corner_of(g, node / 4, seen.b) != NONE) {
                const struct edge other = longest_of(g, node / 4);

                ++*ret_around;
                if (is_longer(&other, &end))
                    end = other;
            }
    } while (end.a != seen.a || end.b != seen.b);
    return end;
}

/* --- bisection --- */

/* Halves a tetrahedron with the edge from a to b: it keeps the half at a, a new one gets that at b.
 */
static void halve(struct growing *g, uint32_t tet, const struct edge *edge, uint32_t middle)
{
    const uint32_t at_a = corner_of(g, tet, edge->a), at_b = corner_of(g, tet, edge->b),
                   other = (uint32_t)g->soup->tet_count++;

    take_off(g, 4 * tet + at_b);
    memcpy(g->soup->tet[other], g->soup->tet[tet], sizeof *g->soup->tet);
    g->soup->tet[tet][at_b] = middle;
    g->soup->tet[other][at_a] = middle;
    g->limit[other] = g->limit[tet];
    put_on(g, 4 * tet + at_b);
    for (uint32_t c = 0; c < 4; c++)
        put_on(g, 4 * other + c);
}

static int split_edge(struct growing *g, const struct edge *edge, size_t around,
                      struct gsn_error *err)
{
    const uint32_t middle = (uint32_t)g->soup->vertex_count;
    uint32_t node, next;
    const int r = need_room(g, around, err);

    if (r < 0)
        return r;
    for (unsigned k = 0; k < 3; k++)
        g->soup->vertex[middle][k] =
            (g->soup->vertex[edge->a][k] + g->soup->vertex[edge->b][k]) / 2;
    g->head[middle] = NONE;
    g->soup->vertex_count++;
    /* What keeps its half at a stays in this list; new ones have no corner there. */
    for (node = g->head[edge->a]; node != NONE; node = next) {
        next = g->next[node];
        if (corner_of(g, node / 4, edge->b) != NONE)
            halve(g, node / 4, edge, middle);
    }
    return GSN_OK;
}

/* Halves keep the orientation of the whole. */
static double volume_of(const struct growing *g, uint32_t tet)
{
    const struct gsn_tets mesh = { .vertex = g->soup->vertex, .tet = g->soup->tet };

    return gsn_tets_volume(&mesh, tet);
}

static int bisect_all(struct growing *g, struct gsn_error *err)
{
    for (uint32_t t = 0; t < g->soup->tet_count; t++)
        while (g->limit[t] > 0 && volume_of(g, t) > g->limit[t] * (1 + SLACK)) {
            size_t around = 0;
            const struct edge edge = end_of_path(g, t, &around);
            const int r = split_edge(g, &edge, around, err);

            if (r < 0)
                return r;
        }
    return GSN_OK;
}

static int copy_mesh(const struct gsn_tets *mesh, const double *max_um3, struct growing *g,
                     struct gsn_error *err)
{
    const int r = gsn_soup_new(mesh->vertex_count, mesh->tet_count, &g->soup, err);

    if (r < 0)
        return r;
    g->tet_room = mesh->tet_count;
    g->vertex_room = mesh->vertex_count;
    g->limit = gsn_memdup(max_um3, mesh->tet_count * sizeof *max_um3);
    g->next = gsn_alloc_array(4 * mesh->tet_count, sizeof *g->next);
    g->head = gsn_alloc_array(mesh->vertex_count, sizeof *g->head);
    if (!g->limit || !g->next || !g->head)
        return fail_memory(err);
    memcpy(g->soup->vertex, mesh->vertex, mesh->vertex_count * sizeof *mesh->vertex);
    memcpy(g->soup->tet, mesh->tet, mesh->tet_count * sizeof *mesh->tet);
    memset(g->head, 0xff, mesh->vertex_count * sizeof *g->head);
    for (uint32_t node = 0; node < 4 * mesh->tet_count; node++)
        put_on(g, node);
    return GSN_OK;
}

static int bisect(const struct gsn_tets *mesh, const double *max_um3, int in_order,
                  struct growing *g, struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    int r = copy_mesh(mesh, max_um3, g, err);

    if (r >= 0)
        r = bisect_all(g, err);
    if (r >= 0 && in_order)
        r = gsn_domain_order(g->soup, err);
    return r < 0 ? r
                 : gsn_tets_new(g->soup->vertex, g->soup->vertex_count, g->soup->tet,
                                g->soup->tet_count, ret_mesh, err);
}

static int check_and_bisect(const struct gsn_tets *mesh, const double *max_um3, int in_order,
                            struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    struct growing g = { .soup = NULL };
    int r;

    for (size_t t = 0; t < mesh->tet_count; t++)
        if (!isfinite(max_um3[t]) || max_um3[t] < 0)
            return gsn_fail(err, GSN_E_INPUT, "the limit %g um^3 of tetrahedron %zu", max_um3[t],
                            t);
    r = bisect(mesh, max_um3, in_order, &g, ret_mesh, err);
    growing_done(&g);
    return r;
}

int gsn_tets_bisect(const struct gsn_tets *mesh, const double *max_um3, struct gsn_tets **ret_mesh,
                    struct gsn_error *err)
{
    return check_and_bisect(mesh, max_um3, 1, ret_mesh, err);
}

int gsn_tets_bisect_behind(const struct gsn_tets *mesh, const double *max_um3,
                           struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    return check_and_bisect(mesh, max_um3, 0, ret_mesh, err);
}
