/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A box of cells with a polynomial field, seen by a camera: what tests of pictures share. */
#ifndef GSN_TESTS_RENDER_BOX_SCENE_H
#define GSN_TESTS_RENDER_BOX_SCENE_H

#include <math.h>

#include "pipeline/render/ray_cast.h"
#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 1200.0, 900.0, 600.0 };
static const unsigned cells[3] = { 4, 3, 3 };
static const struct quadric one = { 1.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };
static const struct quadric linear = { 0.2, { 1e-4, -2e-4, 3e-4 }, { 0.0, 0.0, 0.0 } };

static inline struct gsn_view oblique(uint32_t width, uint32_t height)
{
    return (struct gsn_view){ .direction = { 0.31, 0.42, 0.85 },
                              .up = { 0.05, -1.0, 0.1 },
                              .width = width,
                              .height = height };
}

static inline struct gsn_ray_style plain(double from, double to, double opaque_um)
{
    return (struct gsn_ray_style){ .low = from,
                                   .high = to,
                                   .opaque_um = opaque_um,
                                   .map = GSN_MAP_VIRIDIS,
                                   .level = NAN,
                                   .across = 1 };
}

static inline struct gsn_camera frame(const struct kuhn *kuhn, const struct gsn_view *view)
{
    struct gsn_camera camera;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_camera_frame(view, kuhn->mesh, &camera, &err), err);
    return camera;
}

/* The line of a pixel, start in the plane of the picture; returns how far before it the eye is,
 * infinity without one. */
static inline double line_of(const struct gsn_camera *camera, double x, double y, double start[3],
                             double into[3])
{
    double length;

    gsn_ray_start(camera, x, y, start);
    for (int c = 0; c < 3; c++)
        into[c] = camera->eye_um > 0
                      ? start[c] - camera->centre[c] + camera->eye_um * camera->into[c]
                      : camera->into[c];
    length = sqrt(into[0] * into[0] + into[1] * into[1] + into[2] * into[2]);
    for (int c = 0; c < 3; c++)
        into[c] /= length;
    return camera->eye_um > 0 ? length : INFINITY;
}

/* Where the line start + t into crosses a box; 0 when it passes by. */
static inline int chord(const double from[3], const double to[3], const double start[3],
                        const double into[3], double *ret_from, double *ret_to)
{
    *ret_from = -INFINITY;
    *ret_to = INFINITY;
    for (int a = 0; a < 3; a++) {
        double t0, t1;

        if (fabs(into[a]) < 1e-12) {
            if (start[a] < from[a] || start[a] > to[a])
                return 0;
            continue;
        }
        t0 = (from[a] - start[a]) / into[a];
        t1 = (to[a] - start[a]) / into[a];
        *ret_from = fmax(*ret_from, fmin(t0, t1));
        *ret_to = fmin(*ret_to, fmax(t0, t1));
    }
    return *ret_from < *ret_to;
}

#endif
