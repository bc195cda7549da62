/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose/tre.h"

#include "tests/check.h"
#include "tests/register/mounted.h"

#include <string.h>

static const struct gsn_point TARGET = { 411, 646 };

/* Errors against their predicted covariance, over many stacks. */
struct score {
    size_t stacks, sections, covered;
    double squares, predicted;
    double first, last; /* squares of the first and the last section */
};

static size_t within(const struct gsn_pose_error *error, struct gsn_point e, struct gsn_point at)
{
    const struct gsn_ellipse ellipse = gsn_pose_ellipse_at(error, at, 0, 0.95);
    const double along = e.x * cos(ellipse.angle) + e.y * sin(ellipse.angle);
    const double across = e.y * cos(ellipse.angle) - e.x * sin(ellipse.angle);

    return pow(along / ellipse.major, 2) + pow(across / ellipse.minor, 2) <= 1;
}

static struct score simulate(const struct mounted_world *world, size_t sections, size_t trials,
                             struct gsn_point target, uint64_t seed, int two_marks_only)
{
    struct draw_chance chance = { seed };
    struct mounted_stack s = mounted_new(sections);
    const struct gsn_pose_options options = { world->marks, &target, 1, 0 };
    struct score score = { 0 };

    while (score.sections < trials && score.stacks++ < trials) {
        mounted_draw(&s, world, &chance);
        mounted_solve(&s, &options);
        for (size_t i = 0; i < sections; i++) {
            const struct gsn_point e = mounted_error(&s, i, target);
            const double square = e.x * e.x + e.y * e.y;

            /* One in a thousand is refused by design, whatever its error. */
            if (s.pose[i].gross || (two_marks_only && s.pose[i].state != GSN_POSE_TWO_MARKS))
                continue;
            score.sections++;
            score.squares += square;
            score.predicted += s.pose[i].tre_um * s.pose[i].tre_um;
            score.covered += within(&s.pose[i].error, e, target);
            score.first += i == 0 ? square : 0;
            score.last += i == sections - 1 ? square : 0;
        }
    }
    mounted_done(&s);
    return score;
}

static void check_calibrated(const char *what, const struct score *s)
{
    const double cover = (double)s->covered / (double)s->sections;

    print_message(
        "  %s: %zu sections, rms %.2f um, predicted %.2f um, 95 %% ellipse holds %.2f %%\n", what,
        s->sections, sqrt(s->squares / (double)s->sections),
        sqrt(s->predicted / (double)s->sections), 100 * cover);
    CHECK(cover >= 0.93 && cover <= 0.97);
}

static const struct mounted_world EVEN = { .marks = mounted_marks, .angle = M_PI, .burn_um = 9 };

TEST(the_field_of_three_equal_marks_is_the_formula)
{
    const double fle = 9 * sqrt(2), rho = sqrt(4220833.3333333);
    const struct gsn_point c = { -1850.0 / 3, -400 };
    const size_t trials = mounted_trials(6000);

    for (int k = 0; k < 3; k++) {
        const struct gsn_point at = { c.x + 0.6 * k * rho, c.y - 0.8 * k * rho };
        const struct score s = simulate(&EVEN, 125, trials, at, 10 + (uint64_t)k, 0);
        const double rms = sqrt(s.squares / (double)s.sections);

        print_message("  TRE at %d rho: %.4f of the formula, predicted %.4f\n", k,
                      rms / mounted_tre(fle, rho, k * rho),
                      sqrt(s.predicted / (double)s.sections) / mounted_tre(fle, rho, k * rho));
        CHECK(rms <= 1.05 * mounted_tre(fle, rho, k * rho));
        CHECK_NEAR(sqrt(s.predicted / (double)s.sections), mounted_tre(fle, rho, k * rho),
                   0.02 * fle);
        check_calibrated("three marks", &s);
    }
}

