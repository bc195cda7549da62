/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Any bytes as a selection of ImageJ, or an archive of some: features whose outlines are closed and
 * have finite points, or a sentence. */
#include "pipeline/specimen/imagej_roi.h"

#include <math.h>

#include "tests/fuzz/hold.h"

static void hold_point(const json_t *point)
{
    HOLD(json_array_size(point) == 2);
    HOLD(isfinite(json_real_value(json_array_get(point, 0))));
    HOLD(isfinite(json_real_value(json_array_get(point, 1))));
}

static void hold_ring(const json_t *ring)
{
    const size_t n = json_array_size(ring);

    for (size_t i = 0; i < n; i++)
        hold_point(json_array_get(ring, i));
    HOLD(n == 0 || json_equal(json_array_get(ring, 0), json_array_get(ring, n - 1)));
}

static void hold_feature(const json_t *feature)
{
    const json_t *const geometry = json_object_get(feature, "geometry");
    const json_t *const polygons = json_object_get(geometry, "coordinates");

    HOLD(json_is_string(json_object_get(geometry, "type")) && json_is_array(polygons));
    HOLD(json_integer_value(json_object_get(json_object_get(geometry, "plane"), "z")) >= 0);
    for (size_t i = 0; i < json_array_size(polygons); i++) {
        const json_t *const polygon = json_array_get(polygons, i);

        for (size_t k = 0; k < json_array_size(polygon); k++)
            hold_ring(json_array_get(polygon, k));
    }
}

static void read_for_stack(const uint8_t *bytes, size_t size, size_t planes)
{
    json_t *collection = NULL;
    const json_t *features;
    struct gsn_error err = { 0 };
    const int r = gsn_imagej_roi_read("regions", bytes, size, planes, &collection, &err);

    HOLD((r >= 0) == (collection != NULL));
    HOLD(r >= 0 || (err.code == r && err.text[0]));
    features = json_object_get(collection, "features");
    for (size_t i = 0; i < json_array_size(features); i++)
        hold_feature(json_array_get(features, i));
    json_decref(collection);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    if (!gsn_imagej_roi_is(bytes, size))
        return 0;
    read_for_stack(bytes, size, 1);
    read_for_stack(bytes, size, 12);
    return 0;
}
