/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Blocks of voxels, and half-spaces as their rows see them. */
#include "pipeline/model/resample_internal.h"

#include <math.h>

/* The first voxel along an axis whose centre is not below v (or, above = 1, is above v). */
static size_t first_from(const struct gsn_resample_job *job, int axis, double v, int above)
{
    const double *centre = job->centre[axis];
    const double guess = ceil((v - job->origin[axis]) / job->step[axis]);
    size_t i = !(guess > 0)                       ? 0
               : guess < (double)job->count[axis] ? (size_t)guess
                                                  : job->count[axis];

    while (i > 0 && (above ? centre[i - 1] > v : centre[i - 1] >= v))
        i--;
    while (i < job->count[axis] && (above ? centre[i] <= v : centre[i] < v))
        i++;
    return i;
}

int gsn_resample_block_of(const struct gsn_resample_job *job, const double low[3],
                          const double high[3], const size_t layers[2], struct gsn_voxel_block *ret)
{
    for (int c = 2; c >= 0; c--) {
        ret->low[c] = first_from(job, c, low[c], 0);
        ret->high[c] = first_from(job, c, high[c], 1);
        if (c == 2) {
            ret->low[2] = ret->low[2] > layers[0] ? ret->low[2] : layers[0];
            ret->high[2] = ret->high[2] < layers[1] ? ret->high[2] : layers[1];
        }
        if (ret->low[c] >= ret->high[c])
            return 0;
    }
    return 1;
}

void gsn_resample_extend(double low[3], double high[3], const double v[3])
{
    for (int c = 0; c < 3; c++) {
        low[c] = v[c] < low[c] ? v[c] : low[c];
        high[c] = v[c] > high[c] ? v[c] : high[c];
    }
}

void gsn_resample_start(const struct gsn_voxel_block *block, const double about[3],
                        struct gsn_bodies *bodies)
{
    bodies->origin[0] = about[1];
    bodies->origin[1] = about[2];
    bodies->range[0] = (double)block->low[0];
    bodies->range[1] = (double)(block->high[0] - 1);
    bodies->outer.low.count = bodies->outer.high.count = 0;
    bodies->inner.low.count = bodies->inner.high.count = 0;
}

void gsn_resample_half_space(const struct gsn_resample_job *job,
                             const struct gsn_voxel_block *block, const double about[3],
                             const double normal[3], double constant, double flattest,
                             struct gsn_body *body)
{
    const double slope = normal[0] * job->step[0];
    const double by = -1 / (fabs(slope) > flattest ? slope : copysign(flattest, slope));
    struct gsn_lines *lines = by < 0 ? &body->low : &body->high;
    const unsigned i = lines->count++;

    lines->at[i] = (double)block->low[0] +
                   by * (constant + normal[0] * (job->centre[0][block->low[0]] - about[0]));
    lines->y[i] = by * normal[1];
    lines->z[i] = by * normal[2];
}

int gsn_resample_next_part(const struct gsn_voxel_block *block, struct gsn_voxel_block *part)
{
    const size_t ys = block->high[1] - block->low[1];
    const size_t zs = ys < GSN_MOST_ROWS ? GSN_MOST_ROWS / ys : 1;

    if (part->high[1] == block->high[1] || part->high[2] == block->low[2]) {
        if (part->high[2] == block->high[2])
            return 0;
        part->low[2] = part->high[2];
        part->high[2] = block->high[2] - part->low[2] < zs ? block->high[2] : part->low[2] + zs;
        part->high[1] = block->low[1];
    }
    part->low[1] = part->high[1];
    part->high[1] = block->high[1] - part->low[1] < GSN_MOST_ROWS ? block->high[1]
                                                                  : part->low[1] + GSN_MOST_ROWS;
    return 1;
}
