/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/ray.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Pixels. A centre this near outside is integrated too: it costs one evaluation that gives 0. */
static const double generous = 1e-6;

static int by_place(const void *a, const void *b)
{
    const double *p = a, *q = b;

    if (p[0] < q[0] || p[0] > q[0])
        return p[0] < q[0] ? -1 : 1;
    return (p[1] > q[1]) - (p[1] < q[1]);
}

static double turn(const double a[2], const double b[2], const double c[2])
{
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/* Andrew's monotone chain. Dropping a corner that is collinear up to rounding moves the hull by
 * less than generous. */
static unsigned convex_hull(double (*point)[2], unsigned count, double (*ret_hull)[2])
{
    double chain[2 * GSN_SHADOW_MOST][2];
    unsigned size = 0;

    qsort(point, count, sizeof *point, by_place);
    for (int upper = 0; upper < 2; upper++) {
        const unsigned start = size;

        for (unsigned i = 0; i < count; i++) {
            const double *next = point[upper ? count - 1 - i : i];

            while (size >= start + 2 && turn(chain[size - 2], chain[size - 1], next) <= 0.0)
                size--;
            memcpy(chain[size++], next, sizeof *chain);
        }
        size--; /* the end of one chain is the start of the other */
    }
    if (size < 2) {
        /* All in one place: keep it as a segment of no length. */
        memcpy(chain[1], chain[0], sizeof *chain);
        size = 2;
    }
    memcpy(ret_hull, chain, size * sizeof *chain);
    return size;
}

void gsn_shadow_make(const struct gsn_dms *space, size_t tet, const struct gsn_camera *camera,
                     struct gsn_shadow *ret_shadow)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const double(*knot)[3] = gsn_dms_knots(space);
    const unsigned cloud = gsn_dms_degree(space) + 1;
    double point[GSN_SHADOW_MOST][2];
    unsigned count = 0;

    for (int k = 0; k < 4; k++) {
        for (unsigned l = 0; l < cloud; l++) {
            double depth;

            gsn_camera_project(camera, knot[(size_t)mesh->tet[tet][k] * cloud + l], point[count++],
                               &depth);
        }
    }
    ret_shadow->count = convex_hull(point, count, ret_shadow->corner);
    ret_shadow->top = INFINITY;
    ret_shadow->bottom = -INFINITY;
    for (unsigned i = 0; i < ret_shadow->count; i++) {
        ret_shadow->top = fmin(ret_shadow->top, ret_shadow->corner[i][1]);
        ret_shadow->bottom = fmax(ret_shadow->bottom, ret_shadow->corner[i][1]);
    }
}

void gsn_shadow_span(const struct gsn_shadow *shadow, uint32_t row, uint32_t width,
                     uint32_t *ret_first, uint32_t *ret_end)
{
    const double y = fmin(shadow->bottom, fmax(shadow->top, row + 0.5));
    double low = INFINITY, high = -INFINITY;

    *ret_first = *ret_end = 0;
    if (fabs(y - (row + 0.5)) > generous)
        return;
    for (unsigned i = 0; i < shadow->count; i++) {
        const double *a = shadow->corner[i], *b = shadow->corner[(i + 1) % shadow->count];

        if (y < fmin(a[1], b[1]) || y > fmax(a[1], b[1]))
            continue;
        if (a[1] < b[1] || a[1] > b[1]) {
            const double x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);

            low = fmin(low, x);
            high = fmax(high, x);
        } else {
            low = fmin(low, fmin(a[0], b[0]));
            high = fmax(high, fmax(a[0], b[0]));
        }
    }
    if (low > high)
        return;
    /* Centres at +0.5: the first at or right of low, the last at or left of high. */
    *ret_first = (uint32_t)fmin(width, fmax(0.0, ceil(low - 0.5 - generous)));
    *ret_end = (uint32_t)fmin(width, fmax(0.0, floor(high - 0.5 + generous) + 1.0));
    if (*ret_end < *ret_first)
        *ret_end = *ret_first;
}

void gsn_ray_start(const struct gsn_camera *camera, double x_px, double y_px, double ret_point[3])
{
    const double right = (x_px - 0.5 * camera->width) / camera->px_per_um;
    const double down = (y_px - 0.5 * camera->height) / camera->px_per_um;

    for (int a = 0; a < 3; a++)
        ret_point[a] = camera->centre[a] + right * camera->right[a] + down * camera->down[a];
}
