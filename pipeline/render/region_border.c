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

double gsn_border_at(const struct gsn_border *border, const double u[3], double *ret_gradient)
{
    const struct gsn_lattice *at = &border->at;
    const size_t count[3] = { at->nx, at->ny, at->nz };
    const double origin[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t stride[3] = { 1, at->nx, at->nx * at->ny };
    double share[3], sum = 0, slope[3] = { 0 };
    size_t low = 0;

    for (int c = 0; c < 3; c++) {
        const double place = fmin((double)(count[c] - 1), fmax(0, (u[c] - origin[c]) / step[c]));
        const double below = fmin((double)(count[c] - 2), floor(place));

        share[c] = place - below;
        low += (size_t)below * stride[c];
    }
    for (unsigned corner = 0; corner < 8; corner++) {
        double weight[3], value;
        size_t i = low;

        for (int c = 0; c < 3; c++) {
            const unsigned up = corner >> c & 1;

            weight[c] = up ? share[c] : 1 - share[c];
            i += up ? stride[c] : 0;
        }
        value = (double)border->distance[i];
        sum += weight[0] * weight[1] * weight[2] * value;
        for (int c = 0; c < 3; c++)
            slope[c] += (corner >> c & 1 ? value : -value) * weight[(c + 1) % 3] *
                        weight[(c + 2) % 3] / step[c];
    }
    for (int c = 0; ret_gradient && c < 3; c++)
        ret_gradient[c] = slope[c];
    return sum;
}
