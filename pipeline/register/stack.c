/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/stack.h"

#include "pipeline/core/parallel.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* A section with the way back into its pixels. */
struct source {
    const struct gsn_stack_section *section;
    struct gsn_affine back;        /* block um to pixels of the plane */
    long left, top, right, bottom; /* of the plane, what may be read; ends exclusive */
};

struct job {
    struct gsn_grid *grid;
    const struct source *sources;
    size_t count;
    size_t *planes; /* of the grid, those with a section: which */
    size_t *of;     /* and whose */
};

/* Four floats at once on every machine, so that all give the same bits. */
typedef float four __attribute__((vector_size(16)));

static four load(const float *from)
{
    four value;

    memcpy(&value, from, sizeof value);
    return value;
}

/* Keys' cubic convolution kernel with a = -1/2, for the taps at -1, 0, 1, 2 and the fraction t. */
static four keys(float t)
{
    const float t2 = t * t, t3 = t2 * t;

    return (four){ -0.5F * t3 + t2 - 0.5F * t, 1.5F * t3 - 2.5F * t2 + 1,
                   -1.5F * t3 + 2 * t2 + 0.5F * t, 0.5F * t3 - 0.5F * t2 };
}

static int has(const struct source *s, long x, long y)
{
    return x >= s->left && y >= s->top && x < s->right && y < s->bottom;
}

/* The pixel, or NaN outside the section's box. */
static float tap(const struct source *s, long x, long y)
{
    const struct gsn_plane *density = s->section->density;

    return has(s, x, y) ? density->value[(size_t)y * density->width + (size_t)x] : NAN;
}

/* Over the valid ones of the nearest four pixels, weights made to sum to 1. */
static float bilinear(const struct source *s, long x, long y, float tx, float ty)
{
    float sum = 0, weight = 0;

    for (int k = 0; k < 4; k++) {
        const float w = (k % 2 ? tx : 1 - tx) * (k / 2 ? ty : 1 - ty);
        const float value = tap(s, x + k % 2, y + k / 2);

        if (isnan(value))
            continue;
        sum += w * value;
        weight += w;
    }
    return weight > 0 ? sum / weight : NAN;
}

