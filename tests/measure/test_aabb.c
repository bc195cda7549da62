/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/aabb.h"

#include "tests/check.h"
#include "tests/measure/draw.h"

/* The textbook form: inclusion and exclusion of the corners, in long double; good only while no
 * slope is small. */
static double share_by_corners(double value, const double slope[3])
{
    long double m[3], above = 0.0L, base = (long double)value;

    for (int a = 0; a < 3; a++) {
        m[a] = 2.0L * fabsl((long double)slope[a]);
        base -= fabsl((long double)slope[a]);
    }
    /* vol{x in [0,1]^3 : m.x > -base} by corners, counted from the far one. */
    for (int k = 0; k < 8; k++) {
        long double at = base + m[0] + m[1] + m[2];
        int sign = 1;

        for (int a = 0; a < 3; a++) {
            if (k >> a & 1) {
                at -= m[a];
                sign = -sign;
            }
        }
        if (at > 0.0L)
            above += sign * at * at * at;
    }
    return (double)(above / (6.0L * m[0] * m[1] * m[2]));
}

TEST(a_half_space_cut_equals_inclusion_and_exclusion)
{
    uint64_t seed = 1;

    for (int i = 0; i < 2000; i++) {
        const double slope[3] = { 0.2 + draw(&seed), -0.2 - draw(&seed), 0.2 + draw(&seed) };
        const double value = 4.0 * draw(&seed) - 2.0;

        CHECK_NEAR(gsn_aabb_share_above(value, slope), share_by_corners(value, slope), 1e-14);
    }
}

TEST(a_cut_along_an_axis_is_exact_and_tiny_slopes_change_nothing)
{
    for (int a = 0; a < 3; a++) {
        for (int s = -1; s <= 1; s += 2) {
            double slope[3] = { 0.0, 0.0, 0.0 };

            slope[a] = 2.0 * s;
            CHECK_NEAR(gsn_aabb_share_above(1.0, slope), 0.75, 1e-16);
            CHECK_NEAR(gsn_aabb_share_above(-1.0, slope), 0.25, 1e-16);
            for (int e = 1; e < 300; e++) {
                slope[(a + 1) % 3] = pow(10.0, -e);
                slope[(a + 2) % 3] = pow(10.0, -300 + e);
                CHECK_NEAR(gsn_aabb_share_above(1.0, slope), 0.75, 1e-15);
            }
        }
    }
}

TEST(a_flat_function_is_above_or_not)
{
    const double flat[3] = { 0.0, 0.0, 0.0 };

    CHECK_NEAR(gsn_aabb_share_above(1e-300, flat), 1.0, 0.0);
    CHECK_NEAR(gsn_aabb_share_above(0.0, flat), 0.0, 0.0);
    CHECK_NEAR(gsn_aabb_share_above(-1.0, flat), 0.0, 0.0);
}

TEST(above_and_below_make_one_and_slopes_of_any_size_do)
{
    uint64_t seed = 2;

    for (int i = 0; i < 2000; i++) {
        double slope[3], minus[3], scaled[3];
        const double scale = pow(10.0, 300.0 * draw(&seed) - 150.0);
        double value = 0.0, share;

        for (int a = 0; a < 3; a++) {
            slope[a] = pow(10.0, -12.0 * draw(&seed));
            minus[a] = -slope[a];
            scaled[a] = scale * slope[a];
            value += slope[a] * (2.0 * draw(&seed) - 1.0);
        }
        share = gsn_aabb_share_above(value, slope);
        CHECK_NEAR(share + gsn_aabb_share_above(-value, minus), 1.0, 1e-14);
        CHECK_NEAR(gsn_aabb_share_above(scale * value, scaled), share, 1e-13);
    }
}

TEST(a_tetrahedron_is_the_sum_of_its_parts_in_boxes)
{
    uint64_t seed = 3;

    for (int i = 0; i < 300; i++) {
        double corner[4][3], sum = 0.0, whole = 0.0;
        const struct gsn_aabb all = { { 0.0, 0.0, 0.0 }, { 2.0, 2.0, 2.0 } };

        for (int k = 0; k < 12; k++)
            corner[k / 3][k % 3] = 4.0 * draw(&seed) - 2.0;
        for (int k = 0; k < 64; k++) {
            const struct gsn_aabb part = { { k % 4 - 1.5, k / 4 % 4 - 1.5, k / 16 - 1.5 },
                                           { 0.5, 0.5, 0.5 } };

            sum += gsn_aabb_tet_volume(&part, (const double(*)[3])corner);
        }
        whole = gsn_aabb_tet_volume(&all, (const double(*)[3])corner);
        CHECK(whole > 0.0);
        CHECK_NEAR(sum, whole, 1e-13);
    }
}

TEST(a_corner_of_the_cube_cut_by_a_tetrahedron_has_the_known_volume)
{
    const double corner[4][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };
    const struct gsn_aabb quarter = { { 0.25, 0.25, 0.25 }, { 0.25, 0.25, 0.25 } };
    const struct gsn_aabb within = { { 0.1, 0.1, 0.1 }, { 0.05, 0.05, 0.05 } };
    const struct gsn_aabb away = { { 0.9, 0.9, 0.9 }, { 0.2, 0.2, 0.2 } };

    /* The unit corner is 1/6; three corners of 1/48 lie beyond one half. */
    CHECK_NEAR(gsn_aabb_tet_volume(&quarter, corner), 1.0 / 6.0 - 3.0 / 48.0, 1e-16);
    CHECK_NEAR(gsn_aabb_tet_volume(&within, corner), 0.001, 1e-17);
    CHECK_NEAR(gsn_aabb_tet_volume(&away, corner), 0.0, 0.0);
}

TEST(a_triangle_meets_a_box_when_a_point_of_it_is_inside)
{
    const struct gsn_aabb box = { { 1.0, 2.0, 3.0 }, { 0.5, 0.4, 0.3 } };
    uint64_t seed = 4;
    int met = 0, apart = 0;

    for (int i = 0; i < 3000; i++) {
        double corner[3][3];
        int inside = 0;

        for (int k = 0; k < 3; k++) {
            for (int a = 0; a < 3; a++)
                corner[k][a] = box.centre[a] + 3.0 * (draw(&seed) - 0.5);
        }
        for (int k = 0; k < 400; k++) {
            const double s = sqrt(draw(&seed)), t = draw(&seed);
            int in = 1;

            for (int a = 0; a < 3; a++) {
                const double at =
                    (1.0 - s) * corner[0][a] + s * (1.0 - t) * corner[1][a] + s * t * corner[2][a];

                in &= fabs(at - box.centre[a]) < box.half[a];
            }
            inside |= in;
        }
        /* Sampling may miss a glancing touch, never invent one. */
        if (inside)
            CHECK(gsn_aabb_meets_triangle(&box, (const double(*)[3])corner));
        met += inside;
        apart += !gsn_aabb_meets_triangle(&box, (const double(*)[3])corner);
    }
    CHECK(met > 300 && apart > 300);
    /* Glancing touches are few: nearly all others are seen to be apart. */
    CHECK(met + apart > 2900);
}
