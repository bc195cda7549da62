/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Nested layers along the walls of a density.
 *
 * Method: the isosurface halfway between two plateaus, the signed distance from it, and level sets
 * of that one distance as triangles (level_surface.c). The level is the one at which the density is
 * steepest on average. Reference: J. Weszka, A. Rosenfeld, "Histogram modification for threshold
 * selection", 1979, 10.1109/TSMC.1979.4310072.
 *
 * Steps: (1) noise, from what a voxel differs from the mean of the planes beside it; (2) voxels
 * smoothed a little, to find walls only: nobody fits them; (3) the value
 * where they are steepest, the medians on its two sides are the plateaus, the level is between
 * them; plateaus that are not well apart are none; (4) where the edges of the lattice cross the
 * level there is wall, as far as the density is steep there; how steep gives the blur; (5) signed
 * distance of the voxels around, along the normal of the nearest crossing, smoothed by 0.7 voxel;
 * (6) its levels at -3, -1, 1 and 3 blurs, where the region is, without triangles that cross; (7)
 * points around the region, a voxel outside of it.
 *
 * Failure: memory; a region without data. No walls is an answer. Cost: linear in the voxels, and
 * some hundred voxels visited for each that a wall passes. */
#include "pipeline/model/wall_layers.h"

#include "pipeline/core/distance.h"
#include "pipeline/core/robust.h"
#include "pipeline/model/bvh.h"
#include "pipeline/model/level_surface.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

enum { PAD = 7, BINS = 100, LAYERS = 4 };

/* Of the layers, in blurs; those that matter more come first. */
static const double OFFSET[LAYERS] = { -1, 1, -3, 3 };
static const double EDGE_VOXELS = 4.5, RIM_VOXELS = 5;

/* Voxels outside the region: what its surface goes through, and a shell around that, so that a
 * tetrahedron which must be kept for the corner of a voxel does not reach far out. */
static const double RIM_AT[] = { 1.1, 4 };
static const double CLEAR = 2; /* voxels from a wall's layer: no point of the rim is nearer */

/* Smoothing before walls are looked for, in voxels. More of it where there is noise made the model
 * of a tooth worse. */
static const double SMOOTH = 0.7;

/* A wall is steeper than this share of the steep quarter. Plateaus are apart by so many times their
 * spread. */
static const double STEEP = 0.4, APART = 3;
static const double SHARPEST = 0.7; /* voxels: no layers nearer than the voxels resolve */

/* --- small fields on one lattice --- */

static double voxel_of(const struct gsn_lattice *at)
{
    return cbrt(gsn_lattice_voxel_um3(at));
}

static int fail_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for walls");
}

/* One axis of a Gaussian over values that are there, weighted by how many of them; NaN stays where
 * the kernel meets none. Runs of a line of `count` values `stride` apart. */
static void smooth_line(const float *in, float *out, size_t count, size_t stride,
                        const double *kernel, size_t reach)
{
    for (size_t i = 0; i < count; i++) {
        const size_t first = i > reach ? i - reach : 0;
        const size_t end = i + reach + 1 < count ? i + reach + 1 : count;
        double sum = 0, weight = 0;

        for (size_t j = first; j < end; j++) {
            const float v = in[j * stride];
            const double w = kernel[j > i ? j - i : i - j];

            if (isfinite(v)) {
                sum += w * (double)v;
                weight += w;
            }
        }
        out[i * stride] = isfinite(in[i * stride]) ? (float)(sum / weight) : NAN;
    }
}

/* Smooths in place; values that are missing stay so. */
static int smooth_field(struct gsn_grid *field, double sigma_um, struct gsn_error *err)
{
    const size_t n[3] = { field->at.nx, field->at.ny, field->at.nz };
    const size_t stride[3] = { 1, n[0], n[0] * n[1] };
    const double step[3] = { field->at.step_um.x, field->at.step_um.y, field->at.step_um.z };
    const size_t count = gsn_lattice_count(&field->at);
    gsn_auto_mem(float) from = gsn_alloc_array(count, sizeof *from);

    if (!from)
        return fail_memory(err);
    for (size_t axis = 0; axis < 3; axis++) {
        const size_t b = (axis + 1) % 3, c = (axis + 2) % 3;
        double kernel[32];
        size_t reach = 0;

        while (reach < 31 && (double)reach * step[axis] <= 3 * sigma_um)
            reach++;
        for (size_t k = 0; k <= reach; k++)
            kernel[k] = exp(-0.5 * pow((double)k * step[axis] / sigma_um, 2));
        memcpy(from, field->value, count * sizeof *from);
        for (size_t j = 0; j < n[c]; j++)
            for (size_t i = 0; i < n[b]; i++)
                smooth_line(from + i * stride[b] + j * stride[c],
                            field->value + i * stride[b] + j * stride[c], n[axis], stride[axis],
                            kernel, reach);
    }
    return GSN_OK;
}