/* All 16 pixels lie in the box. */
static float cubic(const struct gsn_plane *density, long x, long y, float tx, float ty)
{
    const float *row = density->value + (size_t)(y - 1) * density->width + (x - 1);
    const four wy = keys(ty);
    four sum = wy[0] * load(row);

    for (int j = 1; j < 4; j++)
        sum += wy[j] * load(row + (size_t)j * density->width);
    sum *= keys(tx);
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

static float sample(const struct source *s, double px, double py)
{
    long x, y;
    float tx, ty, value;

    /* Far outside, where a long might not hold the number. */
    if (!(px > (double)s->left - 2 && py > (double)s->top - 2 && px < (double)s->right + 2 &&
          py < (double)s->bottom + 2))
        return NAN;
    /* Nothing is below -3 here, so cutting off the fraction rounds down. */
    x = (long)(px + 7.5) - 8;
    y = (long)(py + 7.5) - 8;
    tx = (float)(px - 0.5 - (double)x);
    ty = (float)(py - 0.5 - (double)y);
    if (isnan(tap(s, x + (tx >= 0.5F), y + (ty >= 0.5F))))
        return NAN;
    if (!has(s, x - 1, y - 1) || !has(s, x + 2, y + 2))
        return bilinear(s, x, y, tx, ty);
    value = cubic(s->section->density, x, y, tx, ty);
    return isnan(value) ? bilinear(s, x, y, tx, ty) : value;
}

/* One row of the lattice; every row is written by one call, so the threads cannot matter. */
static int fill_row(size_t index, void *context, struct gsn_error *err)
{
    const struct job *job = context;
    const struct gsn_lattice *at = &job->grid->at;
    const size_t y = index % at->ny, k = index / at->ny;
    const struct source *source = &job->sources[job->of[k]];
    const struct gsn_affine *back = &source->back;
    const struct gsn_vec3 first = gsn_lattice_centre(at, 0, y, job->planes[k]);
    float *row = job->grid->value + gsn_lattice_index(at, 0, y, job->planes[k]);

    (void)err;
    for (size_t x = 0; x < at->nx; x++) {
        const double um = first.x + (double)x * at->step_um.x;

        row[x] = sample(source, back->m00 * um + back->m01 * first.y + back->m02,
                        back->m10 * um + back->m11 * first.y + back->m12);
    }
    return GSN_OK;
}

static int check_section(const struct gsn_stack_section *s, struct gsn_error *err)
{
    const double det = gsn_affine_det(&s->panel_to_block_um);

    if (!s->density)
        return gsn_fail(err, GSN_E_INPUT, "section %u has no pixels", s->serial + 1);
    if (s->x < s->plane_x || s->y < s->plane_y || s->width < 1 || s->height < 1 ||
        (int64_t)s->x - s->plane_x + s->width > s->density->width ||
        (int64_t)s->y - s->plane_y + s->height > s->density->height)
        return gsn_fail(err, GSN_E_INPUT, "the box of section %u reaches outside its panel",
                        s->serial + 1);
    if (!isfinite(det) || det == 0 || !isfinite(s->panel_to_block_um.m02) ||
        !isfinite(s->panel_to_block_um.m12))
        return gsn_fail(err, GSN_E_INPUT, "the pose of section %u cannot be undone", s->serial + 1);
    return GSN_OK;
}

static int check(const struct gsn_stack_section *sections, size_t count, struct gsn_error *err)
{
    for (size_t i = 0; i < count; i++) {
        const int r = check_section(&sections[i], err);

        if (r < 0)
            return r;
        for (size_t k = 0; k < i; k++) {
            if (sections[k].serial == sections[i].serial)
                return gsn_fail(err, GSN_E_INPUT,
                                "sections %zu and %zu of %zu both carry serial number %u", k + 1,
                                i + 1, count, sections[i].serial + 1);
        }
    }
    return GSN_OK;
}

static struct source source_of(const struct gsn_stack_section *section)
{
    struct source source = { .section = section,
                             .back = gsn_affine_inverse(&section->panel_to_block_um),
                             .left = (long)section->x - section->plane_x,
                             .top = (long)section->y - section->plane_y };

    source.back.m02 -= section->plane_x;
    source.back.m12 -= section->plane_y;
    source.right = source.left + section->width;
    source.bottom = source.top + section->height;
    return source;
}

static double serial_of_plane(const struct gsn_lattice *at, size_t z, double interval_um)
{
    return round(gsn_lattice_centre(at, 0, 0, z).z / interval_um - 0.5);
}

int gsn_stack_footprint(const struct gsn_lattice *at, double interval_um,
                        struct gsn_stack_section *section)
{
    /* Cubic convolution reaches two pixels; the rest is for rounding. */
    const double reach = 3;
    const struct gsn_affine back = gsn_affine_inverse(&section->panel_to_block_um);
    double left = INFINITY, top = INFINITY, right = -INFINITY, bottom = -INFINITY;
    size_t planes = 0;

    for (size_t z = 0; z < at->nz; z++)
        planes += serial_of_plane(at, z, interval_um) == (double)section->serial;
    for (size_t corner = 0; corner < 4; corner++) {
        const struct gsn_vec3 um =
            gsn_lattice_centre(at, corner % 2 ? at->nx - 1 : 0, corner / 2 ? at->ny - 1 : 0, 0);
        const struct gsn_point px = gsn_affine_apply(&back, (struct gsn_point){ um.x, um.y });

        left = fmin(left, px.x - reach);
        top = fmin(top, px.y - reach);
        right = fmax(right, px.x + reach);
        bottom = fmax(bottom, px.y + reach);
    }
    left = fmax(floor(left), section->x);
    top = fmax(floor(top), section->y);
    right = fmin(ceil(right), (double)section->x + section->width);
    bottom = fmin(ceil(bottom), (double)section->y + section->height);
    if (planes == 0 || !(left < right && top < bottom))
        return 0;
    section->x = (int)left;
    section->y = (int)top;
    section->width = (int)(right - left);
    section->height = (int)(bottom - top);
    return 1;
}

static int fill(struct job *job, double interval_um, unsigned threads, struct gsn_error *err)
{
    const struct gsn_lattice *at = &job->grid->at;
    size_t planes = 0;

    for (size_t z = 0; z < at->nz; z++) {
        const double serial = serial_of_plane(at, z, interval_um);

        for (size_t i = 0; i < job->count; i++)
            if ((double)job->sources[i].section->serial == serial) {
                job->planes[planes] = z;
                job->of[planes++] = i;
            }
    }
    return gsn_parallel_for(at->ny * planes, threads, fill_row, job, err);
}

int gsn_stack_resample(const struct gsn_stack_section *sections, size_t count, double interval_um,
                       unsigned threads, struct gsn_grid *grid, struct gsn_error *err)
{
    gsn_auto_mem(struct source) sources = NULL;
    gsn_auto_mem(size_t) planes = NULL;
    gsn_auto_mem(size_t) of = NULL;
    struct job job;
    int r;

    assert((sections || count == 0) && grid);

    if (!(interval_um > 0))
        return gsn_fail(err, GSN_E_INPUT, "a section interval of %g um", interval_um);
    r = check(sections, count, err);
    if (r < 0)
        return r;
    sources = gsn_alloc_array(count + 1, sizeof *sources);
    planes = gsn_alloc_array(grid->at.nz, sizeof *planes);
    of = gsn_alloc_array(grid->at.nz, sizeof *of);
    if (!sources || !planes || !of)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the stack");
    for (size_t i = 0; i < count; i++)
        sources[i] = source_of(&sections[i]);
    job = (struct job){ grid, sources, count, planes, of };
    return fill(&job, interval_um, threads, err);
}
