/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: central moments of the thresholded shape (Hu 1962), their window an ellipse that follows
 * them.
 *
 * Steps of gsn_oval_find(). 1. The level half way between the disc and what is around it. 2. Four
 * rounds: moments of what is higher within 1.3 times the ellipse of the round before. 3. Refused
 * are shapes that are nearly round, longer than two to one, or elsewhere; what is no ellipse the
 * fit on the stretched pixels refuses. 4. The stretch is the inverse root of the moments, these
 * with determinant 1.
 *
 * Cannot fail. It is a file of its own because both fits (localise.c, contour.c) ask it. */
#include "pipeline/register/fiducial/oval.h"

#include <assert.h>
#include <math.h>

const double gsn_oval_axes_max = 2, gsn_oval_round_score = 0.99;

/* Axes that differ by less are a round mark's. */
static const double AXES_LEAST = 1.2;
/* Of fewer pixels, moments say nothing. */
enum { PIXELS_LEAST = 24 };

/* The mean of the pixels between two distances from the start. */
static double level_between(const struct gsn_plane *plane, struct gsn_point start, double from,
                            double to)
{
    double sum = 0, n = 0;

    for (int y = (int)fmax(floor(start.y - to), 0); y < (int)plane->height && y < start.y + to;
         y++) {
        for (int x = (int)fmax(floor(start.x - to), 0); x < (int)plane->width && x < start.x + to;
             x++) {
            const float value = plane->value[(size_t)y * plane->width + (size_t)x];
            const double r = hypot(x + 0.5 - start.x, y + 0.5 - start.y);

            if (!isfinite(value) || r < from || r > to)
                continue;
            sum += (double)value;
            n += 1;
        }
    }
    return sum / fmax(n, 1);
}

/* An ellipse by its second moments: what is higher than half way between the disc and the tissue
 * within the ellipse of the round before, and a little more. */
struct oval {
    struct gsn_point centre;
    double xx, xy, yy; /* of a uniform ellipse: a quarter of the squared half axes */
};

static int update_moments(const struct gsn_plane *plane, double level, struct oval *oval)
{
    static const double BEYOND = 1.3;
    const double det = oval->xx * oval->yy - oval->xy * oval->xy;
    const double far = BEYOND * 2 * sqrt(oval->xx + oval->yy);
    double n = 0, x1 = 0, y1 = 0, xx = 0, xy = 0, yy = 0;

    for (int y = (int)fmax(floor(oval->centre.y - far), 0);
         y < (int)plane->height && y < oval->centre.y + far; y++) {
        for (int x = (int)fmax(floor(oval->centre.x - far), 0);
             x < (int)plane->width && x < oval->centre.x + far; x++) {
            const double dx = x + 0.5 - oval->centre.x, dy = y + 0.5 - oval->centre.y;
            const double square =
                (oval->yy * dx * dx - 2 * oval->xy * dx * dy + oval->xx * dy * dy) / det;

            if (square > 4 * BEYOND * BEYOND ||
                !(plane->value[(size_t)y * plane->width + (size_t)x] > level))
                continue;
            n += 1;
            x1 += dx;
            y1 += dy;
            xx += dx * dx;
            xy += dx * dy;
            yy += dy * dy;
        }
    }
    if (n < PIXELS_LEAST)
        return 0;
    *oval = (struct oval){ { oval->centre.x + x1 / n, oval->centre.y + y1 / n },
                           xx / n - x1 * x1 / (n * n),
                           xy / n - x1 * y1 / (n * n),
                           yy / n - y1 * y1 / (n * n) };
    return oval->xx * oval->yy > oval->xy * oval->xy;
}

int gsn_oval_find(const struct gsn_plane *plane, struct gsn_point *start, double *radius,
                  struct gsn_oval_stretch *ret_stretch)
{
    enum { ROUNDS = 4 };
    const double quarter = 0.25 * *radius * *radius;
    const double level = 0.5 * (level_between(plane, *start, 0, 0.5 * *radius) +
                                level_between(plane, *start, 1.8 * *radius, 2.3 * *radius));
    struct oval oval = { *start, quarter, 0, quarter };
    double det, half, aspect, by;

    assert(plane && start && radius && ret_stretch);

    for (int round = 0; round < ROUNDS; round++)
        if (!update_moments(plane, level, &oval))
            return 0;
    det = sqrt(oval.xx * oval.yy - oval.xy * oval.xy);
    half = 0.5 * (oval.xx + oval.yy) / det;
    aspect = half + sqrt(fmax(half * half - 1, 0));
    if (aspect < AXES_LEAST || aspect > gsn_oval_axes_max || 2 * sqrt(det) > 1.6 * *radius ||
        hypot(oval.centre.x - start->x, oval.centre.y - start->y) > *radius)
        return 0;
    /* The inverse of the root of the moments, these with determinant 1. */
    by = sqrt(2 * half + 2);
    *ret_stretch = (struct gsn_oval_stretch){ (oval.yy / det + 1) / by, -oval.xy / det / by,
                                              (oval.xx / det + 1) / by };
    *start = oval.centre;
    *radius = 2 * sqrt(det);
    return 1;
}

void gsn_oval_unstretch(const struct gsn_oval_stretch *stretch, struct gsn_fiducial *mark)
{
    /* The inverse: the determinant is 1. */
    const double xx = stretch->yy, xy = -stretch->xy, yy = stretch->xx;
    const double c = mark->cov_xx, d = mark->cov_xy, e = mark->cov_yy;

    mark->px =
        (struct gsn_point){ xx * mark->px.x + xy * mark->px.y, xy * mark->px.x + yy * mark->px.y };
    mark->cov_xx = xx * xx * c + 2 * xx * xy * d + xy * xy * e;
    mark->cov_xy = xx * xy * c + (xx * yy + xy * xy) * d + xy * yy * e;
    mark->cov_yy = xy * xy * c + 2 * xy * yy * d + yy * yy * e;
}