/* A place where an edge of the lattice crosses a level, and the gradient there. */
struct crossing {
    double at[3], gradient[3];
};

struct crossings {
    size_t count, room;
    struct crossing *item;
};

static int add_crossing(struct crossings *list, const struct crossing *one, struct gsn_error *err)
{
    if (list->count == list->room) {
        const size_t room = 2 * list->room + 4096;
        struct crossing *larger = gsn_realloc_array(list->item, room, sizeof *larger);

        if (!larger)
            return fail_memory(err);
        list->item = larger;
        list->room = room;
    }
    list->item[list->count++] = *one;
    return GSN_OK;
}

static struct crossing cross_edge(const struct gsn_grid *field, const size_t from[3], size_t axis,
                                  double share)
{
    const struct gsn_vec3 u = gsn_lattice_centre(&field->at, from[0], from[1], from[2]);
    const double step[3] = { field->at.step_um.x, field->at.step_um.y, field->at.step_um.z };
    size_t to[3] = { from[0], from[1], from[2] };
    struct crossing one = { .at = { u.x, u.y, u.z } };
    double a[3], b[3];

    to[axis]++;
    gsn_field_gradient(field, from, a);
    gsn_field_gradient(field, to, b);
    for (size_t k = 0; k < 3; k++)
        one.gradient[k] = a[k] + share * (b[k] - a[k]);
    one.at[axis] += share * step[axis];
    return one;
}

/* gives: all crossings of edges that begin near the region, in the order of the lattice. */
static int find_crossings(const struct gsn_grid *field, double level, const struct gsn_mask *near,
                          struct crossings *ret, struct gsn_error *err)
{
    const size_t n[3] = { field->at.nx, field->at.ny, field->at.nz };
    const size_t stride[3] = { 1, n[0], n[0] * n[1] };
    size_t i = 0, at[3];
    int r = GSN_OK;

    *ret = (struct crossings){ .count = 0 };
    for (at[2] = 0; at[2] < n[2]; at[2]++)
        for (at[1] = 0; at[1] < n[1]; at[1]++)
            for (at[0] = 0; at[0] < n[0]; at[0]++, i++)
                for (size_t axis = 0; r >= 0 && axis < 3; axis++) {
                    const double a = (double)field->value[i] - level;
                    const double b = at[axis] + 1 < n[axis]
                                         ? (double)field->value[i + stride[axis]] - level
                                         : NAN;

                    if (near->inside[i] && ((a < 0 && b >= 0) || (a >= 0 && b < 0))) {
                        const struct crossing one = cross_edge(field, at, axis, a / (a - b));

                        if (gsn_dot3(one.gradient, one.gradient) > 0)
                            r = add_crossing(ret, &one, err);
                    }
                }
    return r;
}

/* --- what the voxels say --- */

/* gives: the voxels around the region, and their places, a few beyond the grid where that ends. */
static int cut_out(const struct gsn_grid *grid, const struct gsn_mask *region,
                   struct gsn_grid **ret_data, struct gsn_mask **ret_inside, struct gsn_error *err)
{
    const struct gsn_lattice *at = &grid->at;
    size_t low[3] = { SIZE_MAX, SIZE_MAX, SIZE_MAX }, high[3] = { 0 }, x[3], data = 0;
    struct gsn_lattice box = *at;
    int r;

