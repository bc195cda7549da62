/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/phantom/defect.h"

static const struct gsn_phantom_defect TEAR = {
    .kind = GSN_PHANTOM_TEAR, .turn = 0.7, .at = { 300, -200 }, .slope = .12
};
static const struct gsn_phantom_defect FOLD = {
    .kind = GSN_PHANTOM_FOLD, .turn = -2.1, .at = { 500, 0 }, .width = 160
};
static const struct gsn_phantom_defect PIECE = {
    .kind = GSN_PHANTOM_LOST_PIECE,
    .at = { 200, 100 },
    .count = 4,
    .point = { { -300, -300 }, { 300, -300 }, { 300, 300 }, { -300, 300 } },
    .place = { 3200, -3000 },
    .place_turn = M_PI / 2,
};

/* Material that is found somewhere is read there: over the whole section, for every kind. */
static void check_inverse(const struct gsn_phantom_defect *d, double least_found)
{
    int found = 0, all = 0;

    for (double y = -2000; y <= 2000; y += 37)
        for (double x = -2500; x <= 2500; x += 37) {
            const struct gsn_point material = { x, y };
            struct gsn_phantom_reading reading;
            struct gsn_point seen;

            all++;
            if (!gsn_phantom_defect_find(d, material, &seen))
                continue;
            found++;
            reading = gsn_phantom_defect_read(d, seen);
            CHECK(reading.layers >= 1);
            CHECK_NEAR(reading.at[0].x, x, 1e-9);
            CHECK_NEAR(reading.at[0].y, y, 1e-9);
        }
    CHECK(found >= least_found * all && (found < all || !d));
}

TEST(material_is_read_where_it_is_found)
{
    check_inverse(NULL, 1);
    check_inverse(&TEAR, .97);
    check_inverse(&FOLD, .9);
    check_inverse(&PIECE, .95);
}

/* In the frame of the tear the gap is (y - y0) slope to either side, and what lies beyond has moved
 * by nine tenths of it. */
TEST(a_tear_opens_a_wedge_of_glass)
{
    const struct gsn_phantom_defect tear = { .kind = GSN_PHANTOM_TEAR,
                                             .at = { 100, 0 },
                                             .slope = .1 };
    const struct gsn_point in = { 140, 500 }, right = { 200, 500 }, left = { 0, 500 };
    const struct gsn_point above = { 101, -1 };

    CHECK_NEAR(gsn_phantom_tear_gap(&tear, 500), 50, 1e-12);
    CHECK(gsn_phantom_defect_read(&tear, in).layers == 0);
    CHECK_NEAR(gsn_phantom_defect_read(&tear, right).at[0].x, 155, 1e-9);
    CHECK_NEAR(gsn_phantom_defect_read(&tear, left).at[0].x, 45, 1e-9);
    CHECK_NEAR(gsn_phantom_defect_read(&tear, above).at[0].x, 101, 1e-12);
}

TEST(a_fold_lies_double_and_swallows_twice_its_width)
{
    const struct gsn_phantom_defect fold = { .kind = GSN_PHANTOM_FOLD,
                                             .at = { 500, 0 },
                                             .width = 100 };
    const struct gsn_point in = { 530, 7 }, beyond = { 600, 7 }, swallowed = { 750, 7 };
    const struct gsn_phantom_reading reading = gsn_phantom_defect_read(&fold, in);
    struct gsn_point untouched = { 1, 2 };

    CHECK(reading.layers == 2);
    CHECK_NEAR(reading.at[0].x, 530, 0);
    CHECK_NEAR(reading.at[1].x, 470, 1e-9);
    CHECK_NEAR(gsn_phantom_defect_read(&fold, beyond).at[0].x, 800, 1e-9);
    CHECK(!gsn_phantom_defect_find(&fold, swallowed, &untouched));
    CHECK(untouched.x == 1 && untouched.y == 2);
}

TEST(a_lost_piece_leaves_glass_and_lies_elsewhere)
{
    const struct gsn_point hole = { 250, 150 }, place = { 3200, -3000 };
    /* A quarter turn carries what was right of the centre below it. */
    const struct gsn_point below = { 3200, -2900 }, off = { 3200, -2600 };
    struct gsn_phantom_reading reading;

    CHECK(gsn_phantom_defect_read(&PIECE, hole).layers == 0);
    reading = gsn_phantom_defect_read(&PIECE, place);
    CHECK(reading.layers == 2 && reading.moved);
    CHECK_NEAR(reading.at[1].x, 200, 1e-9);
    CHECK_NEAR(reading.at[1].y, 100, 1e-9);
    reading = gsn_phantom_defect_read(&PIECE, below);
    CHECK_NEAR(reading.at[1].x, 300, 1e-9);
    CHECK_NEAR(reading.at[1].y, 100, 1e-9);
    CHECK(!gsn_phantom_defect_read(&PIECE, off).moved);
}

TEST(a_stroke_runs_through_its_points)
{
    const struct gsn_phantom_defect pen = { .kind = GSN_PHANTOM_PEN,
                                            .width = 800,
                                            .count = 3,
                                            .point = { { 0, 0 }, { 1000, 200 }, { 2000, -300 } } };
    struct gsn_point line[GSN_PHANTOM_STROKE + 1];
    const struct gsn_point beside = { 1000, 1200 };

    gsn_phantom_stroke(&pen, line);
    CHECK_NEAR(line[0].x, 0, 1e-9);
    CHECK_NEAR(line[GSN_PHANTOM_STROKE / 2].y, 200, 1e-9);
    CHECK_NEAR(line[GSN_PHANTOM_STROKE].y, -300, 1e-9);
    CHECK_NEAR(gsn_phantom_stroke_distance(line, pen.point[1]), 0, 1e-9);
    CHECK(gsn_phantom_defect_covers(&pen, 16, pen.point[1]));
    CHECK(!gsn_phantom_defect_covers(&pen, 16, beside));
}

TEST(under_a_bubble_all_is_covered_but_only_its_rim_hides)
{
    const struct gsn_phantom_defect bubble = { .kind = GSN_PHANTOM_BUBBLE,
                                               .at = { 5000, 5000 },
                                               .radius = 600 };
    const struct gsn_point middle = { 5000, 5100 }, rim = { 5620, 5000 }, outside = { 5800, 5000 };

    CHECK(gsn_phantom_defect_covers(&bubble, 16, middle));
    CHECK(!gsn_phantom_defect_opaque(&bubble, 16, middle));
    CHECK(gsn_phantom_defect_opaque(&bubble, 16, rim));
    CHECK(!gsn_phantom_defect_covers(&bubble, 16, outside));
}

TEST(every_kind_has_a_name)
{
    for (int i = 0; i < GSN_PHANTOM_DEFECT_KINDS; i++)
        for (int j = 0; j < i; j++)
            CHECK(strcmp(gsn_phantom_defect_name((enum gsn_phantom_defect_kind)i),
                         gsn_phantom_defect_name((enum gsn_phantom_defect_kind)j)) != 0);
}
