/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: VTU with "appended raw" arrays, each behind its length in 64 bits; offsets are known
 * before anything is written. CSV row by row into a buffer of the longest rows there can be.
 * Reference: VTK, "VTK XML Formats"; RFC 4180. Failure: memory.
 * Cost: the file's size in memory, the cells' arrays beside it. */
#include "pipeline/export/cells_file.h"

#include "pipeline/model/bezier_cells.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are written as they lie");

enum { MOST_ARRAYS = 9, XML_ROOM = 4096, NUMBER_ROOM = 28, ROW_ROOM = 15 * NUMBER_ROOM };

/* ---- VTU ----------------------------------------------------------------------------------- */

struct array {
    const char *section; /* the element that it belongs to */
    const char *name, *type;
    int components;
    const void *values;
    size_t size; /* bytes */
};

static void add_array(struct array *list, size_t *count, struct array array)
{
    if (array.values)
        list[(*count)++] = array;
}

static size_t list_arrays(const struct gsn_bezier_cells *p, const struct gsn_model_cells *cells,
                          struct array list[MOST_ARRAYS])
{
    const size_t tets = p->tets;
    size_t count = 0;

    add_array(list, &count, (struct array){ "PointData", "s", "Float64", 1, p->s, 8 * p->points });
    add_array(list, &count,
              (struct array){ "CellData", "density", "Float64", 1, cells->density, 8 * tets });
    add_array(
        list, &count,
        (struct array){ "CellData", "inside_share", "Float64", 1, cells->inside_share, 8 * tets });
    add_array(list, &count,
              (struct array){ "CellData", "residual", "Float64", 1, cells->residual, 8 * tets });
    add_array(list, &count,
              (struct array){ "CellData", "samples", "UInt32", 1, cells->samples, 4 * tets });
    add_array(list, &count,
              (struct array){ "Points", "Points", "Float64", 3, p->point, 24 * p->points });
    add_array(
        list, &count,
        (struct array){ "Cells", "connectivity", "Int64", 1, p->connectivity, 8 * p->points });
    /* VTU's offsets are the ends of the cells. */
    add_array(list, &count,
              (struct array){ "Cells", "offsets", "Int64", 1, p->offset + 1, 8 * tets });
    add_array(list, &count, (struct array){ "Cells", "types", "UInt8", 1, p->type, tets });
    return count;
}

/* The XML up to the first appended byte; its length. */
static size_t write_xml(const struct gsn_bezier_cells *p, const struct array *list, size_t count,
                        char xml[XML_ROOM])
{
    const char *open = "";
    size_t offset = 0;
    int n = snprintf(xml, XML_ROOM,
                     "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"2.2\" "
                     "byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<UnstructuredGrid>\n"
                     "<Piece NumberOfPoints=\"%zu\" NumberOfCells=\"%zu\">\n",
                     p->points, p->tets);

    for (size_t i = 0; i < count; i++) {
        if (strcmp(open, list[i].section) != 0) {
            if (*open)
                n += snprintf(xml + n, XML_ROOM - (size_t)n, "</%s>\n", open);
            open = list[i].section;
            n += snprintf(xml + n, XML_ROOM - (size_t)n, "<%s>\n", open);
        }
        n += snprintf(xml + n, XML_ROOM - (size_t)n,
                      "<DataArray type=\"%s\" Name=\"%s\" NumberOfComponents=\"%d\" "
                      "format=\"appended\" offset=\"%zu\"/>\n",
                      list[i].type, list[i].name, list[i].components, offset);
        offset += sizeof(uint64_t) + list[i].size;
    }
    n += snprintf(xml + n, XML_ROOM - (size_t)n,
                  "</%s>\n</Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_", open);
    return (size_t)n;
}

int gsn_vtu_write(const struct gsn_model *model, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err)
{
    static const char tail[] = "\n</AppendedData>\n</VTKFile>\n";
    gsn_auto(gsn_bezier_cells) p = NULL;
    struct array list[MOST_ARRAYS];
    char xml[XML_ROOM];
    size_t count, length, size;
    uint8_t *bytes, *at;
    const int r = gsn_bezier_cells_new(model->spline, &p, err);

    assert(ret_bytes && ret_size);

    if (r < 0)
        return r;
    count = list_arrays(p, &model->cells, list);
    length = write_xml(p, list, count, xml);
    size = length + sizeof tail - 1;
    for (size_t i = 0; i < count; i++)
        size += sizeof(uint64_t) + list[i].size;
    bytes = at = gsn_alloc(size);
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a model of %zu tetrahedra", p->tets);
    at = memcpy(at, xml, length);
    at += length;
    for (size_t i = 0; i < count; i++) {
        const uint64_t bytes_behind = list[i].size;

        memcpy(at, &bytes_behind, sizeof bytes_behind);
        memcpy(at + sizeof bytes_behind, list[i].values, list[i].size);
        at += sizeof bytes_behind + list[i].size;
    }
    memcpy(at, tail, sizeof tail - 1);
    *ret_bytes = bytes;
    *ret_size = size;
    return GSN_OK;
}

