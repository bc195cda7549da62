/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: exact Euclidean distance of every voxel from the other side (core/distance.h), half a
 * voxel less, so that the two sides meet halfway; a binomial filter of three along each axis, which
 * is a Gaussian of 0.7 voxel, takes the staircase off; trilinear between voxels.
 * Failure: memory. Cost: linear in the voxels of the region's lattice and a margin. */
#include "pipeline/render/region_border.h"

#include "pipeline/core/distance.h"

#include <assert.h>
#include <math.h>

enum { MARGIN = 3 }; /* voxels around the lattice */

struct gsn_border {
    struct gsn_lattice at;
    float *distance;
};

void gsn_border_free(struct gsn_border *border)
{
    if (!border)
        return;
    gsn_free(border->distance);
    gsn_free(border);
}

static struct gsn_lattice widen(const struct gsn_lattice *at)
{
    struct gsn_lattice wide = *at;

    wide.nx += 2 * MARGIN;
    wide.ny += 2 * MARGIN;
    wide.nz += 2 * MARGIN;
    wide.origin_um.x -= MARGIN * at->step_um.x;
    wide.origin_um.y -= MARGIN * at->step_um.y;
    wide.origin_um.z -= MARGIN * at->step_um.z;
    return wide;
}

static int measure_distance(const struct gsn_mask *region, unsigned threads,
                            struct gsn_border *border, struct gsn_error *err)
{
    const struct gsn_lattice *at = &border->at;
    const struct gsn_distance_box box = { at->nx,        at->ny,        at->nz,
                                          at->step_um.x, at->step_um.y, at->step_um.z };
    const double half = fmin(at->step_um.x, fmin(at->step_um.y, at->step_um.z)) / 2;
    const size_t total = gsn_lattice_count(at);
    gsn_auto_mem(uint8_t) inside = gsn_alloc_array(total, 1);
    gsn_auto_mem(uint8_t) outside = gsn_alloc_array(total, 1);
    gsn_auto_mem(float) inner = gsn_alloc_array(total, sizeof *inner);
    int r;

    border->distance = gsn_alloc_array(total, sizeof *border->distance);
    if (!inside || !outside || !inner || !border->distance)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the border of %zu voxels", total);
    for (size_t i = 0, z = 0; z < region->at.nz; z++)
        for (size_t y = 0; y < region->at.ny; y++)
            for (size_t x = 0; x < region->at.nx; x++, i++)
                inside[gsn_lattice_index(at, x + MARGIN, y + MARGIN, z + MARGIN)] =
                    region->inside[i] != 0;
    for (size_t i = 0; i < total; i++)
        outside[i] = !inside[i];
    r = gsn_distance_squared(inside, &box, threads, border->distance, err);
    if (r >= 0)
        r = gsn_distance_squared(outside, &box, threads, inner, err);
    for (size_t i = 0; r >= 0 && i < total; i++)
        border->distance[i] = inside[i] ? sqrtf(inner[i]) - (float)half
                                        : (float)half - sqrtf(fminf(border->distance[i], 1e12F));
    return r;
}

/* 1/4, 1/2, 1/4 along lines of count voxels this far apart; the ends stay. */
static void smooth_lines(float *value, size_t lines, size_t count, size_t stride,
                         const size_t start_of[2], size_t per)
{
    for (size_t line = 0; line < lines; line++) {
        float *v = value + line / per * start_of[0] + line % per * start_of[1];
        float before = v[0];

        for (size_t i = 1; i + 1 < count; i++) {
            const float here = v[i * stride];

            v[i * stride] = 0.25F * before + 0.5F * here + 0.25F * v[(i + 1) * stride];
            before = here;
        }
    }
}

int gsn_border_new(const struct gsn_mask *region, unsigned threads, struct gsn_border **ret_border,
                   struct gsn_error *err)
{
    gsn_auto(gsn_border) border = gsn_alloc_array(1, sizeof *border);
    size_t nx, ny, nz;
    int r;

    assert(region && ret_border);

    if (!border)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the border of a region");
    border->at = widen(&region->at);
    r = measure_distance(region, threads, border, err);
    if (r < 0)
        return r;
    nx = border->at.nx;
    ny = border->at.ny;
    nz = border->at.nz;
    smooth_lines(border->distance, ny * nz, nx, 1, (const size_t[2]){ nx, 0 }, 1);
    smooth_lines(border->distance, nx * nz, ny, nx, (const size_t[2]){ nx * ny, 1 }, nx);
    smooth_lines(border->distance, nx * ny, nz, nx * ny, (const size_t[2]){ 1, 0 }, 1);
    *ret_border = gsn_steal(&border);
    return GSN_OK;
}

/* The voxel below a place along one axis, and how far beyond it the place is, 0..1. */
static size_t voxel_below(double u, double origin, double step, size_t count, double *ret_share)
{
    const double place = fmin((double)(count - 1), fmax(0, (u - origin) / step));
    const double below = fmin((double)(count - 2), floor(place));

    *ret_share = place - below;
    return (size_t)below;
}

/* Of what is trilinear between eight values, x fastest. */
static void find_gradient(const double value[8], const double share[3], const double step[3],
                          double *ret_gradient)
{
    for (int c = 0; c < 3; c++) {
        const int d = (c + 1) % 3, e = (c + 2) % 3;

        ret_gradient[c] = 0;
        for (unsigned corner = 0; corner < 8; corner++) {
            const double along = corner >> d & 1 ? share[d] : 1 - share[d];
            const double across = corner >> e & 1 ? share[e] : 1 - share[e];

            ret_gradient[c] +=
                (corner >> c & 1 ? value[corner] : -value[corner]) * along * across / step[c];
        }
    }
}

double gsn_border_at(const struct gsn_border *border, const double u[3], double *ret_gradient)
{
    const struct gsn_lattice *at = &border->at;
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    double share[3], value[8], sum = 0;
    const size_t x = voxel_below(u[0], at->origin_um.x, step[0], at->nx, &share[0]);
    const size_t y = voxel_below(u[1], at->origin_um.y, step[1], at->ny, &share[1]);
    const size_t z = voxel_below(u[2], at->origin_um.z, step[2], at->nz, &share[2]);
    const double weight[3][2] = { { 1 - share[0], share[0] },
                                  { 1 - share[1], share[1] },
                                  { 1 - share[2], share[2] } };

    for (unsigned k = 0; k < 4; k++) {
        const float *row = border->distance + ((z + (k >> 1)) * at->ny + y + (k & 1)) * at->nx + x;

        value[2 * k] = (double)row[0];
        value[2 * k + 1] = (double)row[1];
        sum += weight[0][0] * weight[1][k & 1] * weight[2][k >> 1] * value[2 * k];
        sum += weight[0][1] * weight[1][k & 1] * weight[2][k >> 1] * value[2 * k + 1];
    }
    if (ret_gradient)
        find_gradient(value, share, step, ret_gradient);
    return sum;
}
