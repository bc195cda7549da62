/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: both formats are a head of known length and rows of fixed size, so the bytes are laid out
 * in one allocation.
 * Reference: 3D Systems, "StereoLithography Interface Specification" (binary: 80 bytes of text, a
 * count, 50 bytes a facet); Turk, "The PLY Polygon File Format" (1994).
 * Failure: memory, and more triangles than the formats' counts hold. */
#include "pipeline/export/surface_file.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are written as they lie");

enum { STL_HEAD = 84, STL_FACET = 50, PLY_VERTEX = 36, PLY_FACE = 13 };

static uint8_t *put_value(uint8_t *at, const void *value, size_t size)
{
    memcpy(at, value, size);
    return at + size;
}

static int check_count(const struct gsn_trimesh *surface, struct gsn_error *err)
{
    if (surface->triangle_count > INT32_MAX || surface->vertex_count > INT32_MAX)
        return gsn_fail(err, GSN_E_LIMIT, "%zu triangles are more than such a file can hold",
                        surface->triangle_count);
    return GSN_OK;
}

/* Of length 1 by the right hand; 0 for a triangle without area. */
static void find_normal(const struct gsn_trimesh *s, const uint32_t corner[3], float ret_normal[3])
{
    double edge[2][3], n[3], length;

    for (int e = 0; e < 2; e++)
        for (int c = 0; c < 3; c++)
            edge[e][c] = s->vertex[corner[e + 1]][c] - s->vertex[corner[0]][c];
    for (int c = 0; c < 3; c++)
        n[c] = edge[0][(c + 1) % 3] * edge[1][(c + 2) % 3] -
               edge[0][(c + 2) % 3] * edge[1][(c + 1) % 3];
    length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int c = 0; c < 3; c++)
        ret_normal[c] = length > 0 ? (float)(n[c] / length) : 0;
}

int gsn_stl_write(const struct gsn_trimesh *surface, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err)
{
    const size_t size = STL_HEAD + STL_FACET * surface->triangle_count;
    const uint32_t count = (uint32_t)surface->triangle_count;
    const int r = check_count(surface, err);
    uint8_t *bytes, *at;

    assert(ret_bytes && ret_size);

    if (r < 0)
        return r;
    bytes = at = gsn_alloc_array(size, 1);
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu triangles", (size_t)count);
    (void)snprintf((char *)bytes, STL_HEAD - sizeof count, "gieson, micrometres");
    at = put_value(at + STL_HEAD - sizeof count, &count, sizeof count);
    for (size_t t = 0; t < count; t++) {
        float row[12];

        find_normal(surface, surface->triangle[t], row);
        for (int k = 0; k < 3; k++)
            for (int c = 0; c < 3; c++)
                row[3 + 3 * k + c] = (float)surface->vertex[surface->triangle[t][k]][c];
        at = put_value(at, row, sizeof row) + 2; /* two bytes that mean nothing */
    }
    *ret_bytes = bytes;
    *ret_size = size;
    return GSN_OK;
}

int gsn_ply_write(const struct gsn_trimesh *surface, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err)
{
    char head[400];
    const int length =
        snprintf(head, sizeof head,
                 "ply\nformat binary_little_endian 1.0\ncomment gieson, micrometres\n"
                 "element vertex %zu\nproperty double x\nproperty double y\nproperty double z\n"
                 "property float nx\nproperty float ny\nproperty float nz\n"
                 "element face %zu\nproperty list uchar int vertex_indices\nend_header\n",
                 surface->vertex_count, surface->triangle_count);
    const size_t size =
        (size_t)length + PLY_VERTEX * surface->vertex_count + PLY_FACE * surface->triangle_count;
    const int r = check_count(surface, err);
    uint8_t *bytes, *at;

    assert(ret_bytes && ret_size);

    if (r < 0)
        return r;
    bytes = at = gsn_alloc(size);
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu triangles",
                        surface->triangle_count);
    at = put_value(at, head, (size_t)length);
    for (size_t v = 0; v < surface->vertex_count; v++) {
        at = put_value(at, surface->vertex[v], sizeof surface->vertex[v]);
        at = put_value(at, surface->normal[v], sizeof surface->normal[v]);
    }
    for (size_t t = 0; t < surface->triangle_count; t++) {
        *at++ = 3;
        at = put_value(at, surface->triangle[t], sizeof surface->triangle[t]);
    }
    *ret_bytes = bytes;
    *ret_size = size;
    return GSN_OK;
}
