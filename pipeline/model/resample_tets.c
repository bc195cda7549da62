/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Tetrahedra into voxels. */
#include "pipeline/model/orient.h"
#include "pipeline/model/poly.h"
#include "pipeline/model/resample_internal.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* Rounding error of a computed plane value, in units of (length of the tetrahedron)^2 (that length
 * + largest coordinate): 7 operations on differences, voxel centres off the straight line. */
#define PLANE_ERROR (128 * DBL_EPSILON / 2)

/* A line that is so steep along y and z that it decides nothing but the side of its whole row
 * stays that far from being parallel, relative to its error over all the voxels of a row. */
#define FLATTEST 1e-3

/* The face opposite corner k, in the order that has corner k on its positive side. */
static const uint8_t face_of[4][3] = { { 1, 3, 2 }, { 0, 2, 3 }, { 0, 3, 1 }, { 0, 1, 2 } };

/* A tetrahedron while its voxels are filled. */
struct solid {
    const double *corner[4];
    double normal[4][3]; /* inward, of the faces opposite the corners */
    double error;        /* of normal . (u - face), at most */
    /* The line that face k is, in low or high of both bodies. */
    unsigned line[4];
    int is_low[4];
};

/* Part of a row. */
struct span {
    int32_t low, high;
};

static int is_inside(const struct gsn_resample_job *job, const struct solid *solid, unsigned face,
                     int32_t x, const double yz[2])
{
    const uint8_t *f = face_of[face];
    const double u[3] = { job->centre[0][x], yz[0], yz[1] };

    return gsn_orient_side(solid->corner[f[0]], solid->corner[f[1]], solid->corner[f[2]], u) >= 0;
}

/* Decides the open part by one face exactly. The side changes once at most along a row. */
static void decide(const struct gsn_resample_job *job, const struct solid *solid, unsigned face,
                   struct span open, const double yz[2], struct span *row)
{
    int first, last;

    if (open.low >= open.high)
        return;
    first = is_inside(job, solid, face, open.low, yz);
    last = open.high - open.low > 1 ? is_inside(job, solid, face, open.high - 1, yz) : first;
    if (first != last) {
        int32_t same = open.low, other = open.high - 1;

        while (other - same > 1) {
            const int32_t middle = same + (other - same) / 2;

            if (is_inside(job, solid, face, middle, yz) == first)
                same = middle;
            else
                other = middle;
        }
        if (first)
            row->high = other;
        else
            row->low = other;
    } else if (!first) {
        if (solid->is_low[face])
            row->low = open.high;
        else
            row->high = open.low;
    }
}

static int32_t clip(double x, int32_t low, int32_t high)
{
    return x < low ? low : x > high ? high : (int32_t)x;
}

/* A row between whose outer and inner ends lie voxels too near a face. */
static void settle(const struct gsn_resample_job *job, const struct gsn_bodies *bodies,
                   const struct solid *solid, const double yz[2], struct span *row)
{
    for (unsigned k = 0; k < 4 && row->low < row->high; k++) {
        const struct gsn_lines *lines = solid->is_low[k] ? &bodies->inner.low : &bodies->inner.high;
        const unsigned i = solid->line[k];
        const double end = lines->at[i] + lines->y[i] * (yz[0] - bodies->origin[0]) +
                           lines->z[i] * (yz[1] - bodies->origin[1]);
        struct span open = { row->low, row->high };

        if (solid->is_low[k])
            open.high = clip(ceil(end), row->low, row->high);
        else
            open.low = clip(floor(end) + 1, row->low, row->high);
        decide(job, solid, k, open, yz, row);
    }
}

/* The faces of a tetrahedron as lines, moved outward and inward by their error. */
static void outline(const struct gsn_resample_job *job, const struct gsn_voxel_block *block,
                    struct solid *solid, struct gsn_bodies *bodies)
{
    const double flattest = FLATTEST * solid->error / (double)(block->high[0] - block->low[0]);

    gsn_resample_start(block, solid->corner[0], bodies);
    for (unsigned k = 0; k < 4; k++) {
        const double *from = solid->corner[face_of[k][0]];
        double d[3], constant;

        gsn_subtract(solid->corner[0], from, d);
        constant = gsn_dot(solid->normal[k], d);
        solid->is_low[k] = !signbit(solid->normal[k][0]);
        solid->line[k] = solid->is_low[k] ? bodies->outer.low.count : bodies->outer.high.count;
        gsn_resample_half_space(job, block, solid->corner[0], solid->normal[k],
                                constant + solid->error, flattest, &bodies->outer);
        gsn_resample_half_space(job, block, solid->corner[0], solid->normal[k],
                                constant - solid->error, flattest, &bodies->inner);
    }
}

