/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Fills short gaps of a stack along z in a straight line, and measures on the stack itself what
 * that costs.
 *
 * Steps: (1) the region's voxels are counted. (2) For each length of gap, every run of planes that
 * is there is left out in turn and compared with its interpolation (leave-out cross-validation):
 * the root mean square error of the region's mean over a window. (3) Each column's gaps that both
 * ends bound are filled. (4) Gaps of one start and length are wrong together, others independently:
 * the standard error of the region's mean.
 *
 * Fails, with the grid untouched, when memory runs out. */
#include "pipeline/register/stack/gap_interpolation.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>

enum { LONGEST = GSN_GAP_LONGEST };

/* A window of one plane left out says something of the region when it holds at least this share of
 * the region's voxels per plane. */
static const double LEAST_WINDOW = 0.1;

struct work {
    struct gsn_grid *grid;
    const struct gsn_mask *region;
    size_t columns, planes;
    bool *inside;   /* of the region, per voxel of the grid */
    size_t *filled; /* [start plane][length - 1]: voxels of the region */
    struct gsn_gap_interpolation *bridge;
};

static float *get_voxel(const struct work *w, size_t column, size_t plane)
{
    return &w->grid->value[plane * w->columns + column];
}

static bool is_inside(const struct work *w, size_t column, size_t plane)
{
    return w->inside[plane * w->columns + column];
}

static void count_region(struct work *w)
{
    const struct gsn_lattice *const at = &w->grid->at;

    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                if (!gsn_mask_has(w->region, gsn_lattice_centre(at, x, y, z)))
                    continue;
                w->inside[i] = true;
                w->bridge->region++;
                w->bridge->measured += isfinite(w->grid->value[i]) != 0;
            }
}

/* The straight line between the voxels before plane `from` and behind the gap of `length`. */
static double interpolate(const struct work *w, size_t column, size_t from, size_t length, size_t k)
{
    const double a = (double)*get_voxel(w, column, from - 1);
    const double b = (double)*get_voxel(w, column, from + length);

    return a + (b - a) * (double)(k + 1) / (double)(length + 1);
}

/* Sums what bridging planes from..from+length-1 would get wrong over the region's voxels there, in
 * the columns where all of them and both ends are measured. */
static size_t sum_window_error(const struct work *w, size_t from, size_t length, double *ret_sum)
{
    size_t count = 0;

    *ret_sum = 0;
    for (size_t column = 0; column < w->columns; column++) {
        bool whole = isfinite(*get_voxel(w, column, from - 1)) != 0;
        double sum = 0;

        for (size_t k = 0; whole && k < length; k++)
            whole = is_inside(w, column, from + k) && isfinite(*get_voxel(w, column, from + k));
        if (!whole || !isfinite(*get_voxel(w, column, from + length)))
            continue;
        for (size_t k = 0; k < length; k++)
            sum +=
                (double)*get_voxel(w, column, from + k) - interpolate(w, column, from, length, k);
        *ret_sum += sum;
        count += length;
    }
    return count;
}

/* Root mean square error of a bridge of this length, over all that can be tried; NaN when none can.
 * To be called before anything is filled. */
static double measure_error(const struct work *w, size_t length)
{
    const double least =
        LEAST_WINDOW * (double)w->bridge->region / (double)w->planes * (double)length;
    double squares = 0;
    size_t windows = 0;

    for (size_t from = 1; from + length < w->planes; from++) {
        double sum;
        const size_t count = sum_window_error(w, from, length, &sum);

        if (count == 0 || (double)count < least)
            continue;
        squares += pow(sum / (double)count, 2);
        windows++;
    }
    return windows > 0 ? sqrt(squares / (double)windows) : (double)NAN;
}

static void fill_gap(struct work *w, size_t column, size_t from, size_t length)
{
    for (size_t k = 0; k < length; k++) {
        *get_voxel(w, column, from + k) = (float)interpolate(w, column, from, length, k);
        if (is_inside(w, column, from + k)) {
            w->filled[from * LONGEST + length - 1]++;
            w->bridge->bridged++;
        }
    }
}

static void fill_column(struct work *w, size_t column)
{
    size_t from = 0;

    for (size_t z = 0; z < w->planes; z++) {
        if (!isfinite(*get_voxel(w, column, z)))
            continue;
        if (from > 0 && z > from && z - from <= LONGEST)
            fill_gap(w, column, from, z - from);
        from = z + 1;
    }
}

/* Gaps of one start and length are wrong together. */
static double total_error(const struct work *w, const double error[LONGEST])
{
    double variance = 0;

    for (size_t i = 0; i < w->planes * LONGEST; i++)
        if (w->filled[i])
            variance +=
                pow((double)w->filled[i] / (double)w->bridge->region * error[i % LONGEST], 2);
    return sqrt(variance);
}

static size_t touched_planes(const struct work *w)
{
    size_t count = 0;

    for (size_t z = 0; z < w->planes; z++) {
        bool any = false;

        for (size_t back = 0; back < LONGEST && back <= z; back++)
            for (size_t length = back + 1; length <= LONGEST; length++)
                any = any || w->filled[(z - back) * LONGEST + length - 1] > 0;
        count += any;
    }
    return count;
}

int gsn_gap_interpolate(struct gsn_grid *grid, const struct gsn_mask *region,
                        struct gsn_gap_interpolation *ret_bridge, struct gsn_error *err)
{
    const size_t total = gsn_lattice_count(&grid->at);
    gsn_auto_mem(bool) inside = gsn_alloc_array(total, sizeof *inside);
    gsn_auto_mem(size_t) filled = gsn_alloc_array(grid->at.nz * LONGEST, sizeof *filled);
    struct gsn_gap_interpolation bridge = { 0 };
    struct work w = { .grid = grid,
                      .region = region,
                      .columns = grid->at.nx * grid->at.ny,
                      .planes = grid->at.nz,
                      .inside = inside,
                      .filled = filled,
                      .bridge = &bridge };
    double error[LONGEST];

    assert(grid && region && ret_bridge);

    if (!inside || !filled)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the gaps of a stack");
    count_region(&w);
    for (size_t length = 1; length <= LONGEST; length++)
        error[length - 1] = measure_error(&w, length);
    for (size_t column = 0; column < w.columns; column++)
        fill_column(&w, column);
    bridge.error = total_error(&w, error);
    bridge.planes = touched_planes(&w);
    *ret_bridge = bridge;
    return GSN_OK;
}
