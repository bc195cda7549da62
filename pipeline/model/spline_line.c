/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Integrals of a spline along whole lines. */
#include "pipeline/model/simplex_line.h"
#include "pipeline/model/spline_internal.h"

#include <math.h>

/* A line as two planes through it: a point's distances from them are its place in the picture. The
 * start is moved along the line beside the mesh, to where all tetrahedra agree on it. */
struct sight {
    double start[3], along[3], axis[2][3];
};

/* Any length will do, but 0; NaN when there is no direction. */
static void normalise(double v[3])
{
    const double most = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
    double size;

    for (int c = 0; c < 3; c++)
        v[c] = most > 0 ? v[c] / most : NAN;
    size = sqrt(gsn_dot(v, v));
    for (int c = 0; c < 3; c++)
        v[c] /= size;
}

/* Returns 0 when p or d is no place or direction. */
static int sight_init(struct sight *sight, const struct gsn_dms *space, const double p[3],
                      const double d[3])
{
    const struct gsn_box *bounds = gsn_boxtree_bounds(space->tree);
    double beside[3] = { 0, 0, 0 }, to[3], shift;
    double *along = sight->along;
    int least = 0;

    for (int c = 0; c < 3; c++) {
        if (!isfinite(p[c]) || !isfinite(d[c]))
            return 0;
        along[c] = d[c];
    }
    normalise(along);
    for (int c = 0; c < 3; c++) {
        to[c] = (bounds->low[c] + bounds->high[c]) / 2 - p[c];
        if (fabs(along[c]) < fabs(along[least]))
            least = c;
    }
    shift = gsn_dot(to, along);
    for (int c = 0; c < 3; c++)
        sight->start[c] = p[c] + shift * along[c];
    if (!isfinite(shift) || !isfinite(sight->start[0] + sight->start[1] + sight->start[2]))
        return 0;
    beside[least] = 1;
    gsn_cross(along, beside, sight->axis[0]);
    normalise(sight->axis[0]);
    gsn_cross(along, sight->axis[0], sight->axis[1]);
    return 1;
}

/* Whether all points lie on one side of the line, in the picture. */
static int is_beside(const double (*seen)[2], size_t count)
{
    unsigned sides = 15;

    for (size_t i = 0; i < count; i++)
        sides &= (seen[i][0] < 0) | (seen[i][0] > 0) << 1 | (seen[i][1] < 0) << 2 |
                 (seen[i][1] > 0) << 3;
    return sides != 0;
}

static double tet_line(const struct gsn_spline *spline, const struct sight *sight, size_t tet)
{
    const struct gsn_dms *space = spline->space;
    const struct gsn_simplex_sets *sets = space->sets;
    const uint32_t *id = gsn_dms_control_ids(space, tet);
    double knot[GSN_SIMPLEX_MAX_KNOTS][3], seen[GSN_SIMPLEX_MAX_KNOTS][2];
    double integral[GSN_DMS_MAX_FUNCTIONS], sum = 0;

    gsn_dms_gather(space, tet, knot);
    for (unsigned i = 0; i < 4 * (space->degree + 1); i++) {
        double to[3];

        gsn_subtract(knot[i], sight->start, to);
        seen[i][0] = gsn_dot(to, sight->axis[0]);
        seen[i][1] = gsn_dot(to, sight->axis[1]);
    }
    if (is_beside((const double(*)[2])seen, 4 * (space->degree + 1)) ||
        !gsn_simplex_line(sets, (const double(*)[2])seen, integral))
        return 0;
    for (size_t f = 0; f < sets->functions; f++) {
        if (integral[f] != 0)
            sum += spline->control[id[f]] * integral[f] *
                   fabs(gsn_simplex_det(&sets->set[sets->corners[f]], (const double(*)[3])knot));
    }
    return sum;
}

double gsn_spline_tet_line(const struct gsn_spline *spline, size_t tet, const double p[3],
                           const double d[3])
{
    struct sight sight;

    return sight_init(&sight, spline->space, p, d) ? tet_line(spline, &sight, tet) : NAN;
}

double gsn_spline_line(const struct gsn_spline *spline, const double p[3], const double d[3])
{
    struct gsn_ascent ascent;
    struct sight sight;
    double sum = 0;

    if (!sight_init(&sight, spline->space, p, d))
        return NAN;
    gsn_ascent_begin(&ascent);
    do {
        (void)gsn_boxtree_along(spline->space->tree, sight.start, sight.along, gsn_ascent_add,
                                &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            sum += tet_line(spline, &sight, ascent.item[i]);
    } while (gsn_ascent_next(&ascent));
    return sum;
}
