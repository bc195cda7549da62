/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose/rigid.h"

#include "tests/check.h"
#include "tests/register/draw.h"

#include <string.h>

static const struct gsn_point TRIANGLE[3] = { { -2050, -1000 }, { 1700, -1500 }, { -1500, 1300 } };

TEST(recovers_every_mounting_angle)
{
    for (int degrees = -180; degrees < 180; degrees++) {
        const double angle = degrees * M_PI / 180;
        const struct gsn_rigid truth = { cos(angle), sin(angle), 8200.5, -431.25 };
        struct gsn_point onto[3];
        struct gsn_rigid motion;
        struct gsn_error err = { 0 };
        double rms;

        for (int i = 0; i < 3; i++)
            onto[i] = gsn_rigid_apply(&truth, TRIANGLE[i]);
        CHECK_OK(gsn_rigid_fit(TRIANGLE, onto, NULL, 3, &motion, &rms, &err), err);
        CHECK_NEAR(motion.cos, truth.cos, 1e-14);
        CHECK_NEAR(motion.sin, truth.sin, 1e-14);
        CHECK_NEAR(motion.dx, truth.dx, 1e-9);
        CHECK_NEAR(motion.dy, truth.dy, 1e-9);
        CHECK_NEAR(rms, 0, 1e-9);
        CHECK_NEAR(cos(atan2(motion.sin, motion.cos) - angle), 1, 1e-14);
    }
}

TEST(the_determinant_is_one_whatever_the_marks_say)
{
    struct draw_chance chance = { 7 };

    for (int n = 0; n < 2000; n++) {
        struct gsn_point from[3], onto[3];
        struct gsn_rigid motion;
        struct gsn_error err = { 0 };

        for (int i = 0; i < 3; i++) {
            from[i].x = draw_uniform(&chance, -1e4, 1e4);
            from[i].y = draw_uniform(&chance, -1e4, 1e4);
            onto[i].x = draw_uniform(&chance, -1e4, 1e4);
            onto[i].y = draw_uniform(&chance, -1e4, 1e4);
        }
        CHECK_OK(gsn_rigid_fit(from, onto, NULL, 3, &motion, NULL, &err), err);
        CHECK_NEAR(motion.cos * motion.cos + motion.sin * motion.sin, 1, 1e-15);
    }
}

/* Independent of the closed form: no neighbouring motion leaves less. */
TEST(no_motion_nearby_leaves_less)
{
    const struct gsn_point onto[3] = { { 90, -40 }, { 3800, -420 }, { 520, 2380 } };
    const double weight[3] = { 1, 0.3, 2 };
    struct gsn_rigid motion;
    struct gsn_error err = { 0 };
    double rms;

    CHECK_OK(gsn_rigid_fit(TRIANGLE, onto, weight, 3, &motion, &rms, &err), err);
    for (int k = 0; k < 6; k++) {
        const double turn = atan2(motion.sin, motion.cos) + (k == 0 ? 1e-4 : k == 1 ? -1e-4 : 0);
        const struct gsn_rigid other = { cos(turn), sin(turn),
                                         motion.dx + (k == 2   ? 0.1
                                                      : k == 3 ? -0.1
                                                               : 0),
                                         motion.dy + (k == 4   ? 0.1
                                                      : k == 5 ? -0.1
                                                               : 0) };
        double squares = 0;

        for (int i = 0; i < 3; i++) {
            const struct gsn_point p = gsn_rigid_apply(&other, TRIANGLE[i]);

            squares += weight[i] * (pow(p.x - onto[i].x, 2) + pow(p.y - onto[i].y, 2));
        }
        CHECK(sqrt(squares / 3.3) > rms);
    }
}

TEST(a_larger_triangle_is_not_shrunk)
{
    struct gsn_point larger[3];
    struct gsn_rigid motion;
    struct gsn_error err = { 0 };
    double rms;

    for (int i = 0; i < 3; i++)
        larger[i] = (struct gsn_point){ 1.1 * TRIANGLE[i].x, 1.1 * TRIANGLE[i].y };
    CHECK_OK(gsn_rigid_fit(TRIANGLE, larger, NULL, 3, &motion, &rms, &err), err);
    CHECK_NEAR(motion.cos, 1, 1e-15);
    /* What is left is 0.1 of the distances from the centroid, whose mean square is the sum of the
     * squared sides over 9. */
    CHECK_NEAR(rms,
               0.1 * sqrt((3750.0 * 3750 + 500.0 * 500 + 3200.0 * 3200 + 2800.0 * 2800 +
                           550.0 * 550 + 2300.0 * 2300) /
                          9),
               1e-9);
}

