/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The region of interest, and the lattice of the stack around it.
 *
 * 1. A stated shape (box, cylinder, sphere) becomes a mask by voxel centres; a mask file, or drawn
 * outlines as drawn_region.c made them a mask, are taken as they are.
 * 2. A band is looked for when the densities are there: the body is a mask file or a tissue that is
 *    found in the block (stain/tissue_segmentation.h), the band is what lies at the stated
 * distances from its surface, within the stated cylinder and z range.
 * 3. The lattice has voxels of the finest panel's pixels or as coarse as the job asks, and one
 * plane a section; it reaches some voxels beyond the region, so that cuts show what lies beside it.
 * It lies on the mask's own raster where that has the same step.
 *
 * A region that misses the block fails with GSN_E_INPUT. */
#include "pipeline/specimen/region.h"

#include "pipeline/register/tissue/bands.h"
#include "pipeline/specimen/specimen.h"
#include "pipeline/stain/tissue_segmentation.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Voxels kept around the region of interest, so that cuts show what lies beside it. */
enum { MARGIN_VOXELS = 6 };

static int shape_holds(const struct gsn_region *region, struct gsn_vec3 u)
{
    const struct gsn_vec3 d = gsn_vec3_sub(u, region->centre);

    if (region->kind == GSN_REGION_SPHERE)
        return gsn_vec3_length(d) <= region->radius_um;
    if (!(region->low.z <= u.z && u.z < region->high.z))
        return 0;
    if (region->kind == GSN_REGION_CYLINDER)
        return hypot(d.x, d.y) <= region->radius_um;
    return region->low.x <= u.x && u.x < region->high.x && region->low.y <= u.y &&
           u.y < region->high.y;
}

void gsn_region_done(struct gsn_region *region)
{
    gsn_free(region->file);
    gsn_free(region->class_name);
}

int gsn_region_has_coordinates(const struct gsn_region *region)
{
    return region->kind == GSN_REGION_BAND ? region->file != NULL || region->radius_um > 0
                                           : region->kind != GSN_REGION_NONE;
}

void gsn_region_describe(const struct gsn_region *region, char *text, size_t room)
{
    const struct gsn_vec3 side = gsn_vec3_sub(region->high, region->low);

    switch (region->kind) {
    case GSN_REGION_NONE:
        (void)snprintf(text, room, "the whole volume");
        return;
    case GSN_REGION_DRAWN:
        (void)snprintf(text, room, "drawn as %s",
                       region->class_name && region->class_name[0] ? region->class_name
                                                                   : region->file);
        return;
    case GSN_REGION_MASK:
        (void)snprintf(text, room, "%s", region->file);
        return;
    case GSN_REGION_BOX:
        (void)snprintf(text, room, "a box of %g x %g x %g um", side.x, side.y, side.z);
        return;
    case GSN_REGION_CYLINDER:
        (void)snprintf(text, room, "a cylinder of radius %g um and height %g um",
                       region->radius_um, side.z);
        return;
    case GSN_REGION_SPHERE:
        (void)snprintf(text, room, "a sphere of radius %g um", region->radius_um);
        return;
    case GSN_REGION_BAND:
        (void)snprintf(text, room, "%g to %g um from the surface of %s%s", region->low_um,
                       region->high_um, region->file ? "" : "the ",
                       region->file ? region->file : gsn_tissue_name(region->from));
        return;
    }
}

int gsn_region_raster(const struct gsn_region *region, const struct gsn_lattice *at,
                      struct gsn_mask **ret_mask, struct gsn_error *err)
{
    gsn_auto(gsn_mask) mask = NULL;
    const int r = gsn_mask_new(at, &mask, err);

    if (r < 0)
        return r;
    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++)
                mask->inside[gsn_lattice_index(at, x, y, z)] =
                    (uint8_t)shape_holds(region, gsn_lattice_centre(at, x, y, z));
    if (gsn_mask_count(mask) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region of interest holds no voxel of this stack");
    *ret_mask = gsn_steal(&mask);
    return GSN_OK;
}

enum { MOST_TARGETS = 4096 };

int gsn_region_targets(const struct gsn_mask *region, struct gsn_point **ret_points,
                       size_t *ret_count, struct gsn_error *err)
{
    const size_t total = region ? gsn_mask_count(region) : 0;
    const size_t every = total / MOST_TARGETS + 1;
    gsn_auto_mem(struct gsn_point) points = gsn_alloc_array(total / every + 1, sizeof *points);
    size_t seen = 0, count = 0;

    if (!points)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for target points");
    for (size_t i = 0; total && i < gsn_lattice_count(&region->at); i++) {
        const size_t x = i % region->at.nx, y = i / region->at.nx % region->at.ny;
        struct gsn_vec3 u;

        if (!region->inside[i] || seen++ % every != 0)
            continue;
        u = gsn_lattice_centre(&region->at, x, y, 0);
        points[count++] = (struct gsn_point){ .x = u.x, .y = u.y };
    }
    *ret_points = gsn_steal(&points);
    *ret_count = count;
    return GSN_OK;
}

