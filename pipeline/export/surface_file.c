/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: both formats are a head of known length and rows of fixed size, so the bytes are laid out
 * in one allocation.
 * Reference: 3D Systems, "StereoLithography Interface Specification" (binary: 80 bytes of text, a
 * count, 50 bytes a facet); Turk, "The PLY Polygon File Format" (1994); Khronos, "glTF 2.0
 * Specification", 4.4 (binary).
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

/* ---- glTF ---------------------------------------------------------------------------------- */

enum { GLB_HEAD = 12, GLB_CHUNK = 8, GLB_VERTEX = 12, GLB_FACE = 12 };

/* The ends of the surface along each axis. */
static void find_ends(const struct gsn_trimesh *s, double low[3], double high[3])
{
    for (int c = 0; c < 3; c++) {
        low[c] = INFINITY;
        high[c] = -INFINITY;
        for (size_t v = 0; v < s->vertex_count; v++) {
            low[c] = fmin(low[c], s->vertex[v][c]);
            high[c] = fmax(high[c], s->vertex[v][c]);
        }
    }
}

/* gives: what the binary chunk holds: places, normals, corners; padded with blanks to a multiple of
 * four. NULL: no memory. */
static char *describe_glb(const struct gsn_trimesh *s, const double middle[3], const float half[3])
{
    const size_t points = GLB_VERTEX * s->vertex_count, faces = GLB_FACE * s->triangle_count;

    return gsn_format(
        "{\"asset\":{\"version\":\"2.0\",\"generator\":\"gieson\"},\"scene\":0,"
        "\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,\"translation\":[%.9g,%.9g,%.9g],"
        "\"scale\":[1e-6,1e-6,1e-6]}],\"meshes\":[{\"primitives\":[{\"attributes\":{"
        "\"POSITION\":0,\"NORMAL\":1},\"indices\":2,\"material\":0}]}],\"materials\":[{"
        "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.85,0.8,0.7,1],\"metallicFactor\":0,"
        "\"roughnessFactor\":0.7},\"doubleSided\":true}],\"accessors\":[{\"bufferView\":0,"
        "\"componentType\":5126,\"count\":%zu,\"type\":\"VEC3\",\"min\":[%.9g,%.9g,%.9g],"
        "\"max\":[%.9g,%.9g,%.9g]},{\"bufferView\":1,\"componentType\":5126,\"count\":%zu,"
        "\"type\":\"VEC3\"},{\"bufferView\":2,\"componentType\":5125,\"count\":%zu,"
        "\"type\":\"SCALAR\"}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":%zu,"
        "\"target\":34962},{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu,\"target\":34962},"
        "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu,\"target\":34963}],\"buffers\":[{"
        "\"byteLength\":%zu}]}",
        1e-6 * middle[0], 1e-6 * middle[1], 1e-6 * middle[2], s->vertex_count, -(double)half[0],
        -(double)half[1], -(double)half[2], (double)half[0], (double)half[1], (double)half[2],
        s->vertex_count, 3 * s->triangle_count, points, points, points, 2 * points, faces,
        2 * points + faces);
}

static uint8_t *put_chunk(uint8_t *at, uint32_t size, const char kind[4])
{
    return put_value(put_value(at, &size, sizeof size), kind, 4);
}

int gsn_glb_write(const struct gsn_trimesh *surface, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err)
{
    const size_t binary =
        2 * GLB_VERTEX * surface->vertex_count + GLB_FACE * surface->triangle_count;
    gsn_auto_mem(char) text = NULL;
    double low[3], high[3], middle[3];
    float half[3];
    size_t length, padded, size;
    uint8_t *bytes, *at;

    assert(ret_bytes && ret_size);

    if (binary > INT32_MAX / 2)
        return gsn_fail(err, GSN_E_LIMIT, "%zu triangles are more than such a file can hold",
                        surface->triangle_count);
    find_ends(surface, low, high);
    for (int c = 0; c < 3; c++) {
        middle[c] = (low[c] + high[c]) / 2;
        half[c] = (float)(high[c] - middle[c]);
    }
    text = describe_glb(surface, middle, half);
    length = text ? strlen(text) : 0;
    padded = (length + 3) / 4 * 4;
    size = GLB_HEAD + 2 * GLB_CHUNK + padded + binary;
    bytes = at = text ? gsn_alloc(size) : NULL;
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu triangles",
                        surface->triangle_count);
    at = put_value(at, "glTF", 4);
    at = put_value(at, &(uint32_t){ 2 }, 4);
    at = put_value(at, &(uint32_t){ (uint32_t)size }, 4);
    at = put_chunk(at, (uint32_t)padded, "JSON");
    memset(at, ' ', padded);
    (void)put_value(at, text, length);
    at = put_chunk(at + padded, (uint32_t)binary, "BIN\0");
    for (size_t v = 0; v < surface->vertex_count; v++)
        for (int c = 0; c < 3; c++) {
            const float place = (float)(surface->vertex[v][c] - middle[c]);

            at = put_value(at, &(float){ fminf(half[c], fmaxf(-half[c], place)) }, sizeof place);
        }
    at = put_value(at, surface->normal, GLB_VERTEX * surface->vertex_count);
    (void)put_value(at, surface->triangle, GLB_FACE * surface->triangle_count);
    *ret_bytes = bytes;
    *ret_size = size;
    return GSN_OK;
}