/* Twice Fisher's F with 2 and 10 degrees of freedom: 2 * 4.102821. */
/* Half axes a and b in directions v and w: the covariance is (a^2 v v' + b^2 w w') / k^2. */
TEST(the_ellipse_has_the_covariances_own_axes)
{
    struct gsn_pose_error error = { .pose = { { 9, 2, 0.1 }, { 2, 4, 0.2 }, { 0.1, 0.2, 0.05 } },
                                    .strain = { { 0.01, 0, 0 }, { 0, 0.02, 0 }, { 0, 0, 0.01 } },
                                    .freedom = INFINITY };
    const struct gsn_point at[] = { { 0, 0 }, { 7, -3 }, { -11, 20 } };

    for (size_t i = 0; i < sizeof at / sizeof *at; i++) {
        const struct gsn_cov2 c = gsn_pose_tre_at(&error, at[i], 0);
        const struct gsn_ellipse e = gsn_pose_ellipse_at(&error, at[i], 0, 0.95);
        const double a = e.major * e.major / 5.991465, b = e.minor * e.minor / 5.991465;
        const double x = cos(e.angle), y = sin(e.angle);

        CHECK(e.major >= e.minor && fabs(e.angle) <= M_PI / 2);
        CHECK_NEAR(a * x * x + b * y * y, c.xx, 1e-6 * c.xx);
        CHECK_NEAR((a - b) * x * y, c.xy, 1e-6 * c.xx);
        CHECK_NEAR(a * y * y + b * x * x, c.yy, 1e-6 * c.yy);
    }
}

TEST(the_ellipse_is_wider_when_few_sections_tell_the_noise)
{
    CHECK_NEAR(gsn_pose_ellipse(INFINITY, 0.95), sqrt(5.991465), 1e-6);
    CHECK_NEAR(pow(gsn_pose_ellipse(10, 0.95), 2), 2 * 4.102821, 1e-5);
}

TEST(few_sections_are_calibrated_too)
{
    for (size_t sections = 4; sections <= 24; sections *= 2) {
        const struct score s = simulate(&EVEN, sections, mounted_trials(8000), TARGET, 20, 0);

        print_message("  %zu sections to a stack\n", sections);
        check_calibrated("few", &s);
    }
}

TEST(marks_fitted_unequally_are_calibrated)
{
    struct mounted_world world = EVEN;
    struct score s;

    world.burn_um = 4;
    world.fit_um = 6;
    world.unequal = 0.3;
    s = simulate(&world, 60, mounted_trials(8000), TARGET, 30, 0);
    check_calibrated("unequal marks", &s);
    world.burn_um = 0;
    s = simulate(&world, 60, mounted_trials(8000), TARGET, 31, 0);
    check_calibrated("unequal marks, exact covariances", &s);
}

/* Fits that take texture for noise say too little, the poor ones by as much as the good ones: the
 * poses are as exact as if they had said what is so. */
TEST(fits_that_all_say_too_little_are_found_out_by_the_stack)
{
    struct mounted_world world = EVEN;
    struct score right, modest;

    world.burn_um = 0;
    world.fit_um = 6;
    world.unequal = 0.3;
    right = simulate(&world, 60, mounted_trials(8000), TARGET, 32, 0);
    world.modest = 2;
    modest = simulate(&world, 60, mounted_trials(8000), TARGET, 32, 0);
    check_calibrated("fits that say half", &modest);
    CHECK(modest.squares / (double)modest.sections <
          pow(1.03, 2) * right.squares / (double)right.sections);
}

/* What fits of marks of three pixels say differs by more than the marks do. */
TEST(fits_whose_word_is_chance_are_found_out_by_the_stack)
{
    struct mounted_world world = EVEN;
    struct score s;

    world.burn_um = 0;
    world.fit_um = 6;
    world.erratic = 0.4;
    s = simulate(&world, 60, mounted_trials(8000), TARGET, 33, 0);
    check_calibrated("fits whose word is chance", &s);
}

