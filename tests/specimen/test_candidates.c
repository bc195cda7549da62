/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/candidates.h"

#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/tre.h"
#include "tests/check.h"

#include <math.h>
#include <string.h>

static const double PX_UM = 10;
static const struct gsn_point TRIANGLE[GSN_FIDUCIALS] = { { -700, -350 },
                                                          { 600, -520 },
                                                          { -520, 450 } };

/* A section of pixels turned by this angle and shifted, mirrored in x before that. */
static struct gsn_point seen_at(struct gsn_point um, double deg, int mirrored)
{
    const double c = cos(deg * M_PI / 180), s = sin(deg * M_PI / 180);
    const struct gsn_point p = { c * um.x - s * um.y, s * um.x + c * um.y };

    return (struct gsn_point){ 500 + (mirrored ? -p.x : p.x) / PX_UM, 400 + p.y / PX_UM };
}

static void see(struct gsn_fiducial mark[GSN_FIDUCIALS], double deg, int mirrored)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        mark[i] = (struct gsn_fiducial){ .px = seen_at(TRIANGLE[i], deg, mirrored),
                                         .radius_px = 7.5,
                                         .found = 1 };
}

static const struct gsn_point UPRIGHT = { 1, 0 };

/* By the way the marks were made: every pair and the triple give the same map back, whichever way
 * up the section lies. */
TEST(pairs_and_triple_of_one_section_are_laid_where_it_was)
{
    for (int mirrored = 0; mirrored < 2; mirrored++) {
        struct gsn_fiducial mark[GSN_FIDUCIALS];
        struct gsn_candidates list;

        see(mark, 150, mirrored);
        gsn_candidates_of_marks(mark, mirrored, &list);
        gsn_candidates_lay(&list, PX_UM, TRIANGLE);
        gsn_candidates_say(&list, UPRIGHT);
        CHECK(list.count == 4);
        for (size_t i = 0; i < list.count; i++) {
            const struct gsn_point beside = { 123, -456 };
            const struct gsn_point back =
                gsn_affine_apply(&list.at[i].panel_to_block_um, seen_at(beside, 150, mirrored));

            CHECK(list.at[i].laid);
            CHECK_NEAR(back.x, beside.x, 1e-6);
            CHECK_NEAR(back.y, beside.y, 1e-6);
            CHECK(list.at[i].flipped == mirrored);
            CHECK(list.at[i].rotated180 == 1);
        }
        assert_string_equal(list.at[0].differs, "on two marks, without mark 1");
        assert_string_equal(list.at[2].differs, "on two marks, without mark 3");
        assert_string_equal(list.at[3].differs, "on all three marks");
    }
}

/* Two marks leave two ways round and two ways up. */
static void four_ways(struct gsn_candidates *ret_list)
{
    struct gsn_fiducial_hypothesis rivals[4] = { 0 };
    struct gsn_fiducial mark[GSN_FIDUCIALS];

    see(mark, 0, 0);
    for (int k = 0; k < 4; k++) {
        rivals[k].mark[0] = mark[k % 2];
        rivals[k].mark[1] = mark[1 - k % 2];
        rivals[k].mirrored = k / 2;
        rivals[k].share = 0.25;
    }
    gsn_candidates_of_rivals(rivals, 4, ret_list);
    gsn_candidates_lay(ret_list, PX_UM, TRIANGLE);
    gsn_candidates_say(ret_list, UPRIGHT);
}

TEST(what_differs_is_said_of_the_same_spots)
{
    struct gsn_candidates list;

    four_ways(&list);
    assert_string_equal(list.at[0].differs, "on two marks, without mark 3");
    assert_string_equal(list.at[1].differs, "the same spots, turned by 180 degrees");
    CHECK(strncmp(list.at[2].differs, "the same spots, the other way up", 32) == 0);
    CHECK(!list.at[0].flipped && list.at[2].flipped);
    CHECK(!list.at[0].rotated180 && list.at[1].rotated180);
}

TEST(another_spot_is_named_by_its_place)
{
    struct gsn_fiducial_hypothesis rivals[2] = { 0 };
    struct gsn_candidates list;

    see(rivals[0].mark, 0, 0);
    see(rivals[1].mark, 0, 0);
    rivals[1].mark[2].px = (struct gsn_point){ 441.2, 466.9 };
    gsn_candidates_of_rivals(rivals, 2, &list);
    gsn_candidates_say(&list, UPRIGHT);
    assert_string_equal(list.at[1].differs,
                        "on all three marks: mark 3 is the spot at (441, 467) px");
}

