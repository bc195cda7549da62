/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/vtu.h"

#include "pipeline/core/file.h"
#include "pipeline/model/simplex_sets.h"

#include <assert.h>
#include <string.h>

#if __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
#define BYTE_ORDER_NAME "LittleEndian"
#else
#define BYTE_ORDER_NAME "BigEndian"
#endif

enum { BEZIER_TETRAHEDRON = 78 }; /* VTK's number of the cell type */

/* VTK's points of a tetrahedron of any degree: corners, then along each of these edges, then inside
 * each of these faces (one point at degree 3, none below). */
static const uint8_t EDGE[6][2] = { { 0, 1 }, { 1, 2 }, { 2, 0 }, { 0, 3 }, { 1, 3 }, { 2, 3 } };
static const uint8_t FACE[4][3] = { { 0, 1, 3 }, { 1, 2, 3 }, { 0, 2, 3 }, { 0, 1, 2 } };

/* The multi-indices of VTK's points, one after the other. */
static void order_points(unsigned degree, uint8_t ret_beta[GSN_DMS_MAX_FUNCTIONS][4])
{
    size_t p = 0;

    memset(ret_beta, 0, GSN_DMS_MAX_FUNCTIONS * sizeof *ret_beta);
    for (int k = 0; k < 4; k++)
        ret_beta[p++][k] = (uint8_t)degree;
    for (int e = 0; e < 6; e++) {
        for (unsigned i = 1; i < degree; i++, p++) {
            ret_beta[p][EDGE[e][0]] = (uint8_t)(degree - i);
            ret_beta[p][EDGE[e][1]] = (uint8_t)i;
        }
    }
    for (int f = 0; degree == 3 && f < 4; f++, p++) {
        for (int k = 0; k < 3; k++)
            ret_beta[p][FACE[f][k]] = 1;
    }
}

/* The arrays of the file in the order they follow each other behind the XML, each after its length
 * in bytes as 64 bits. */
enum { VALUES, POINTS, CONNECTIVITY, OFFSETS, TYPES, ARRAYS };

struct layout {
    size_t tets, per_tet, points;
    size_t size[ARRAYS];  /* bytes */
    size_t start[ARRAYS]; /* of the length, from the first array on */
    size_t total;
};

static struct layout lay_out(const struct gsn_spline *spline)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const size_t tets = gsn_dms_mesh(space)->tet_count, per_tet = gsn_dms_functions(space);
    struct layout layout = { .tets = tets, .per_tet = per_tet, .points = tets * per_tet };

    layout.size[VALUES] = layout.points * sizeof(double);
    layout.size[POINTS] = 3 * layout.points * sizeof(double);
    layout.size[CONNECTIVITY] = layout.points * sizeof(int64_t);
    layout.size[OFFSETS] = tets * sizeof(int64_t);
    layout.size[TYPES] = tets;
    for (int a = 0; a < ARRAYS; a++) {
        layout.start[a] = layout.total;
        layout.total += sizeof(uint64_t) + layout.size[a];
    }
    return layout;
}

static char *describe(const struct layout *layout)
{
    return gsn_format(
        "<?xml version=\"1.0\"?>\n"
        "<VTKFile type=\"UnstructuredGrid\" version=\"2.0\" byte_order=\"" BYTE_ORDER_NAME
        "\" header_type=\"UInt64\">\n"
        "<UnstructuredGrid>\n"
        "<Piece NumberOfPoints=\"%zu\" NumberOfCells=\"%zu\">\n"
        "<PointData Scalars=\"s\">\n"
        "<DataArray type=\"Float64\" Name=\"s\" format=\"appended\" offset=\"%zu\"/>\n"
        "</PointData>\n"
        "<Points>\n"
        "<DataArray type=\"Float64\" Name=\"Points\" NumberOfComponents=\"3\" format=\"appended\" "
        "offset=\"%zu\"/>\n"
        "</Points>\n"
        "<Cells>\n"
        "<DataArray type=\"Int64\" Name=\"connectivity\" format=\"appended\" offset=\"%zu\"/>\n"
        "<DataArray type=\"Int64\" Name=\"offsets\" format=\"appended\" offset=\"%zu\"/>\n"
        "<DataArray type=\"UInt8\" Name=\"types\" format=\"appended\" offset=\"%zu\"/>\n"
        "</Cells>\n"
        "</Piece>\n"
        "</UnstructuredGrid>\n"
        "<AppendedData encoding=\"raw\">\n_",
        layout->points, layout->tets, layout->start[VALUES], layout->start[POINTS],
        layout->start[CONNECTIVITY], layout->start[OFFSETS], layout->start[TYPES]);
}

