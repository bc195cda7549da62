/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/region.h"

#include <math.h>

static int holds(const struct gsn_region *region, struct gsn_vec3 u)
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

int gsn_region_has_coordinates(const struct gsn_region *region)
{
    return region->kind == GSN_REGION_BAND ? region->file != NULL || region->radius_um > 0
                                           : region->kind != GSN_REGION_NONE;
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
                    (uint8_t)holds(region, gsn_lattice_centre(at, x, y, z));
    if (gsn_mask_count(mask) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region of interest holds no voxel of this stack");
    *ret_mask = gsn_steal(&mask);
    return GSN_OK;
}