/* The closed form for three marks alike: TRE^2 = FLE^2/3 (1 + r^2 / (2 rho^2)), here r = rho. */
TEST(the_error_is_that_of_the_formula_and_larger_on_two_marks)
{
    struct gsn_pose_summary summary = { .fle_um = 6 };
    struct gsn_point centre = { 0 }, around[4];
    struct gsn_fiducial mark[GSN_FIDUCIALS];
    struct gsn_candidates list;
    double rho = 0;

    memcpy(summary.mean_triangle, TRIANGLE, sizeof TRIANGLE);
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        centre.x += TRIANGLE[i].x / 3;
        centre.y += TRIANGLE[i].y / 3;
    }
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        rho += (pow(TRIANGLE[i].x - centre.x, 2) + pow(TRIANGLE[i].y - centre.y, 2)) / 3;
    rho = sqrt(rho);
    for (int i = 0; i < 4; i++)
        around[i] = (struct gsn_point){ centre.x + (i == 0   ? rho
                                                    : i == 1 ? -rho
                                                             : 0),
                                        centre.y + (i == 2   ? rho
                                                    : i == 3 ? -rho
                                                             : 0) };
    see(mark, 20, 0);
    gsn_candidates_of_marks(mark, 0, &list);
    CHECK(!list.at[3].laid && isnan(list.at[3].error_um));

    const struct gsn_pose_targets targets = gsn_pose_targets_of(around, 4);

    gsn_candidates_lay(&list, PX_UM, TRIANGLE);
    gsn_candidates_predict(&list, PX_UM, &summary, &targets);
    CHECK_NEAR(list.at[3].error_um, 6 / sqrt(3) * sqrt(1.5), 1e-3);
    for (int i = 0; i < 3; i++)
        CHECK(list.at[i].error_um > 1.1 * list.at[3].error_um);
}

TEST(gross_candidates_come_by_their_likelihood_and_one_that_could_not_be_laid_is_left_out)
{
    const struct gsn_affine map = { 10, 0, 0, 0, 10, 0 };
    const struct gsn_pose pose = { .state = GSN_POSE_OK,
                                   .gross = 1,
                                   .candidate = { { .share = 0.1, .tre_um = 1 },
                                                  { map, .share = 0.2, .tre_um = 20 },
                                                  { map, .share = 0.7, .tre_um = 7 } } };
    struct gsn_fiducial mark[GSN_FIDUCIALS];
    struct gsn_candidates list;

    see(mark, 0, 0);
    gsn_candidates_of_gross(mark, &pose, &list);
    CHECK(list.count == 2);
    CHECK(list.at[0].share == 0.7 && list.at[0].error_um == 7);
    CHECK(list.at[0].mark[1].found && !list.at[0].mark[2].found);
    CHECK(list.at[1].share == 0.2 && !list.at[1].mark[1].found);
}

static struct gsn_candidate_choice choice_of(const struct gsn_candidate *c, double off_px)
{
    struct gsn_candidate_choice choice = { .mirrored = c->mirrored };

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        choice.found[i] = c->mark[i].found;
        choice.px[i] = (struct gsn_point){ c->mark[i].px.x + off_px, c->mark[i].px.y };
    }
    return choice;
}

TEST(a_choice_is_known_by_its_spots_and_not_by_its_number)
{
    struct gsn_candidates list, other;
    struct gsn_candidate_choice choice;

    four_ways(&list);
    for (unsigned i = 0; i < 4; i++) {
        choice = choice_of(&list.at[i], 0.05);
        CHECK(gsn_candidates_meant(&list, &choice) == i + 1);
    }
    other = list;
    other.at[0] = list.at[3];
    other.at[3] = list.at[0];
    CHECK(gsn_candidates_meant(&other, &choice) == 1);
    choice = choice_of(&list.at[3], 4); /* more than half of the radius of 7.5 px */
    CHECK(gsn_candidates_meant(&list, &choice) == 0);
    other.count = 0;
    choice = choice_of(&list.at[0], 0);
    CHECK(gsn_candidates_meant(&other, &choice) == 0);
}
