/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Resamples the registered sections into the planes of a grid.
 *
 * Steps: (1) the sections are checked, and each plane of the lattice gets the section whose serial
 * number it shows; planes of none are left alone. (2) Every voxel's centre goes back through the
 * section's pose. (3) There cubic convolution (Keys 1981, a = -1/2) over 16 pixels; where one of
 * them is masked or outside the box, bilinear over the valid ones of the nearest four. (4) Where
 * voxels are coarser than pixels the kernel is as many times wider, over its valid pixels.
 *
 * Our own and not OpenCV's, whose cubic warp rounds places to 1/32 pixel: an error of up to 0.065
 * pixels of the density. Rows are shared out among threads, each written by one call, so the result
 * does not depend on their number. */
#include "pipeline/register/stack/resample.h"

#include "pipeline/core/parallel.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* A section with the way back into its pixels. */
struct source {
    const struct gsn_stack_section *section;
    struct gsn_affine back;        /* block um to pixels of the plane */
    long left, top, right, bottom; /* of the plane, what may be read; ends exclusive */
    double reach;                  /* gsn_stack_reach() */
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

static four load_four(const float *from)
{
    four value;

    memcpy(&value, from, sizeof value);
    return value;
}

/* Keys' cubic convolution kernel with a = -1/2, for the taps at -1, 0, 1, 2 and the fraction t. */
static four cubic_weights(float t)
{
    const four c0 = { 0, 1, 0, 0 }, c1 = { -0.5F, 0, 0.5F, 0 }, c2 = { 1, -2.5F, 2, -0.5F },
               c3 = { -0.5F, 1.5F, -1.5F, 0.5F };

    return ((c3 * t + c2) * t + c1) * t + c0;
}

static int has_pixel(const struct source *s, long x, long y)
{
    return x >= s->left && y >= s->top && x < s->right && y < s->bottom;
}

/* The pixel, or NaN outside the section's box. */
static float get_pixel(const struct source *s, long x, long y)
{
    const struct gsn_plane *density = s->section->density;

    return has_pixel(s, x, y) ? density->value[(size_t)y * density->width + (size_t)x] : NAN;
}

/* Over the valid ones of the nearest four pixels, weights made to sum to 1. */
static float sample_bilinear(const struct source *s, long x, long y, float tx, float ty)
{
    float sum = 0, weight = 0;

    for (int k = 0; k < 4; k++) {
        const float w = (k % 2 ? tx : 1 - tx) * (k / 2 ? ty : 1 - ty);
        const float value = get_pixel(s, x + k % 2, y + k / 2);

        if (isnan(value))
            continue;
        sum += w * value;
        weight += w;
    }
    return weight > 0 ? sum / weight : NAN;
}

/* All 16 pixels lie in the box. NaN when one of them is. */
static float sample_cubic(const struct gsn_plane *density, long x, long y, float tx, float ty)
{
    const size_t width = density->width;
    const float *row = density->value + (size_t)(y - 1) * width + (x - 1);
    const four wy = cubic_weights(ty);
    const four sum = cubic_weights(tx) *
                     ((wy[0] * load_four(row) + wy[1] * load_four(row + width)) +
                      (wy[2] * load_four(row + 2 * width) + wy[3] * load_four(row + 3 * width)));

    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

static float sample_point(const struct source *s, double px, double py)
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
    if (has_pixel(s, x - 1, y - 1) && has_pixel(s, x + 2, y + 2)) {
        value = sample_cubic(s->section->density, x, y, tx, ty);
        if (!isnan(value))
            return value;
    }
    return isnan(get_pixel(s, x + (tx >= 0.5F), y + (ty >= 0.5F)))
               ? NAN
               : sample_bilinear(s, x, y, tx, ty);
}

static double cubic_weight(double x)
{
    const double t = fabs(x);

    return t >= 2 ? 0 : t > 1 ? ((-0.5 * t + 2.5) * t - 4) * t + 2 : (1.5 * t - 2.5) * t * t + 1;
}

/* The kernel of a coarse voxel, two voxels to either side. */
static float sample_wide(const struct source *s, double px, double py)
{
    const double wide = 2 * s->reach;
    double sum = 0, valid = 0, all = 0;

    if (!(px > (double)s->left - wide && py > (double)s->top - wide &&
          px < (double)s->right + wide && py < (double)s->bottom + wide))
        return NAN;
    for (long y = (long)floor(py - wide); (double)y < py + wide; y++) {
        const double wy = cubic_weight(((double)y + 0.5 - py) / s->reach);

        for (long x = (long)floor(px - wide); (double)x < px + wide; x++) {
            const double w = wy * cubic_weight(((double)x + 0.5 - px) / s->reach);
            const float value = get_pixel(s, x, y);

            all += w;
            valid += isnan(value) ? 0 : w;
            sum += isnan(value) ? 0 : w * value;
        }
    }
    return valid > 0.5 * all ? (float)(sum / valid) : NAN;
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

        const double px = back->m00 * um + back->m01 * first.y + back->m02;
        const double py = back->m10 * um + back->m11 * first.y + back->m12;

        row[x] = source->reach > 1 ? sample_wide(source, px, py) : sample_point(source, px, py);
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

static int check_all(const struct gsn_stack_section *sections, size_t count, struct gsn_error *err)
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

static struct source make_source(const struct gsn_stack_section *section,
                                 const struct gsn_lattice *at)
{
    struct source source = { .section = section,
                             .back = gsn_affine_inverse(&section->panel_to_block_um),
                             .left = (long)section->x - section->plane_x,
                             .top = (long)section->y - section->plane_y,
                             .reach = gsn_stack_reach(&section->panel_to_block_um, at) };

    source.back.m02 -= section->plane_x;
    source.back.m12 -= section->plane_y;
    source.right = source.left + section->width;
    source.bottom = source.top + section->height;
    return source;
}

int gsn_stack_shows(const struct gsn_lattice *at, double interval_um, size_t z, unsigned serial)
{
    return round(gsn_lattice_centre(at, 0, 0, z).z / interval_um - 0.5) == (double)serial;
}

double gsn_stack_reach(const struct gsn_affine *panel_to_block_um, const struct gsn_lattice *at)
{
    const double pixel_um = sqrt(fabs(gsn_affine_det(panel_to_block_um)));
    const double reach = sqrt(fabs(at->step_um.x * at->step_um.y)) / pixel_um;

    return reach > 1.01 ? reach : 1;
}

int gsn_stack_footprint(const struct gsn_lattice *at, double interval_um,
                        struct gsn_stack_section *section)
{
    /* Cubic convolution reaches two voxels; the rest is for rounding. */
    const double reach = 2 * gsn_stack_reach(&section->panel_to_block_um, at) + 1;
    const struct gsn_affine back = gsn_affine_inverse(&section->panel_to_block_um);
    double left = INFINITY, top = INFINITY, right = -INFINITY, bottom = -INFINITY;
    size_t planes = 0;

    for (size_t z = 0; z < at->nz; z++)
        planes += (size_t)gsn_stack_shows(at, interval_um, z, section->serial);
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

static int fill_all(struct job *job, double interval_um, unsigned threads, struct gsn_error *err)
{
    const struct gsn_lattice *at = &job->grid->at;
    size_t planes = 0;

    for (size_t z = 0; z < at->nz; z++)
        for (size_t i = 0; i < job->count; i++)
            if (gsn_stack_shows(at, interval_um, z, job->sources[i].section->serial)) {
                job->planes[planes] = z;
                job->of[planes++] = i;
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
    r = check_all(sections, count, err);
    if (r < 0)
        return r;
    sources = gsn_alloc_array(count + 1, sizeof *sources);
    planes = gsn_alloc_array(grid->at.nz, sizeof *planes);
    of = gsn_alloc_array(grid->at.nz, sizeof *of);
    if (!sources || !planes || !of)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the stack");
    for (size_t i = 0; i < count; i++)
        sources[i] = make_source(&sections[i], &grid->at);
    job = (struct job){ grid, sources, count, planes, of };
    return fill_all(&job, interval_um, threads, err);
}