    for (x[2] = 0; x[2] < at->nz; x[2]++)
        for (x[1] = 0; x[1] < at->ny; x[1]++)
            for (x[0] = 0; x[0] < at->nx; x[0]++) {
                if (!gsn_mask_has(region, gsn_lattice_centre(at, x[0], x[1], x[2])))
                    continue;
                data += isfinite(grid->value[gsn_lattice_index(at, x[0], x[1], x[2])]) ? 1 : 0;
                for (size_t k = 0; k < 3; k++) {
                    low[k] = x[k] < low[k] ? x[k] : low[k];
                    high[k] = x[k] > high[k] ? x[k] : high[k];
                }
            }
    if (data == 0)
        return gsn_fail(err, GSN_E_INPUT, "no voxel of the region has data");
    box.nx = high[0] - low[0] + 1 + 2 * PAD;
    box.ny = high[1] - low[1] + 1 + 2 * PAD;
    box.nz = high[2] - low[2] + 1 + 2 * PAD;
    box.origin_um.x += ((double)low[0] - PAD) * at->step_um.x;
    box.origin_um.y += ((double)low[1] - PAD) * at->step_um.y;
    box.origin_um.z += ((double)low[2] - PAD) * at->step_um.z;
    r = gsn_grid_new(&box, ret_data, err);
    if (r >= 0)
        r = gsn_mask_new(&box, ret_inside, err);
    if (r < 0)
        return r;
    for (size_t i = 0, c = 0; c < box.nz; c++)
        for (size_t b = 0; b < box.ny; b++)
            for (size_t a = 0; a < box.nx; a++, i++) {
                /* wraps below 0, which is no voxel either */
                const size_t gx = low[0] + a - PAD, gy = low[1] + b - PAD, gz = low[2] + c - PAD;
                const bool there = gx < at->nx && gy < at->ny && gz < at->nz;

                (*ret_data)->value[i] =
                    there ? grid->value[gsn_lattice_index(at, gx, gy, gz)] : NAN;
                (*ret_inside)->inside[i] =
                    gsn_mask_has(region, gsn_lattice_centre(&box, a, b, c)) ? 1 : 0;
            }
    return GSN_OK;
}

/* Grows a mask by a voxel in every direction. */
static int grow_mask(const struct gsn_mask *inside, struct gsn_mask **ret_near,
                     struct gsn_error *err)
{
    const struct gsn_lattice *at = &inside->at;
    const int r = gsn_mask_new(at, ret_near, err);

    for (size_t z = 0; r >= 0 && z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++) {
                if (!inside->inside[gsn_lattice_index(at, x, y, z)])
                    continue;
                for (size_t c = z - 1; c <= z + 1; c++) /* the region never touches the border */
                    for (size_t b = y - 1; b <= y + 1; b++)
                        for (size_t a = x - 1; a <= x + 1; a++)
                            (*ret_near)->inside[gsn_lattice_index(at, a, b, c)] = 1;
            }
    return r;
}

/* Of the region's voxels with data: how a plane differs from the mean of its neighbours, by the
 * median, which walls do not move. 0 where there are no three planes. */
static int find_noise(const struct gsn_grid *data, const struct gsn_mask *inside, double *ret_noise,
                      struct gsn_error *err)
{
    const size_t plane = data->at.nx * data->at.ny, total = gsn_lattice_count(&data->at);
    gsn_auto_mem(double) off = gsn_alloc_array(total, sizeof *off);
    size_t count = 0;

    if (!off)
        return fail_memory(err);
    for (size_t i = plane; i + plane < total; i++) {
        const double d = (double)data->value[i] -
                         0.5 * ((double)data->value[i - plane] + (double)data->value[i + plane]);

        if (inside->inside[i] && isfinite(d))
            off[count++] = fabs(d);
    }
    *ret_noise = count > 0 ? gsn_median(off, count) / 0.6745 / sqrt(1.5) : 0;
    return GSN_OK;
}

/* The value at which the density is steepest on average: halfway up the walls, whatever share of
 * the region lies on either side. Each bin has a hundredth of the range; an empty one says nothing.
 * NaN: there is no such value. */
