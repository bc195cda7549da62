/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose/pose.h"

#include "tests/check.h"
#include "tests/register/mounted.h"

static const struct mounted_world EVEN = { .marks = mounted_marks, .angle = M_PI, .burn_um = 6 };

/* A slope less what a shift and a twist common to all three axes can explain: least squares of the
 * six coordinates on (1, 0), (0, 1) and the turn about the centroid. */
static void less_common(struct gsn_point slope[GSN_FIDUCIALS])
{
    const struct gsn_point c = { -1850.0 / 3, -400 };
    struct gsn_point mean = { 0, 0 };
    double turn = 0, square = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        mean.x += slope[i].x / 3;
        mean.y += slope[i].y / 3;
    }
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const double x = mounted_marks[i].x - c.x, y = mounted_marks[i].y - c.y;

        turn += x * slope[i].y - y * slope[i].x;
        square += x * x + y * y;
    }
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const double x = mounted_marks[i].x - c.x, y = mounted_marks[i].y - c.y;

        slope[i].x -= mean.x - turn / square * y;
        slope[i].y -= mean.y + turn / square * x;
    }
}

/* Case 24: 30 mrad of 24 um are 0.72 um per section. */
TEST(axes_that_are_not_parallel_are_found_and_followed)
{
    struct draw_chance chance = { 11 };
    struct mounted_world world = EVEN;
    struct mounted_stack s = mounted_new(125);
    struct gsn_point truth[GSN_FIDUCIALS] = { { 0.5, 0 }, { -0.72, 0.2 }, { 0.1, -0.6 } };
    size_t gross = 0;
    double squares = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++)
        world.slope[i] = truth[i];
    mounted_draw(&s, &world, &chance);
    mounted_solve(&s, &mounted_declared);
    less_common(truth);
    CHECK(s.summary.axes.slanted && !s.summary.axes.bent);
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        print_message("  axis %d: %.3f %.3f um per section, truth %.3f %.3f, sd %.3f\n", i + 1,
                      s.summary.axes.slope[i].x, s.summary.axes.slope[i].y, truth[i].x, truth[i].y,
                      s.summary.axes.slope_sd);
        CHECK_NEAR(s.summary.axes.slope[i].x, truth[i].x, 5 * s.summary.axes.slope_sd);
        CHECK_NEAR(s.summary.axes.slope[i].y, truth[i].y, 5 * s.summary.axes.slope_sd);
    }
    CHECK(s.summary.axes.slope_sd < 0.02);
    for (size_t i = 0; i < s.count; i++) {
        gross += s.pose[i].gross != 0;
        squares += s.pose[i].rms_um * s.pose[i].rms_um / 125;
    }
    /* FRE = FLE / sqrt 2, as if the axes were parallel. */
    CHECK_NEAR(sqrt(squares), 6, 0.1 * 6);
    CHECK_NEAR(s.summary.fle_um, 6 * sqrt(2), 0.1 * 6 * sqrt(2));
    CHECK(gross <= 1);
    mounted_done(&s);
}

/* Case 24, what cannot be seen: a tilt of the whole laser, or a turn of the stage while it burns.
 */
TEST(a_slope_that_all_axes_share_is_not_seen)
{
    struct draw_chance chance = { 2 };
    struct mounted_world world = EVEN;
    struct mounted_stack s = mounted_new(60);

    for (int i = 0; i < GSN_FIDUCIALS; i++)
        world.slope[i] = (struct gsn_point){ 2 - 2e-4 * (mounted_marks[i].y + 400),
                                             -3 + 2e-4 * (mounted_marks[i].x + 1850.0 / 3) };
    mounted_draw(&s, &world, &chance);
    mounted_solve(&s, &mounted_declared);
    CHECK(!s.summary.axes.slanted && !s.summary.axes.bent);
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        CHECK_NEAR(hypot(s.summary.axes.slope[i].x, s.summary.axes.slope[i].y), 0,
                   6 * s.summary.axes.slope_sd);
    mounted_done(&s);
}

TEST(parallel_axes_are_hardly_ever_called_slanted)
{
    struct draw_chance chance = { 3 };
    struct mounted_stack s = mounted_new(40);
    const size_t trials = mounted_trials(400);
    size_t slanted = 0, bent = 0;

    for (size_t i = 0; i < trials; i++) {
        mounted_draw(&s, &EVEN, &chance);
        mounted_solve(&s, &mounted_declared);
        slanted += s.summary.axes.slanted != 0;
        bent += s.summary.axes.bent != 0;
    }
    print_message("  of %zu stacks %zu are called slanted, %zu bent\n", trials, slanted, bent);
    CHECK((double)slanted <= 0.002 * (double)trials + 3);
    CHECK((double)bent <= 0.002 * (double)trials + 3);
    mounted_done(&s);
}

/* A bend in the marks that all three axes do not share: drawn as a shape that grows as z^2. */
TEST(a_bend_is_told_from_a_slope)
{
    struct draw_chance chance = { 4 };
    struct mounted_stack s = mounted_new(101);

    mounted_draw(&s, &EVEN, &chance);
    for (size_t i = 0; i < s.count; i++) {
        const double t = ((double)i - 50) / 50;
        struct mounted *m = &s.mounting[i];
        const struct gsn_point at = mounted_px(m, mounted_marks[0]);
        const struct gsn_point to = mounted_px(
            m, (struct gsn_point){ mounted_marks[0].x + 40 * t * t, mounted_marks[0].y });

        s.input[i].marks[0].px.x += to.x - at.x;
        s.input[i].marks[0].px.y += to.y - at.y;
    }
    mounted_solve(&s, &mounted_declared);
    print_message("  bend of axis 1: %.1f um, sd %.1f\n", s.summary.axes.bend[0].x,
                  s.summary.axes.bend_sd);
    CHECK(s.summary.axes.bent);
    CHECK(hypot(s.summary.axes.bend[0].x, s.summary.axes.bend[0].y) > 10);
    mounted_done(&s);
}
