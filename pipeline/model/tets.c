/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A tetrahedral mesh, checked and made ready.
 *
 * Steps: (1) every coordinate is finite; (2) every tetrahedron names vertices there are, is not
 * flat by the exact predicate (orient.h), and is turned to be positive; (3) every vertex is used;
 * (4) neighbours: all faces as ascending triples of vertices, sorted, so that the two sides of an
 * inner face stand beside each other; they must lie on different sides of it.
 *
 * Failure: GSN_E_MESH names the vertex, tetrahedron or face. Cost: linear where few tetrahedra meet
 * at a vertex, and 64 bytes a tetrahedron while faces are sorted. */
#include "pipeline/model/tets.h"

#include "pipeline/core/geom.h"
#include "pipeline/model/orient.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* One face of one tetrahedron: its vertices in ascending order, and 4 * tet + opposite corner. */
struct face {
    uint32_t vertex[3];
    uint32_t owner;
};

static int by_vertices(const void *left, const void *right)
{
    const struct face *a = left, *b = right;

    for (int i = 0; i < 3; i++) {
        if (a->vertex[i] != b->vertex[i])
            return a->vertex[i] < b->vertex[i] ? -1 : 1;
    }
    return (a->owner > b->owner) - (a->owner < b->owner);
}

static int same_face(const struct face *a, const struct face *b)
{
    return memcmp(a->vertex, b->vertex, sizeof a->vertex) == 0;
}

static void swap_if_greater(uint32_t *a, uint32_t *b)
{
    if (*a > *b) {
        const uint32_t swapped = *a;

        *a = *b;
        *b = swapped;
    }
}

static struct face face_of(const struct gsn_tets *mesh, size_t tet, unsigned corner)
{
    struct face face = { .owner = (uint32_t)(4 * tet + corner) };
    unsigned n = 0;

    for (unsigned k = 0; k < 4; k++) {
        if (k != corner)
            face.vertex[n++] = mesh->tet[tet][k];
    }
    swap_if_greater(&face.vertex[0], &face.vertex[1]);
    swap_if_greater(&face.vertex[1], &face.vertex[2]);
    swap_if_greater(&face.vertex[0], &face.vertex[1]);
    return face;
}

/* The corner opposite a face must see it from the other side than the neighbour's does. */
static int apex_side(const struct gsn_tets *mesh, const struct face *face)
{
    return gsn_orient3d(mesh->vertex[face->vertex[0]], mesh->vertex[face->vertex[1]],
                        mesh->vertex[face->vertex[2]],
                        mesh->vertex[mesh->tet[face->owner / 4][face->owner % 4]]);
}

static int join_faces(struct gsn_tets *mesh, const struct face *a, const struct face *b,
                      struct gsn_error *err)
{
    if (apex_side(mesh, a) == apex_side(mesh, b))
        return gsn_fail(err, GSN_E_MESH,
                        "tetrahedra %u and %u overlap: both lie on the same side "
                        "of their common face %u %u %u",
                        a->owner / 4, b->owner / 4, a->vertex[0], a->vertex[1], a->vertex[2]);
    mesh->neighbour[a->owner / 4][a->owner % 4] = (int32_t)(b->owner / 4);
    mesh->neighbour[b->owner / 4][b->owner % 4] = (int32_t)(a->owner / 4);
    return GSN_OK;
}

/* All faces by their vertices: in bins by the smallest, each of which is sorted. end: of the
 * bins. */
static void sort_faces(const struct gsn_tets *mesh, size_t *end, struct face *face)
{
    const size_t count = 4 * mesh->tet_count;
    size_t before = 0;

    for (size_t i = 0; i < count; i++)
        end[face_of(mesh, i / 4, (unsigned)(i % 4)).vertex[0]]++;
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        const size_t own = end[v];

        end[v] = before;
        before += own;
    }
    for (size_t i = 0; i < count; i++) {
        const struct face own = face_of(mesh, i / 4, (unsigned)(i % 4));

        face[end[own.vertex[0]]++] = own;
    }
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        const size_t begin = v > 0 ? end[v - 1] : 0;

        qsort(face + begin, end[v] - begin, sizeof *face, by_vertices);
    }
}

