/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How dense: the mean over a region of voxels, and a figure per tetrahedron of the domain.
 *
 * Method: over the region the 2 x 2 x 2 Gauss rule in every voxel, exact for polynomials of degree
 * three, with the voxel-centre rule beside it as a measure of how well voxels resolve the field.
 * Over a tetrahedron the exact mean (equation (9)), and the share of it that lies in the region by
 * clipping it against voxels.
 *
 * Steps: (1) slabs of layers, resampled at the Gauss points (model/resample.h); (2) sums that lose
 * nothing (Neumaier) row by row, in a fixed order; (3) units: mean, share, state; (4) quartiles by
 * order statistics, a histogram with ends that the caller fixes. What sections err by is told by
 * second differences of their means.
 *
 * Failure: GSN_E_INPUT names a voxel outside the mesh; GSN_E_NOMEM.
 * Cost: nine values a voxel at the resampler's price; a unit the integral of its pieces. */
#include "pipeline/measure/density.h"

#include "pipeline/core/parallel.h"
#include "pipeline/measure/overlap.h"
#include "pipeline/measure/sum.h"
#include "pipeline/model/resample.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* --- the region --- */

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

/* --- its sections --- */

/* Mean over the region's voxels of one section that have data. */
struct section {
    double mean, voxels;
};

static struct section section_at(const struct gsn_grid *grid, const struct gsn_mask *region,
                                 size_t z)
{
    const struct gsn_lattice *const at = &grid->at;
    struct gsn_sum sum = { 0 };
    double voxels = 0;

    for (size_t y = 0; y < at->ny; y++)
        for (size_t x = 0; x < at->nx; x++) {
            const double value = (double)grid->value[gsn_lattice_index(at, x, y, z)];

            if (isnan(value) || !gsn_mask_has(region, gsn_lattice_centre(at, x, y, z)))
                continue;
            gsn_sum_add(&sum, value);
            voxels++;
        }
    return (struct section){ voxels > 0 ? (sum.value + sum.rest) / voxels : (double)NAN, voxels };
}

double gsn_section_error(const struct gsn_grid *grid, const struct gsn_mask *region)
{
    struct section last = { NAN, 0 }, before = { NAN, 0 };
    double squares = 0, weights = 0, voxels = 0, voxels_squared = 0;

    for (size_t z = 0; z < grid->at.nz; z++) {
        const struct section here = section_at(grid, region, z);

        voxels += here.voxels;
        voxels_squared += here.voxels * here.voxels;
        if (before.voxels > 0 && last.voxels > 0 && here.voxels > 0) {
            const double off = last.mean - 0.5 * (before.mean + here.mean);

            squares += last.voxels * off * off;
            weights += last.voxels;
        }
        before = last;
        last = here;
    }
    return weights > 0 ? sqrt(squares / weights / 1.5 * voxels_squared) / voxels : (double)NAN;
}

/* --- tetrahedra as units --- */

/* The box of the voxels first..end. */
static struct gsn_aabb box_of(const struct gsn_lattice *at, const size_t first[3],
                              const size_t end[3])
{
    const struct gsn_vec3 low = gsn_lattice_centre(at, first[0], first[1], first[2]);
    const struct gsn_vec3 high = gsn_lattice_centre(at, end[0] - 1, end[1] - 1, end[2] - 1);

    return (struct gsn_aabb){
        .centre = { 0.5 * (low.x + high.x), 0.5 * (low.y + high.y), 0.5 * (low.z + high.z) },
        .half = { 0.5 * at->step_um.x * (double)(end[0] - first[0]),
                  0.5 * at->step_um.y * (double)(end[1] - first[1]),
                  0.5 * at->step_um.z * (double)(end[2] - first[2]) },
    };
}

static int all_inside(const struct gsn_mask *region, const size_t first[3], const size_t end[3])
{
    for (size_t z = first[2]; z < end[2]; z++) {
        for (size_t y = first[1]; y < end[1]; y++) {
            if (memchr(region->inside + gsn_lattice_index(&region->at, first[0], y, z), 0,
                       end[0] - first[0]))
                return 0;
        }
    }
    return 1;
}

/* The volume that a tetrahedron shares with the region in one row of voxels, from first to x_end:
 * neighbours are one box. */
static double volume_in_row(const struct gsn_mask *region, const size_t first[3], size_t x_end,
                            const double corner[4][3])
{
    const uint8_t *inside = region->inside + gsn_lattice_index(&region->at, 0, first[1], first[2]);
    double volume = 0.0;

    for (size_t x = first[0]; x < x_end; x++) {
        const size_t from[3] = { x, first[1], first[2] };
        size_t to[3] = { x, first[1] + 1, first[2] + 1 };

        while (to[0] < x_end && inside[to[0]])
            to[0]++;
        if (to[0] > x) {
            const struct gsn_aabb box = box_of(&region->at, from, to);

            volume += gsn_aabb_tet_volume(&box, corner);
            x = to[0];
        }
    }
    return volume;
}