/* Case 20. */
TEST(two_marks_are_calibrated_with_a_larger_error)
{
    struct mounted_world world = EVEN;
    struct score two, all;

    world.missing = 0.3;
    two = simulate(&world, 60, mounted_trials(6000), TARGET, 40, 1);
    all = simulate(&EVEN, 60, mounted_trials(6000), TARGET, 41, 0);
    check_calibrated("two marks", &two);
    CHECK(two.predicted / (double)two.sections > 1.3 * all.predicted / (double)all.sections);
}

TEST(sections_that_stretch_are_calibrated)
{
    struct mounted_world world = EVEN;
    struct score s;

    world.burn_um = 5;
    world.strain_sd[0] = 0.008;
    world.strain_sd[1] = 0.003;
    s = simulate(&world, 60, mounted_trials(8000), TARGET, 50, 0);
    check_calibrated("stretching", &s);
    s = simulate(&world, 24, mounted_trials(8000), TARGET, 51, 0);
    check_calibrated("stretching, 24 sections", &s);
    world.missing = 0.2;
    s = simulate(&world, 60, mounted_trials(6000), TARGET, 52, 1);
    check_calibrated("stretching, two marks", &s);
}

TEST(the_hundredth_section_is_as_exact_as_the_first)
{
    const struct score s = simulate(&EVEN, 101, 101 * mounted_trials(1500), TARGET, 60, 0);

    print_message("  section 101 / section 1: %.4f\n", sqrt(s.last / s.first));
    /* 1500 squares of two degrees of freedom each have a ratio within 0.05 with 95 %: the 0.10 is
     * for chance, full length shows less. */
    CHECK_NEAR(sqrt(s.last / s.first), 1, 0.10);
}

/* The mean over a disc of radius R about the centroid: r^2 = R^2 / 2. */
TEST(the_mean_over_a_disc_is_the_formulas_integral)
{
    enum { SIDE = 60 };
    static struct gsn_point disc[SIDE * SIDE];
    struct draw_chance chance = { 70 };
    struct mounted_stack s = mounted_new(40);
    struct gsn_pose_options options = { mounted_marks, disc, 0, 0 };
    const double rho = sqrt(4220833.3333333), radius = 2000;

    for (int i = 0; i < SIDE * SIDE; i++) {
        const double x = (i % SIDE + 0.5) / SIDE * 2 - 1, y = (i / SIDE + 0.5) / SIDE * 2 - 1;

        if (x * x + y * y <= 1)
            disc[options.target_count++] =
                (struct gsn_point){ -1850.0 / 3 + radius * x, -400 + radius * y };
    }
    mounted_draw(&s, &EVEN, &chance);
    mounted_solve(&s, &options);
    CHECK_NEAR(s.pose[3].tre_um, mounted_tre(s.summary.fle_um, rho, radius / sqrt(2)),
               0.002 * s.pose[3].tre_um);
    mounted_done(&s);
}

/* Any quadratic has the same mean over the four points as over the targets. */
TEST(four_points_stand_for_all_targets)
{
    struct draw_chance chance = { 80 };
    struct gsn_point targets[50];
    struct gsn_pose_targets four;
    double all = 0, few = 0;

    for (int i = 0; i < 50; i++)
        targets[i] =
            (struct gsn_point){ draw_uniform(&chance, -900, 300), draw_uniform(&chance, 100, 200) };
    four = gsn_pose_targets_of(targets, 50);
    for (int i = 0; i < 50; i++)
        all += (3 + targets[i].x * (2 + targets[i].y) - pow(targets[i].y, 2)) / 50;
    for (int i = 0; i < 4; i++)
        few += (3 + four.at[i].x * (2 + four.at[i].y) - pow(four.at[i].y, 2)) / 4;
    CHECK_NEAR(few, all, 1e-9 * fabs(all));
    CHECK(gsn_pose_targets_of(NULL, 0).count == 0);
}
