/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: libtiff into memory; the description of the first page is the OME-XML that says what the
 * pages are.
 * Reference: Open Microscopy Environment, "OME-TIFF specification" 6.2, schema 2016-06.
 *
 * Steps: the XML, with the place of each plane; a page a plane, its rows in strips of 64; the
 * bytes. Failure: memory, or libtiff's own, which is told without its printing. */
#include "pipeline/export/ome_tiff.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

#include <tiffio.h>

enum { PLANE_ROOM = 320, XML_ROOM = 2048, NAME_ROOM = 128, STRIP_ROWS = 64 };

static const double BIG = 4e9; /* bytes of colour from which TIFF's 32 bits may not do */

/* ---- a file in memory ---------------------------------------------------------------------- */

struct memory {
    uint8_t *bytes;
    size_t size, room, at;
    int failed;
};

static void memory_done(struct memory *m)
{
    gsn_free(m->bytes);
}

static tmsize_t write_memory(thandle_t handle, void *bytes, tmsize_t size)
{
    struct memory *m = handle;
    const size_t end = m->at + (size_t)size;

    if (end > m->room) {
        const size_t room = end + end / 2;
        uint8_t *more = gsn_realloc_array(m->bytes, room, 1);

        if (!more) {
            m->failed = 1;
            return -1;
        }
        memset(more + m->size, 0, room - m->size);
        m->bytes = more;
        m->room = room;
    }
    memcpy(m->bytes + m->at, bytes, (size_t)size);
    m->at = end;
    if (end > m->size)
        m->size = end;
    return size;
}

static tmsize_t read_memory(thandle_t handle, void *bytes, tmsize_t size)
{
    struct memory *m = handle;
    const size_t left = m->at < m->size ? m->size - m->at : 0;
    const size_t given = (size_t)size < left ? (size_t)size : left;

    if (given)
        memcpy(bytes, m->bytes + m->at, given);
    m->at += given;
    return (tmsize_t)given;
}

static toff_t seek_memory(thandle_t handle, toff_t offset, int whence)
{
    struct memory *m = handle;

    m->at = (size_t)offset + (whence == SEEK_CUR ? m->at : whence == SEEK_END ? m->size : 0);
    return m->at;
}

static int close_memory(thandle_t handle)
{
    (void)handle;
    return 0;
}

static toff_t size_memory(thandle_t handle)
{
    return ((struct memory *)handle)->size;
}

/* ---- OME-XML ------------------------------------------------------------------------------- */

/* gives: the name as XML. */
static void escape_name(const char *name, char ret_name[NAME_ROOM])
{
    size_t n = 0;

    for (; *name && n + 7 < NAME_ROOM; name++) {
        const char c = *name;
        const char *entity = c == '&' ? "&amp;" : c == '<' ? "&lt;" : c == '"' ? "&quot;" : NULL;

        if (entity)
            n += (size_t)snprintf(ret_name + n, NAME_ROOM - n, "%s", entity);
        else
            ret_name[n++] = c >= ' ' && c <= '~' ? c : '?';
    }
    ret_name[n] = '\0';
}

