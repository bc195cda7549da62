/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stated_region.h"

#include "pipeline/stated_value.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

static int read_box(const json_t *shape, struct gsn_region *region)
{
    double low[3], high[3];

    if (gsn_stated_numbers(json_object_get(shape, "min"), 3, low) < 0 ||
        gsn_stated_numbers(json_object_get(shape, "max"), 3, high) < 0)
        return -1;
    region->low = gsn_vec3_make(low[0], low[1], low[2]);
    region->high = gsn_vec3_make(high[0], high[1], high[2]);
    return low[0] < high[0] && low[1] < high[1] && low[2] < high[2] ? 0 : -1;
}

static int read_round(const json_t *shape, struct gsn_region *region)
{
    const json_t *radius = json_object_get(shape, "radius");
    double centre[3] = { 0 }, z[2];

    if (gsn_stated_numbers(json_object_get(shape, "centre"),
                           region->kind == GSN_REGION_SPHERE ? 3 : 2, centre) < 0)
        return -1;
    region->centre = gsn_vec3_make(centre[0], centre[1], centre[2]);
    region->radius_um = json_is_number(radius) ? json_number_value(radius) : 0;
    if (region->kind == GSN_REGION_CYLINDER) {
        if (gsn_stated_numbers(json_object_get(shape, "z"), 2, z) < 0 || !(z[0] < z[1]))
            return -1;
        region->low.z = z[0];
        region->high.z = z[1];
    }
    return region->radius_um > 0 ? 0 : -1;
}

int gsn_stated_shape_read(const json_t *shape_of, const char *key, struct gsn_region *region,
                          struct gsn_error *err)
{
    static const char *const shapes[] = { "box", "cylinder", "sphere", NULL };
    int shape = -1;
    const int r = gsn_stated_word(shape_of, "shape", shapes, &shape, err);

    if (r < 0)
        return r;
    if (shape >= 0)
        region->kind = (enum gsn_region_kind)(GSN_REGION_BOX + shape);
    if (shape < 0 || (shape == 0 ? read_box(shape_of, region) : read_round(shape_of, region)))
        return gsn_stated_bad(
            err, key,
            "{\"shape\": \"box\", \"min\": [x,y,z], \"max\": [x,y,z]}, {\"shape\": "
            "\"cylinder\", \"centre\": [x,y], \"radius\": r, \"z\": [from,to]} or "
            "{\"shape\": \"sphere\", \"centre\": [x,y,z], \"radius\": r}");
    return GSN_OK;
}

static const char BAND[] =
    "{\"kind\": \"band\", \"from\": \"root\", \"bone\", \"tissue\" or a mask file, \"low_um\": a, "
    "\"high_um\": b above a}, "
    "with or without \"z\": [from,to] and \"within\": {\"centre\": [x,y], \"radius\": r}";

/* The cylinder and the z range that limit a band, where they are stated. */
static int read_limits(const json_t *band, struct gsn_region *region)
{
    const json_t *z = json_object_get(band, "z"), *within = json_object_get(band, "within");
    double range[2] = { -INFINITY, INFINITY }, centre[2] = { 0 };
    const json_t *radius = json_object_get(within, "radius");

    if (z && (gsn_stated_numbers(z, 2, range) < 0 || !(range[0] < range[1])))
        return -1;
    if (within && (gsn_stated_numbers(json_object_get(within, "centre"), 2, centre) < 0 ||
                   !(json_number_value(radius) > 0)))
        return -1;
    region->low.z = range[0];
    region->high.z = range[1];
    region->centre = gsn_vec3_make(centre[0], centre[1], 0);
    region->radius_um = within ? json_number_value(radius) : 0;
    return 0;
}

static int read_band(const json_t *band, struct gsn_region *region, struct gsn_error *err)
{
    const json_t *from = json_object_get(band, "from");
    const json_t *low = json_object_get(band, "low_um"), *high = json_object_get(band, "high_um");

    region->kind = GSN_REGION_BAND;
    region->low_um = json_number_value(low);
    region->high_um = json_number_value(high);
    if (!json_is_string(from) || !json_string_value(from)[0] || !json_is_number(low) ||
        !json_is_number(high) || !(region->low_um < region->high_um) || !isfinite(region->low_um) ||
        !isfinite(region->high_um) || read_limits(band, region) < 0)
        return gsn_stated_bad(err, "region", BAND);
    for (enum gsn_tissue_kind k = GSN_TISSUE_ROOT; k < GSN_TISSUE_BODIES; k++)
        if (strcmp(json_string_value(from), gsn_tissue_name(k)) == 0) {
            region->from = k;
            return GSN_OK;
        }
    return gsn_stated_text(band, "from", &region->file, err);
}

int gsn_stated_region_read(const json_t *job, struct gsn_region *region, struct gsn_error *err)
{
    const json_t *stated = json_object_get(job, "region");
    const json_t *kind = json_object_get(stated, "kind");

    if (!stated)
        return GSN_OK;
    if (json_is_string(stated)) {
        region->kind = GSN_REGION_MASK;
        return gsn_stated_text(job, "region", &region->file, err);
    }
    if (!json_is_object(stated))
        return gsn_stated_bad(err, "region", "the name of a mask file or a shape");
    if (kind && !(json_is_string(kind) && strcmp(json_string_value(kind), "band") == 0))
        return gsn_stated_bad(err, "region", BAND);
    if (kind)
        return read_band(stated, region, err);
    return gsn_stated_shape_read(stated, "region", region, err);
}