static double find_steepest(const struct gsn_grid *data, double low, double high)
{
    double slope[BINS] = { 0 }, count[BINS] = { 0 }, best = 0, level = NAN;
    size_t i = 0, at[3];

    for (at[2] = 0; at[2] < data->at.nz; at[2]++)
        for (at[1] = 0; at[1] < data->at.ny; at[1]++)
            for (at[0] = 0; at[0] < data->at.nx; at[0]++, i++) {
                const double place = ((double)data->value[i] - low) / (high - low) * BINS;
                size_t bin;
                double g[3];

                if (!isfinite(place))
                    continue;
                bin = place < 0 ? 0 : place < BINS ? (size_t)place : BINS - 1;
                gsn_field_gradient(data, at, g);
                slope[bin] += sqrt(gsn_dot3(g, g));
                count[bin]++;
            }
    for (size_t b = 1; b + 1 < BINS; b++) {
        /* of three bins, against chance */
        const double seen = count[b - 1] + count[b] + count[b + 1];
        const double here = seen > 0 ? (slope[b - 1] + slope[b] + slope[b + 1]) / seen : 0;

        if (count[b] > 0 && here > best) {
            best = here;
            level = low + ((double)b + 0.5) * (high - low) / BINS;
        }
    }
    return level;
}

/* 1.4826 times the median of the distances from the median: a standard deviation that walls do not
 * move. Reorders the values. */
static double find_spread(double *value, size_t count, double median)
{
    for (size_t i = 0; i < count; i++)
        value[i] = fabs(value[i] - median);
    return 1.4826 * gsn_median(value, count);
}

/* The medians on both sides of the steepest value, also of what lies right beside the region. None
 * (low is high) where they are not well apart for their own spread: such sides are two halves of
 * one texture. */
static int find_plateaus(const struct gsn_grid *data, struct gsn_wall_layers *layers,
                         struct gsn_error *err)
{
    const size_t total = gsn_lattice_count(&data->at);
    gsn_auto_mem(double) value = gsn_alloc_array(total, sizeof *value);
    double low = INFINITY, high = -INFINITY, split;
    size_t count = 0, below = 0;

    if (!value)
        return fail_memory(err);
    for (size_t i = 0; i < total; i++)
        if (isfinite(data->value[i])) {
            value[count++] = (double)data->value[i];
            low = fmin(low, (double)data->value[i]);
            high = fmax(high, (double)data->value[i]);
        }
    layers->low = layers->high = low;
    split = low < high ? find_steepest(data, low, high) : NAN;
    for (size_t i = 0; i < count; i++)
        if (value[i] < split) {
            const double swap = value[below];

            value[below++] = value[i];
            value[i] = swap;
        }
    if (below == 0 || below == count)
        return GSN_OK;
    low = gsn_median(value, below);
    high = gsn_median(value + below, count - below);
    if (high - low > APART * fmax(find_spread(value, below, low),
                                  find_spread(value + below, count - below, high))) {
        layers->low = low;
        layers->high = high;
    }
    return GSN_OK;
}

/* Keeps the crossings that are steep, and finds the blur of a step of the plateaus that makes them
 * so: a Gaussian's, less what smoothing and differences have added. */
static int keep_steep(struct crossings *list, const struct gsn_lattice *at, double smoothed_um,
                      struct gsn_wall_layers *layers, struct gsn_error *err)
{
    const double voxel = voxel_of(at), contrast = layers->high - layers->low;
    gsn_auto_mem(double) slope = gsn_alloc_array(list->count, sizeof *slope);
    double steep, width;
    size_t kept = 0;

    if (!slope)
        return fail_memory(err);
    if (list->count == 0)
        return GSN_OK;
    for (size_t i = 0; i < list->count; i++)
        slope[i] = sqrt(gsn_dot3(list->item[i].gradient, list->item[i].gradient));
    steep = gsn_order_pick(slope, list->count, list->count * 3 / 4);
    for (size_t i = 0; i < list->count; i++) {
        const double here = sqrt(gsn_dot3(list->item[i].gradient, list->item[i].gradient));

        if (here > STEEP * steep) {
            slope[kept] = here;
            list->item[kept++] = list->item[i];
        }
    }
    list->count = kept;
    width = contrast / (sqrt(2 * M_PI) * gsn_median(slope, kept));
    layers->blur_um = sqrt(fmax(pow(SHARPEST * voxel, 2),
                                width * width - smoothed_um * smoothed_um - voxel * voxel / 3));
    return GSN_OK;
}

/* --- signed distance --- */

