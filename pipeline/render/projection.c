/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/projection.h"

#include <math.h>

#include "pipeline/core/parallel.h"
#include "pipeline/render/plate.h"
#include "pipeline/render/ray.h"

enum { BATCHES = 20 }; /* how often progress is said */

struct projecting {
    const struct gsn_spline *spline;
    const struct gsn_camera *camera;
    const struct gsn_shadow *shadow; /* one per tetrahedron */
    size_t tet_count, first_row;
    struct gsn_plane *plane;
};

/* One row of pixels: every tetrahedron whose shadow meets it, in order, so that the sum in a pixel
 * does not depend on the threads. */
static int project_row(size_t index, void *context, struct gsn_error *err)
{
    const struct projecting *projecting = context;
    const struct gsn_camera *camera = projecting->camera;
    const uint32_t row = (uint32_t)(projecting->first_row + index), width = camera->width;
    gsn_auto_mem(double) sum = gsn_alloc_array(width, sizeof *sum);

    if (!sum)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a row of %u pixels", width);
    for (uint32_t i = 0; i < width; i++)
        sum[i] = NAN;
    for (size_t t = 0; t < projecting->tet_count; t++) {
        uint32_t first, end;

        gsn_shadow_span(&projecting->shadow[t], row, width, &first, &end);
        for (uint32_t i = first; i < end; i++) {
            double start[3], part;

            gsn_ray_start(camera, i + 0.5, row + 0.5, start);
            part = gsn_spline_tet_line(projecting->spline, t, start, camera->into);
            sum[i] = isnan(sum[i]) ? part : sum[i] + part;
        }
    }
    for (uint32_t i = 0; i < width; i++)
        projecting->plane->value[(size_t)row * width + i] = (float)sum[i];
    return GSN_OK;
}

static int project_rows(struct projecting *projecting, unsigned threads,
                        const struct gsn_progress *progress, struct gsn_error *err)
{
    const size_t rows = projecting->camera->height;

    for (size_t batch = 0; batch < BATCHES; batch++) {
        const size_t first = rows * batch / BATCHES, end = rows * (batch + 1) / BATCHES;
        int r;

        gsn_progress_say(progress, "projection", first, rows);
        projecting->first_row = first;
        r = gsn_parallel_for(end - first, threads, project_row, projecting, err);
        if (r < 0)
            return r;
    }
    gsn_progress_say(progress, "projection", rows, rows);
    return GSN_OK;
}

int gsn_projection(const struct gsn_spline *spline, const struct gsn_view *view, unsigned threads,
                   const struct gsn_progress *progress, struct gsn_plane **ret_plane,
                   struct gsn_camera *ret_camera, struct gsn_error *err)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const size_t count = gsn_dms_mesh(space)->tet_count;
    gsn_auto_mem(struct gsn_shadow) shadow = NULL;
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct projecting projecting = { .spline = spline, .camera = &camera, .tet_count = count };
    int r;

    if (view->eye_distance > 0.0)
        return gsn_fail(err, GSN_E_INPUT, "an X-ray picture has no eye: the view is orthographic");
    r = gsn_camera_frame(view, gsn_dms_mesh(space), &camera, err);
    if (r == GSN_OK)
        r = gsn_plane_new(camera.width, camera.height, &plane, err);
    if (r < 0)
        return r;
    shadow = gsn_alloc_array(count, sizeof *shadow);
    if (!shadow)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    for (size_t t = 0; t < count; t++)
        gsn_shadow_make(space, t, &camera, &shadow[t]);
    projecting.shadow = shadow;
    projecting.plane = plane;
    r = project_rows(&projecting, threads, progress, err);
    if (r < 0)
        return r;
    *ret_camera = camera;
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}

int gsn_projection_paint(const struct gsn_plane *plane, const struct gsn_camera *camera,
                         const char *title, const char *unit, double low, double high,
                         enum gsn_colour_map map, struct gsn_image **ret_image,
                         struct gsn_error *err)
{
    gsn_auto(gsn_image) sheet = NULL;
    struct gsn_plate plate = { .title = title,
                               .note = "integral along the line of view",
                               .um_per_px = 1.0 / camera->px_per_um,
                               .has_scale = 1,
                               .unit = unit ? unit : "density \xc3\x97 \xc2\xb5m",
                               .low = low,
                               .high = high,
                               .map = map };
    int r, x, y;

    if (!(low < high)) {
        gsn_plate_range(plane, &plate.low, &plate.high);
        plate.low = fmin(0.0, plate.low);
    }
    r = gsn_plate_new(&plate, plane->width, plane->height, &sheet, &x, &y, err);
    if (r < 0)
        return r;
    gsn_plate_fill(sheet, x, y, plane, map, plate.low, plate.high);
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}
