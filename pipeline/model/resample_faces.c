/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Seams into voxels. */
#include "pipeline/model/resample_internal.h"
#include "pipeline/model/seam.h"

#include <math.h>
#include <string.h>

enum { BUCKET = 256 }; /* points that wait for one kernel */

/* Voxels of one face that wait for its kernels, by their unclear clouds. */
struct bucket {
    size_t count, voxel[BUCKET];
    double at[3][BUCKET];
};

/* What a thread needs for faces. */
struct facing {
    struct gsn_prism prism;
    struct gsn_seam seam;
    int ready; /* seam is */
    struct bucket bucket[8];
};

static void flush(const struct gsn_resample_job *job, struct facing *facing, unsigned unclear)
{
    struct bucket *bucket = &facing->bucket[unclear];
    const double *const at[3] = { bucket->at[0], bucket->at[1], bucket->at[2] };
    double value[BUCKET];

    if (bucket->count == 0)
        return;
    if (!facing->ready)
        gsn_seam_init(&facing->seam, job->space, &facing->prism, job->spline->control);
    facing->ready = 1;
    memset(value, 0, bucket->count * sizeof *value);
    gsn_seam_add(&facing->seam, unclear, at, bucket->count, value, NULL);
    for (size_t i = 0; i < bucket->count; i++)
        job->value[bucket->voxel[i]] += value[i];
    bucket->count = 0;
}

static void put(const struct gsn_resample_job *job, struct facing *facing, unsigned unclear,
                int32_t x, const double yz[2], size_t first)
{
    struct bucket *bucket = &facing->bucket[unclear];
    const size_t i = bucket->count++;

    __builtin_prefetch(&job->value[first + (size_t)x], 1);
    bucket->voxel[i] = first + (size_t)x;
    bucket->at[0][i] = job->centre[0][x];
    bucket->at[1][i] = yz[0];
    bucket->at[2][i] = yz[1];
    if (bucket->count == BUCKET)
        flush(job, facing, unclear);
}

static void put_unclear(const struct gsn_resample_job *job, struct facing *facing, int32_t from,
                        int32_t to, const double yz[2], size_t first)
{
    const struct gsn_prism *prism = &facing->prism;

    for (int32_t x = from; x < to; x++) {
        const double d[3] = { job->centre[0][x] - prism->origin[0], yz[0] - prism->origin[1],
                              yz[1] - prism->origin[2] };
        unsigned unclear = 0;

        for (int m = 0; m < 3; m++)
            unclear |= (unsigned)!(gsn_dot(prism->clear[m], d) + prism->clear[m][3] > 0) << m;
        put(job, facing, unclear, x, yz, first);
    }
}

static void collect_row(const struct gsn_resample_job *job, struct facing *facing,
                        const struct gsn_rows *rows, size_t i, const double yz[2], size_t first)
{
    const int32_t from = rows->low[i], to = rows->high[i];
    const int32_t low = rows->inner_low[i] < from ? from
                        : rows->inner_low[i] > to ? to
                                                  : rows->inner_low[i];
    const int32_t high = rows->inner_high[i] < low  ? low
                         : rows->inner_high[i] > to ? to
                                                    : rows->inner_high[i];

    put_unclear(job, facing, from, low, yz, first);
    for (int32_t x = low; x < high; x++)
        put(job, facing, 0, x, yz, first);
    put_unclear(job, facing, high, to, yz, first);
}

/* The prism, and the part of it that is clear of all clouds. */
static void outline_prism(const struct gsn_resample_job *job, const struct gsn_voxel_block *block,
                          const struct gsn_prism *prism, struct gsn_bodies *bodies)
{
    const double voxels = (double)(block->high[0] - block->low[0]);

    gsn_resample_start(block, prism->origin, bodies);
    for (int i = 0; i < 5; i++)
        gsn_resample_half_space(job, block, prism->origin, prism->inside[i], prism->inside[i][3],
                                1e-13 * (i < 3 ? 1 : prism->size) / voxels, &bodies->outer);
    for (int m = 0; m < 3; m++)
        gsn_resample_half_space(job, block, prism->origin, prism->clear[m], prism->clear[m][3],
                                1e-13 / voxels, &bodies->inner);
}

/* The box around the knots of a face. */
static void box_of_face(const struct gsn_dms *space, size_t tet, unsigned corner, unsigned top,
                        double low[3], double high[3])
{
    for (int c = 0; c < 3; c++) {
        low[c] = INFINITY;
        high[c] = -INFINITY;
    }
    for (unsigned k = 0; k < 4; k++) {
        const double(*knot)[3] =
            (const double(*)[3]) & space->knot[space->mesh->tet[tet][k] * (space->degree + 1)];

        for (unsigned l = 0; k != corner && l <= top; l++)
            gsn_resample_extend(low, high, knot[l]);
    }
}

/* Adds the seam of one face to the voxels of a slab. */
static void add_face(const struct gsn_resample_job *job, size_t tet, unsigned corner,
                     const size_t layers[2], struct facing *facing)
{
    const struct gsn_dms *space = job->space;
    const int64_t other = space->mesh->neighbour[tet][corner];
    const unsigned top =
        space->sharing == GSN_DMS_SHARED && other >= 0 ? space->degree - 1 : space->degree;
    struct gsn_rows rows;
    struct gsn_bodies bodies;
    double low[3], high[3];
    struct gsn_voxel_block block, part = { .low = { 0 } };

    if ((other >= 0 && (size_t)other < tet) || top == 0)
        return;
    box_of_face(space, tet, corner, top, low, high);
    if (!gsn_resample_block_of(job, low, high, layers, &block) ||
        !gsn_prism_init(space, tet, corner, &facing->prism))
        return;
    facing->ready = 0;
    outline_prism(job, &block, &facing->prism, &bodies);
    memcpy(part.high, block.low, sizeof part.high);
    while (gsn_resample_next_part(&block, &part)) {
        const double *y = &job->centre[1][part.low[1]], *z = &job->centre[2][part.low[2]];
        space->kernels->rows(&bodies, y, part.high[1] - part.low[1], z, part.high[2] - part.low[2],
                             &rows);
        for (size_t i = 0; i < rows.count; i++)
            collect_row(job, facing, &rows, i, (const double[2]){ y[rows.y[i]], z[rows.z[i]] },
                        gsn_lattice_index(job->at, 0, part.low[1] + (size_t)rows.y[i],
                                          part.low[2] + (size_t)rows.z[i]));
    }
    for (unsigned unclear = 0; unclear < 8; unclear++)
        flush(job, facing, unclear);
}

void gsn_resample_faces(const struct gsn_resample_job *job, const size_t layers[2])
{
    struct facing facing;

    for (unsigned unclear = 0; unclear < 8; unclear++)
        facing.bucket[unclear].count = 0;
    for (size_t t = 0; t < job->space->mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++)
            add_face(job, t, k, layers, &facing);
    }
}