/* gives: the description, NULL when memory runs out. */
static char *describe_stack(const struct gsn_colour_grid *stack, const char *name)
{
    const struct gsn_lattice *at = &stack->at;
    const size_t room = XML_ROOM + at->nz * PLANE_ROOM;
    char *xml = gsn_alloc(room);
    char safe[NAME_ROOM];
    size_t n = 0;

    if (!xml)
        return NULL;
    escape_name(name, safe);
    n += (size_t)snprintf(
        xml, room,
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>"
        "<OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\" "
        "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" "
        "xsi:schemaLocation=\"http://www.openmicroscopy.org/Schemas/OME/2016-06 "
        "http://www.openmicroscopy.org/Schemas/OME/2016-06/ome.xsd\" Creator=\"gieson " GSN_VERSION
        "\"><Image ID=\"Image:0\" Name=\"%s\"><Pixels ID=\"Pixels:0\" DimensionOrder=\"XYCZT\" "
        "Type=\"uint8\" SizeX=\"%zu\" SizeY=\"%zu\" SizeC=\"3\" SizeZ=\"%zu\" SizeT=\"1\" "
        "Interleaved=\"true\" PhysicalSizeX=\"%.9g\" PhysicalSizeY=\"%.9g\" "
        "PhysicalSizeZ=\"%.9g\">"
        "<Channel ID=\"Channel:0:0\" SamplesPerPixel=\"3\"/><TiffData/>",
        safe, at->nx, at->ny, at->nz, at->step_um.x, at->step_um.y, at->step_um.z);
    for (size_t z = 0; z < at->nz; z++)
        n += (size_t)snprintf(xml + n, room - n,
                              "<Plane TheZ=\"%zu\" TheT=\"0\" TheC=\"0\" PositionX=\"%.9g\" "
                              "PositionXUnit=\"&#181;m\" "
                              "PositionY=\"%.9g\" PositionYUnit=\"&#181;m\" PositionZ=\"%.9g\" "
                              "PositionZUnit=\"&#181;m\"/>",
                              z, at->origin_um.x, at->origin_um.y,
                              at->origin_um.z + (double)z * at->step_um.z);
    (void)snprintf(xml + n, room - n, "</Pixels></Image></OME>");
    return xml;
}

/* ---- pages --------------------------------------------------------------------------------- */

/* row: room for one, for libtiff changes what it is given. */
static int write_page(TIFF *tiff, const struct gsn_colour_grid *stack, size_t z, const char *xml,
                      uint8_t *row)
{
    const struct gsn_lattice *at = &stack->at;
    const size_t size = 3 * at->nx;
    int ok = TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, (uint32_t)at->nx) &&
             TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, (uint32_t)at->ny) &&
             TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 8) &&
             TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 3) &&
             TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_RGB) &&
             TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG) &&
             TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_ADOBE_DEFLATE) &&
             TIFFSetField(tiff, TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL) &&
             TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, STRIP_ROWS) &&
             TIFFSetField(tiff, TIFFTAG_RESOLUTIONUNIT, RESUNIT_CENTIMETER) &&
             TIFFSetField(tiff, TIFFTAG_XRESOLUTION, 1e4 / at->step_um.x) &&
             TIFFSetField(tiff, TIFFTAG_YRESOLUTION, 1e4 / at->step_um.y) &&
             (z > 0 || TIFFSetField(tiff, TIFFTAG_IMAGEDESCRIPTION, xml));

    for (size_t y = 0; ok && y < at->ny; y++) {
        memcpy(row, stack->rgb + (z * at->ny + y) * size, size);
        ok = TIFFWriteScanline(tiff, row, (uint32_t)y, 0) == 1;
    }
    return ok && TIFFWriteDirectory(tiff);
}

int gsn_ome_tiff_write(const struct gsn_colour_grid *stack, const char *name, uint8_t **ret_bytes,
                       size_t *ret_size, struct gsn_error *err)
{
    struct memory m __attribute__((cleanup(memory_done))) = { .size = 0 };
    gsn_auto_mem(char) xml = describe_stack(stack, name);
    gsn_auto_mem(uint8_t) row = gsn_alloc_array(stack->at.nx, 3);
    const double colour = 3.0 * (double)gsn_lattice_count(&stack->at);
    TIFF *tiff;
    int ok;

    assert(ret_bytes && ret_size);

    if (!xml || !row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the description of a stack");
    (void)TIFFSetErrorHandler(NULL);
    (void)TIFFSetWarningHandler(NULL);
    tiff = TIFFClientOpen("stack.ome.tif", colour < BIG ? "w" : "w8", &m, read_memory, write_memory,
                          seek_memory, close_memory, size_memory, NULL, NULL);
    ok = tiff != NULL;
    for (size_t z = 0; ok && z < stack->at.nz; z++)
        ok = write_page(tiff, stack, z, xml, row);
    if (tiff)
        TIFFClose(tiff);
    if (!ok || m.failed)
        return gsn_fail(err, m.failed ? GSN_E_NOMEM : GSN_E_IO,
                        m.failed ? "out of memory for a stack of %zu planes"
                                 : "libtiff could not write a stack of %zu planes",
                        stack->at.nz);
    *ret_bytes = gsn_steal(&m.bytes);
    *ret_size = m.size;
    return GSN_OK;
}