/* The voxels of a box around a point, within reach of it and of the lattice. */
static void find_box(const struct gsn_lattice *at, const double u[3], double reach, size_t first[3],
                     size_t end[3])
{
    const double origin[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t n[3] = { at->nx, at->ny, at->nz };

    for (size_t k = 0; k < 3; k++) {
        const double low = ceil((u[k] - reach - origin[k]) / step[k]);
        const double high = floor((u[k] + reach - origin[k]) / step[k]) + 1;

        first[k] = low > 0 ? (size_t)low : 0;
        end[k] = high > 0 ? (size_t)fmin(high, (double)n[k]) : 0;
    }
}

/* The crossing nearest to each voxel within reach; UINT32_MAX: none. */
static void find_nearest(const struct gsn_lattice *at, const struct crossings *list, double reach,
                         float *squared, uint32_t *nearest)
{
    for (size_t i = 0; i < list->count; i++) {
        const double *u = list->item[i].at;
        size_t first[3], end[3];

        find_box(at, u, reach, first, end);
        for (size_t z = first[2]; z < end[2]; z++)
            for (size_t y = first[1]; y < end[1]; y++)
                for (size_t x = first[0]; x < end[0]; x++) {
                    const size_t v = gsn_lattice_index(at, x, y, z);
                    const struct gsn_vec3 c = gsn_lattice_centre(at, x, y, z);
                    const double d[3] = { c.x - u[0], c.y - u[1], c.z - u[2] };
                    const float far = (float)gsn_dot3(d, d);

                    if ((double)far <= reach * reach && far < squared[v]) {
                        squared[v] = far;
                        nearest[v] = (uint32_t)i;
                    }
                }
    }
}

/* A voxel's distance is counted along the normal of its nearest crossing; beside the edge of a wall
 * that ends it is none. */
static const double ALONG = 0.8, BESIDE = 1.5;

/* gives: distances, positive towards the greater density; NaN: out of reach. */
static int find_distance(const struct gsn_lattice *at, const struct crossings *list, double reach,
                         struct gsn_grid **ret_distance, struct gsn_error *err)
{
    const size_t total = gsn_lattice_count(at);
    gsn_auto_mem(float) squared = gsn_alloc_array(total, sizeof *squared);
    gsn_auto_mem(uint32_t) nearest = gsn_alloc_array(total, sizeof *nearest);
    gsn_auto(gsn_grid) distance = NULL;
    int r = gsn_grid_new(at, &distance, err);

    if (r < 0)
        return r;
    if (!squared || !nearest)
        return fail_memory(err);
    for (size_t i = 0; i < total; i++) {
        squared[i] = INFINITY;
        nearest[i] = UINT32_MAX;
    }
    find_nearest(at, list, reach, squared, nearest);
    /* crossings are sparse: near to the wall the nearest of them may well lie aside */
    const double beside = BESIDE * fmax(at->step_um.x, fmax(at->step_um.y, at->step_um.z));
    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const struct gsn_vec3 c = gsn_lattice_centre(at, x, y, z);
                const struct crossing *from;
                double d[3], along, far;

                distance->value[i] = NAN;
                if (nearest[i] == UINT32_MAX)
                    continue;
                from = &list->item[nearest[i]];
                d[0] = c.x - from->at[0];
                d[1] = c.y - from->at[1];
                d[2] = c.z - from->at[2];
                along =
                    gsn_dot3(d, from->gradient) / sqrt(gsn_dot3(from->gradient, from->gradient));
                far = sqrt(gsn_dot3(d, d));
                if (fabs(along) >= ALONG * far || far < beside)
                    distance->value[i] = (float)along;
            }
    *ret_distance = gsn_steal(&distance);
    return GSN_OK;
}

/* gives: the distance from the region's rim, positive outside; halfway between the last voxel
 * inside and the first outside it is 0. */
