/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/density.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/core/parallel.h"
#include "pipeline/measure/overlap.h"

enum { BATCHES = 16 }; /* how often progress is said */

/* Sums over one row of voxels: the centres, and the means of the eight Gauss points. */
struct row {
    double centres, gauss;
};

struct rows {
    const struct gsn_spline *spline;
    const struct gsn_mask *region;
    size_t first; /* of this batch */
    struct row *row;
};

static int no_data(const struct gsn_mask *region, size_t index, struct gsn_error *err)
{
    const struct gsn_lattice *at = &region->at;

    return gsn_fail(err, GSN_E_INPUT, "voxel (%zu, %zu, %zu) of the region lies outside the domain",
                    index % at->nx, index / at->nx % at->ny, index / at->nx / at->ny);
}

static int voxel_means(const struct gsn_spline *spline, const struct gsn_box *box, size_t *hint,
                       double *ret_centre, double *ret_gauss)
{
    const double node = 1.0 / sqrt(3.0);
    double sum = 0.0;

    if (gsn_spline_eval(spline, box->centre, hint, ret_centre, NULL) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    for (int k = 0; k < 8; k++) {
        double u[3], value;

        for (int a = 0; a < 3; a++)
            u[a] = box->centre[a] + ((k >> a & 1) ? node : -node) * box->half[a];
        if (gsn_spline_eval(spline, u, hint, &value, NULL) != GSN_OK)
            return GSN_DMS_OUTSIDE;
        sum += value;
    }
    *ret_gauss = sum / 8.0;
    return GSN_OK;
}

static int sum_row(size_t index, void *context, struct gsn_error *err)
{
    const struct rows *rows = context;
    const struct gsn_lattice *at = &rows->region->at;
    const size_t first = (rows->first + index) * at->nx;
    struct row sum = { 0.0, 0.0 };
    size_t hint = 0;

    for (size_t i = first; i < first + at->nx; i++) {
        const struct gsn_box box = gsn_overlap_box(at, i);
        double centre, gauss;

        if (!rows->region->inside[i])
            continue;
        if (voxel_means(rows->spline, &box, &hint, &centre, &gauss) != GSN_OK)
            return no_data(rows->region, i, err);
        sum.centres += centre;
        sum.gauss += gauss;
    }
    rows->row[rows->first + index] = sum;
    return GSN_OK;
}

int gsn_region_density(const struct gsn_spline *spline, const struct gsn_mask *region,
                       unsigned threads, const struct gsn_progress *progress,
                       struct gsn_region_density *ret_density, struct gsn_error *err)
{
    const size_t count = region->at.ny * region->at.nz, voxels = gsn_mask_count(region);
    gsn_auto_mem(struct row) row = NULL;
    struct rows rows = { .spline = spline, .region = region };
    struct gsn_region_density density = { .voxels = voxels };

    if (voxels == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region of interest is empty");
    row = gsn_alloc_array(count, sizeof *row);
    if (!row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu rows of voxels", count);
    rows.row = row;
    for (size_t batch = 0; batch < BATCHES; batch++) {
        const size_t first = count * batch / BATCHES, end = count * (batch + 1) / BATCHES;
        int r;

        gsn_progress_say(progress, "density", first, count);
        rows.first = first;
        r = gsn_parallel_for(end - first, threads, sum_row, &rows, err);
        if (r < 0)
            return r;
    }
    gsn_progress_say(progress, "density", count, count);
    for (size_t i = 0; i < count; i++) {
        density.mean += row[i].gauss;
        density.centres_mean += row[i].centres;
    }
    density.mean /= (double)voxels;
    density.centres_mean /= (double)voxels;
    density.volume_um3 = (double)voxels * gsn_lattice_voxel_um3(&region->at);
    *ret_density = density;
    return GSN_OK;
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
        gsn_overlap_range(&region->at, a, low, high, &first[a], &end[a]);
    }
    for (size_t z = first[2]; z < end[2]; z++) {
        for (size_t y = first[1]; y < end[1]; y++) {
            for (size_t x = first[0]; x < end[0]; x++) {
                const size_t index = gsn_lattice_index(&region->at, x, y, z);

                if (region->inside[index]) {
                    const struct gsn_box box = gsn_overlap_box(&region->at, index);

                    volume += gsn_box_tet_volume(&box, corner);
                }
            }
        }
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
static double quantile(const double *sorted, size_t count, double q)
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
        summary.quartile1 = quantile(mean, summary.ok, 0.25);
        summary.median = quantile(mean, summary.ok, 0.5);
        summary.quartile3 = quantile(mean, summary.ok, 0.75);
        summary.max = mean[summary.ok - 1];
    }
    *ret_summary = summary;
    return GSN_OK;
}
