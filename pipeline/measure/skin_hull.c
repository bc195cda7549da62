/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/skin_hull.h"

#include <math.h>
#include <string.h>

#include "pipeline/model/frame.h"

enum { STEPS = 12 };

/* Of the largest coordinate. */
static const double layer = 4e-15;

void gsn_skin_hull_add(struct gsn_skin_hull *hull, const double knot[3])
{
    memcpy(hull->knot[hull->count], knot, sizeof hull->knot[0]);
    for (int a = 0; a < 3; a++) {
        hull->low[a] = hull->count > 0 ? fmin(hull->low[a], knot[a]) : knot[a];
        hull->high[a] = hull->count > 0 ? fmax(hull->high[a], knot[a]) : knot[a];
    }
    hull->count++;
}

/* The knot of the hull least far along a direction, less the corner of the cell furthest along it.
 * Returns the component of that along the direction: at least 0 when the direction separates. */
static double gap_along(const struct gsn_skin_hull *hull, const struct gsn_tet_cell *cell,
                        const double way[3], double ret_difference[3])
{
    double least = INFINITY, most = -INFINITY;
    const double *knot = hull->knot[0], *corner = cell->corner[0];

    for (unsigned i = 0; i < hull->count; i++) {
        const double at = gsn_dot(way, hull->knot[i]);

        if (at < least) {
            least = at;
            knot = hull->knot[i];
        }
    }
    for (int k = 0; k < 4; k++) {
        const double at = gsn_dot(way, cell->corner[k]);

        if (at > most) {
            most = at;
            corner = cell->corner[k];
        }
    }
    gsn_subtract(knot, corner, ret_difference);
    return gsn_dot(way, ret_difference);
}

static int separates(const struct gsn_skin_hull *hull, const struct gsn_tet_cell *cell,
                     const double way[3], double reach, double ret_difference[3])
{
    return gap_along(hull, cell, way, ret_difference) >= -layer * reach * sqrt(gsn_dot(way, way));
}

/* The faces of a tetrahedron as seen from outside or inside: where cells touch, only a face's own
 * plane tells. */
static int faces_separate(const struct gsn_skin_hull *hull, const struct gsn_tet_cell *cell,
                          double reach)
{
    for (int k = 0; k < 4; k++) {
        const double *a = cell->corner[(k + 1) % 4];
        double b[3], c[3], top[3], way[3], difference[3];

        gsn_subtract(cell->corner[(k + 2) % 4], a, b);
        gsn_subtract(cell->corner[(k + 3) % 4], a, c);
        gsn_subtract(a, cell->corner[k], top);
        gsn_cross(b, c, way);
        if (gsn_dot(way, top) < 0.0) {
            for (int i = 0; i < 3; i++)
                way[i] = -way[i];
        }
        if (separates(hull, cell, way, reach, difference))
            return 1;
    }
    return 0;
}

/* Gilbert's search for the shortest difference of a point of the hull and one of the cell; every
 * direction it tries may turn out to separate. */
static int search_separates(const struct gsn_skin_hull *hull, const struct gsn_tet_cell *cell,
                            double reach)
{
    double at[3], next[3];

    gsn_subtract(hull->knot[0], cell->corner[0], at);
    for (int step = 0; step < STEPS; step++) {
        double back[3], length, t;

        if (separates(hull, cell, at, reach, next))
            return gsn_dot(at, at) > 0.0;
        gsn_subtract(at, next, back);
        length = gsn_dot(back, back);
        if (!(length > 0.0))
            return 0;
        t = fmin(1.0, fmax(0.0, gsn_dot(at, back) / length));
        for (int i = 0; i < 3; i++)
            at[i] -= t * back[i];
    }
    return 0;
}

int gsn_skin_hull_reaches(const struct gsn_skin_hull *hull, const struct gsn_tet_cell *cell)
{
    double reach = 0.0;

    for (int a = 0; a < 3; a++) {
        double low = INFINITY, high = -INFINITY;

        for (int k = 0; k < 4; k++) {
            low = fmin(low, cell->corner[k][a]);
            high = fmax(high, cell->corner[k][a]);
        }
        if (hull->low[a] >= high || hull->high[a] <= low)
            return 0;
        reach = fmax(reach, fmax(fmax(fabs(low), fabs(high)),
                                 fmax(fabs(hull->low[a]), fabs(hull->high[a]))));
    }
    return !faces_separate(hull, cell, reach) && !search_separates(hull, cell, reach);
}
