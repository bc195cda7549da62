/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/stack.h"

#include "pipeline/core/parallel.h"

#include <assert.h>
#include <math.h>

struct job {
    struct gsn_grid *grid;
    const struct gsn_stack_section **of_plane; /* nz: the section of each plane, or NULL */
};

/* Keys' cubic convolution kernel with a = -1/2, for the taps at -1, 0, 1, 2 and the fraction t. */
static void keys(double t, double weight[4])
{
    const double t2 = t * t, t3 = t2 * t;

    weight[0] = -0.5 * t3 + t2 - 0.5 * t;
    weight[1] = 1.5 * t3 - 2.5 * t2 + 1;
    weight[2] = -1.5 * t3 + 2 * t2 + 0.5 * t;
    weight[3] = 0.5 * t3 - 0.5 * t2;
}

/* The pixel, or NaN outside the section's box. */
static double tap(const struct gsn_stack_section *s, long x, long y)
{
    if (x < s->x || y < s->y || x >= (long)s->x + s->width || y >= (long)s->y + s->height)
        return NAN;
    return s->density->value[(size_t)y * s->density->width + (size_t)x];
}

/* Over the valid ones of the nearest four pixels, weights made to sum to 1. */
static double bilinear(const struct gsn_stack_section *s, long x, long y, double tx, double ty)
{
    double sum = 0, weight = 0;

    for (int k = 0; k < 4; k++) {
        const double w = (k % 2 ? tx : 1 - tx) * (k / 2 ? ty : 1 - ty);
        const double value = tap(s, x + k % 2, y + k / 2);

        if (isnan(value))
            continue;
        sum += w * value;
        weight += w;
    }
    return weight > 0 ? sum / weight : NAN;
}

static double sample(const struct gsn_stack_section *s, struct gsn_point at)
{
    const double fx = floor(at.x - 0.5), fy = floor(at.y - 0.5);
    const double tx = at.x - 0.5 - fx, ty = at.y - 0.5 - fy;
    double wx[4], wy[4], sum = 0;
    long x, y;

    /* Far outside, where a long might not hold the number. */
    if (!(at.x > s->x - 2.0 && at.y > s->y - 2.0 && at.x < (double)s->x + s->width + 2.0 &&
          at.y < (double)s->y + s->height + 2.0))
        return NAN;
    x = (long)fx;
    y = (long)fy;
    if (isnan(tap(s, x + (tx >= 0.5), y + (ty >= 0.5))))
        return NAN;
    keys(tx, wx);
    keys(ty, wy);
    for (int j = 0; j < 4; j++) {
        double row = 0;

        for (int i = 0; i < 4; i++)
            row += wx[i] * tap(s, x + i - 1, y + j - 1);
        sum += wy[j] * row;
    }
    return isnan(sum) ? bilinear(s, x, y, tx, ty) : sum;
}

/* One row of the lattice; every row is written by one call, so the threads cannot matter. */
static int fill_row(size_t index, void *context, struct gsn_error *err)
{
    const struct job *job = context;
    const struct gsn_lattice *at = &job->grid->at;
    const size_t y = index % at->ny, z = index / at->ny;
    const struct gsn_stack_section *section = job->of_plane[z];
    float *row = job->grid->value + gsn_lattice_index(at, 0, y, z);
    struct gsn_affine block_to_panel;

    (void)err;
    if (section)
        block_to_panel = gsn_affine_inverse(&section->panel_to_block_um);
    for (size_t x = 0; x < at->nx; x++) {
        const struct gsn_vec3 centre = gsn_lattice_centre(at, x, y, z);
        const struct gsn_point um = { centre.x, centre.y };

        row[x] = section ? (float)sample(section, gsn_affine_apply(&block_to_panel, um)) : NAN;
    }
    return GSN_OK;
}

static int check_section(const struct gsn_stack_section *s, struct gsn_error *err)
{
    const double det = gsn_affine_det(&s->panel_to_block_um);

    if (!s->density)
        return gsn_fail(err, GSN_E_INPUT, "section %u has no pixels", s->serial + 1);
    if (s->x < 0 || s->y < 0 || s->width < 1 || s->height < 1 ||
        (uint64_t)s->x + (uint64_t)s->width > s->density->width ||
        (uint64_t)s->y + (uint64_t)s->height > s->density->height)
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

static const struct gsn_stack_section *section_of(const struct gsn_stack_section *sections,
                                                  size_t count, double serial)
{
    for (size_t i = 0; i < count; i++) {
        if ((double)sections[i].serial == serial)
            return &sections[i];
    }
    return NULL;
}

int gsn_stack_resample(const struct gsn_stack_section *sections, size_t count,
                       const struct gsn_lattice *at, double interval_um, unsigned threads,
                       struct gsn_grid **ret_grid, struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto_mem(const struct gsn_stack_section *) of_plane = NULL;
    struct job job;
    int r;

    assert((sections || count == 0) && at && ret_grid);

    if (!(interval_um > 0))
        return gsn_fail(err, GSN_E_INPUT, "a section interval of %g um", interval_um);
    r = check(sections, count, err);
    if (r < 0)
        return r;
    r = gsn_grid_new(at, &grid, err);
    if (r < 0)
        return r;
    of_plane = gsn_alloc_array(at->nz, sizeof *of_plane);
    if (!of_plane)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the planes of the stack");
    for (size_t z = 0; z < at->nz; z++) {
        const double z_um = gsn_lattice_centre(at, 0, 0, z).z;

        of_plane[z] = section_of(sections, count, round(z_um / interval_um - 0.5));
    }

    job = (struct job){ .grid = grid, .of_plane = of_plane };
    r = gsn_parallel_for(at->ny * at->nz, threads, fill_row, &job, err);
    if (r < 0)
        return r;
    *ret_grid = gsn_steal(&grid);
    return GSN_OK;
}