static int find_rim(const struct gsn_mask *inside, struct gsn_grid **ret_distance,
                    struct gsn_error *err)
{
    const struct gsn_lattice *at = &inside->at;
    const struct gsn_distance_box box = { at->nx,        at->ny,        at->nz,
                                          at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t total = gsn_lattice_count(at);
    gsn_auto(gsn_grid) outer = NULL;
    gsn_auto(gsn_grid) inner = NULL;
    gsn_auto_mem(uint8_t) outside = gsn_alloc_array(total, 1);
    int r = gsn_grid_new(at, &outer, err);

    if (r >= 0)
        r = gsn_grid_new(at, &inner, err);
    if (r < 0)
        return r;
    if (!outside)
        return fail_memory(err);
    for (size_t i = 0; i < total; i++)
        outside[i] = !inside->inside[i];
    r = gsn_distance_squared(inside->inside, &box, 1, outer->value, err);
    if (r >= 0)
        r = gsn_distance_squared(outside, &box, 1, inner->value, err);
    for (size_t i = 0; r >= 0 && i < total; i++)
        outer->value[i] = outside[i] ? sqrtf(outer->value[i]) - (float)(voxel_of(at) / 2)
                                     : (float)(voxel_of(at) / 2) - sqrtf(inner->value[i]);
    if (r >= 0)
        *ret_distance = gsn_steal(&outer);
    return r;
}

/* --- all together --- */

static int add_walls(const struct crossings *walls, const struct gsn_mask *near, double blur_um,
                     double edge_um, struct gsn_triangles *layers, struct gsn_error *err)
{
    const double voxel = voxel_of(&near->at);
    gsn_auto(gsn_grid) distance = NULL;
    int r =
        find_distance(&near->at, walls, OFFSET[LAYERS - 1] * blur_um + 3 * voxel, &distance, err);

    if (r >= 0)
        r = smooth_field(distance, SMOOTH * voxel, err);
    for (size_t k = 0; r >= 0 && k < LAYERS; k++)
        r = gsn_level_surface_add(distance, OFFSET[k] * blur_um, near, edge_um, layers, err);
    return r < 0 ? r : gsn_triangles_drop_crossings(layers, err);
}

/* --- the region's rim --- */

static int spread_rim(const struct gsn_mask *inside, double edge_um, struct gsn_triangles *rim,
                      struct gsn_error *err)
{
    const double voxel = voxel_of(&inside->at);
    gsn_auto(gsn_grid) distance = NULL;
    gsn_auto(gsn_mask) all = NULL;
    int r = find_rim(inside, &distance, err);

    if (r >= 0)
        r = gsn_mask_new(&inside->at, &all, err);
    if (r >= 0)
        r = smooth_field(distance, SMOOTH * voxel, err);
    if (r < 0)
        return r;
    memset(all->inside, 1, gsn_lattice_count(&all->at));
    for (size_t k = 0; r >= 0 && k < sizeof RIM_AT / sizeof RIM_AT[0]; k++)
        r = gsn_level_surface_add(distance, RIM_AT[k] * voxel, all, edge_um, rim, err);
    return r;
}

/* A point, and whether one of the layers is nearer than `clear`. */
struct clearance {
    const struct gsn_triangles *layers;
    const double *u;
    double clear;
};

static int look_near(void *context, uint32_t point)
{
    const struct clearance *search = context;
    const double *v = search->layers->at[point];
    const double d[3] = { v[0] - search->u[0], v[1] - search->u[1], v[2] - search->u[2] };

    return gsn_dot3(d, d) < search->clear * search->clear;
}

/* Keeps the points of the rim that are clear of those of the layers. */
static int keep_clear(const struct gsn_triangles *layers, double clear, struct gsn_triangles *rim,
                      struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_bvh_box) box = gsn_alloc_array(layers->points, sizeof *box);
    gsn_auto(gsn_bvh) tree = NULL;
    size_t kept = 0;
    int r;

    if (!box)
        return fail_memory(err);
    if (layers->points == 0)
        return GSN_OK;
    for (size_t i = 0; i < layers->points; i++)
        box[i] = gsn_bvh_box_around((const double(*)[3])layers->at + i, 1);
    r = gsn_bvh_new(box, layers->points, &tree, err);
    for (size_t i = 0; r >= 0 && i < rim->points; i++) {
        struct clearance search = { layers, rim->at[i], clear };
        struct gsn_bvh_box around = gsn_bvh_box_around((const double(*)[3])rim->at + i, 1);

        for (size_t k = 0; k < 3; k++) {
            around.low[k] -= clear;
            around.high[k] += clear;
        }
        if (!gsn_bvh_meeting(tree, &around, look_near, &search))
            memmove(rim->at[kept++], rim->at[i], sizeof *rim->at);
    }
    rim->points = r < 0 ? rim->points : kept;
    return r;
}

/* --- all together --- */