TEST(a_mirrored_triangle_is_left_mirrored)
{
    struct gsn_point mirrored[3];
    struct gsn_rigid motion;
    struct gsn_error err = { 0 };
    double rms;

    for (int i = 0; i < 3; i++)
        mirrored[i] = (struct gsn_point){ -TRIANGLE[i].x, TRIANGLE[i].y };
    CHECK_OK(gsn_rigid_fit(mirrored, TRIANGLE, NULL, 3, &motion, &rms, &err), err);
    CHECK_NEAR(motion.cos * motion.cos + motion.sin * motion.sin, 1, 1e-15);
    CHECK(rms > 500);
}

TEST(two_marks_share_their_misfit_by_weight)
{
    const struct gsn_point from[2] = { { 0, 0 }, { 100, 0 } }, onto[2] = { { 0, 0 }, { 0, 104 } };
    const double weight[2] = { 3, 1 };
    struct gsn_rigid motion;
    struct gsn_error err = { 0 };
    double rms;

    CHECK_OK(gsn_rigid_fit(from, onto, weight, 2, &motion, &rms, &err), err);
    CHECK_NEAR(motion.sin, 1, 1e-15);
    /* 4 um too long: a quarter of it at the heavy mark, three quarters at the light one. */
    CHECK_NEAR(gsn_rigid_apply(&motion, from[0]).y, 1, 1e-12);
    CHECK_NEAR(gsn_rigid_apply(&motion, from[1]).y, 101, 1e-12);
    CHECK_NEAR(rms, sqrt((3 * 1.0 + 9.0) / 4), 1e-12);
}

TEST(marks_that_coincide_are_refused_and_nothing_is_touched)
{
    const struct gsn_point one[3] = { { 5e6, 7e6 }, { 5e6, 7e6 }, { 5e6, 7e6 } };
    const struct gsn_point lost[3] = { { 0, 0 }, { NAN, 0 }, { 0, 1 } };
    struct gsn_rigid motion = { 9, 9, 9, 9 };
    struct gsn_error err = { 0 };
    double rms = 9;

    CHECK(gsn_rigid_fit(one, TRIANGLE, NULL, 3, &motion, &rms, &err) == GSN_E_MARKERS);
    CHECK(strstr(err.text, "coincide"));
    CHECK(gsn_rigid_fit(TRIANGLE, one, NULL, 3, &motion, &rms, &err) == GSN_E_MARKERS);
    CHECK(gsn_rigid_fit(lost, TRIANGLE, NULL, 3, &motion, &rms, &err) == GSN_E_MARKERS);
    CHECK(strstr(err.text, "finite"));
    CHECK(motion.cos == 9 && motion.sin == 9 && motion.dx == 9 && motion.dy == 9 && rms == 9);
}

TEST(a_mirrored_equilateral_triangle_has_no_best_rotation)
{
    const double h = sqrt(0.75);
    const struct gsn_point up[3] = { { -0.5, 0 }, { 0.5, 0 }, { 0, h } };
    const struct gsn_point down[3] = { { 0.5, 0 }, { -0.5, 0 }, { 0, h } };
    struct gsn_rigid motion;
    struct gsn_error err = { 0 };

    CHECK(gsn_rigid_fit(down, up, NULL, 3, &motion, NULL, &err) == GSN_E_MARKERS);
    CHECK(strstr(err.text, "every rotation"));
}

TEST(the_affine_map_scales_mirrors_and_moves)
{
    const struct gsn_rigid motion = { 0.6, 0.8, 100, -50 };
    const struct gsn_point px = { 10, 20 };
    const struct gsn_affine up = gsn_rigid_to_affine(&motion, 16, 0);
    const struct gsn_affine down = gsn_rigid_to_affine(&motion, 16, 1);
    const struct gsn_point a = gsn_affine_apply(&up, px), b = gsn_affine_apply(&down, px);

    CHECK_NEAR(gsn_affine_det(&up), 256, 1e-12);
    CHECK_NEAR(gsn_affine_det(&down), -256, 1e-12);
    CHECK_NEAR(a.x, 0.6 * 160 - 0.8 * 320 + 100, 1e-12);
    CHECK_NEAR(a.y, 0.8 * 160 + 0.6 * 320 - 50, 1e-12);
    CHECK_NEAR(b.x, -0.6 * 160 - 0.8 * 320 + 100, 1e-12);
    CHECK_NEAR(b.y, -0.8 * 160 + 0.6 * 320 - 50, 1e-12);
}
