/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline on a regular grid, object by object instead of voxel by voxel.
 *
 * Method: scan conversion (rasterisation) of tetrahedra in three dimensions. A convex body meets a
 * row of voxels in one interval, whose ends are linear in the row's place; a polynomial runs along
 * it with constant differences in its variables. No point is ever searched for.
 *
 * Steps: (1) cut the grid into slabs of layers of equal work, one a thread; (2) every tetrahedron
 * writes its polynomial into the voxels whose centres it holds; (3) every face adds its correction
 * to the voxels in its prism, collected into groups that one kernel takes; (4) what nobody wrote
 * stays NaN. Voxels that rounding could put on either side are decided exactly, by the half-open
 * rule.
 *
 * Failure: GSN_E_INPUT on a grid that is none, GSN_E_NOMEM; the output is then untouched.
 * Cost: a voxel in a core is one polynomial, one in a prism the pieces of its row; the same bits
 * for any number of threads and any instruction set. */
#include "pipeline/model/resample.h"

#include "pipeline/core/grid.h"
#include "pipeline/core/parallel.h"
#include "pipeline/model/bpatch.h"
#include "pipeline/model/face_correction.h"
#include "pipeline/model/orient.h"
#include "pipeline/model/spline_internal.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <string.h>

struct resample_job {
    const struct gsn_spline *spline;
    const struct gsn_dms *space;
    const struct gsn_lattice *at;
    const double *centre[3]; /* along each axis */
    size_t count[3];
    double origin[3], step[3], farthest;
    const size_t *cut; /* the first layers of the slabs, and the number of layers */
    double *value;
};

/* A block of voxels: low inclusive, high not. */
struct voxel_block {
    size_t low[3], high[3];
};

/* --- blocks of voxels, and half-spaces as their rows see them --- */

/* The first voxel along an axis whose centre is not below v (or, above = 1, is above v). */
static size_t first_from(const struct resample_job *job, int axis, double v, int above)
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

/* The voxels of a slab whose centres lie in a closed box. Returns 0 when there are none. */
static int find_block(const struct resample_job *job, const double low[3], const double high[3],
                      const size_t layers[2], struct voxel_block *ret)
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

/* Enlarges a box to hold v. */
static void extend_box(double low[3], double high[3], const double v[3])
{
    for (int c = 0; c < 3; c++) {
        low[c] = v[c] < low[c] ? v[c] : low[c];
        high[c] = v[c] > high[c] ? v[c] : high[c];
    }
}

/* Bodies without faces, told from a point with these y and z. */
static void start_bodies(const struct voxel_block *block, const double about[3],
                         struct gsn_bodies *bodies)
{
    bodies->origin[0] = about[1];
    bodies->origin[1] = about[2];
    bodies->range[0] = (double)block->low[0];
    bodies->range[1] = (double)(block->high[0] - 1);
    bodies->outer.low.count = bodies->outer.high.count = 0;
    bodies->inner.low.count = bodies->inner.high.count = 0;
}

/* Adds {normal . (u - about) + constant >= 0} to a body. flattest: a slope per voxel that is
 * smaller changes nothing over a row. */
static void add_half_space(const struct resample_job *job, const struct voxel_block *block,
                           const double about[3], const double normal[3], double constant,
                           double flattest, struct gsn_convex_body *body)
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

/* Cuts a block into parts of at most GSN_MOST_ROWS rows, one a call; 0 after the last. The caller
 * starts with part->high = block->low. */
static int next_part(const struct voxel_block *block, struct voxel_block *part)
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

/* --- polynomials of tetrahedra --- */

/* Tetrahedra into voxels. */

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

static int is_inside(const struct resample_job *job, const struct solid *solid, unsigned face,
                     int32_t x, const double yz[2])
{
    const uint8_t *f = face_of[face];
    const double u[3] = { job->centre[0][x], yz[0], yz[1] };

    return gsn_orient_side(solid->corner[f[0]], solid->corner[f[1]], solid->corner[f[2]], u) >= 0;
}

