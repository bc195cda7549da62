/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/density.h"

#include <math.h>

#include "pipeline/core/parallel.h"
#include "pipeline/model/resample.h"

enum {
    MOST_VOXELS = 1 << 22, /* of a slab: a number each, 32 MiB */
    POINTS = 8             /* of the Gauss rule in a voxel */
};

/* One row of voxels: sums over its part of the region of the centres and of all Gauss points; the
 * first voxel of that part of which a point lies outside the mesh, SIZE_MAX if none does. */
struct row {
    double centres, gauss;
    size_t outside;
};

/* Some rows of one layer, or some whole layers, at one point of every voxel. */
struct slab {
    const struct gsn_mask *region;
    struct gsn_lattice at; /* its voxels */
    size_t first;          /* of these in the region's lattice */
    int is_centre;         /* which sum the values are of */
    double *value;
    struct row *row; /* of the region's lattice */
};

static int no_data(const struct gsn_mask *region, size_t index, struct gsn_error *err)
{
    const struct gsn_lattice *at = &region->at;

    return gsn_fail(err, GSN_E_INPUT, "voxel (%zu, %zu, %zu) of the region lies outside the domain",
                    index % at->nx, index / at->nx % at->ny, index / at->nx / at->ny);
}

/* How many rows of the lattice a slab has at most: whole layers if there is room for one. */
static size_t rows_of_slab(const struct gsn_lattice *at)
{
    const size_t rows = MOST_VOXELS / at->nx;

    if (rows == 0)
        return 1;
    return rows < at->ny ? rows : rows - rows % at->ny;
}

/* Takes the rows from first on. Returns how many it took: a part of a layer ends with it. */
static size_t place_slab(const struct gsn_lattice *at, size_t first, size_t rows, struct slab *slab)
{
    const size_t y = first % at->ny, z = first / at->ny;
    const size_t left = rows < at->ny ? at->ny - y : at->ny * (at->nz - z);
    const size_t count = rows < left ? rows : left;

    slab->first = first * at->nx;
    slab->at = *at;
    slab->at.ny = rows < at->ny ? count : at->ny;
    slab->at.nz = count / slab->at.ny;
    slab->at.origin_um = gsn_lattice_centre(at, 0, y, z);
    return count;
}

/* Only the region's voxels count: others may lie outside the mesh, or partly. */
static int add_row(size_t index, void *context, struct gsn_error *err)
{
    const struct slab *slab = context;
    const size_t n = slab->at.nx, first = slab->first + index * n;
    const double *value = slab->value + index * n;
    struct row *row = &slab->row[first / n];
    double *sum = slab->is_centre ? &row->centres : &row->gauss;

    (void)err;
    for (size_t x = 0; x < n; x++) {
        if (!slab->region->inside[first + x])
            continue;
        if (isnan(value[x]) && x < row->outside)
            row->outside = x;
        *sum += value[x];
    }
    return GSN_OK;
}

/* s at the centre (point POINTS) or one Gauss point of every voxel, added up. */
static int add_point(const struct gsn_spline *spline, struct slab *slab, int point,
                     unsigned threads, struct gsn_error *err)
{
    const double node = 0.5 / sqrt(3.0);
    struct gsn_lattice at = slab->at;
    int r;

    slab->is_centre = point == POINTS;
    if (!slab->is_centre) {
        at.origin_um.x += (point & 1 ? node : -node) * at.step_um.x;
        at.origin_um.y += (point & 2 ? node : -node) * at.step_um.y;
        at.origin_um.z += (point & 4 ? node : -node) * at.step_um.z;
    }
    r = gsn_spline_resample(spline, &at, threads, slab->value, err);
    return r < 0 ? r : gsn_parallel_for(at.ny * at.nz, threads, add_row, slab, err);
}

/* total: rows of the lattice, for progress. */
static int sum_slab(const struct gsn_spline *spline, struct slab *slab, size_t total,
                    unsigned threads, const struct gsn_progress *progress, struct gsn_error *err)
{
    const size_t rows = slab->at.ny * slab->at.nz, before = slab->first / slab->at.nx;

    for (int point = 0; point <= POINTS; point++) {
        int r;

        gsn_progress_say(progress, "density", before + rows * (size_t)point / (POINTS + 1), total);
        r = add_point(spline, slab, point, threads, err);
        if (r < 0)
            return r;
    }
    for (size_t i = before; i < before + rows; i++) {
        if (slab->row[i].outside < slab->at.nx)
            return no_data(slab->region, i * slab->at.nx + slab->row[i].outside, err);
    }
    return GSN_OK;
}

static int sum_slabs(const struct gsn_spline *spline, struct slab *slab, unsigned threads,
                     const struct gsn_progress *progress, struct gsn_error *err)
{
    const struct gsn_lattice *at = &slab->region->at;
    const size_t total = at->ny * at->nz, rows = rows_of_slab(at);
    const size_t room = (rows < total ? rows : total) * at->nx;
    gsn_auto_mem(double) value = gsn_alloc_array(room, sizeof *value);

    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu voxels", room);
    slab->value = value;
    for (size_t first = 0; first < total;) {
        const size_t count = place_slab(at, first, rows, slab);
        const int r = sum_slab(spline, slab, total, threads, progress, err);

        if (r < 0)
            return r;
        first += count;
    }
    gsn_progress_say(progress, "density", total, total);
    return GSN_OK;
}

int gsn_region_density(const struct gsn_spline *spline, const struct gsn_mask *region,
                       unsigned threads, const struct gsn_progress *progress,
                       struct gsn_region_density *ret_density, struct gsn_error *err)
{
    const size_t count = region->at.ny * region->at.nz, voxels = gsn_mask_count(region);
    gsn_auto_mem(struct row) row = NULL;
    struct slab slab = { .region = region };
    struct gsn_region_density density = { .voxels = voxels };
    int r;

    if (voxels == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region of interest is empty");
    row = gsn_alloc_array(count, sizeof *row);
    if (!row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu rows of voxels", count);
    for (size_t i = 0; i < count; i++)
        row[i] = (struct row){ .outside = SIZE_MAX };
    slab.row = row;
    r = sum_slabs(spline, &slab, threads, progress, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < count; i++) {
        density.mean += row[i].gauss;
        density.centres_mean += row[i].centres;
    }
    density.mean /= POINTS * (double)voxels;
    density.centres_mean /= (double)voxels;
    density.volume_um3 = (double)voxels * gsn_lattice_voxel_um3(&region->at);
    *ret_density = density;
    return GSN_OK;
}