/* ---- CSV ----------------------------------------------------------------------------------- */

/* ",number" with all its digits, "," alone where it is not known. */
static size_t put_number(char *at, double value)
{
    return (size_t)(isfinite(value) ? snprintf(at, NUMBER_ROOM, ",%.17g", value)
                                    : snprintf(at, NUMBER_ROOM, ","));
}

static size_t put_row(const struct gsn_model *model, size_t tet, char *at)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(model->space);
    const struct gsn_model_cells *cells = &model->cells;
    size_t n = (size_t)snprintf(at, NUMBER_ROOM, "%zu", tet);

    for (int c = 0; c < 3; c++) {
        double sum = 0;

        for (int k = 0; k < 4; k++)
            sum += mesh->vertex[mesh->tet[tet][k]][c];
        n += put_number(at + n, sum / 4);
    }
    n += put_number(at + n, gsn_tets_volume(mesh, tet));
    n += put_number(at + n, cells->density ? cells->density[tet] : (double)NAN);
    n += put_number(at + n, cells->inside_share ? cells->inside_share[tet] : (double)NAN);
    n += put_number(at + n, cells->samples ? (double)cells->samples[tet] : (double)NAN);
    n += put_number(at + n, cells->residual ? cells->residual[tet] : (double)NAN);
    n += (size_t)snprintf(at + n, NUMBER_ROOM, "\r\n");
    return n;
}

int gsn_units_csv_write(const struct gsn_model *model, uint8_t **ret_bytes, size_t *ret_size,
                        struct gsn_error *err)
{
    static const char head[] =
        "cell,x_um,y_um,z_um,volume_um3,density,inside_share,samples,residual\r\n";
    const size_t tets = gsn_dms_mesh(model->space)->tet_count;
    char *text = gsn_alloc_array(sizeof head + tets * ROW_ROOM, 1);
    size_t n = sizeof head - 1;

    assert(ret_bytes && ret_size);

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %zu tetrahedra", tets);
    memcpy(text, head, n);
    for (size_t t = 0; t < tets; t++)
        n += put_row(model, t, text + n);
    *ret_bytes = (uint8_t *)text;
    *ret_size = n;
    return GSN_OK;
}

static size_t put_base_row(const struct gsn_base_side *side, const struct gsn_base_cell *cell,
                           const struct gsn_loss_cell *loss, char *at)
{
    size_t n = (size_t)snprintf(at, ROW_ROOM, "%d,%d,%d,%d", cell->address.cube[0],
                                cell->address.cube[1], cell->address.cube[2], cell->address.tet);
    double corner[4][3];

    gsn_base_corners(cell->address, corner);
    for (int c = 0; c < 3; c++)
        n += put_number(at + n, 0.25 * (corner[0][c] + corner[1][c] + corner[2][c] + corner[3][c]));
    n += put_number(at + n, cell->volume_um3);
    n += put_number(at + n, cell->mean);
    n += put_number(at + n, side->plane_error / sqrt(cell->planes));
    n += put_number(at + n, loss ? loss->control : (double)NAN);
    n += put_number(at + n, loss ? loss->control_error : (double)NAN);
    n += put_number(at + n, loss ? loss->percent : (double)NAN);
    n += put_number(at + n, loss ? loss->error : (double)NAN);
    n += (size_t)snprintf(at + n, NUMBER_ROOM, "\r\n");
    return n;
}

int gsn_base_csv_write(const struct gsn_base_side *side, const struct gsn_loss_map *map,
                       uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err)
{
    static const char head[] =
        "cube_x,cube_y,cube_z,tet,x_um,y_um,z_um,volume_um3,density,density_error,"
        "baseline_density,baseline_error,loss_percent,loss_error\r\n";
    const struct gsn_base_cells *const cells = side->cells;
    char *text = gsn_alloc_array(sizeof head + cells->count * ROW_ROOM, 1);
    size_t n = sizeof head - 1, lost = 0;

    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %zu cells", cells->count);
    memcpy(text, head, n);
    for (size_t i = 0; i < cells->count; i++) {
        const struct gsn_loss_cell *const next = map && lost < map->count ? &map->cell[lost] : NULL;
        const int has_loss = next && gsn_base_compare(next->address, cells->cell[i].address) == 0;

        n += put_base_row(side, &cells->cell[i], has_loss ? next : NULL, text + n);
        lost += (size_t)has_loss;
    }
    *ret_bytes = (uint8_t *)text;
    *ret_size = n;
    return GSN_OK;
}