/* Decides the open part by one face exactly. The side changes once at most along a row. */
static void decide_face(const struct resample_job *job, const struct solid *solid, unsigned face,
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

static int32_t clip_index(double x, int32_t low, int32_t high)
{
    return x < low ? low : x > high ? high : (int32_t)x;
}

/* A row between whose outer and inner ends lie voxels too near a face. */
static void settle_row(const struct resample_job *job, const struct gsn_bodies *bodies,
                       const struct solid *solid, const double yz[2], struct span *row)
{
    for (unsigned k = 0; k < 4 && row->low < row->high; k++) {
        const struct gsn_lines *lines = solid->is_low[k] ? &bodies->inner.low : &bodies->inner.high;
        const unsigned i = solid->line[k];
        const double end = lines->at[i] + lines->y[i] * (yz[0] - bodies->origin[0]) +
                           lines->z[i] * (yz[1] - bodies->origin[1]);
        struct span open = { row->low, row->high };

        if (solid->is_low[k])
            open.high = clip_index(ceil(end), row->low, row->high);
        else
            open.low = clip_index(floor(end) + 1, row->low, row->high);
        decide_face(job, solid, k, open, yz, row);
    }
}

/* The faces of a tetrahedron as lines, moved outward and inward by their error. */
static void outline_solid(const struct resample_job *job, const struct voxel_block *block,
                          struct solid *solid, struct gsn_bodies *bodies)
{
    const double flattest = FLATTEST * solid->error / (double)(block->high[0] - block->low[0]);

    start_bodies(block, solid->corner[0], bodies);
    for (unsigned k = 0; k < 4; k++) {
        const double *from = solid->corner[face_of[k][0]];
        double d[3], constant;

        gsn_subtract(solid->corner[0], from, d);
        constant = gsn_dot(solid->normal[k], d);
        solid->is_low[k] = !signbit(solid->normal[k][0]);
        solid->line[k] = solid->is_low[k] ? bodies->outer.low.count : bodies->outer.high.count;
        add_half_space(job, block, solid->corner[0], solid->normal[k], constant + solid->error,
                       flattest, &bodies->outer);
        add_half_space(job, block, solid->corner[0], solid->normal[k], constant - solid->error,
                       flattest, &bodies->inner);
    }
}

static void solid_init(const struct resample_job *job, size_t tet, struct solid *solid,
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
        extend_box(low, high, solid->corner[k]);
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
static void paint_init(const struct resample_job *job, size_t tet, const struct solid *solid,
                       const struct voxel_block *block, struct gsn_paint *paint)
{
    const double x = job->centre[0][block->low[0]] - solid->corner[0][0];
    struct gsn_barycentric frame;

    gsn_barycentric_init(&frame, solid->corner[0], solid->corner[1], solid->corner[2],
                         solid->corner[3]);
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
static void fill_tet(const struct resample_job *job, size_t tet, const size_t layers[2])
{
    const struct gsn_kernels *kernels = job->space->kernels;
    const size_t stride[2] = { job->at->nx, job->at->nx * job->at->ny };
    double low[3], high[3];
    struct gsn_rows rows;
    struct gsn_bodies bodies;
    struct gsn_paint paint;
    struct solid solid;
    struct voxel_block block, part = { .low = { 0 } };

    solid_init(job, tet, &solid, low, high);
    if (!find_block(job, low, high, layers, &block))
        return;
    solid_normals(&solid);
    outline_solid(job, &block, &solid, &bodies);
    paint_init(job, tet, &solid, &block, &paint);
    memcpy(part.high, block.low, sizeof part.high);
    while (next_part(&block, &part)) {
        const double *y = &job->centre[1][part.low[1]], *z = &job->centre[2][part.low[2]];
        kernels->rows(&bodies, y, part.high[1] - part.low[1], z, part.high[2] - part.low[2], &rows);
        for (size_t i = 0; i < rows.count; i++) {
            const double yz[2] = { y[rows.y[i]], z[rows.z[i]] };
            struct span row = { rows.low[i], rows.high[i] };

            if (row.low == rows.inner_low[i] && row.high == rows.inner_high[i])
                continue;
            settle_row(job, &bodies, &solid, yz, &row);
            rows.low[i] = row.low;
            rows.high[i] = row.high;
        }
        kernels->paint[job->space->degree](
            &paint, y, z, &rows, stride,
            &job->value[gsn_lattice_index(job->at, 0, part.low[1], part.low[2])]);
    }
}

/* Writes the polynomials into the voxels of a slab that tetrahedra hold. */
static void fill_tets(const struct resample_job *job, const size_t layers[2])
{
    for (size_t t = 0; t < job->space->mesh->tet_count; t++)
        fill_tet(job, t, layers);
}

/* --- corrections of faces --- */

/* Seams into voxels. */

enum { BUCKET = 256 }; /* points that wait for one kernel */

/* Voxels of one face that wait for its kernels, by their unclear clouds. */
struct bucket {
    size_t count, voxel[BUCKET];
    double at[3][BUCKET];
};

/* What a thread needs for faces. */
struct facing {
    struct gsn_prism prism;
    struct gsn_face_correction seam;
    int ready; /* seam is */
    struct bucket bucket[8];
};

static void flush_facing(const struct resample_job *job, struct facing *facing, unsigned unclear)
{
    struct bucket *bucket = &facing->bucket[unclear];
    const double *const at[3] = { bucket->at[0], bucket->at[1], bucket->at[2] };
    double value[BUCKET];

    if (bucket->count == 0)
        return;
    if (!facing->ready)
        gsn_face_correction_init(&facing->seam, job->space, &facing->prism, job->spline->control);
    facing->ready = 1;
    memset(value, 0, bucket->count * sizeof *value);
    gsn_face_correction_add(&facing->seam, unclear, at, bucket->count, value, NULL);
    for (size_t i = 0; i < bucket->count; i++)
        job->value[bucket->voxel[i]] += value[i];
    bucket->count = 0;
}

static void put_voxel(const struct resample_job *job, struct facing *facing, unsigned unclear,
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
        flush_facing(job, facing, unclear);
}

static void put_unclear(const struct resample_job *job, struct facing *facing, int32_t from,
                        int32_t to, const double yz[2], size_t first)
{
    const struct gsn_prism *prism = &facing->prism;

    for (int32_t x = from; x < to; x++) {
        const double d[3] = { job->centre[0][x] - prism->origin[0], yz[0] - prism->origin[1],
                              yz[1] - prism->origin[2] };
        unsigned unclear = 0;

        for (int m = 0; m < 3; m++)
            unclear |= (unsigned)!(gsn_dot(prism->clear[m], d) + prism->clear[m][3] > 0) << m;
        put_voxel(job, facing, unclear, x, yz, first);
    }
}

static void collect_row(const struct resample_job *job, struct facing *facing,
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
        put_voxel(job, facing, 0, x, yz, first);
    put_unclear(job, facing, high, to, yz, first);
}

/* The prism, and the part of it that is clear of all clouds. */
static void outline_prism(const struct resample_job *job, const struct voxel_block *block,
                          const struct gsn_prism *prism, struct gsn_bodies *bodies)
{
    const double voxels = (double)(block->high[0] - block->low[0]);

    start_bodies(block, prism->origin, bodies);
    for (int i = 0; i < 5; i++)
        add_half_space(job, block, prism->origin, prism->inside[i], prism->inside[i][3],
                       1e-13 * (i < 3 ? 1 : prism->size) / voxels, &bodies->outer);
    for (int m = 0; m < 3; m++)
        add_half_space(job, block, prism->origin, prism->clear[m], prism->clear[m][3],
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
            extend_box(low, high, knot[l]);
    }
}

/* Adds the seam of one face to the voxels of a slab. */
static void add_face(const struct resample_job *job, size_t tet, unsigned corner,
                     const size_t layers[2], struct facing *facing)
{
    const struct gsn_dms *space = job->space;
    const int64_t other = space->mesh->neighbour[tet][corner];
    const unsigned top =
        space->sharing == GSN_DMS_SHARED && other >= 0 ? space->degree - 1 : space->degree;
    struct gsn_rows rows;
    struct gsn_bodies bodies;
    double low[3], high[3];
    struct voxel_block block, part = { .low = { 0 } };

    if ((other >= 0 && (size_t)other < tet) || top == 0)
        return;
    box_of_face(space, tet, corner, top, low, high);
    if (!find_block(job, low, high, layers, &block) ||
        !gsn_prism_init(space, tet, corner, &facing->prism))
        return;
    facing->ready = 0;
    outline_prism(job, &block, &facing->prism, &bodies);
    memcpy(part.high, block.low, sizeof part.high);
    while (next_part(&block, &part)) {
        const double *y = &job->centre[1][part.low[1]], *z = &job->centre[2][part.low[2]];
        space->kernels->rows(&bodies, y, part.high[1] - part.low[1], z, part.high[2] - part.low[2],
                             &rows);
        for (size_t i = 0; i < rows.count; i++)
            collect_row(job, facing, &rows, i, (const double[2]){ y[rows.y[i]], z[rows.z[i]] },
                        gsn_lattice_index(job->at, 0, part.low[1] + (size_t)rows.y[i],
                                          part.low[2] + (size_t)rows.z[i]));
    }
    for (unsigned unclear = 0; unclear < 8; unclear++)
        flush_facing(job, facing, unclear);
}

/* Adds the seams to the voxels of a slab. */
static void add_faces(const struct resample_job *job, const size_t layers[2])
{
    struct facing facing;

    for (unsigned unclear = 0; unclear < 8; unclear++)
        facing.bucket[unclear].count = 0;
    for (size_t t = 0; t < job->space->mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++)
            add_face(job, t, k, layers, &facing);
    }
}

/* --- slabs --- */

/* What a grid without any mesh costs, as a share of what the mesh adds. */
#define FILLING 0.1

static int fill_slab(size_t index, void *context, struct gsn_error *err)
{
    const struct resample_job *job = context;
    const size_t *layers = &job->cut[index];
    const size_t area = job->at->nx * job->at->ny;

    (void)err;
    /* Every byte 255 is a NaN, and memset() spares reading what it overwrites. */
    memset(&job->value[layers[0] * area], 255, (layers[1] - layers[0]) * area * sizeof *job->value);
    fill_tets(job, layers);
    add_faces(job, layers);
    return GSN_OK;
}

static int check_lattice(const struct gsn_lattice *at, struct gsn_error *err)
{
    const struct gsn_vec3 last = gsn_lattice_centre(at, at->nx, at->ny, at->nz);
    const double all[9] = { at->origin_um.x, at->origin_um.y, at->origin_um.z,
                            at->step_um.x,   at->step_um.y,   at->step_um.z,
                            last.x,          last.y,          last.z };

    if (at->nx == 0 || at->ny == 0 || at->nz == 0)
        return gsn_fail(err, GSN_E_INPUT, "a grid of %zu x %zu x %zu has no voxels", at->nx, at->ny,
                        at->nz);
    if (at->nx > INT32_MAX / 2)
        return gsn_fail(err, GSN_E_INPUT, "a grid of %zu x %zu x %zu is too wide", at->nx, at->ny,
                        at->nz);
    for (int i = 0; i < 9; i++) {
        if (!isfinite(all[i]))
            return gsn_fail(err, GSN_E_INPUT, "the place of the grid is not finite");
    }
    if (!(at->step_um.x > 0 && at->step_um.y > 0 && at->step_um.z > 0))
        return gsn_fail(err, GSN_E_INPUT,
                        "the steps of the grid, %g x %g x %g um, are not positive", at->step_um.x,
                        at->step_um.y, at->step_um.z);
    return GSN_OK;
}

/* Cuts the layers where each slab has the same share of the mesh's volume and of all voxels. */
static void cut_slabs(const struct resample_job *job, size_t slabs, double *layer, size_t *ret_cut)
{
    const struct gsn_tets *mesh = job->space->mesh;
    const size_t layers = job->count[2];
    double whole = 0, sum = 0;
    size_t z = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double at = (mesh->vertex[mesh->tet[t][0]][2] - job->origin[2]) / job->step[2];
        const double volume = gsn_tets_volume(mesh, t);

        if (!(at >= 0 && at < (double)layers))
            continue;
        whole += volume;
        layer[(size_t)at] += volume;
    }
    for (size_t i = 0; i < slabs; i++) {
        const double share = (double)i / (double)slabs;

        while (z < layers && sum < share * (1 + FILLING) * whole) {
            sum += layer[z] + FILLING * whole / (double)layers;
            z++;
        }
        ret_cut[i] = z;
    }
    ret_cut[slabs] = layers;
}

int gsn_spline_resample(const struct gsn_spline *spline, const struct gsn_lattice *at,
                        unsigned threads, double *ret_value, struct gsn_error *err)
{
    gsn_auto_mem(double) centre = NULL;
    gsn_auto_mem(double) layer = NULL;
    gsn_auto_mem(size_t) cut = NULL;
    const size_t wanted = threads == 0 ? gsn_parallel_threads() : threads;
    const size_t slabs = wanted < at->nz ? wanted : at->nz;
    struct resample_job job = { .spline = spline,
                                .space = gsn_spline_space(spline),
                                .at = at,
                                .count = { at->nx, at->ny, at->nz },
                                .origin = { at->origin_um.x, at->origin_um.y, at->origin_um.z },
                                .step = { at->step_um.x, at->step_um.y, at->step_um.z },
                                .value = ret_value };
    int r = check_lattice(at, err);
    double *to;

    assert(spline && ret_value);

    if (r < 0)
        return r;
    centre = to = gsn_alloc_array(at->nx + at->ny + at->nz, sizeof *centre);
    layer = gsn_alloc_array(at->nz, sizeof *layer);
    cut = gsn_alloc_array(slabs + 1, sizeof *cut);
    if (!centre || !layer || !cut)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a grid of %zu x %zu x %zu", at->nx,
                        at->ny, at->nz);
    for (int c = 0; c < 3; c++) {
        job.centre[c] = to;
        for (size_t i = 0; i < job.count[c]; i++) {
            const struct gsn_vec3 p = gsn_lattice_centre(at, i, i, i);

            *to = c == 0 ? p.x : c == 1 ? p.y : p.z;
            job.farthest = fmax(job.farthest, fabs(*to++));
        }
        job.farthest = fmax(job.farthest, fabs(job.origin[c]));
    }
    cut_slabs(&job, slabs, layer, cut);
    job.cut = cut;
    return gsn_parallel_for(slabs, threads, fill_slab, &job, err);
}

int gsn_spline_grid(const struct gsn_spline *spline, const struct gsn_lattice *at, unsigned threads,
                    struct gsn_grid **ret_grid, struct gsn_error *err)
{
    const size_t voxels = gsn_lattice_count(at);
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto_mem(double) value = NULL;
    int r = gsn_grid_new(at, &grid, err);

    if (r < 0)
        return r;
    value = gsn_alloc_array(voxels, sizeof *value);
    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu voxels", voxels);
    r = gsn_spline_resample(spline, at, threads, value, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < voxels; i++)
        grid->value[i] = (float)value[i];
    *ret_grid = gsn_steal(&grid);
    return GSN_OK;
}
