/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A colour volume in memory, and as an NRRD file (format NRRD0004 of Teem) with its header and raw
 * samples in one piece.
 *
 * Reading back is no parser of that format: the numbers are scanned out of the header, the header
 * is written anew from them, and the file is ours when the two are equal byte by byte.
 *
 * Failure: GSN_E_INPUT for a file of anybody else or of another length than it states. Cost: one
 * copy. */
#include "pipeline/core/colour_grid.h"

#include <stdio.h>
#include <string.h>

int gsn_colour_grid_new(const struct gsn_lattice *at, struct gsn_colour_grid **ret_grid,
                        struct gsn_error *err)
{
    gsn_auto(gsn_colour_grid) grid = gsn_alloc_array(1, sizeof *grid);
    const size_t plane = at->nx * at->ny;

    if (grid && (at->ny == 0 || plane / at->ny == at->nx) && plane <= SIZE_MAX / 3)
        grid->rgb = gsn_alloc_array(at->nz, 3 * plane);
    if (!grid || !grid->rgb)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a colour volume of %zu x %zu x %zu",
                        at->nx, at->ny, at->nz);
    grid->at = *at;
    *ret_grid = gsn_steal(&grid);
    return GSN_OK;
}

void gsn_colour_grid_free(struct gsn_colour_grid *grid)
{
    if (!grid)
        return;
    gsn_free(grid->rgb);
    gsn_free(grid);
}

enum { HEAD_ROOM = 640 };

static int write_head(const struct gsn_lattice *at, char head[HEAD_ROOM])
{
    return snprintf(head, HEAD_ROOM,
                    "NRRD0004\n# sRGB codes of 8 bits; 0 0 0: no data\ntype: uint8\ndimension: 4\n"
                    "space dimension: 3\nsizes: 3 %zu %zu %zu\n"
                    "space directions: none (%.9g,0,0) (0,%.9g,0) (0,0,%.9g)\n"
                    "space origin: (%.9g,%.9g,%.9g)\nspace units: \"um\" \"um\" \"um\"\n"
                    "kinds: RGB-color domain domain domain\nencoding: raw\n\n",
                    at->nx, at->ny, at->nz, at->step_um.x, at->step_um.y, at->step_um.z,
                    at->origin_um.x, at->origin_um.y, at->origin_um.z);
}

int gsn_colour_grid_nrrd(const struct gsn_colour_grid *grid, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err)
{
    const size_t samples = 3 * gsn_lattice_count(&grid->at);
    char head[HEAD_ROOM];
    const int length = write_head(&grid->at, head);
    uint8_t *bytes = gsn_alloc((size_t)length + samples);

    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the file of a colour volume");
    memcpy(bytes, head, (size_t)length);
    memcpy(bytes + length, grid->rgb, samples);
    *ret_bytes = bytes;
    *ret_size = (size_t)length + samples;
    return GSN_OK;
}

/* A head is one of ours when its numbers give the same head again. */
int gsn_colour_grid_read(const uint8_t *bytes, size_t size, struct gsn_colour_grid **ret_grid,
                         struct gsn_error *err)
{
    gsn_auto(gsn_colour_grid) grid = NULL;
    char text[HEAD_ROOM] = "", head[HEAD_ROOM];
    struct gsn_lattice at;
    size_t length = 0;
    const char *sizes, *directions, *origin;
    int r;

    memcpy(text, bytes, size < HEAD_ROOM - 1 ? size : HEAD_ROOM - 1);
    sizes = strstr(text, "\nsizes: ");
    directions = strstr(text, "\nspace directions: ");
    origin = strstr(text, "\nspace origin: ");
    if (sizes && directions && origin &&
        sscanf(sizes, " sizes: 3 %zu %zu %zu", &at.nx, &at.ny, &at.nz) == 3 &&
        sscanf(directions, " space directions: none (%lf,0,0) (0,%lf,0) (0,0,%lf)", &at.step_um.x,
               &at.step_um.y, &at.step_um.z) == 3 &&
        sscanf(origin, " space origin: (%lf,%lf,%lf)", &at.origin_um.x, &at.origin_um.y,
               &at.origin_um.z) == 3)
        length = (size_t)write_head(&at, head);
    if (length == 0 || length >= HEAD_ROOM || length > size || memcmp(head, bytes, length) != 0)
        return gsn_fail(err, GSN_E_INPUT, "this is no colour volume that gieson wrote");
    r = gsn_colour_grid_new(&at, &grid, err);
    if (r < 0)
        return r;
    if (size - length != 3 * gsn_lattice_count(&at))
        return gsn_fail(err, GSN_E_INPUT,
                        "a colour volume of %zu x %zu x %zu voxels has not %zu bytes", at.nx, at.ny,
                        at.nz, size - length);
    memcpy(grid->rgb, bytes + length, size - length);
    *ret_grid = gsn_steal(&grid);
    return GSN_OK;
}
