/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What goes to the mesher and comes back: closed surfaces, meshes, and both as bytes.
 *
 * Method: a message is eight bytes of kind, three counts, then arrays of little-endian doubles and
 * 32-bit numbers. Both ends check counts against the length before anything is allocated, for the
 * other end may have crashed or been taken over.
 *
 * A surface passes when its coordinates are finite, its corners in range and distinct, and every
 * edge is run through exactly once in each direction: edges are sorted, and a pair must meet its
 * opposite. Whether facets cross is for the mesher to find.
 *
 * Failure: GSN_E_MESH names the vertex, facet or edge; GSN_E_INPUT a message that is not one.
 * Cost: linear, but for the sort of edges. */
#include "pipeline/model/tetgen_wire.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

/* --- closed surfaces --- */

/* An edge of one facet: its ends in ascending order, and whether the facet runs through it so. */
struct edge {
    uint64_t ends;
    uint32_t ascending;
};

int gsn_surface_new(size_t vertex_count, size_t facet_count, size_t inner_count,
                    struct gsn_surface **ret_surface, struct gsn_error *err)
{
    gsn_auto(gsn_surface) surface = gsn_alloc_array(1, sizeof *surface);

    if (surface) {
        surface->vertex = gsn_alloc_array(vertex_count, sizeof *surface->vertex);
        surface->facet = gsn_alloc_array(facet_count + inner_count, sizeof *surface->facet);
        surface->vertex_count = vertex_count;
        surface->facet_count = facet_count;
        surface->inner_count = inner_count;
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

    for (size_t f = 0; f < surface->facet_count + surface->inner_count; f++) {
        const size_t corners = gsn_surface_corners(surface, f);

        for (size_t k = 0; k < corners; k++) {
            const uint32_t from = surface->facet[f][k], to = surface->facet[f][(k + 1) % corners];
            const uint64_t low = from < to ? from : to, high = from < to ? to : from;

            if (from == to || high >= surface->vertex_count)
                return gsn_fail(err, GSN_E_MESH, "surface facet %zu has impossible corners", f);
            if (f < surface->facet_count)
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

/* --- questions and answers as bytes --- */

/* The first eight bytes of each kind of message. */
enum kind { KIND_FILL, KIND_MESH, KIND_REFUSAL, KINDS };
static const char MAGIC[KINDS][8] = { "gsnfill1", "gsnmesh1", "gsnnope1" };

enum {
    COUNTS = 3,              /* of vertices, facets, tetrahedra or inner facets */
    HEADER = 8 + 8 * COUNTS, /* every message */
    OPTIONS = 3 * 8,         /* behind the header of a question */
    VERTEX = 24,
    CORNERS = 16,
};

struct cursor {
    uint8_t *write;      /* packing */
    const uint8_t *read; /* unpacking */
};

static void put_number(struct cursor *at, uint64_t value, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        *at->write++ = (uint8_t)(value >> 8 * i);
}

static uint64_t get_number(struct cursor *at, size_t bytes)
{
    uint64_t value = 0;

    for (size_t i = 0; i < bytes; i++)
        value |= (uint64_t)*at->read++ << 8 * i;
    return value;
}

static void put_double(struct cursor *at, double value)
{
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    put_number(at, bits, sizeof bits);
}

static double get_double(struct cursor *at)
{
    const uint64_t bits = get_number(at, sizeof bits);
    double value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

static void put_vertices(struct cursor *at, const double (*vertex)[3], size_t count)
{
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < 3; k++)
            put_double(at, vertex[i][k]);
}

static void put_corners(struct cursor *at, const uint32_t (*corner)[4], size_t count)
{
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < 4; k++)
            put_number(at, corner[i][k], 4);
}

static void get_vertices(struct cursor *at, double (*vertex)[3], size_t count)
{
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < 3; k++)
            vertex[i][k] = get_double(at);
}

static void get_corners(struct cursor *at, uint32_t (*corner)[4], size_t count)
{
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < 4; k++)
            corner[i][k] = (uint32_t)get_number(at, 4);
}

/* gives: a message of its final size with the header written. */
static uint8_t *begin_message(enum kind kind, const size_t count[COUNTS], size_t size,
                              struct cursor *at)
{
    uint8_t *bytes = gsn_alloc(size);

    if (!bytes)
        return NULL;
    memcpy(bytes, MAGIC[kind], 8);
    at->write = bytes + 8;
    for (size_t i = 0; i < COUNTS; i++)
        put_number(at, count[i], 8);
    return bytes;
}

static bool is_kind(const uint8_t *bytes, size_t size, enum kind kind)
{
    return size >= HEADER && memcmp(bytes, MAGIC[kind], 8) == 0;
}

/* Reads the counts; false when one is beyond what 32-bit indices reach. */
static bool get_counts(const uint8_t *bytes, struct cursor *at, size_t ret_count[COUNTS])
{
    bool sane = true;

    at->read = bytes + 8;
    for (size_t i = 0; i < COUNTS; i++) {
        const uint64_t count = get_number(at, 8);

        sane &= count < INT32_MAX;
        ret_count[i] = (size_t)count;
    }
    return sane;
}

int gsn_soup_new(size_t vertex_count, size_t tet_count, struct gsn_soup **ret_soup,
                 struct gsn_error *err)
{
    gsn_auto(gsn_soup) soup = gsn_alloc_array(1, sizeof *soup);

