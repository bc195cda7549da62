/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/density.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/core/parallel.h"
#include "pipeline/measure/overlap.h"

/* The box of the voxels first..end. */
static struct gsn_box box_of(const struct gsn_lattice *at, const size_t first[3],
                             const size_t end[3])
{
    const struct gsn_vec3 low = gsn_lattice_centre(at, first[0], first[1], first[2]);
    const struct gsn_vec3 high = gsn_lattice_centre(at, end[0] - 1, end[1] - 1, end[2] - 1);

    return (struct gsn_box){
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
            const struct gsn_box box = box_of(&region->at, from, to);

            volume += gsn_box_tet_volume(&box, corner);
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
        gsn_overlap_range(&region->at, a, low, high, &first[a], &end[a]);
    }
    if (first[0] >= end[0] || first[1] >= end[1] || first[2] >= end[2])
        return 0.0;
    if (all_inside(region, first, end)) {
        const struct gsn_box box = box_of(&region->at, first, end);

        return gsn_box_tet_volume(&box, corner);
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
