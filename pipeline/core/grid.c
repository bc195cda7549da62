/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Lattices, grids and masks: index and place of a voxel, zeroed memory for all of them (refused
 * where their number overflows), and the voxel whose centre is nearest to a point. */
#include "pipeline/core/grid.h"

#include <math.h>

size_t gsn_lattice_count(const struct gsn_lattice *at)
{
    return at->nx * at->ny * at->nz;
}

size_t gsn_lattice_index(const struct gsn_lattice *at, size_t x, size_t y, size_t z)
{
    return (z * at->ny + y) * at->nx + x;
}

struct gsn_vec3 gsn_lattice_centre(const struct gsn_lattice *at, size_t x, size_t y, size_t z)
{
    return gsn_vec3_make(at->origin_um.x + (double)x * at->step_um.x,
                         at->origin_um.y + (double)y * at->step_um.y,
                         at->origin_um.z + (double)z * at->step_um.z);
}

double gsn_lattice_voxel_um3(const struct gsn_lattice *at)
{
    return at->step_um.x * at->step_um.y * at->step_um.z;
}

/* Zeroed room for one item a voxel, or NULL, also when there are more than can be counted. */
static void *alloc_voxels(const struct gsn_lattice *at, size_t size)
{
    size_t count;

    if (__builtin_mul_overflow(at->nx, at->ny, &count) ||
        __builtin_mul_overflow(count, at->nz, &count))
        return NULL;
    return gsn_alloc_array(count, size);
}

int gsn_grid_new(const struct gsn_lattice *at, struct gsn_grid **ret_grid, struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = gsn_alloc_array(1, sizeof *grid);

    if (grid)
        *grid = (struct gsn_grid){ .at = *at, .value = alloc_voxels(at, sizeof(float)) };
    if (!grid || !grid->value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a grid of %zu x %zu x %zu", at->nx,
                        at->ny, at->nz);
    *ret_grid = gsn_steal(&grid);
    return GSN_OK;
}

void gsn_grid_free(struct gsn_grid *grid)
{
    if (!grid)
        return;
    gsn_free(grid->value);
    gsn_free(grid);
}

int gsn_mask_new(const struct gsn_lattice *at, struct gsn_mask **ret_mask, struct gsn_error *err)
{
    gsn_auto(gsn_mask) mask = gsn_alloc_array(1, sizeof *mask);

    if (mask)
        *mask = (struct gsn_mask){ .at = *at, .inside = alloc_voxels(at, 1) };
    if (!mask || !mask->inside)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a mask of %zu x %zu x %zu", at->nx,
                        at->ny, at->nz);
    *ret_mask = gsn_steal(&mask);
    return GSN_OK;
}

void gsn_mask_free(struct gsn_mask *mask)
{
    if (!mask)
        return;
    gsn_free(mask->inside);
    gsn_free(mask);
}

size_t gsn_mask_count(const struct gsn_mask *mask)
{
    const size_t total = gsn_lattice_count(&mask->at);
    size_t count = 0;

    for (size_t i = 0; i < total; i++)
        count += mask->inside[i] != 0;
    return count;
}

/* The cell index along one axis, or n when the point lies beyond. */
static size_t find_cell(double at, double origin, double step, size_t n)
{
    const double c = floor((at - origin) / step + 0.5);

    return c >= 0 && c < (double)n ? (size_t)c : n;
}

void gsn_mask_box(const struct gsn_mask *mask, double ret_low[3], double ret_high[3])
{
    const struct gsn_lattice *at = &mask->at;
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };

    for (int c = 0; c < 3; c++) {
        ret_low[c] = INFINITY;
        ret_high[c] = -INFINITY;
    }
    for (size_t i = 0; i < gsn_lattice_count(at); i++) {
        const struct gsn_vec3 u =
            gsn_lattice_centre(at, i % at->nx, i / at->nx % at->ny, i / at->nx / at->ny);
        const double middle[3] = { u.x, u.y, u.z };

        for (int c = 0; mask->inside[i] && c < 3; c++) {
            ret_low[c] = fmin(ret_low[c], middle[c] - step[c] / 2);
            ret_high[c] = fmax(ret_high[c], middle[c] + step[c] / 2);
        }
    }
}

int gsn_mask_has(const struct gsn_mask *mask, struct gsn_vec3 p)
{
    const struct gsn_lattice *at = &mask->at;
    const size_t x = find_cell(p.x, at->origin_um.x, at->step_um.x, at->nx);
    const size_t y = find_cell(p.y, at->origin_um.y, at->step_um.y, at->ny);
    const size_t z = find_cell(p.z, at->origin_um.z, at->step_um.z, at->nz);

    return x < at->nx && y < at->ny && z < at->nz &&
           mask->inside[gsn_lattice_index(at, x, y, z)] != 0;
}
