/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/band.h"

#include "pipeline/stain/tissue_segmentation.h"

#include <math.h>

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

static void widen(struct span *span, const struct gsn_lattice *at, size_t margin)
{
    const size_t n[3] = { at->nx, at->ny, at->nz };

    for (int k = 0; k < 3; k++) {
        span->first[k] -= span->first[k] < margin ? span->first[k] : margin;
        span->last[k] = span->last[k] + margin < n[k] ? span->last[k] + margin : n[k] - 1;
    }
}

int gsn_band_crop(struct gsn_grid **density, struct gsn_mask **region, size_t margin,
                  struct gsn_error *err)
{
    const struct gsn_lattice *from = &(*region)->at;
    struct span span = span_of(*region);
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    struct gsn_lattice at = *from;
    int r;

    widen(&span, from, margin);
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
