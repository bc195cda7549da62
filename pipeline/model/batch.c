/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A spline at many points at once.
 *
 * Method: points are put in the order of the Morton (Z-order) curve through the mesh, so that each
 * is located from the tetrahedron of the one before; then work is shared by sorting: all points of
 * a tetrahedron use its polynomial, all points near a face that face's correction, once made ready
 * (docs/MATH.md, section 13).
 *
 * Steps: (1) Morton codes, sorted by radix; (2) chunks of 2048 points go to threads; (3) each point
 * is located; outside is NaN; (4) sorted by tetrahedron, the polynomials are evaluated by the SIMD
 * kernels in groups; (5) points outside their tetrahedron's core are paired with the faces that
 * reach them; (6) the pairs, sorted by face, get their corrections. A point has its faces added in
 * ascending order wherever a list is cut, so the bits do not depend on the threads.
 *
 * Failure: GSN_E_NOMEM, before anything is written. Cost: 32 bytes a point for the order, and a
 * chunk's work on the stack of each thread. */
#include "pipeline/model/batch.h"

#include "pipeline/core/parallel.h"
#include "pipeline/model/bpatch.h"
#include "pipeline/model/face_correction.h"
#include "pipeline/model/spline_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum {
    CHUNK = 2048, /* points that one thread takes at once */
    PAIRS = 4096, /* (face, point) that wait to be sorted */
    GROUP = 64,   /* points of one kernel call */
    CELLS = 1024, /* of the Morton code along an axis */
    DIGIT = 1 << 11,
};

/* A point and its place along the Morton curve. */
struct stop {
    uint32_t code;
    size_t point;
};

struct job {
    const struct gsn_spline *spline;
    const struct gsn_dms *space;
    const double (*at)[3];
    size_t count;
    const struct stop *stop;
    double *value, (*gradient)[3];
};

/* A number to sort by, and which point of the chunk. */
struct key {
    uint32_t by, point;
};

/* What one thread needs for a chunk. */
struct work {
    const struct job *job;
    double u[CHUNK][3];
    struct key key[CHUNK], pair[PAIRS], scratch[PAIRS];
    size_t pairs;
    uint32_t point; /* whose faces are being listed */
    struct gsn_prism prism;
    struct gsn_face_correction seam;
    double value[CHUNK], slope[3][CHUNK];
};

/* Ten bits spread to every third. */
static uint32_t spread_bits(uint32_t x)
{
    x = (x | x << 16) & 0x030000FFu;
    x = (x | x << 8) & 0x0300F00Fu;
    x = (x | x << 4) & 0x030C30C3u;
    return (x | x << 2) & 0x09249249u;
}

static int is_finite(const double u[3])
{
    return isfinite(u[0]) && isfinite(u[1]) && isfinite(u[2]);
}

static uint32_t morton_code(const double low[3], const double scale[3], const double u[3])
{
    uint32_t code = 0;

    for (int c = 0; c < 3; c++) {
        const double cell = (u[c] - low[c]) * scale[c];

        code |= spread_bits(!(cell > 0) ? 0 : cell >= CELLS ? CELLS - 1 : (uint32_t)cell) << c;
    }
    return code;
}

/* One pass of a radix sort that keeps the order of equals. */
static void sort_stops(const struct stop *from, size_t count, unsigned shift, struct stop *to)
{
    size_t start[DIGIT] = { 0 }, sum = 0;

    for (size_t i = 0; i < count; i++)
        start[from[i].code >> shift & (DIGIT - 1)]++;
    for (size_t d = 0; d < DIGIT; d++) {
        const size_t here = start[d];

        start[d] = sum;
        sum += here;
    }
    for (size_t i = 0; i < count; i++)
        to[start[from[i].code >> shift & (DIGIT - 1)]++] = from[i];
}

/* The points along the Morton curve through the box of the mesh; equals in the order given. */
static void plan_stops(const struct gsn_tets *mesh, const double (*at)[3], size_t count,
                       struct stop *ret_stop, struct stop *scratch)
{
    double low[3], scale[3];

    for (int c = 0; c < 3; c++) {
        double high = low[c] = mesh->vertex[0][c];

        for (size_t v = 1; v < mesh->vertex_count; v++) {
            low[c] = fmin(low[c], mesh->vertex[v][c]);
            high = fmax(high, mesh->vertex[v][c]);
        }
        scale[c] = CELLS / (high - low[c]);
    }
    for (size_t i = 0; i < count; i++)
        scratch[i] =
            (struct stop){ is_finite(at[i]) ? morton_code(low, scale, at[i]) : UINT32_MAX, i };
    sort_stops(scratch, count, 0, ret_stop);
    sort_stops(ret_stop, count, 11, scratch);
    sort_stops(scratch, count, 22, ret_stop);
}