    if (soup) {
        soup->vertex = gsn_alloc_array(vertex_count, sizeof *soup->vertex);
        soup->tet = gsn_alloc_array(tet_count, sizeof *soup->tet);
        soup->vertex_count = vertex_count;
        soup->tet_count = tet_count;
    }
    if (!soup || !soup->vertex || !soup->tet)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", tet_count);
    *ret_soup = gsn_steal(&soup);
    return GSN_OK;
}

void gsn_soup_free(struct gsn_soup *soup)
{
    if (!soup)
        return;
    gsn_free(soup->vertex);
    gsn_free(soup->tet);
    gsn_free(soup);
}

void gsn_mesh_question_done(struct gsn_mesh_question *question)
{
    gsn_surface_free(question->surface);
    *question = (struct gsn_mesh_question){ .surface = NULL };
}

static size_t question_size(const size_t count[COUNTS])
{
    return HEADER + OPTIONS + count[0] * VERTEX + (count[1] + count[2]) * CORNERS;
}

int gsn_mesh_question_pack(const struct gsn_mesh_question *question, uint8_t **ret_bytes,
                           size_t *ret_size, struct gsn_error *err)
{
    const struct gsn_surface *surface = question->surface;
    const size_t count[COUNTS] = { surface->vertex_count, surface->facet_count,
                                   surface->inner_count };
    const size_t size = question_size(count);
    struct cursor at;
    uint8_t *bytes = begin_message(KIND_FILL, count, size, &at);

    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the mesher's question");
    put_double(&at, question->options.max_tet_um3);
    put_double(&at, question->options.radius_edge);
    put_double(&at, question->options.min_dihedral_deg);
    put_vertices(&at, surface->vertex, count[0]);
    put_corners(&at, surface->facet, count[1] + count[2]);
    *ret_bytes = bytes;
    *ret_size = size;
    return GSN_OK;
}

static int get_surface(struct cursor *at, const size_t count[COUNTS],
                       struct gsn_mesh_question *question, struct gsn_error *err)
{
    const int r = gsn_surface_new(count[0], count[1], count[2], &question->surface, err);

    if (r < 0)
        return r;
    get_vertices(at, question->surface->vertex, count[0]);
    get_corners(at, question->surface->facet, count[1] + count[2]);
    return GSN_OK;
}

int gsn_mesh_question_unpack(const uint8_t *bytes, size_t size,
                             struct gsn_mesh_question *ret_question, struct gsn_error *err)
{
    struct gsn_mesh_question question = { .surface = NULL };
    size_t count[COUNTS];
    struct cursor at;
    int r;

    if (!is_kind(bytes, size, KIND_FILL) || !get_counts(bytes, &at, count) ||
        question_size(count) != size)
        return gsn_fail(err, GSN_E_INPUT, "%zu bytes that are no question for a mesher", size);
    question.options.max_tet_um3 = get_double(&at);
    question.options.radius_edge = get_double(&at);
    question.options.min_dihedral_deg = get_double(&at);
    r = get_surface(&at, count, &question, err);
    if (r < 0)
        gsn_mesh_question_done(&question);
    else
        *ret_question = question;
    return r;
}

int gsn_mesh_answer_pack(const struct gsn_soup *mesh, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err)
{
    const size_t count[COUNTS] = { mesh->vertex_count, 0, mesh->tet_count };
    const size_t size = HEADER + count[0] * VERTEX + count[2] * CORNERS;
    struct cursor at;
    uint8_t *bytes = begin_message(KIND_MESH, count, size, &at);

    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the mesher's answer");
    put_vertices(&at, mesh->vertex, count[0]);
    put_corners(&at, mesh->tet, count[2]);
    *ret_bytes = bytes;
    *ret_size = size;
    return GSN_OK;
}

/* The counts of a refusal are its code's absolute value, 0 and the sentence's length. */
int gsn_mesh_refusal_pack(const struct gsn_error *why, uint8_t **ret_bytes, size_t *ret_size,
                          struct gsn_error *err)
{
    const size_t count[COUNTS] = { (size_t)-why->code, 0, strlen(why->text) };
    struct cursor at;
    uint8_t *bytes = begin_message(KIND_REFUSAL, count, HEADER + count[2], &at);

    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the mesher's answer");
    memcpy(at.write, why->text, count[2]);
    *ret_bytes = bytes;
    *ret_size = HEADER + count[2];
    return GSN_OK;
}

int gsn_mesh_answer_unpack(const uint8_t *bytes, size_t size, struct gsn_soup **ret_mesh,
                           struct gsn_error *err)
{
    gsn_auto(gsn_soup) mesh = NULL;
    const bool refused = is_kind(bytes, size, KIND_REFUSAL);
    size_t count[COUNTS];
    struct cursor at;
    int r;

    if ((!refused && !is_kind(bytes, size, KIND_MESH)) || !get_counts(bytes, &at, count) ||
        count[1] != 0 || count[0] == 0 ||
        size != HEADER + (refused ? count[2] : count[0] * VERTEX + count[2] * CORNERS))
        return gsn_fail(err, GSN_E_MESH, "the mesher's answer of %zu bytes is damaged", size);
    if (refused)
        return gsn_fail(err, -(int)count[0], "%.*s", (int)count[2], (const char *)at.read);
    r = gsn_soup_new(count[0], count[2], &mesh, err);
    if (r < 0)
        return r;
    get_vertices(&at, mesh->vertex, count[0]);
    get_corners(&at, mesh->tet, count[2]);
    *ret_mesh = gsn_steal(&mesh);
    return GSN_OK;
}
