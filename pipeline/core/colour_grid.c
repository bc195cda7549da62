/* SPDX-License-Identifier: AGPL-3.0-or-later */
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

int gsn_colour_grid_nrrd(const struct gsn_colour_grid *grid, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err)
{
    const struct gsn_lattice *at = &grid->at;
    const size_t samples = 3 * gsn_lattice_count(at);
    char head[640];
    const int length =
        snprintf(head, sizeof head,
                 "NRRD0004\n# sRGB codes of 8 bits; 0 0 0: no data\ntype: uint8\ndimension: 4\n"
                 "space dimension: 3\nsizes: 3 %zu %zu %zu\n"
                 "space directions: none (%.9g,0,0) (0,%.9g,0) (0,0,%.9g)\n"
                 "space origin: (%.9g,%.9g,%.9g)\nspace units: \"um\" \"um\" \"um\"\n"
                 "kinds: RGB-color domain domain domain\nencoding: raw\n\n",
                 at->nx, at->ny, at->nz, at->step_um.x, at->step_um.y, at->step_um.z,
                 at->origin_um.x, at->origin_um.y, at->origin_um.z);
    uint8_t *bytes = gsn_alloc((size_t)length + samples);

    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the file of a colour volume");
    memcpy(bytes, head, (size_t)length);
    memcpy(bytes + length, grid->rgb, samples);
    *ret_bytes = bytes;
    *ret_size = (size_t)length + samples;
    return GSN_OK;
}