/* The volume that a tetrahedron shares with the region's voxel boxes. */
static double volume_inside(const struct gsn_mask *region, const double corner[4][3])
{
    size_t first[3], end[3];
    double volume = 0.0;

    for (int a = 0; a < 3; a++) {
        double low = corner[0][a], high = corner[0][a];

        for (int k = 1; k < 4; k++) {
            low = fmin(low, corner[k][a]);
            high = fmax(high, corner[k][a]);
        }
        gsn_voxel_range(&region->at, a, low, high, &first[a], &end[a]);
    }
    if (first[0] >= end[0] || first[1] >= end[1] || first[2] >= end[2])
        return 0.0;
    if (all_inside(region, first, end)) {
        const struct gsn_aabb box = box_of(&region->at, first, end);

        return gsn_aabb_tet_volume(&box, corner);
    }
    for (size_t z = first[2]; z < end[2]; z++) {
        for (size_t y = first[1]; y < end[1]; y++)
            volume += volume_in_row(region, (const size_t[3]){ first[0], y, z }, end[0], corner);
    }
    return volume;
}

struct units {
    const struct gsn_spline *spline;
    const struct gsn_mask *region;
    const uint32_t *samples;
    struct gsn_unit *unit;
};

static int fill_unit(size_t tet, void *context, struct gsn_error *err)
{
    const struct units *units = context;
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(units->spline));
    struct gsn_unit unit = { .mean = NAN, .volume_um3 = gsn_tets_volume(mesh, tet) };
    double corner[4][3];
    int r;

    for (int k = 0; k < 4; k++)
        memcpy(corner[k], mesh->vertex[mesh->tet[tet][k]], sizeof corner[k]);
    unit.inside_share =
        fmin(1.0, volume_inside(units->region, (const double(*)[3])corner) / unit.volume_um3);
    unit.samples = units->samples ? units->samples[tet] : 0;
    if (!(unit.inside_share > 0.0))
        unit.state = GSN_UNIT_OUTSIDE;
    else
        unit.state = units->samples && unit.samples == 0 ? GSN_UNIT_NO_DATA : GSN_UNIT_OK;
    if (unit.state == GSN_UNIT_OK) {
        r = gsn_spline_tet_mean(units->spline, tet, &unit.mean, err);
        if (r < 0)
            return gsn_fail_at(err, "tetrahedron %zu", tet);
    }
    units->unit[tet] = unit;
    return GSN_OK;
}

int gsn_units(const struct gsn_spline *spline, const struct gsn_mask *region,
              const uint32_t *samples, unsigned threads, struct gsn_unit **ret_units,
              struct gsn_error *err)
{
    const size_t count = gsn_dms_mesh(gsn_spline_space(spline))->tet_count;
    gsn_auto_mem(struct gsn_unit) unit = gsn_alloc_array(count, sizeof *unit);
    struct units units = { spline, region, samples, unit };
    int r;

    if (!unit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    r = gsn_parallel_for(count, threads, fill_unit, &units, err);
    if (r < 0)
        return r;
    *ret_units = gsn_steal(&unit);
    return GSN_OK;
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

/* sorted, count > 0 */
static double find_quantile(const double *sorted, size_t count, double q)
{
    const double place = q * (double)(count - 1);
    const size_t below = (size_t)place;

    if (below + 1 >= count)
        return sorted[count - 1];
    return sorted[below] + (place - (double)below) * (sorted[below + 1] - sorted[below]);
}

static size_t bin_of(double value, double low, double high)
{
    const double place = (value - low) / (high - low) * GSN_UNIT_BINS;

    return (size_t)fmin(GSN_UNIT_BINS - 1, fmax(0.0, place));
}

int gsn_units_summarise(const struct gsn_unit *units, size_t count, double low, double high,
                        struct gsn_units_summary *ret_summary, struct gsn_error *err)
{
    gsn_auto_mem(double) mean = gsn_alloc_array(count, sizeof *mean);
    struct gsn_units_summary summary = { .low = low, .high = high };

    assert(low < high);
    if (!mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    for (size_t i = 0; i < count; i++) {
        summary.outside += units[i].state == GSN_UNIT_OUTSIDE;
        summary.no_data += units[i].state == GSN_UNIT_NO_DATA;
        if (units[i].state == GSN_UNIT_OK) {
            mean[summary.ok++] = units[i].mean;
            summary.bin[bin_of(units[i].mean, low, high)]++;
        }
    }
    if (summary.ok > 0) {
        qsort(mean, summary.ok, sizeof *mean, by_value);
        summary.min = mean[0];
        summary.quartile1 = find_quantile(mean, summary.ok, 0.25);
        summary.median = find_quantile(mean, summary.ok, 0.5);
        summary.quartile3 = find_quantile(mean, summary.ok, 0.75);
        summary.max = mean[summary.ok - 1];
    }
    *ret_summary = summary;
    return GSN_OK;
}
