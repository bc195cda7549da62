/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_grid_parts.h"

#include <math.h>
#include <string.h>

/* Every twentieth of a pitch's logarithm, every tenth of a pitch. */
static const double PITCH_STEP = 1.05, PLACE_STEP = 0.1;

static double square(double x)
{
    return x * x;
}

static long line_of(const struct gsn_grid_axis *axis, unsigned lines, double at)
{
    return lround(fmin(fmax((at - axis->first) / axis->pitch, 0), (double)lines - 1));
}

static double coordinate(const struct gsn_grid_problem *p, size_t i, int along_x)
{
    return along_x ? p->centre[i].x : p->centre[i].y;
}

static double axis_cost(const struct gsn_grid_problem *p, int along_x, unsigned lines,
                        struct gsn_grid_axis *axis)
{
    double cost = 0;

    for (size_t i = 0; i < p->count; i++) {
        const double at = coordinate(p, i, along_x);
        const double off = at - axis->first - (double)line_of(axis, lines, at) * axis->pitch;

        cost += fmin(square(off / p->hand) / 2, gsn_grid_stranger_cost(p, i));
    }
    return cost;
}

static int same_lines(const struct gsn_grid_problem *p, int along_x, unsigned lines,
                      const struct gsn_grid_axis *a, const struct gsn_grid_axis *b)
{
    for (size_t i = 0; i < p->count; i++) {
        const double at = coordinate(p, i, along_x);

        if (line_of(a, lines, at) != line_of(b, lines, at))
            return 0;
    }
    return 1;
}

/* Puts an axis among the best few, which are sorted; of those with the same lines the best stays.
 */
static void keep_axis(const struct gsn_grid_problem *p, int along_x, unsigned lines,
                      struct gsn_grid_axis *kept, size_t *count, const struct gsn_grid_axis *axis)
{
    size_t at = *count;

    for (size_t k = 0; k < *count; k++) {
        if (!same_lines(p, along_x, lines, &kept[k], axis))
            continue;
        if (kept[k].cost <= axis->cost)
            return;
        memmove(&kept[k], &kept[k + 1], (*count - k - 1) * sizeof *kept);
        at = --*count;
        break;
    }
    while (at > 0 && kept[at - 1].cost > axis->cost)
        at--;
    if (at == GSN_GRID_AXES)
        return;
    if (*count < GSN_GRID_AXES)
        ++*count;
    memmove(&kept[at + 1], &kept[at], (*count - at - 1) * sizeof *kept);
    kept[at] = *axis;
}

size_t gsn_grid_axes(const struct gsn_grid_problem *p, int along_x,
                     struct gsn_grid_axis kept[GSN_GRID_AXES])
{
    const unsigned lines = along_x ? p->ground->columns : p->ground->rows;
    const double length = along_x ? p->ground->width : p->ground->height;
    const double most = lines > 1 ? length / (lines - 1) : GSN_GRID_PITCH_LEAST * p->ground->size;
    size_t count = 0;

    for (double pitch = GSN_GRID_PITCH_LEAST * p->ground->size; pitch <= most;
         pitch *= PITCH_STEP) {
        const double last = length - (lines - 1) * pitch;

        for (double first = 0; first <= last; first += PLACE_STEP * pitch) {
            struct gsn_grid_axis axis = { .first = first, .pitch = pitch };

            axis.cost = axis_cost(p, along_x, lines, &axis);
            keep_axis(p, along_x, lines, kept, &count, &axis);
        }
    }
    return count;
}
