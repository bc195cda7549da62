/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A band at a distance from the surface of a body (tissue_segmentation.h), by a signed distance.
 *
 * The distance transform (core/distance.h) runs between centres of voxels, and the surface lies
 * between them: each voxel's distance is the mean of those from the body and from the body grown by
 * its neighbours. That lattice is interpolated at the centres of another one. Two transforms inside
 * and two outside; 9 bytes a voxel. A file of its own, since it is no segmentation. */
#include "pipeline/core/distance.h"
#include "pipeline/core/mem.h"
#include "pipeline/stain/tissue_segmentation.h"

#include <math.h>

/* Whether a voxel or one of its six neighbours is `of`. */
static int touches_set(const struct gsn_mask *body, size_t i, uint8_t of)
{
    const struct gsn_lattice *at = &body->at;
    const size_t x = i % at->nx, y = i / at->nx % at->ny, z = i / at->nx / at->ny;
    const size_t plane = at->nx * at->ny;
    const uint8_t *in = body->inside + i;

    return in[0] == of || (x > 0 && in[-1] == of) || (x + 1 < at->nx && in[1] == of) ||
           (y > 0 && *(in - at->nx) == of) || (y + 1 < at->ny && in[at->nx] == of) ||
           (z > 0 && *(in - plane) == of) || (z + 1 < at->nz && in[plane] == of);
}

/* Adds to each voxel that is not `of` its distance from those that are, and from those that are or
 * touch them: the surface lies midway, whichever way it runs through the voxels. */
static int add_distances(const struct gsn_mask *body, uint8_t of, unsigned threads, double sign,
                         float *distance, struct gsn_error *err)
{
    const struct gsn_lattice *at = &body->at;
    const struct gsn_distance_box box = { at->nx,        at->ny,        at->nz,
                                          at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t count = gsn_lattice_count(at);
    gsn_auto_mem(uint8_t) set = gsn_alloc_array(count, 1);
    gsn_auto_mem(float) squared = gsn_alloc_array(count, sizeof *squared);
    int r = set && squared ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for distances");

    for (int wide = 0; wide < 2 && r >= 0; wide++) {
        for (size_t i = 0; i < count; i++)
            set[i] = wide ? (uint8_t)touches_set(body, i, of) : body->inside[i] == of;
        r = gsn_distance_squared(set, &box, threads, squared, err);
        for (size_t i = 0; r >= 0 && i < count; i++)
            distance[i] += (float)(body->inside[i] == of ? 0 : sign * sqrt(squared[i]) / 2);
    }
    return r;
}

/* Distance from the surface at every voxel centre, negative inside. */
static int signed_distance(const struct gsn_mask *body, unsigned threads, float *distance,
                           struct gsn_error *err)
{
    const int r = add_distances(body, 1, threads, 1, distance, err);

    return r < 0 ? r : add_distances(body, 0, threads, -1, distance, err);
}

/* One axis of an interpolation: the cell before and how far beyond it. 0 outside the lattice. */
static int place_on_axis(double um, double origin, double step, size_t n, size_t *ret_at,
                         double *ret_t)
{
    const double x = (um - origin) / step;
    const double within = fmin(fmax(x, 0), (double)n - 1);
    const double first = fmin(floor(within), fmax((double)n - 2, 0));

    *ret_at = (size_t)first;
    *ret_t = within - first;
    return x > -0.5 - 1e-9 && x < (double)n - 0.5 + 1e-9;
}

/* Trilinear; NaN outside the lattice. */
static double distance_at(const struct gsn_lattice *at, const float *distance, struct gsn_vec3 u)
{
    size_t x, y, z;
    double tx, ty, tz, sum = 0;

    if (!place_on_axis(u.x, at->origin_um.x, at->step_um.x, at->nx, &x, &tx) ||
        !place_on_axis(u.y, at->origin_um.y, at->step_um.y, at->ny, &y, &ty) ||
        !place_on_axis(u.z, at->origin_um.z, at->step_um.z, at->nz, &z, &tz))
        return NAN;
    for (size_t k = 0; k < 8; k++) {
        const double w = (k & 1 ? tx : 1 - tx) * (k & 2 ? ty : 1 - ty) * (k & 4 ? tz : 1 - tz);

        if (w > 0)
            sum += w * distance[gsn_lattice_index(at, x + (k & 1), y + (k >> 1 & 1), z + (k >> 2))];
    }
    return sum;
}

int gsn_tissue_band(const struct gsn_mask *body, double low_um, double high_um,
                    const struct gsn_lattice *at, unsigned threads, struct gsn_mask **ret_band,
                    struct gsn_error *err)
{
    gsn_auto_mem(float) distance = gsn_alloc_array(gsn_lattice_count(&body->at), sizeof *distance);
    gsn_auto(gsn_mask) band = NULL;
    int r;

    if (!distance)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the distance from a surface");
    if (gsn_mask_count(body) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the body to measure distances from is empty");
    r = signed_distance(body, threads, distance, err);
    if (r >= 0)
        r = gsn_mask_new(at, &band, err);
    if (r < 0)
        return r;
    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const double d = distance_at(&body->at, distance, gsn_lattice_centre(at, x, y, z));

                band->inside[i] = d >= low_um && d < high_um;
            }
    if (gsn_mask_count(band) == 0)
        return gsn_fail(err, GSN_E_INPUT, "no voxel lies %g to %g um from the surface of the body",
                        low_um, high_um);
    *ret_band = gsn_steal(&band);
    return GSN_OK;
}
