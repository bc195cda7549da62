/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Boxes against half-spaces, tetrahedra and triangles.
 *
 * The share of a cube above a linear function: along the axis of the smallest slope the area of the
 * cut square is piecewise quadratic, so that Gauss' rule of two points on each of its at most five
 * pieces is exact. The volume common to box and tetrahedron: the tetrahedron is clipped at the six
 * planes of the box, one after the other, and what a plane leaves is cut into at most three
 * tetrahedra. Whether a triangle meets the box: the separating axis theorem with the thirteen axes
 * of T. Akenine-Moeller, "Fast 3D triangle-box overlap testing", J. Graphics Tools 6, 2001.
 *
 * Failure: none; a flat tetrahedron has no volume. Cost: constant. */
#include "pipeline/measure/aabb.h"

#include <math.h>
#include <string.h>

/* Area of {x in [0,1]^2 : m[0] x_0 + m[1] x_1 < a}, 0 <= m[0] <= m[1], m[1] > 0. */
static double square_below(const double m[2], double a)
{
    if (a <= 0.0)
        return 0.0;
    if (a >= m[0] + m[1])
        return 1.0;
    if (a < m[0])
        return a * a / (2.0 * m[0] * m[1]);
    if (a <= m[1])
        return (a - 0.5 * m[0]) / m[1];
    return 1.0 - (m[0] + m[1] - a) * (m[0] + m[1] - a) / (2.0 * m[0] * m[1]);
}

/* Volume of {x in [0,1]^3 : m . x < a} with 0 <= m[0] <= m[1] <= m[2], m[2] > 0.
 *
 * The textbook closed form is a difference of cubes over m0 m1 m2 and loses everything when a slope
 * is small. The same number without cancellation: along the axis of the smallest slope the area of
 * the cut square is piecewise quadratic with four known breaks, and Gauss' two-point rule is exact
 * on each piece. */
static double cube_below(const double m[3], double a)
{
    const double breaks[4] = { m[1] + m[2], m[2], m[1], 0.0 };
    const double node = 0.5 / sqrt(3.0);
    double at = 0.0, volume = 0.0;

    if (a <= 0.0)
        return 0.0;
    if (a >= m[0] + m[1] + m[2])
        return 1.0;
    for (int piece = 0; piece < 5; piece++) {
        double end = 1.0;

        /* a - m0 x falls through the breaks as x grows. */
        if (piece < 4 && m[0] > 0.0)
            end = fmin(1.0, fmax(at, (a - breaks[piece]) / m[0]));
        if (end > at) {
            const double mid = 0.5 * (at + end), reach = node * (end - at);

            volume += 0.5 * (end - at) *
                      (square_below(m + 1, a - m[0] * (mid - reach)) +
                       square_below(m + 1, a - m[0] * (mid + reach)));
        }
        at = end;
    }
    return fmin(1.0, volume);
}

static void sort_three(double m[3])
{
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2 - i; j++) {
            if (m[j] > m[j + 1]) {
                const double swap = m[j];

                m[j] = m[j + 1];
                m[j + 1] = swap;
            }
        }
    }
}

double gsn_aabb_share_above(double value, const double slope[3])
{
    /* With x = (1 + sign t) / 2 the function is value - sum m / 2 + m . x, m = 2 |slope|. */
    double m[3] = { 2.0 * fabs(slope[0]), 2.0 * fabs(slope[1]), 2.0 * fabs(slope[2]) };
    double half, scale;

    sort_three(m);
    half = 0.5 * (m[0] + m[1] + m[2]);
    if (value >= half)
        return value > 0.0 ? 1.0 : 0.0;
    if (value <= -half)
        return 0.0;
    /* Slopes of any size, products that neither overflow nor vanish. */
    scale = 1.0 / m[2];
    for (int k = 0; k < 3; k++)
        m[k] *= scale;
    half *= scale;
    value *= scale;
    /* By symmetry the part above is the part below of the negative: take the smaller directly. */
    return value > 0.0 ? 1.0 - cube_below(m, half - value) : cube_below(m, half + value);
}

static double tet_volume(const double p[4][3])
{
    const double a[3] = { p[1][0] - p[0][0], p[1][1] - p[0][1], p[1][2] - p[0][2] };
    const double b[3] = { p[2][0] - p[0][0], p[2][1] - p[0][1], p[2][2] - p[0][2] };
    const double c[3] = { p[3][0] - p[0][0], p[3][1] - p[0][1], p[3][2] - p[0][2] };

    return fabs(a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
                a[2] * (b[0] * c[1] - b[1] * c[0])) /
           6.0;
}

/* The point where the edge in -> out crosses the plane; in has distance >= 0, out < 0. */
static void find_crossing(const double in[3], const double out[3], double d_in, double d_out,
                          double ret[3])
{
    const double t = d_in / (d_in - d_out);

    for (int a = 0; a < 3; a++)
        ret[a] = in[a] + t * (out[a] - in[a]);
}