static int is_within(const struct gsn_region *region, struct gsn_vec3 u)
{
    return region->low.z <= u.z && u.z < region->high.z &&
           (region->radius_um == 0 ||
            hypot(u.x - region->centre.x, u.y - region->centre.y) <= region->radius_um);
}

int gsn_band_region(const struct gsn_region *region, const struct gsn_mask *body,
                    const struct gsn_grid *density, unsigned threads, struct gsn_mask **ret_region,
                    struct gsn_error *err)
{
    gsn_auto(gsn_mask) found = NULL;
    gsn_auto(gsn_mask) band = NULL;
    struct gsn_tissue_levels levels;
    int r = body ? GSN_OK : gsn_tissue_find(density, region->from, &found, &levels, err);

    if (r >= 0)
        r = gsn_tissue_band(body ? body : found, region->low_um, region->high_um, &density->at,
                            threads, &band, err);
    if (r < 0)
        return r;
    for (size_t i = 0, z = 0; z < band->at.nz; z++)
        for (size_t y = 0; y < band->at.ny; y++)
            for (size_t x = 0; x < band->at.nx; x++, i++)
                if (!is_within(region, gsn_lattice_centre(&band->at, x, y, z)))
                    band->inside[i] = 0;
    if (gsn_mask_count(band) == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "the band of %g to %g um holds no voxel within the stated z and \"within\"",
                        region->low_um, region->high_um);
    *ret_region = gsn_steal(&band);
    return GSN_OK;
}

/* First and last index along each axis. */
struct span {
    size_t first[3], last[3];
};

static struct span span_of(const struct gsn_mask *region)
{
    struct span span = { { SIZE_MAX, SIZE_MAX, SIZE_MAX }, { 0, 0, 0 } };

    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++) {
        const size_t at[3] = { i % region->at.nx, i / region->at.nx % region->at.ny,
                               i / region->at.nx / region->at.ny };

        for (int k = 0; region->inside[i] && k < 3; k++) {
            span.first[k] = at[k] < span.first[k] ? at[k] : span.first[k];
            span.last[k] = at[k] > span.last[k] ? at[k] : span.last[k];
        }
    }
    return span;
}

static void widen_span(struct span *span, const struct gsn_lattice *at, size_t margin)
{
    const size_t n[3] = { at->nx, at->ny, at->nz };

    for (int k = 0; k < 3; k++) {
        span->first[k] -= span->first[k] < margin ? span->first[k] : margin;
        span->last[k] = span->last[k] + margin < n[k] ? span->last[k] + margin : n[k] - 1;
    }
}

int gsn_band_crop(struct gsn_grid **density, struct gsn_mask **region, struct gsn_error *err)
{
    const struct gsn_lattice *from = &(*region)->at;
    struct span span = span_of(*region);
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_lattice at = *from;
    int r;

    widen_span(&span, from, MARGIN_VOXELS);
    at.nx = span.last[0] - span.first[0] + 1;
    at.ny = span.last[1] - span.first[1] + 1;
    at.nz = span.last[2] - span.first[2] + 1;
    at.origin_um = gsn_lattice_centre(from, span.first[0], span.first[1], span.first[2]);
    r = gsn_grid_new(&at, &grid, err);
    if (r >= 0)
        r = gsn_mask_new(&at, &mask, err);
    if (r < 0)
        return r;
    for (size_t i = 0, z = 0; z < at.nz; z++)
        for (size_t y = 0; y < at.ny; y++)
            for (size_t x = 0; x < at.nx; x++, i++) {
                const size_t k = gsn_lattice_index(from, span.first[0] + x, span.first[1] + y,
                                                   span.first[2] + z);

                grid->value[i] = (*density)->value[k];
                mask->inside[i] = (*region)->inside[k];
            }
    gsn_grid_free(*density);
    gsn_mask_free(*region);
    *density = gsn_steal(&grid);
    *region = gsn_steal(&mask);
    return GSN_OK;
}

/* A stack larger than this is a mistake in the region, not a block. */
static const double MOST_VOXELS_PER_SIDE = 1 << 20, MOST_VOXELS = 2147483648.0;

static struct gsn_block_box box_of_mask(const struct gsn_mask *mask)
{
    const struct gsn_lattice *at = &mask->at;
    struct gsn_block_box box = { { INFINITY, INFINITY, INFINITY },
                                 { -INFINITY, -INFINITY, -INFINITY } };

    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const struct gsn_vec3 u = gsn_lattice_centre(at, x, y, z);

                if (!mask->inside[i])
                    continue;
                box.low =
                    gsn_vec3_make(fmin(box.low.x, u.x), fmin(box.low.y, u.y), fmin(box.low.z, u.z));
                box.high = gsn_vec3_make(fmax(box.high.x, u.x), fmax(box.high.y, u.y),
                                         fmax(box.high.z, u.z));
            }
    return box;
}

struct gsn_block_box gsn_region_box(const struct gsn_region *region)
{
    const struct gsn_vec3 c = region->centre;
    const double r = region->radius_um;