/* The Bezier points of a straight tetrahedron divide it evenly. */
static void bezier_point(const struct gsn_tets *mesh, size_t tet, const uint8_t beta[4],
                         unsigned degree, double ret_point[3])
{
    for (int c = 0; c < 3; c++) {
        ret_point[c] = 0;
        for (int k = 0; k < 4; k++)
            ret_point[c] += beta[k] * mesh->vertex[mesh->tet[tet][k]][c];
        ret_point[c] /= degree;
    }
}

/* Items of an array lie anywhere in the file, aligned or not. */
static void put(uint8_t *arrays, const struct layout *layout, int array, size_t item,
                const void *bytes, size_t size)
{
    memcpy(arrays + layout->start[array] + sizeof(uint64_t) + item * size, bytes, size);
}

static void put_tet(uint8_t *arrays, const struct layout *layout, const struct gsn_spline *spline,
                    const uint8_t (*beta)[4], size_t tet)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const int64_t end = (int64_t)((tet + 1) * layout->per_tet);
    const uint8_t type = BEZIER_TETRAHEDRON;
    double coefficient[GSN_DMS_MAX_FUNCTIONS], point[3];

    gsn_spline_bernstein(spline, tet, coefficient);
    put(arrays, layout, OFFSETS, tet, &end, sizeof end);
    put(arrays, layout, TYPES, tet, &type, sizeof type);
    for (size_t p = 0; p < layout->per_tet; p++) {
        const size_t item = tet * layout->per_tet + p;
        const int64_t number = (int64_t)item;

        bezier_point(gsn_dms_mesh(space), tet, beta[p], gsn_dms_degree(space), point);
        put(arrays, layout, VALUES, item, &coefficient[gsn_simplex_place(beta[p])],
            sizeof *coefficient);
        put(arrays, layout, POINTS, item, point, sizeof point);
        put(arrays, layout, CONNECTIVITY, item, &number, sizeof number);
    }
}

static void fill(uint8_t *arrays, const struct layout *layout, const struct gsn_spline *spline)
{
    uint8_t beta[GSN_DMS_MAX_FUNCTIONS][4];

    order_points(gsn_dms_degree(gsn_spline_space(spline)), beta);
    for (int a = 0; a < ARRAYS; a++) {
        const uint64_t size = layout->size[a];

        memcpy(arrays + layout->start[a], &size, sizeof size);
    }
    for (size_t t = 0; t < layout->tets; t++)
        put_tet(arrays, layout, spline, (const uint8_t(*)[4])beta, t);
}

int gsn_vtu_write(const struct gsn_spline *spline, const char *path, struct gsn_error *err)
{
    static const char TAIL[] = "\n</AppendedData>\n</VTKFile>\n";
    const struct layout layout = lay_out(spline);
    gsn_auto_mem(char) head = describe(&layout);
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t before;

    assert(spline && path);

    if (!head)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", path);
    before = strlen(head);
    bytes = gsn_alloc(before + layout.total + sizeof TAIL - 1);
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory for %zu tetrahedra", path,
                        layout.tets);
    memcpy(bytes, head, before);
    fill(bytes + before, &layout, spline);
    memcpy(bytes + before + layout.total, TAIL, sizeof TAIL - 1);
    return gsn_file_write(path, bytes, before + layout.total + sizeof TAIL - 1, err);
}
