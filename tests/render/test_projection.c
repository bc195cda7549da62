/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/projection.h"

#include <string.h>

#include "pipeline/render/ray.h"
#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 1200.0, 900.0, 600.0 };
static const unsigned cells[3] = { 4, 3, 2 };
/* Clouds of 2 % stick out of the faces by less than this: lines that pass the box's edges at a
 * greater distance see the field alone. */
static const double skin = 20.0;

static struct gsn_view oblique(void)
{
    return (struct gsn_view){ .direction = { 0.31, 0.42, 0.85 },
                              .up = { 0.05, -1.0, 0.1 },
                              .width = 90,
                              .height = 70 };
}

/* Where the line start + t into crosses the box grown by some um; 0 when it passes by. */
static int chord(const double start[3], const double into[3], double grown, double *ret_from,
                 double *ret_to)
{
    double from = -INFINITY, to = INFINITY;

    for (int a = 0; a < 3; a++) {
        const double t0 = (low[a] - grown - start[a]) / into[a];
        const double t1 = (high[a] + grown - start[a]) / into[a];

        from = fmax(from, fmin(t0, t1));
        to = fmin(to, fmax(t0, t1));
    }
    *ret_from = from;
    *ret_to = to;
    return from < to;
}

/* Integral of a linear field along the chord; where the line runs near an edge of the box it is
 * between two figures that differ by what the skins may hold. */
static void check_linear(const struct quadric *q, unsigned degree)
{
    const struct gsn_view view = oblique();
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_camera camera;
    struct gsn_error err = { 0 };
    struct kuhn kuhn;
    size_t compared = 0;

    CHECK_OK(kuhn_new(low, high, cells, degree, 0.02, q, &kuhn, &err), err);
    CHECK_OK(gsn_projection(kuhn.spline, &view, 0, NULL, &plane, &camera, &err), err);
    for (uint32_t j = 0; j < view.height; j++) {
        for (uint32_t i = 0; i < view.width; i++) {
            const double value = (double)plane->value[j * view.width + i];
            double start[3], from, to, middle[3], truth;

            gsn_ray_start(&camera, i + 0.5, j + 0.5, start);
            if (!chord(start, camera.into, skin, &from, &to)) {
                CHECK(isnan(value));
                continue;
            }
            if (!chord(start, camera.into, 0.0, &from, &to))
                continue;
            for (int a = 0; a < 3; a++)
                middle[a] = start[a] + 0.5 * (from + to) * camera.into[a];
            truth = (to - from) * quadric_at(q, middle);
            /* The functions fade out beyond the two faces instead of ending at them: the field goes
             * on for a cloud's length. */
            CHECK_NEAR(value, truth, 0.05 * (to - from) + 2.0 * skin);
            compared++;
        }
    }
    CHECK(compared > 1000);
    kuhn_done(&kuhn);
}