/* Sorts by the numbers, equals in their order, byte by byte where they differ. */
static void sort_keys(struct key *key, size_t count, struct key *scratch)
{
    uint32_t differ = 0;

    for (size_t i = 1; i < count; i++)
        differ |= key[i].by ^ key[0].by;
    for (unsigned shift = 0; shift < 32; shift += 8) {
        uint32_t start[256] = { 0 }, sum = 0;

        if ((differ >> shift & 255) == 0)
            continue;
        for (size_t i = 0; i < count; i++)
            start[key[i].by >> shift & 255]++;
        for (size_t d = 0; d < 256; d++) {
            const uint32_t here = start[d];

            start[d] = sum;
            sum += here;
        }
        for (size_t i = 0; i < count; i++)
            scratch[start[key[i].by >> shift & 255]++] = key[i];
        memcpy(key, scratch, count * sizeof *key);
    }
}

/* Adds the seam of the face that has been prepared at up to GROUP points of one kind. */
static void add_group(struct work *work, unsigned unclear, const uint32_t *point, size_t count)
{
    double at[3][GROUP], value[GROUP] = { 0 }, slope[3][GROUP];
    const double *const u[3] = { at[0], at[1], at[2] };
    double *const slopes[3] = { slope[0], slope[1], slope[2] };

    memset(slope, 0, sizeof slope);
    for (size_t i = 0; i < count; i++) {
        for (int c = 0; c < 3; c++)
            at[c][i] = work->u[point[i]][c];
    }
    gsn_face_correction_add(&work->seam, unclear, u, count, value,
                            work->job->gradient ? slopes : NULL);
    for (size_t i = 0; i < count; i++) {
        work->value[point[i]] += value[i];
        for (int c = 0; work->job->gradient && c < 3; c++)
            work->slope[c][point[i]] += slope[c][i];
    }
}

/* Adds the seam of one face to the points paired with it. */
static void add_face(struct work *work, const struct key *pair, size_t count)
{
    const struct gsn_dms *space = work->job->space;
    uint32_t point[8][GROUP];
    size_t waiting[8] = { 0 };
    int ready = 0;

    if (!gsn_prism_init(space, pair->by / 4, pair->by % 4, &work->prism))
        return;
    for (size_t i = 0; i < count; i++) {
        const int unclear = gsn_prism_at(&work->prism, work->u[pair[i].point]);

        if (unclear < 0)
            continue;
        if (!ready)
            gsn_face_correction_init(&work->seam, space, &work->prism, work->job->spline->control);
        ready = 1;
        point[unclear][waiting[unclear]++] = pair[i].point;
        if (waiting[unclear] == GROUP) {
            add_group(work, (unsigned)unclear, point[unclear], GROUP);
            waiting[unclear] = 0;
        }
    }
    for (unsigned unclear = 0; unclear < 8; unclear++) {
        if (waiting[unclear] != 0)
            add_group(work, unclear, point[unclear], waiting[unclear]);
    }
}

/* A point's faces come ascending, so that it has them added in this order wherever lists are
 * cut. */
static void add_pairs(struct work *work)
{
    sort_keys(work->pair, work->pairs, work->scratch);
    for (size_t i = 0, end; i < work->pairs; i = end) {
        for (end = i + 1; end < work->pairs && work->pair[end].by == work->pair[i].by;)
            end++;
        add_face(work, &work->pair[i], end - i);
    }
    work->pairs = 0;
}

static void list_face(void *context, size_t tet, unsigned corner)
{
    struct work *work = context;

    if (work->pairs == PAIRS)
        add_pairs(work);
    work->pair[work->pairs++] = (struct key){ (uint32_t)(4 * tet + corner), work->point };
}

/* The polynomials of one tetrahedron at some of its points, and the faces of those that are not in
 * its core. */
