/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/band.h"
#include "pipeline/masking.h"

#include <math.h>
#include <string.h>

/* Voxels kept around the region of interest, so that cuts show what lies beside it. */
enum { MARGIN_VOXELS = 6 };

/* A stack larger than this is a mistake in the region, not a block. */
static const double MOST_VOXELS_PER_SIDE = 1 << 20, MOST_VOXELS = 2147483648.0;

static struct gsn_box box_of_mask(const struct gsn_mask *mask)
{
    const struct gsn_lattice *at = &mask->at;
    struct gsn_box box = { { INFINITY, INFINITY, INFINITY }, { -INFINITY, -INFINITY, -INFINITY } };

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

struct gsn_box gsn_assembly_box_of_shape(const struct gsn_region *region)
{
    const struct gsn_vec3 c = region->centre;
    const double r = region->radius_um;

    switch (region->kind) {
    case GSN_REGION_CYLINDER:
        return (struct gsn_box){ { c.x - r, c.y - r, region->low.z },
                                 { c.x + r, c.y + r, region->high.z } };
    case GSN_REGION_SPHERE:
        return (struct gsn_box){ { c.x - r, c.y - r, c.z - r }, { c.x + r, c.y + r, c.z + r } };
    default:
        return (struct gsn_box){ region->low, region->high };
    }
}

/* Voxels of the scan's own pixel size, on the mask's raster where that has the same step. z planes
 * are the sections' own: all that the region needs, also those that the block has not, so that they
 * count as not seen; and one more on either side where the block has one. 0 when that makes no
 * lattice that could be worked with. */
int gsn_assembly_lattice(struct gsn_box box, const struct gsn_mask *mask, double px_um,
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

double gsn_assembly_voxel(const struct gsn_specimen *specimen)
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

int gsn_assembly_place_region(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                              struct gsn_assembly *a, struct gsn_lattice *lattice,
                              struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->region;
    struct gsn_box box;

    if (specimen->region && gsn_mask_count(specimen->region) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region mask is empty: no voxel in it is set");
    box = specimen->region ? box_of_mask(specimen->region) : gsn_assembly_box_of_shape(stated);
    if (!gsn_assembly_lattice(box, specimen->region, px_um, specimen->protocol->interval_um,
                              sections, lattice))
        return gsn_fail(err, GSN_E_INPUT,
                        "the region of interest (z %g to %g um) does not lie in this block of "
                        "%u sections every %g um",
                        box.low.z, box.high.z, sections, specimen->protocol->interval_um);
    return specimen->region ? copy_mask(specimen->region, &a->region, err)
                            : gsn_region_raster(stated, lattice, &a->region, err);
}

int gsn_assembly_empty_grid(const struct gsn_lattice *lattice, struct gsn_grid **ret_grid,
                            struct gsn_error *err)
{
    const int r = gsn_grid_new(lattice, ret_grid, err);

    for (size_t i = 0; r >= 0 && i < gsn_lattice_count(lattice); i++)
        (*ret_grid)->value[i] = NAN;
    return r;
}

/* The boxes of all posed sections, laid into the block. */
static struct gsn_box box_of_sections(const struct gsn_assembly *a, double interval_um)
{
    struct gsn_box box = { { INFINITY, INFINITY, INFINITY }, { -INFINITY, -INFINITY, -INFINITY } };

    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];

        for (int corner = 0; s->posed && corner < 4; corner++) {
            const struct gsn_point px = { s->seen.x + (corner & 1 ? s->seen.width : 0),
                                          s->seen.y + (corner & 2 ? s->seen.height : 0) };
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            box.low = gsn_vec3_make(fmin(box.low.x, um.x), fmin(box.low.y, um.y),
                                    fmin(box.low.z, interval_um * s->seen.serial));
            box.high = gsn_vec3_make(fmax(box.high.x, um.x), fmax(box.high.y, um.y),
                                     fmax(box.high.z, interval_um * (s->seen.serial + 1)));
        }
    }
    return box;
}

int gsn_assembly_place_block(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                             const struct gsn_assembly *a, struct gsn_lattice *lattice,
                             struct gsn_error *err)
{
    const double interval_um = specimen->protocol->interval_um;

    if (gsn_assembly_lattice(box_of_sections(a, interval_um), NULL, px_um, interval_um, sections,
                             lattice))
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "the sections span more than a block can: look at the marks and \"px_um\"");
}

/* Finds the band. Not finding it is a state, with a sentence. */
int gsn_assembly_find_band(const struct gsn_specimen *specimen,
                           const struct gsn_specimen_options *options, struct gsn_assembly *a,
                           struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    int r = gsn_band_region(&specimen->protocol->region, specimen->region, a->grid,
                            options->threads, &a->region, &why);

    if (r == GSN_E_STAIN || r == GSN_E_INPUT) {
        memcpy(a->no_region, why.text, sizeof a->no_region);
        gsn_grid_free(a->grid);
        a->grid = NULL;
        return GSN_OK;
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    r = gsn_band_crop(&a->grid, &a->region, MARGIN_VOXELS, err);
    if (r >= 0)
        r = gsn_assembly_crop_colour(a, err);
    if (r >= 0)
        gsn_masking_gaps(specimen->protocol->interval_um, a);
    return r;
}
