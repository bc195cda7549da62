/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Means over a cell for knots in any position: cut, then integrate polynomial by polynomial. */
#include "pipeline/model/frame.h"
#include "pipeline/model/simplex.h"
#include "pipeline/model/simplex_mean.h"

#include <math.h>
#include <string.h>

/* A plane that passes a corner nearer than this share of the cell's size goes through it. */
#define TOUCH 1e-13

/* One function over the pieces of one cell. */
struct cutting {
    const struct gsn_simplex_sets *sets;
    const double (*knot)[3];
    const uint16_t *pick;
    size_t function;
    double touch;
};

/* The mean over one piece, by a rule that is exact for polynomials of degree 3 (Keast): the middle
 * and four points around it. All lie inside the piece, off every knot plane. */
static double rule(const struct cutting *cutting, const double (*corner)[3])
{
    double sum = 0;

    for (int i = 0; i < 5; i++) {
        struct gsn_simplex_at at;
        double u[3];

        for (int c = 0; c < 3; c++) {
            u[c] = (corner[0][c] + corner[1][c] + corner[2][c] + corner[3][c]) / (i < 4 ? 6 : 4);
            u[c] += i < 4 ? corner[i][c] / 3 : 0;
        }
        gsn_simplex_at_init(&at, cutting->sets, cutting->knot, cutting->pick, u, 0);
        sum += (i < 4 ? 0.45 : -0.8) * gsn_simplex_value(&at, cutting->function);
    }
    return sum;
}

/* How far the corners lie on either side of the plane of a knot triple; 0 when it has none. */
static int see_plane(const struct cutting *cutting, size_t triple, const double (*corner)[3],
                     double ret_value[4])
{
    const uint8_t *m = cutting->sets->set[triple].member;
    double p[3], q[3], r[3], normal[3], size;

    gsn_subtract(cutting->knot[m[1]], cutting->knot[m[0]], p);
    gsn_subtract(cutting->knot[m[2]], cutting->knot[m[0]], q);
    gsn_cross(p, q, normal);
    size = sqrt(gsn_dot(normal, normal));
    if (!(size > 0))
        return 0;
    for (int i = 0; i < 4; i++) {
        gsn_subtract(corner[i], cutting->knot[m[0]], r);
        ret_value[i] = gsn_dot(normal, r) / size;
        if (fabs(ret_value[i]) <= cutting->touch)
            ret_value[i] = 0;
    }
    return 1;
}

/* The mean over a piece that the planes before this one do not cut. */
static double cut(const struct cutting *cutting, size_t triple, const double (*corner)[3])
{
    for (; triple < cutting->sets->first[2]; triple++) {
        double value[4], part[4][3], at, mean;
        int in = -1, out = -1;

        if (cutting->sets->set[triple].mask & ~cutting->sets->set[cutting->function].mask ||
            !see_plane(cutting, triple, corner, value))
            continue;
        for (int i = 0; i < 4; i++) {
            in = value[i] > 0 ? i : in;
            out = value[i] < 0 ? i : out;
        }
        if (in < 0 || out < 0)
            continue;
        at = value[in] / (value[in] - value[out]);
        memcpy(part, corner, sizeof part);
        for (int c = 0; c < 3; c++)
            part[out][c] = corner[in][c] + at * (corner[out][c] - corner[in][c]);
        mean = at * cut(cutting, triple, (const double(*)[3])part);
        memcpy(part[in], part[out], sizeof *part);
        memcpy(part[out], corner[out], sizeof *part);
        return mean + (1 - at) * cut(cutting, triple, (const double(*)[3])part);
    }
    return rule(cutting, corner);
}

double gsn_simplex_mean_by_pieces(const struct gsn_simplex_sets *sets, const double (*knot)[3],
                                  const uint16_t *pick, const struct gsn_simplex_cell *cell,
                                  size_t function)
{
    double edge[3];

    gsn_subtract(cell->corner[3], cell->corner[0], edge);
    return cut(&(struct cutting){ .sets = sets,
                                  .knot = knot,
                                  .pick = pick,
                                  .function = function,
                                  .touch = TOUCH * sqrt(gsn_dot(edge, edge)) },
               sets->first[3], (const double(*)[3])cell->corner);
}
