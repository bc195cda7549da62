/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The exact Euclidean distance transform of a box of voxels, axis by axis (Felzenszwalb and
 * Huttenlocher 2012): scan a line, keep the lower envelope of the parabolas, read it off.
 *
 * cv::distanceTransform() is the same method and gives the same sets (test_morphology.c, 200
 * cases), but of planes with square pixels alone, and the square root of the sum as float. Bands at
 * a distance from a surface are of blocks, whose sections lie further apart than their pixels; so
 * this one stays, and pictures take OpenCV's by pipeline/imaging/morphology.h. Planes and rows go
 * to threads; 32 bytes of scratch for each voxel of the longest line and thread. Fails only without
 * memory. */
#include "pipeline/core/distance.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/parallel.h"

#include <math.h>

/* Scratch for one line. */
struct line {
    double *in, *out, *from; /* from: where each parabola of the envelope begins */
    size_t *at;              /* its apex */
};

struct pass {
    const struct gsn_distance_box *box;
    float *squared;
};

/* out[q] = min over p of in[p] + (step (q - p))^2. */
static void lower_envelope(struct line *line, size_t n, double step)
{
    const double unit = step * step;
    size_t count = 0, k = 0;

    for (size_t q = 0; q < n; q++) {
        const double height = line->in[q] + unit * (double)q * (double)q;
        double from = -INFINITY;

        if (isinf(line->in[q]))
            continue;
        while (count > 0) {
            const size_t p = line->at[count - 1];

            from = (height - line->in[p] - unit * (double)p * (double)p) /
                   (2 * unit * (double)(q - p));
            if (from > line->from[count - 1])
                break;
            count--;
        }
        line->at[count] = q;
        line->from[count] = count > 0 ? from : -INFINITY;
        count++;
    }
    for (size_t q = 0; q < n; q++) {
        while (k + 1 < count && line->from[k + 1] < (double)q)
            k++;
        line->out[q] = INFINITY;
        if (count > 0) {
            const double d = (double)q - (double)line->at[k];

            line->out[q] = line->in[line->at[k]] + unit * d * d;
        }
    }
}

static void transform_line(float *value, size_t n, size_t stride, double step, struct line *line)
{
    for (size_t i = 0; i < n; i++)
        line->in[i] = value[i * stride];
    lower_envelope(line, n, step);
    for (size_t i = 0; i < n; i++)
        value[i * stride] = (float)line->out[i];
}

static int line_of(size_t n, struct line *ret_line, double **ret_memory, struct gsn_error *err)
{
    double *memory = gsn_alloc_array(3 * n, sizeof *memory);
    size_t *at = memory ? gsn_alloc_array(n, sizeof *at) : NULL;

    if (!at) {
        gsn_free(memory);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for distances");
    }
    *ret_line = (struct line){ memory, memory + n, memory + 2 * n, at };
    *ret_memory = memory;
    return GSN_OK;
}

/* Along x and y within the plane of one z. */
static int one_plane(size_t z, void *context, struct gsn_error *err)
{
    const struct pass *pass = context;
    const struct gsn_distance_box *box = pass->box;
    const size_t n = box->nx > box->ny ? box->nx : box->ny;
    float *plane = pass->squared + z * box->nx * box->ny;
    gsn_auto_mem(double) memory = NULL;
    gsn_auto_mem(size_t) at = NULL;
    struct line line = { .at = NULL };
    const int r = line_of(n, &line, &memory, err);

    if (r < 0)
        return r;
    at = line.at;
    for (size_t y = 0; y < box->ny; y++)
        transform_line(plane + y * box->nx, box->nx, 1, box->step_x, &line);
    for (size_t x = 0; x < box->nx; x++)
        transform_line(plane + x, box->ny, box->nx, box->step_y, &line);
    return GSN_OK;
}

/* Along z, all columns of one row y. */
static int one_row(size_t y, void *context, struct gsn_error *err)
{
    const struct pass *pass = context;
    const struct gsn_distance_box *box = pass->box;
    gsn_auto_mem(double) memory = NULL;
    gsn_auto_mem(size_t) at = NULL;
    struct line line = { .at = NULL };
    const int r = line_of(box->nz, &line, &memory, err);

    if (r < 0)
        return r;
    at = line.at;
    for (size_t x = 0; x < box->nx; x++)
        transform_line(pass->squared + y * box->nx + x, box->nz, box->nx * box->ny, box->step_z,
                       &line);
    return GSN_OK;
}

int gsn_distance_squared(const uint8_t *set, const struct gsn_distance_box *box, unsigned threads,
                         float *ret_squared, struct gsn_error *err)
{
    const size_t count = box->nx * box->ny * box->nz;
    struct pass pass = { box, ret_squared };
    int r;

    for (size_t i = 0; i < count; i++)
        ret_squared[i] = set[i] ? 0 : INFINITY;
    r = gsn_parallel_for(box->nz, threads, one_plane, &pass, err);
    if (r >= 0 && box->nz > 1)
        r = gsn_parallel_for(box->ny, threads, one_row, &pass, err);
    return r;
}
