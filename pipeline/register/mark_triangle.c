/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_triangle.h"

#include <math.h>

double gsn_mark_distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

struct gsn_point gsn_mark_to_um(struct gsn_point px, double px_um, int mirrored)
{
    return (struct gsn_point){ mirrored ? -px.x * px_um : px.x * px_um, px.y * px_um };
}

double gsn_mark_triangle_size(const struct gsn_point corner[GSN_MARKS])
{
    double squares = 0;

    for (int i = 0; i < GSN_MARKS; i++)
        squares += pow(gsn_mark_distance(corner[i], corner[(i + 1) % GSN_MARKS]), 2);
    /* The mean squared distance of n points from their centroid is the sum over pairs / n^2. */
    return sqrt(squares) / GSN_MARKS;
}

double gsn_mark_tolerance(const struct gsn_triangle_prior *prior, double px_um)
{
    return hypot(GSN_MARK_STRETCH * gsn_mark_triangle_size(prior->mark_um), 0.5 * px_um);
}
