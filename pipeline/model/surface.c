/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/surface.h"

#include <math.h>
#include <stdlib.h>

/* An edge of one facet: its ends in ascending order, and whether the facet runs through it so. */
struct edge {
    uint64_t ends;
    uint32_t ascending;
};

int gsn_surface_new(size_t vertex_count, size_t facet_count, struct gsn_surface **ret_surface,
                    struct gsn_error *err)
{
    gsn_auto(gsn_surface) surface = gsn_alloc_array(1, sizeof *surface);

    if (surface) {
        surface->vertex = gsn_alloc_array(vertex_count, sizeof *surface->vertex);
        surface->facet = gsn_alloc_array(facet_count, sizeof *surface->facet);
        surface->vertex_count = vertex_count;
        surface->facet_count = facet_count;
    }
    if (!surface || !surface->vertex || !surface->facet)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a surface of %zu facets", facet_count);
    *ret_surface = gsn_steal(&surface);
    return GSN_OK;
}

void gsn_surface_free(struct gsn_surface *surface)
{
    if (!surface)
        return;
    gsn_free(surface->vertex);
    gsn_free(surface->facet);
    gsn_free(surface);
}

size_t gsn_surface_corners(const struct gsn_surface *surface, size_t facet)
{
    return surface->facet[facet][3] == GSN_SURFACE_NONE ? 3 : 4;
}

static int compare_edges(const void *a, const void *b)
{
    const struct edge *left = a, *right = b;

    if (left->ends != right->ends)
        return left->ends < right->ends ? -1 : 1;
    return (left->ascending > right->ascending) - (left->ascending < right->ascending);
}

static int check_vertices(const struct gsn_surface *surface, struct gsn_error *err)
{
    for (size_t v = 0; v < surface->vertex_count; v++)
        for (size_t k = 0; k < 3; k++)
            if (!isfinite(surface->vertex[v][k]))
                return gsn_fail(err, GSN_E_MESH, "surface vertex %zu is not finite", v);
    return GSN_OK;
}

/* Appends the edges of every facet; refuses corners out of range or repeated. */
static int collect_edges(const struct gsn_surface *surface, struct edge *edges, size_t *ret_count,
                         struct gsn_error *err)
{
    size_t count = 0;

    for (size_t f = 0; f < surface->facet_count; f++) {
        const size_t corners = gsn_surface_corners(surface, f);

        for (size_t k = 0; k < corners; k++) {
            const uint32_t from = surface->facet[f][k], to = surface->facet[f][(k + 1) % corners];
            const uint64_t low = from < to ? from : to, high = from < to ? to : from;

            if (from == to || high >= surface->vertex_count)
                return gsn_fail(err, GSN_E_MESH, "surface facet %zu has impossible corners", f);
            edges[count++] = (struct edge){ low << 32 | high, from < to };
        }
    }
    *ret_count = count;
    return GSN_OK;
}

int gsn_surface_check(const struct gsn_surface *surface, struct gsn_error *err)
{
    gsn_auto_mem(struct edge) edges = NULL;
    size_t count = 0;
    int r = check_vertices(surface, err);

    if (r < 0)
        return r;
    if (surface->facet_count == 0)
        return gsn_fail(err, GSN_E_MESH, "the surface has no facets");
    edges = gsn_alloc_array(surface->facet_count, 4 * sizeof *edges);
    if (!edges)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the edges of a surface");
    r = collect_edges(surface, edges, &count, err);
    if (r < 0)
        return r;

    qsort(edges, count, sizeof *edges, compare_edges);
    for (size_t i = 0; i < count; i += 2)
        if (i + 1 == count || edges[i].ends != edges[i + 1].ends ||
            edges[i].ascending == edges[i + 1].ascending ||
            (i + 2 < count && edges[i + 2].ends == edges[i].ends))
            return gsn_fail(err, GSN_E_MESH,
                            "the surface is not closed at the edge between vertices %u and %u",
                            (unsigned)(edges[i].ends >> 32), (unsigned)edges[i].ends);
    return GSN_OK;
}