static int find_neighbours(struct gsn_tets *mesh, struct gsn_error *err)
{
    const size_t count = 4 * mesh->tet_count;
    gsn_auto_mem(struct face) face = gsn_alloc_array(count, sizeof *face);
    gsn_auto_mem(size_t) end = gsn_alloc_array(mesh->vertex_count, sizeof *end);
    int r;

    if (!face || !end)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu faces", count);
    sort_faces(mesh, end, face);
    for (size_t i = 0; i + 1 < count; i++) {
        if (!same_face(&face[i], &face[i + 1]))
            continue;
        if (i + 2 < count && same_face(&face[i], &face[i + 2]))
            return gsn_fail(err, GSN_E_MESH, "face %u %u %u belongs to more than two tetrahedra",
                            face[i].vertex[0], face[i].vertex[1], face[i].vertex[2]);
        r = join_faces(mesh, &face[i], &face[i + 1], err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

static int check_vertices(const struct gsn_tets *mesh, struct gsn_error *err)
{
    for (size_t i = 0; i < mesh->vertex_count; i++) {
        for (int c = 0; c < 3; c++) {
            if (!isfinite(mesh->vertex[i][c]))
                return gsn_fail(err, GSN_E_MESH, "vertex %zu has a coordinate that is not finite",
                                i);
        }
    }
    return GSN_OK;
}

static int check_used(const struct gsn_tets *mesh, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) used = gsn_alloc_array(mesh->vertex_count, sizeof *used);

    if (!used)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu vertices", mesh->vertex_count);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (int k = 0; k < 4; k++)
            used[mesh->tet[t][k]] = 1;
    }
    for (size_t i = 0; i < mesh->vertex_count; i++) {
        if (!used[i])
            return gsn_fail(err, GSN_E_MESH, "vertex %zu belongs to no tetrahedron", i);
    }
    return GSN_OK;
}

/* Turns a negative tetrahedron around by swapping its last two corners. */
static int orient_tet(struct gsn_tets *mesh, size_t t, struct gsn_error *err)
{
    uint32_t *v = mesh->tet[t];
    int side;

    for (int k = 0; k < 4; k++) {
        if (v[k] >= mesh->vertex_count)
            return gsn_fail(err, GSN_E_MESH, "tetrahedron %zu names vertex %u of %zu", t, v[k],
                            mesh->vertex_count);
    }
    side = gsn_orient3d(mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                        mesh->vertex[v[3]]);
    if (side == 0)
        return gsn_fail(err, GSN_E_MESH, "tetrahedron %zu (vertices %u %u %u %u) is flat", t, v[0],
                        v[1], v[2], v[3]);
    if (side < 0) {
        const uint32_t swapped = v[2];

        v[2] = v[3];
        v[3] = swapped;
    }
    return GSN_OK;
}

static int copy_in(const double (*vertex)[3], size_t vertex_count, const uint32_t (*tet)[4],
                   size_t tet_count, struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    gsn_auto(gsn_tets) mesh = gsn_alloc_array(1, sizeof *mesh);

    if (mesh) {
        mesh->vertex_count = vertex_count;
        mesh->tet_count = tet_count;
        mesh->vertex = gsn_memdup(vertex, vertex_count * sizeof *vertex);
        mesh->tet = gsn_memdup(tet, tet_count * sizeof *tet);
        mesh->neighbour = gsn_alloc_array(tet_count, sizeof *mesh->neighbour);
    }
    if (!mesh || !mesh->vertex || !mesh->tet || !mesh->neighbour)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", tet_count);
    for (size_t t = 0; t < tet_count; t++) {
        for (int k = 0; k < 4; k++)
            mesh->neighbour[t][k] = -1;
    }
    *ret_mesh = gsn_steal(&mesh);
    return GSN_OK;
}

int gsn_tets_new(const double (*vertex)[3], size_t vertex_count, const uint32_t (*tet)[4],
                 size_t tet_count, struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    gsn_auto(gsn_tets) mesh = NULL;
    int r;

    assert(vertex && tet && ret_mesh);

    if (tet_count == 0 || tet_count > INT32_MAX / 4 || vertex_count > UINT32_MAX)
        return gsn_fail(err, GSN_E_MESH, "%zu tetrahedra of %zu vertices are no mesh", tet_count,
                        vertex_count);
    r = copy_in(vertex, vertex_count, tet, tet_count, &mesh, err);
    if (r == GSN_OK)
        r = check_vertices(mesh, err);
    for (size_t t = 0; r == GSN_OK && t < tet_count; t++)
        r = orient_tet(mesh, t, err);
    if (r == GSN_OK)
        r = check_used(mesh, err);
    if (r == GSN_OK)
        r = find_neighbours(mesh, err);
    if (r < 0)
        return r;
    *ret_mesh = gsn_steal(&mesh);
    return GSN_OK;
}

void gsn_tets_free(struct gsn_tets *mesh)
{
    if (!mesh)
        return;
    gsn_free(mesh->vertex);
    gsn_free(mesh->tet);
    gsn_free(mesh->neighbour);
    gsn_free(mesh);
}

double gsn_tets_volume(const struct gsn_tets *mesh, size_t tet)
{
    const double *a = mesh->vertex[mesh->tet[tet][0]];
    double row[3][3];

    for (int k = 0; k < 3; k++) {
        for (int c = 0; c < 3; c++)
            row[k][c] = mesh->vertex[mesh->tet[tet][k + 1]][c] - a[c];
    }
    return (row[0][0] * (row[1][1] * row[2][2] - row[1][2] * row[2][1]) +
            row[0][1] * (row[1][2] * row[2][0] - row[1][0] * row[2][2]) +
            row[0][2] * (row[1][0] * row[2][1] - row[1][1] * row[2][0])) /
           6;
}

double gsn_tets_height(const struct gsn_tets *mesh, size_t tet)
{
    static const size_t FACE[4][3] = { { 0, 1, 2 }, { 0, 1, 3 }, { 0, 2, 3 }, { 1, 2, 3 } };
    double area = 0, edge = 0;

    for (size_t f = 0; f < 4; f++) {
        double side[3][3], normal[3];

        for (size_t k = 0; k < 3; k++) {
            const double *from = mesh->vertex[mesh->tet[tet][FACE[f][k]]];
            const double *to = mesh->vertex[mesh->tet[tet][FACE[f][(k + 1) % 3]]];

            for (size_t c = 0; c < 3; c++)
                side[k][c] = to[c] - from[c];
            edge = fmax(edge, gsn_dot3(side[k], side[k]));
        }
        gsn_cross3(side[0], side[1], normal);
        area = fmax(area, sqrt(gsn_dot3(normal, normal)) / 2);
    }
    return 3 * gsn_tets_volume(mesh, tet) / (area * sqrt(edge));
}