/* The walls' points, and behind them the rim's. */
static int join_points(struct gsn_triangles *walls, const struct gsn_triangles *rim,
                       struct gsn_wall_layers *layers, struct gsn_error *err)
{
    layers->at = gsn_alloc_array(walls->points + rim->points, sizeof *layers->at);
    if (!layers->at)
        return fail_memory(err);
    if (walls->points > 0)
        memcpy(layers->at, walls->at, walls->points * sizeof *layers->at);
    if (rim->points > 0)
        memcpy(layers->at[walls->points], rim->at, rim->points * sizeof *layers->at);
    layers->walls = walls->points;
    layers->rims = rim->points;
    layers->facets = walls->facets;
    layers->facet = gsn_steal(&walls->facet);
    return GSN_OK;
}

/* Where the voxels, smoothed, have walls. */
static int find_walls(struct gsn_grid *data, const struct gsn_mask *near,
                      struct gsn_wall_layers *layers, struct crossings *ret_walls,
                      struct gsn_error *err)
{
    const double smoothed = SMOOTH * voxel_of(&data->at);
    int r = smooth_field(data, smoothed, err);

    if (r >= 0)
        r = find_plateaus(data, layers, err);
    if (r < 0 || layers->low == layers->high)
        return r;
    r = find_crossings(data, (layers->low + layers->high) / 2, near, ret_walls, err);
    return r < 0 ? r : keep_steep(ret_walls, &data->at, smoothed, layers, err);
}

/* The edge at which the layers of these walls have at most so many points: a wall is crossed 1.5
 * times where it passes the side of a voxel, on average over its directions, and even triangles
 * have half a point each. */
static double choose_edge(size_t crossings, double voxel, double edge_um, size_t most_points)
{
    const double area = (double)crossings * voxel * voxel / 1.5;

    return most_points > 0 ? fmax(edge_um, sqrt(LAYERS * area / ((double)most_points * sqrt(0.75))))
                           : edge_um;
}

static int find_layers(struct gsn_grid *data, const struct gsn_mask *inside,
                       const struct gsn_wall_options *options, struct gsn_wall_layers *layers,
                       struct gsn_error *err)
{
    const double voxel = voxel_of(&data->at);
    const double rim_edge = options->rim_um > 0 ? options->rim_um : RIM_VOXELS * voxel;
    struct crossings walls = { .count = 0 };
    struct gsn_triangles surface = { .points = 0 }, rim = { .points = 0 };
    gsn_auto(gsn_mask) near = NULL;
    int r = find_noise(data, inside, &layers->noise, err);

    layers->edge_um = options->edge_um > 0 ? options->edge_um : EDGE_VOXELS * voxel;
    if (r >= 0)
        r = grow_mask(inside, &near, err);
    if (r >= 0)
        r = find_walls(data, near, layers, &walls, err);
    layers->edge_um = choose_edge(walls.count, voxel, layers->edge_um, options->most_points);
    if (r >= 0 && walls.count > 0)
        r = add_walls(&walls, near, layers->blur_um, layers->edge_um, &surface, err);
    if (r >= 0)
        r = spread_rim(inside, rim_edge, &rim, err);
    if (r >= 0)
        r = keep_clear(&surface, CLEAR * voxel, &rim, err);
    if (r >= 0)
        r = join_points(&surface, &rim, layers, err);
    gsn_triangles_done(&surface);
    gsn_triangles_done(&rim);
    gsn_free(walls.item);
    return r;
}

int gsn_wall_layers_find(const struct gsn_grid *grid, const struct gsn_mask *region,
                         const struct gsn_wall_options *options,
                         struct gsn_wall_layers **ret_layers, struct gsn_error *err)
{
    gsn_auto(gsn_wall_layers) layers = gsn_alloc_array(1, sizeof *layers);
    gsn_auto(gsn_grid) data = NULL;
    gsn_auto(gsn_mask) inside = NULL;
    int r;

    assert(grid && region && options && ret_layers);
    if (!layers)
        return fail_memory(err);
    r = cut_out(grid, region, &data, &inside, err);
    if (r >= 0)
        r = find_layers(data, inside, options, layers, err);
    if (r >= 0)
        *ret_layers = gsn_steal(&layers);
    return r;
}

void gsn_wall_layers_free(struct gsn_wall_layers *layers)
{
    if (!layers)
        return;
    gsn_free(layers->at);
    gsn_free(layers->facet);
    gsn_free(layers);
}
