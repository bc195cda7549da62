/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/appearance.h"

#include "tests/check.h"

static const double PX = 16;
static const struct gsn_displacement MOVES = { 30, 40, 240, 0.9, 0.07, 0.03 };

/* One spot that is no mark per mm^2, and hardly any that look like one; marks that look as burns
 * may. */
static struct gsn_triangle_prior taught(void)
{
    struct gsn_triangle_prior prior = { .learnt = 1, .contrast = 0.4, .radius_um = 75 };

    for (int k = 0; k < GSN_APPEARANCE_CLASSES; k++) {
        prior.alike[k] = k > 0 ? exp(-0.5 * ldexp(1, k - 1)) : 1;
        prior.chance[k] = 1e-6 * ldexp(1, k - GSN_APPEARANCE_CLASSES + 1);
    }
    return prior;
}

static struct gsn_fiducial spot(double contrast, double radius_um)
{
    return (struct gsn_fiducial){
        .contrast = contrast, .radius_px = radius_um / PX, .score = 0.95, .found = 1
    };
}

static double odds(double contrast, double away_um)
{
    const struct gsn_triangle_prior prior = taught();
    const struct gsn_fiducial mark = spot(contrast, 75);

    return gsn_third_mark_ratio(&mark, PX, &prior, &MOVES, away_um, 3000, 2000);
}

/* Of the density alone: what is seen in its place, and looks like a mark, is one. */
TEST(in_its_place_the_odds_are_those_of_the_three_spreads)
{
    const double carried = 0.5 + 4.0 / 9;
    const double here = 0.9 / (2 * M_PI * 900 * (1 + carried)) +
                        0.07 / (2 * M_PI * 1600 * (1 + carried)) +
                        0.03 / (2 * M_PI * (57600 + 1600 * carried));

    CHECK_NEAR(odds(0.4, 0) / (19 * here / 1e-6 * 128), 1, 1e-12);
}

/* Nothing is carried over from other marks: the error is that of the place alone. */
TEST(beside_a_place_of_its_own_error_the_odds_are_those_of_the_three_spreads)
{
    const struct gsn_triangle_prior prior = taught();
    const struct gsn_fiducial mark = spot(0.4, 75);
    const double variance[3] = { 900 + 2500, 1600 + 2500, 57600 + 2500 };
    const double share[3] = { 0.9, 0.07, 0.03 };

    for (double away = 0; away < 500; away += 50) {
        double here = 0;

        for (int k = 0; k < 3; k++)
            here += share[k] * exp(-0.5 * away * away / variance[k]) / (2 * M_PI * variance[k]);
        CHECK_NEAR(gsn_placed_mark_ratio(&mark, PX, &prior, &MOVES, away, 50) /
                       (19 * here / 1e-6 * 128),
                   1, 1e-12);
    }
}

TEST(the_odds_fall_with_the_distance_and_with_the_looks)
{
    for (double away = 0; away < 1000; away += 10)
        CHECK(odds(0.4, away + 10) < odds(0.4, away));
    CHECK(odds(0.3, 50) < odds(0.4, 50));
    CHECK(odds(0.2, 50) < odds(0.3, 50));
    CHECK_NEAR(odds(0.3, 50), odds(0.4 * 0.4 / 0.3, 50), 1e-6 * odds(0.3, 50));
    /* Half burnt in: a mark where it must be, chance beside it. */
    CHECK(odds(0.12, 0) > 20);
    CHECK(odds(0.12, 120) < 20);
    CHECK(odds(0.4, 400) > 20);
    CHECK(odds(0.4, 1e5) == 0);
}

TEST(looks_of_the_typical_mark_cost_nothing)
{
    const struct gsn_triangle_prior prior = taught();
    struct gsn_fiducial mark = spot(0.4, 75);

    CHECK_NEAR(gsn_appearance_distance(&mark, PX, &prior), 0, 1e-12);
    CHECK(gsn_appearance_residual(&mark) == 0);
    mark.contrast *= exp(0.15);
    CHECK_NEAR(gsn_appearance_distance(&mark, PX, &prior), 0.5, 1e-12);
    mark.score = 0.75;
    CHECK_NEAR(gsn_appearance_residual(&mark), 1, 1e-12);
}