    switch (region->kind) {
    case GSN_REGION_CYLINDER:
        return (struct gsn_block_box){ { c.x - r, c.y - r, region->low.z },
                                       { c.x + r, c.y + r, region->high.z } };
    case GSN_REGION_SPHERE:
        return (struct gsn_block_box){ { c.x - r, c.y - r, c.z - r },
                                       { c.x + r, c.y + r, c.z + r } };
    default:
        return (struct gsn_block_box){ region->low, region->high };
    }
}

/* Voxels of the scan's own pixel size, on the mask's raster where that has the same step. z planes
 * are the sections' own: all that the region needs, also those that the block has not, so that they
 * count as not seen; and one more on either side where the block has one. 0 when that makes no
 * lattice that could be worked with. */
int gsn_region_lattice(struct gsn_block_box box, const struct gsn_mask *mask, double px_um,
                       double interval_um, unsigned sections, struct gsn_lattice *lattice)
{
    const int same = mask && fabs(mask->at.step_um.x / px_um - 1) < 1e-3 &&
                     fabs(mask->at.step_um.y / px_um - 1) < 1e-3;
    const double sx = same ? mask->at.step_um.x : px_um, sy = same ? mask->at.step_um.y : px_um;
    const double ox = same ? mask->at.origin_um.x : 0, oy = same ? mask->at.origin_um.y : 0;
    const double x0 = floor((box.low.x - ox) / sx) - MARGIN_VOXELS;
    const double y0 = floor((box.low.y - oy) / sy) - MARGIN_VOXELS;
    const double first = floor(box.low.z / interval_um), last = ceil(box.high.z / interval_um) - 1;
    const double z0 = first > 0 ? first - 1 : first;
    const double z1 = last < sections - 1.0 ? last + 1 : last;
    const double nx = ceil((box.high.x - ox) / sx) + MARGIN_VOXELS - x0 + 1;
    const double ny = ceil((box.high.y - oy) / sy) + MARGIN_VOXELS - y0 + 1;
    const double nz = z1 - z0 + 1;

    if (!(first < sections && last >= 0 && nx <= MOST_VOXELS_PER_SIDE &&
          ny <= MOST_VOXELS_PER_SIDE && nx * ny * nz <= MOST_VOXELS))
        return 0;
    *lattice = (struct gsn_lattice){
        .nx = (size_t)nx,
        .ny = (size_t)ny,
        .nz = (size_t)nz,
        .origin_um = gsn_vec3_make(ox + x0 * sx, oy + y0 * sy, (z0 + 0.5) * interval_um),
        .step_um = gsn_vec3_make(sx, sy, interval_um),
    };
    return 1;
}

double gsn_region_voxel_um(const struct gsn_specimen *specimen)
{
    double finest = 0;

    for (size_t i = 0; i < specimen->panel_count; i++) {
        const double px_um = specimen->panel[i].px_um;

        if (specimen->panel[i].section_count > 0 && (finest == 0 || px_um < finest))
            finest = px_um;
    }
    return finest > 0 ? fmax(finest, specimen->protocol->voxel_um) : 0;
}

static int copy_mask(const struct gsn_mask *mask, struct gsn_mask **ret_mask, struct gsn_error *err)
{
    const int r = gsn_mask_new(&mask->at, ret_mask, err);

    if (r >= 0)
        memcpy((*ret_mask)->inside, mask->inside, gsn_lattice_count(&mask->at));
    return r;
}

int gsn_region_place(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                     struct gsn_mask **ret_region, struct gsn_lattice *lattice,
                     struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->region;
    struct gsn_block_box box;

    if (specimen->region && gsn_mask_count(specimen->region) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region mask is empty: no voxel in it is set");
    box = specimen->region ? box_of_mask(specimen->region) : gsn_region_box(stated);
    if (!gsn_region_lattice(box, specimen->region, px_um, specimen->protocol->interval_um, sections,
                            lattice))
        return gsn_fail(err, GSN_E_INPUT,
                        "the region of interest (z %g to %g um) does not lie in this block of "
                        "%u sections every %g um",
                        box.low.z, box.high.z, sections, specimen->protocol->interval_um);
    return specimen->region ? copy_mask(specimen->region, ret_region, err)
                            : gsn_region_raster(stated, lattice, ret_region, err);
}

int gsn_grid_new_unseen(const struct gsn_lattice *lattice, struct gsn_grid **ret_grid,
                        struct gsn_error *err)
{
    const int r = gsn_grid_new(lattice, ret_grid, err);

    for (size_t i = 0; r >= 0 && i < gsn_lattice_count(lattice); i++)
        (*ret_grid)->value[i] = NAN;
    return r;
}

int gsn_region_place_block(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                           const struct gsn_block_box *extent, struct gsn_lattice *lattice,
                           struct gsn_error *err)
{
    const double interval_um = specimen->protocol->interval_um;

    if (gsn_region_lattice(*extent, NULL, px_um, interval_um, sections, lattice))
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "the sections span more than a block can: look at the marks and \"px_um\"");
}
