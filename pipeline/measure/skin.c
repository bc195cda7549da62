/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/skin.h"

#include <math.h>

#include "pipeline/measure/skin_hull.h"
#include "pipeline/model/bpatch.h"

/* Of a slope: more than its rounding. */
static const double slope_slack = 1e-11;
/* Of the largest coordinate: what counts as on a plane. */
static const double layer = 4e-15;

/* Whether the cell lies on corner k's side of the plane through three knots, or touches it. */
static int is_inner(const double a[3], const double b[3], const double c[3], const double top[3],
                    const struct gsn_tet_cell *cell)
{
    double p[3], q[3], up[3], normal[3], size, sign;

    gsn_subtract(b, a, p);
    gsn_subtract(c, a, q);
    gsn_subtract(top, a, up);
    gsn_cross(p, q, normal);
    sign = gsn_dot(normal, up) < 0.0 ? -1.0 : 1.0;
    size = sqrt(gsn_dot(normal, normal));
    for (int k = 0; k < 4; k++) {
        double from[3], reach = 0.0;

        gsn_subtract(cell->corner[k], a, from);
        for (int i = 0; i < 3; i++)
            reach = fmax(reach, fmax(fabs(cell->corner[k][i]), fabs(a[i])));
        if (sign * gsn_dot(normal, from) < -layer * reach * size)
            return 0;
    }
    return 1;
}

int gsn_skin_clear(const struct gsn_skin *skin, const struct gsn_tet_cell *cell)
{
    const unsigned n = skin->degree, cloud = n + 1U;

    for (unsigned k = 0; k < 4; k++) {
        const double(*a)[3] = skin->knot + (k + 1) % 4 * cloud;
        const double(*b)[3] = skin->knot + (k + 2) % 4 * cloud;
        const double(*c)[3] = skin->knot + (k + 3) % 4 * cloud;

        for (unsigned i = 0; i <= n; i++) {
            for (unsigned j = 0; i + j <= n; j++) {
                for (unsigned l = 0; i + j + l <= n; l++) {
                    if (!is_inner(a[i], b[j], c[l], skin->knot[k * cloud], cell))
                        return 0;
                }
            }
        }
    }
    return 1;
}

size_t gsn_skin_by_values(const struct gsn_skin *skin, const struct gsn_tet_cell *cell,
                          struct gsn_skin_bound *ret_bound)
{
    size_t count = 0;

    *ret_bound = (struct gsn_skin_bound){ { 0.0 }, 0.0, 0.0 };
    for (size_t i = 0; i < skin->values; i++) {
        if (!gsn_skin_hull_reaches(&skin->value[i].hull, cell))
            continue;
        ret_bound->low = fmin(ret_bound->low, skin->value[i].d);
        ret_bound->high = fmax(ret_bound->high, skin->value[i].d);
        count++;
    }
    ret_bound->low -= skin->slack;
    ret_bound->high += skin->slack;
    return count;
}

/* Whether the cell lies in a hull of four knots: there M, of degree 0, is 1/|det| all over. */
static int is_within(const struct gsn_skin_hull *hull, const struct gsn_tet_cell *cell)
{
    const double(*knot)[3] = hull->knot;
    int within = hull->count == 4;

    for (int k = 0; within && k < 4; k++)
        within = is_inner(knot[(k + 1) % 4], knot[(k + 2) % 4], knot[(k + 3) % 4], knot[k], cell);
    return within;
}

/* Between which vectors a gradient lies: means from low to high, plus jumps. */
struct range {
    double low[3], high[3], jump_low[3], jump_high[3];
};

static void widen(struct range *range, const struct gsn_skin_slope *slope, int full)
{
    const double *gradient = slope->gradient;

    for (int a = 0; a < 3; a++) {
        const double low = fmin(0.0, gradient[a]), high = fmax(0.0, gradient[a]);

        if (slope->jump) {
            range->jump_low[a] += full ? gradient[a] : low;
            range->jump_high[a] += full ? gradient[a] : high;
        } else {
            range->low[a] = fmin(range->low[a], low);
            range->high[a] = fmax(range->high[a], high);
        }
    }
}

/* The means are of 0 too: what home's own functions, or none, bring. */
static void find_range(const struct gsn_skin *skin, const struct gsn_tet_cell *cell,
                       struct range *ret_range)
{
    *ret_range = (struct range){ .low = { 0.0 } };
    for (size_t i = 0; i < skin->slopes; i++) {
        const struct gsn_skin_slope *slope = &skin->slope[i];

        if (gsn_skin_hull_reaches(&slope->hull, cell))
            widen(ret_range, slope, slope->jump && is_within(&slope->hull, cell));
    }
    for (int a = 0; a < 3; a++) {
        ret_range->low[a] += ret_range->jump_low[a];
        ret_range->high[a] += ret_range->jump_high[a];
    }
}

/* From the value at the middle of the cell. Returns 0 when a slope has no bound. */
static int bound_slopes(const struct gsn_tet_cell *cell, const double middle[3], double value,
                        const struct range *range, struct gsn_skin_bound *ret_bound)
{
    double most = 0.0;

    for (int k = 0; k < 4; k++) {
        double swing = 0.0;

        ret_bound->corner[k] = value;
        for (int a = 0; a < 3; a++) {
            const double low = range->low[a], high = range->high[a];
            const double step = cell->corner[k][a] - middle[a];

            ret_bound->corner[k] += 0.5 * (low + high) * step;
            swing += (0.5 * (high - low) + slope_slack * fmax(fabs(low), fabs(high))) * fabs(step);
        }
        if (!isfinite(swing))
            return 0;
        most = fmax(most, swing);
    }
    ret_bound->low = -most;
    ret_bound->high = most;
    return 1;
}

int gsn_skin_by_slopes(const struct gsn_skin *skin, const struct gsn_tet_cell *cell,
                       struct gsn_skin_bound *ret_bound)
{
    struct range range;
    struct gsn_skin_bound bound;
    double middle[3], value;
    const double *const arg[GSN_DMS_MAX_DEGREE] = { middle, middle, middle };
    size_t hint = skin->tet;

    for (int a = 0; a < 3; a++)
        middle[a] = 0.25 * (cell->corner[0][a] + cell->corner[1][a] + cell->corner[2][a] +
                            cell->corner[3][a]);
    if (gsn_spline_eval(skin->spline, middle, &hint, &value, NULL) != GSN_OK)
        return 0;
    if (skin->whole)
        value -= gsn_bpatch_polar(skin->degree, (const double(*)[3])skin->knot, skin->control, arg);
    find_range(skin, cell, &range);
    if (!bound_slopes(cell, middle, value, &range, &bound))
        return 0;
    bound.low -= skin->slack;
    bound.high += skin->slack;
    *ret_bound = bound;
    return 1;
}
