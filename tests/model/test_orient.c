/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/orient.h"

#include "tests/check.h"
#include "tests/model/kuhn.h"

#include <string.h>

__extension__ typedef __int128 whole;

static int sign(whole x)
{
    return (x > 0) - (x < 0);
}

/* What the signs must be, for points with integer coordinates. */
static void minors(const double *a, const double *b, const double *c, whole ret[3])
{
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;

        ret[i] = (whole)(b[j] - a[j]) * (whole)(c[k] - a[k]) -
                 (whole)(b[k] - a[k]) * (whole)(c[j] - a[j]);
    }
}

static int true_orient(const double *a, const double *b, const double *c, const double *d)
{
    whole g[3];

    minors(a, b, c, g);
    return sign(g[0] * (whole)(d[0] - a[0]) + g[1] * (whole)(d[1] - a[1]) +
                g[2] * (whole)(d[2] - a[2]));
}

static int true_side(const double *a, const double *b, const double *c, const double *u)
{
    int s = true_orient(a, b, c, u);
    whole g[3];

    minors(a, b, c, g);
    for (int i = 0; i < 3 && s == 0; i++)
        s = sign(g[i]);
    return s;
}

static double draw_whole(uint64_t *seed, double size)
{
    return floor(size * (2 * draw(seed) - 1));
}

TEST(signs_are_exact_next_to_and_on_a_plane)
{
    uint64_t seed = 1;
    int zero = 0, one = 0;

    for (int i = 0; i < 20000; i++) {
        double p[4][3];
        const double s = draw_whole(&seed, 3), t = draw_whole(&seed, 3), size = i % 2 ? 1e9 : 20;

        for (int c = 0; c < 3; c++) {
            for (int k = 0; k < 3; k++)
                p[k][c] = draw_whole(&seed, size);
            p[3][c] = p[0][c] + s * (p[1][c] - p[0][c]) + t * (p[2][c] - p[0][c]) +
                      floor(3 * draw(&seed)) - 1;
        }
        CHECK(gsn_orient3d(p[0], p[1], p[2], p[3]) == true_orient(p[0], p[1], p[2], p[3]));
        CHECK(gsn_orient3d(p[1], p[0], p[2], p[3]) == -true_orient(p[0], p[1], p[2], p[3]));
        CHECK(gsn_orient_side(p[0], p[1], p[2], p[3]) == true_side(p[0], p[1], p[2], p[3]));
        zero += true_orient(p[0], p[1], p[2], p[3]) == 0;
        one += gsn_orient_side(p[0], p[1], p[2], p[3]) == 0;
    }
    CHECK(zero > 500 && one < zero / 10);
}

/* Three points of the diagonal, moved by single units in the last place: the well-known picture in
 * which the rounded determinant is noise. */
TEST(signs_are_exact_where_the_rounded_determinant_is_noise)
{
    int wrong = 0;

    for (int i = 0; i < 64; i++) {
        for (int j = 0; j < 64; j++) {
            const double a[3] = { 0.5 + i * 0x1p-53, 0.5 + j * 0x1p-53, 0 };
            const double b[3] = { 12, 12, 0 }, c[3] = { 12, 12, 1 }, d[3] = { 24, 24, 0 };
            const whole ax = (whole)(a[0] * 0x1p53), ay = (whole)(a[1] * 0x1p53);
            const whole one = (whole)1 << 53;
            /* det[b - a, c - a, d - a] = (d - a) . ((b - a) x (c - b)), c - b = (0, 0, 1). */
            const int truth =
                sign((24 * one - ax) * (12 * one - ay) - (24 * one - ay) * (12 * one - ax));
            const double px = b[0] - a[0], py = b[1] - a[1];
            const double det = (d[0] - a[0]) * py - (d[1] - a[1]) * px;

            CHECK(gsn_orient3d(a, b, c, d) == truth);
            wrong += ((det > 0) - (det < 0)) != truth;
        }
    }
    CHECK(wrong > 100);
}

TEST(a_point_in_the_plane_belongs_to_the_side_of_the_first_axis_that_leaves_it)
{
    const double o[3] = { 0, 0, 0 }, x[3] = { 1, 0, 0 }, y[3] = { 0, 1, 0 }, z[3] = { 0, 0, 1 };
    const double in_xy[3] = { 0.25, 0.25, 0 }, skew[3] = { -1, 2, 0 }, far[3] = { 3, 0, 0 };

    CHECK(gsn_orient_side(o, x, y, in_xy) == 1);
    CHECK(gsn_orient_side(o, y, x, in_xy) == -1);
    CHECK(gsn_orient_side(o, y, z, o) == 1);
    CHECK(gsn_orient_side(o, x, z, far) == -1);
    CHECK(gsn_orient_side(o, skew, z, o) == 1);
    CHECK(gsn_orient_side(o, x, far, in_xy) == 0);
    CHECK(gsn_orient_side(x, x, y, in_xy) == 0);
}

TEST(plane_products_are_compared_exactly)
{
    uint64_t seed = 9;
    int zero = 0;

    for (int i = 0; i < 20000; i++) {
        const double p[2] = { draw_whole(&seed, 0x1p52), draw_whole(&seed, 0x1p52) };
        const double by = draw_whole(&seed, 2);
        const double q[2] = { by * p[0] + floor(3 * draw(&seed)) - 1,
                              by * p[1] + floor(3 * draw(&seed)) - 1 };
        const int truth = sign((whole)p[0] * (whole)q[1] - (whole)p[1] * (whole)q[0]);

        CHECK(gsn_orient_cross(p, q) == truth);
        CHECK(gsn_orient_cross(q, p) == -truth);
        zero += truth == 0;
    }
    CHECK(zero > 100);
}

/* (1 + e) (1 - e) - 1 = -e^2, which rounding makes 0. */
TEST(a_determinant_keeps_its_digits_when_its_products_cancel)
{
    const double e = 0x1p-30;
    const double a[3] = { 0, 0, 0 }, b[3] = { 1 + e, 1, 0 }, c[3] = { 1, 1 - e, 0 };
    const double d[3] = { 0.25, 0.5, 3 };
    const double *const end[3] = { b, c, d };
    double row[3][3];

    CHECK(gsn_orient_value(a, b, c, d) == -3 * e * e);
    CHECK(gsn_orient_value(a, c, b, d) == 3 * e * e);
    CHECK(gsn_orient_value(a, b, c, b) == 0);
    gsn_orient_rows(a, b, c, d, row);
    /* The rows are 1 / e^2 long, so these sums cancel from there. */
    for (int k = 0; k < 3; k++) {
        for (int j = 0; j < 3; j++)
            CHECK_NEAR(fma(row[k][0], end[j][0], row[k][1] * end[j][1]) + row[k][2] * end[j][2],
                       k == j, 1e-15 / (e * e));
    }
    CHECK(row[0][0] == -(1 - e) / (e * e) && row[1][1] == -(1 + e) / (e * e));
}