static void solid_init(const struct gsn_resample_job *job, size_t tet, struct solid *solid,
                       double low[3], double high[3])
{
    const struct gsn_tets *mesh = job->space->mesh;
    double length = 0;

    for (int k = 0; k < 4; k++) {
        solid->corner[k] = mesh->vertex[mesh->tet[tet][k]];
        if (k == 0) {
            memcpy(low, solid->corner[0], 3 * sizeof *low);
            memcpy(high, solid->corner[0], 3 * sizeof *high);
        }
        gsn_resample_extend(low, high, solid->corner[k]);
    }
    for (int c = 0; c < 3; c++)
        length += high[c] - low[c];
    solid->error = PLANE_ERROR * length * length * (length + job->farthest);
}

static void solid_normals(struct solid *solid)
{
    for (unsigned k = 0; k < 4; k++) {
        const uint8_t *f = face_of[k];
        double p[3], q[3];

        gsn_subtract(solid->corner[f[1]], solid->corner[f[0]], p);
        gsn_subtract(solid->corner[f[2]], solid->corner[f[0]], q);
        gsn_cross(p, q, solid->normal[k]);
    }
}

/* The polynomial of a tetrahedron as a function of lambda_1..3. */
static void paint_init(const struct gsn_resample_job *job, size_t tet, const struct solid *solid,
                       const struct gsn_voxel_block *block, struct gsn_paint *paint)
{
    const double x = job->centre[0][block->low[0]] - solid->corner[0][0];
    struct gsn_frame frame;

    gsn_frame_init(&frame, solid->corner[0], solid->corner[1], solid->corner[2], solid->corner[3]);
    gsn_poly_of_bernstein(job->space->degree,
                          &job->spline->bernstein[tet * gsn_dms_functions(job->space)],
                          paint->coefficient);
    paint->origin[0] = solid->corner[0][1];
    paint->origin[1] = solid->corner[0][2];
    for (int k = 0; k < 3; k++) {
        paint->x[k] = frame.row[k][0] * job->step[0];
        paint->at[k] = frame.row[k][0] * x - paint->x[k] * (double)block->low[0];
        paint->y[k] = frame.row[k][1];
        paint->z[k] = frame.row[k][2];
    }
}

/* Writes the polynomial of one tetrahedron into the voxels of a slab that it holds. */
static void fill_tet(const struct gsn_resample_job *job, size_t tet, const size_t layers[2])
{
    const struct gsn_kernels *kernels = job->space->kernels;
    const size_t stride[2] = { job->at->nx, job->at->nx * job->at->ny };
    double low[3], high[3];
    struct gsn_rows rows;
    struct gsn_bodies bodies;
    struct gsn_paint paint;
    struct solid solid;
    struct gsn_voxel_block block, part = { .low = { 0 } };

    solid_init(job, tet, &solid, low, high);
    if (!gsn_resample_block_of(job, low, high, layers, &block))
        return;
    solid_normals(&solid);
    outline(job, &block, &solid, &bodies);
    paint_init(job, tet, &solid, &block, &paint);
    memcpy(part.high, block.low, sizeof part.high);
    while (gsn_resample_next_part(&block, &part)) {
        const double *y = &job->centre[1][part.low[1]], *z = &job->centre[2][part.low[2]];
        kernels->rows(&bodies, y, part.high[1] - part.low[1], z, part.high[2] - part.low[2], &rows);
        for (size_t i = 0; i < rows.count; i++) {
            const double yz[2] = { y[rows.y[i]], z[rows.z[i]] };
            struct span row = { rows.low[i], rows.high[i] };

            if (row.low == rows.inner_low[i] && row.high == rows.inner_high[i])
                continue;
            settle(job, &bodies, &solid, yz, &row);
            rows.low[i] = row.low;
            rows.high[i] = row.high;
        }
        kernels->paint[job->space->degree](
            &paint, y, z, &rows, stride,
            &job->value[gsn_lattice_index(job->at, 0, part.low[1], part.low[2])]);
    }
}

void gsn_resample_tets(const struct gsn_resample_job *job, const size_t layers[2])
{
    for (size_t t = 0; t < job->space->mesh->tet_count; t++)
        fill_tet(job, t, layers);
}
