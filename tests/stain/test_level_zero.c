/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/level_zero.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <math.h>
#include <string.h>

enum { PANELS = 10, DRAWS = 400 };

static const double APART = 0.06;

/* A vector turns by a normal angle to any side; what it turns towards red is all that counts. */
static double turned(struct dice *dice)
{
    return APART * M_SQRT2 * dice_normal(dice) * cos(2 * M_PI * dice_even(dice));
}

static double normal(struct dice *dice)
{
    return APART * dice_normal(dice);
}

/* Mean squares of what density 0 is off by, of what the panels' mean is, and how often the error
 * holds it at 95 %. */
struct score {
    double here, mean;
    size_t held;
};

static struct score score_of(double (*draw)(struct dice *dice))
{
    struct dice dice = { 20261124 };
    struct score score = { 0 };

    for (int i = 0; i < DRAWS; i++) {
        double zero[PANELS], mean = 0;
        struct gsn_level_zero found;

        for (int p = 0; p < PANELS; p++) {
            zero[p] = draw(&dice);
            mean += zero[p] / PANELS;
        }
        found = gsn_level_zero_of(zero, PANELS);
        score.here += found.at * found.at / DRAWS;
        score.mean += mean * mean / DRAWS;
        score.held += fabs(found.at) <= 1.96 * found.error;
    }
    return score;
}

TEST(panels_that_agree_put_density_0_where_they_do)
{
    const double zero[] = { 0.031, 0.031, 0.031, 0.031 };
    const struct gsn_level_zero found = gsn_level_zero_of(zero, 4);

    CHECK_NEAR(found.at, 0.031, 1e-9);
    CHECK(found.error > 0 && found.error < 0.01);
    CHECK(found.panels == 4);
}

TEST(two_panels_leave_density_0_in_their_middle_and_open)
{
    const double zero[] = { 0.05, -0.03 };
    const struct gsn_level_zero found = gsn_level_zero_of(zero, 2);

    CHECK_NEAR(found.at, 0.01, 1e-9);
    CHECK(found.error > 0.04);
}

TEST(one_bath_far_off_hardly_moves_density_0)
{
    const double zero[PANELS] = { 0.004, -0.003, 0.2, 0.001, -0.004, 0.002, 0.003, -0.002, 0, 0 };
    const struct gsn_level_zero found = gsn_level_zero_of(zero, PANELS);

    CHECK_NEAR(found.at, 0, 0.002); /* their mean is 0.02 */
    CHECK(found.error < 0.004);
}

TEST(a_shift_of_all_panels_is_one_of_density_0_and_their_order_is_nothing)
{
    const double zero[] = { 0.01, 0.12, -0.02, 0.03, 0 }, back[] = { 0, 0.03, -0.02, 0.12, 0.01 };
    const struct gsn_level_zero found = gsn_level_zero_of(zero, 5);
    const struct gsn_level_zero other = gsn_level_zero_of(back, 5);
    double moved[5];

    for (int p = 0; p < 5; p++)
        moved[p] = zero[p] + 0.4;
    CHECK_NEAR(gsn_level_zero_of(moved, 5).at, found.at + 0.4, 1e-12);
    CHECK_NEAR(gsn_level_zero_of(moved, 5).error, found.error, 1e-12);
    CHECK_NEAR(other.at, found.at, 1e-12);
    CHECK_NEAR(other.error, found.error, 1e-12);
}

TEST(vectors_that_turn_to_any_side_leave_it_better_known_than_the_mean_and_as_said)
{
    const struct score score = score_of(turned);

    CHECK(sqrt(score.here) < 0.93 * sqrt(score.mean));
    CHECK(score.held >= DRAWS * 92 / 100 && score.held <= DRAWS * 98 / 100);
}

/* There the mean is the best that can be had. */
TEST(baths_that_scatter_normally_cost_little)
{
    const struct score score = score_of(normal);

    CHECK(sqrt(score.here) < 1.08 * sqrt(score.mean));
    CHECK(score.held >= DRAWS * 92 / 100 && score.held <= DRAWS * 98 / 100);
}

TEST(fewer_than_two_panels_tell_nothing)
{
    const double zero = 0.07;

    for (size_t panels = 0; panels < 2; panels++) {
        const struct gsn_level_zero found = gsn_level_zero_of(&zero, panels);

        CHECK_NEAR(found.at, 0, 0);
        CHECK_NEAR(found.error, 0, 0);
    }
}