/* A spot that differs from the typical mark by so much in contrast alone. */
static struct gsn_fiducial as_unlike(double unlike)
{
    return spot(0.4 * exp(0.15 * sqrt(2 * unlike)), 75);
}

/* However rare they are among marks, and however often chance makes them. */
TEST(looks_weigh_as_marks_have_them_more_often_than_other_spots)
{
    struct gsn_triangle_prior prior = taught();
    const struct gsn_fiducial plain = as_unlike(0), odd = as_unlike(5);

    prior.alike[3] = 0.005;
    prior.chance[3] = 0.04e-6;
    CHECK_NEAR(gsn_third_mark_ratio(&odd, PX, &prior, &MOVES, 100, 3000, 2000) /
                   gsn_third_mark_ratio(&plain, PX, &prior, &MOVES, 100, 3000, 2000) /
                   (0.005 / 0.04 / 128),
               1, 1e-9);
}

/* Marks themselves and what lies farther out than they do, a neighbour's, are not chance. */
TEST(what_is_seen_beside_the_marks_is_counted_as_far_as_they_reach)
{
    const struct gsn_triangle_prior prior = taught();
    struct gsn_fiducial_candidates section = { .px_um = PX, .tissue_px = { 100, 100 }, .count = 6 };
    struct gsn_appearance_counts counts = { .area_um2 = 5 };
    const struct gsn_point at[6] = { { 200, 100 }, { 40, 100 },  { 100, 150 },
                                     { 120, 120 }, { 100, 180 }, { 100, 201 } };

    for (int i = 0; i < 6; i++) {
        section.mark[i] = i == 2 ? as_unlike(3) : spot(i == 4 ? 0.1 : 0.4, 75);
        section.mark[i].px = at[i];
    }
    gsn_appearance_count(&section, section.mark, &prior, &counts);
    CHECK_NEAR(counts.area_um2, 5 + M_PI * 1600 * 1600, 1e-6);
    CHECK(counts.seen[0] == 1 && counts.seen[GSN_APPEARANCE_CLASSES - 1] == 2);
    for (int k = 1; k < GSN_APPEARANCE_CLASSES; k++)
        CHECK(counts.seen[k] >= counts.seen[k - 1]);
    CHECK(counts.marks == 3 && counts.alike[0] == 3);
    CHECK(counts.alike[1] == 1 && counts.alike[2] == 1 && counts.alike[3] == 0);
}

/* Of the marks that were counted, the one in question may be the only one that looks so. */
TEST(no_mark_vouches_for_itself)
{
    struct gsn_appearance_counts counts = { .marks = 30, .area_um2 = 1e8 };
    struct gsn_triangle_prior none = taught(), one = none, two = none, unknown = none;

    counts.alike[0] = 30;
    gsn_appearance_learn(&counts, &none);
    for (int k = 1; k < 4; k++)
        counts.alike[k] = 1;
    gsn_appearance_learn(&counts, &one);
    counts.alike[1] = 2;
    gsn_appearance_learn(&counts, &two);
    CHECK_NEAR(one.alike[0], 1, 1e-12);
    for (int k = 0; k < GSN_APPEARANCE_CLASSES; k++)
        CHECK(one.alike[k] == none.alike[k]);
    CHECK_NEAR(one.alike[3], exp(-2) / 30, 1e-12);
    CHECK_NEAR(two.alike[1] - one.alike[1], 1.0 / 30, 1e-12);
    counts = (struct gsn_appearance_counts){ .marks = 0 };
    gsn_appearance_learn(&counts, &unknown);
    for (int k = 0; k < GSN_APPEARANCE_CLASSES; k++)
        CHECK(unknown.alike[k] == 0 && unknown.chance[k] == 0);
}