static void eval_group(struct work *work, const struct gsn_dms_shape *shape,
                       const double *coefficient, const struct key *key, size_t count)
{
    const struct gsn_dms *space = work->job->space;
    const struct gsn_barycentric *frame = &shape->frame;
    double lambda[3][GROUP], value[GROUP], slope[3][GROUP];
    const double *const at[3] = { lambda[0], lambda[1], lambda[2] };
    double *const slopes[3] = { slope[0], slope[1], slope[2] };
    const int with_gradient = work->job->gradient != NULL;

    for (size_t i = 0; i < count; i++) {
        double d[3];

        gsn_subtract(work->u[key[i].point], frame->origin, d);
        for (int k = 0; k < 3; k++)
            lambda[k][i] = gsn_dot(frame->row[k], d);
    }
    space->kernels->points[space->degree](coefficient, at, count, value,
                                          with_gradient ? slopes : NULL);
    for (size_t i = 0; i < count; i++) {
        const uint32_t point = key[i].point;

        work->value[point] = value[i];
        for (int c = 0; with_gradient && c < 3; c++)
            work->slope[c][point] = frame->row[0][c] * slope[0][i] +
                                    frame->row[1][c] * slope[1][i] + frame->row[2][c] * slope[2][i];
    }
    for (size_t i = 0; i < count; i++) {
        const double all[4] = { 1 - lambda[0][i] - lambda[1][i] - lambda[2][i], lambda[0][i],
                                lambda[1][i], lambda[2][i] };

        if (gsn_dms_clear(shape, all) == GSN_DMS_ALL)
            continue;
        work->point = key[i].point;
        gsn_face_correction_each(space, key[i].by, work->u[key[i].point], list_face, work);
    }
}

static void eval_home(struct work *work, const struct key *key, size_t count)
{
    const struct gsn_dms *space = work->job->space;
    double coefficient[GSN_DMS_MAX_FUNCTIONS];
    struct gsn_dms_shape shape;

    gsn_dms_shape_of(space, key->by, &shape);
    gsn_poly_of_bernstein(space->degree,
                          &work->job->spline->bernstein[key->by * gsn_dms_functions(space)],
                          coefficient);
    for (size_t i = 0; i < count; i += GROUP)
        eval_group(work, &shape, coefficient, &key[i], count - i < GROUP ? count - i : GROUP);
}

/* The homes of the points of a chunk; those outside get their answer here. Returns how many are
 * inside. */
static size_t locate_points(struct work *work, size_t count)
{
    size_t hint = 0, inside = 0;

    for (size_t i = 0; i < count; i++) {
        const double *u = work->u[i];

        if (is_finite(u) && gsn_dms_locate(work->job->space, u, hint, &hint) == GSN_OK) {
            work->key[inside++] = (struct key){ (uint32_t)hint, (uint32_t)i };
            continue;
        }
        work->value[i] = NAN;
        for (int c = 0; c < 3; c++)
            work->slope[c][i] = NAN;
    }
    return inside;
}

static int eval_chunk(size_t index, void *context, struct gsn_error *err)
{
    const struct job *job = context;
    const size_t first = index * CHUNK;
    const size_t count = job->count - first < CHUNK ? job->count - first : CHUNK;
    const struct stop *stop = &job->stop[first];
    struct work work;
    size_t inside;

    (void)err;
    work.job = job;
    work.pairs = 0;
    /* All at once: the memory is far away. */
    for (size_t i = 0; i < count; i++)
        memcpy(work.u[i], job->at[stop[i].point], sizeof work.u[i]);
    inside = locate_points(&work, count);
    sort_keys(work.key, inside, work.scratch);
    for (size_t i = 0, end; i < inside; i = end) {
        for (end = i + 1; end < inside && work.key[end].by == work.key[i].by;)
            end++;
        eval_home(&work, &work.key[i], end - i);
    }
    add_pairs(&work);
    for (size_t i = 0; i < count; i++) {
        const size_t point = stop[i].point;

        job->value[point] = work.value[i];
        for (int c = 0; job->gradient && c < 3; c++)
            job->gradient[point][c] = work.slope[c][i];
    }
    return GSN_OK;
}

int gsn_spline_eval_many(const struct gsn_spline *spline, const double (*at)[3], size_t count,
                         unsigned threads, double *ret_value, double (*ret_gradient)[3],
                         struct gsn_error *err)
{
    gsn_auto_mem(struct stop) stop = NULL;
    gsn_auto_mem(struct stop) scratch = NULL;
    struct job job = { .spline = spline,
                       .space = gsn_spline_space(spline),
                       .at = at,
                       .count = count,
                       .value = ret_value,
                       .gradient = ret_gradient };

    assert(spline && ((at && ret_value) || count == 0));

    stop = gsn_alloc_array(count, sizeof *stop);
    scratch = gsn_alloc_array(count, sizeof *scratch);
    if (!stop || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu points", count);
    plan_stops(job.space->mesh, at, count, stop, scratch);
    job.stop = stop;
    return gsn_parallel_for((count + CHUNK - 1) / CHUNK, threads, eval_chunk, &job, err);
}