static double clip_volume(const struct gsn_aabb *box, const double p[4][3], int plane);

static double clip_piece(const struct gsn_aabb *box, const double a[3], const double b[3],
                         const double c[3], const double d[3], int plane)
{
    double piece[4][3];

    memcpy(piece[0], a, sizeof piece[0]);
    memcpy(piece[1], b, sizeof piece[1]);
    memcpy(piece[2], c, sizeof piece[2]);
    memcpy(piece[3], d, sizeof piece[3]);
    return clip_volume(box, piece, plane);
}

/* Volume of the tetrahedron's part inside planes plane..5 of the box. A plane leaves of it a
 * tetrahedron or a prism, which is three: volumes only add, nothing cancels. */
static double clip_volume(const struct gsn_aabb *box, const double p[4][3], int plane)
{
    double d[4], cut[4][3];
    int in[4], out[4], ins = 0, outs = 0;

    for (; plane < 6; plane++) {
        const int axis = plane / 2;

        ins = outs = 0;
        for (int k = 0; k < 4; k++) {
            const double from = p[k][axis] - box->centre[axis];

            d[k] = box->half[axis] + (plane % 2 ? -from : from);
            if (d[k] >= 0.0)
                in[ins++] = k;
            else
                out[outs++] = k;
        }
        if (ins == 0)
            return 0.0;
        if (outs > 0)
            break;
    }
    if (plane == 6)
        return tet_volume(p);
    plane++;
    if (ins == 1) {
        for (int k = 0; k < 3; k++)
            find_crossing(p[in[0]], p[out[k]], d[in[0]], d[out[k]], cut[k]);
        return clip_piece(box, p[in[0]], cut[0], cut[1], cut[2], plane);
    }
    if (ins == 3) {
        for (int k = 0; k < 3; k++)
            find_crossing(p[in[k]], p[out[0]], d[in[k]], d[out[0]], cut[k]);
        return clip_piece(box, p[in[0]], p[in[1]], p[in[2]], cut[0], plane) +
               clip_piece(box, p[in[1]], p[in[2]], cut[0], cut[1], plane) +
               clip_piece(box, p[in[2]], cut[0], cut[1], cut[2], plane);
    }
    for (int k = 0; k < 4; k++)
        find_crossing(p[in[k / 2]], p[out[k % 2]], d[in[k / 2]], d[out[k % 2]], cut[k]);
    /* Prism with the triangles (in0, cut0, cut1) and (in1, cut2, cut3). */
    return clip_piece(box, p[in[0]], cut[0], cut[1], p[in[1]], plane) +
           clip_piece(box, cut[0], cut[1], p[in[1]], cut[2], plane) +
           clip_piece(box, cut[1], p[in[1]], cut[2], cut[3], plane);
}

double gsn_aabb_tet_volume(const struct gsn_aabb *box, const double corner[4][3])
{
    return clip_volume(box, corner, 0);
}

/* Whether the axis keeps the triangle (relative to the box's centre) and the box apart. */
static int axis_separates(const double axis[3], const double half[3], const double p[3][3])
{
    const double reach =
        half[0] * fabs(axis[0]) + half[1] * fabs(axis[1]) + half[2] * fabs(axis[2]);
    double low = INFINITY, high = -INFINITY;

    for (int k = 0; k < 3; k++) {
        const double at = axis[0] * p[k][0] + axis[1] * p[k][1] + axis[2] * p[k][2];

        low = fmin(low, at);
        high = fmax(high, at);
    }
    return low > reach || high < -reach;
}

int gsn_aabb_meets_triangle(const struct gsn_aabb *box, const double corner[3][3])
{
    double p[3][3], edge[3][3], normal[3];

    for (int k = 0; k < 3; k++) {
        for (int a = 0; a < 3; a++)
            p[k][a] = corner[k][a] - box->centre[a];
    }
    for (int k = 0; k < 3; k++) {
        for (int a = 0; a < 3; a++)
            edge[k][a] = p[(k + 1) % 3][a] - p[k][a];
    }
    for (int a = 0; a < 3; a++) {
        const double unit[3] = { a == 0, a == 1, a == 2 };

        if (axis_separates(unit, box->half, p))
            return 0;
        normal[a] = edge[0][(a + 1) % 3] * edge[1][(a + 2) % 3] -
                    edge[0][(a + 2) % 3] * edge[1][(a + 1) % 3];
    }
    if (axis_separates(normal, box->half, p))
        return 0;
    for (int k = 0; k < 3; k++) {
        for (int a = 0; a < 3; a++) {
            double axis[3] = { 0.0, 0.0, 0.0 }; /* unit a x edge k */

            axis[(a + 1) % 3] = -edge[k][(a + 2) % 3];
            axis[(a + 2) % 3] = edge[k][(a + 1) % 3];
            if (axis_separates(axis, box->half, p))
                return 0;
        }
    }
    return 1;
}
