/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/phantom/planning.h"

static void check_there_and_back(const struct gsn_phantom_section *s, double px_um)
{
    const struct gsn_affine map = gsn_phantom_panel_map(s, px_um);

    for (double y = -2000; y <= 2000; y += 500)
        for (double x = -2500; x <= 2500; x += 500) {
            const struct gsn_point block = { x, y };
            const struct gsn_point back =
                gsn_phantom_material(s, px_um, gsn_affine_apply(&map, block));

            CHECK_NEAR(back.x, x, 1e-9);
            CHECK_NEAR(back.y, y, 1e-9);
        }
}

TEST(the_map_to_the_panel_undoes_the_material_point)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S01", "L1", 3, 16, &plan, &err), err);
    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
        const struct gsn_affine map = gsn_phantom_panel_map(&plan.section[k], 16);

        CHECK(memcmp(&map, &plan.section[k].to_panel, sizeof map) == 0);
        check_there_and_back(&plan.section[k], 16);
    }
}

TEST(so_it_does_for_a_turned_over_and_stretched_section)
{
    const struct gsn_phantom_section s = {
        .flip = 1, .theta = 2.5, .sx = 1.02, .sy = 0.97, .centre_px = { 512.25, 268.5 }
    };

    check_there_and_back(&s, 10.58);
}

/* A positive angle turns the tissue clockwise on the picture, where y points down. */
TEST(a_quarter_turn_carries_right_to_down)
{
    const struct gsn_phantom_section s = { .theta = M_PI / 2, .sx = 1, .sy = 1 };
    const struct gsn_affine map = gsn_phantom_panel_map(&s, 16);
    const struct gsn_point p = gsn_affine_apply(&map, (struct gsn_point){ 1600, 0 });

    CHECK_NEAR(p.x, 0, 1e-9);
    CHECK_NEAR(p.y, 100, 1e-9);
}

TEST(sections_fill_the_panels_row_by_row)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("GVP-D-S00", "L0", 1, 16, &plan, &err), err);
    CHECK(plan.width == 2300 && plan.height == 1560);
    CHECK(plan.section[0].panel == 1 && plan.section[59].panel == 5);
    CHECK_NEAR(plan.section[0].centre_px.x, 8200 / 16.0, 1e-9);
    CHECK_NEAR(plan.section[0].centre_px.y, 4300 / 16.0, 1e-9);
    /* k = 18: panel 2, slot 6, second row, third column. */
    CHECK(plan.section[18].panel == 2 && plan.section[18].slot == 6);
    CHECK_NEAR(plan.section[18].centre_px.x, 24200 / 16.0, 1e-9);
    CHECK_NEAR(plan.section[18].centre_px.y, 12300 / 16.0, 1e-9);
    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++)
        CHECK(plan.section[k].theta == 0);
}

TEST(poses_of_level_1_keep_within_their_limits_and_use_them)
{
    double most_turn = 0, most_shift = 0;
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S02", "L1", 11, 16, &plan, &err), err);
    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
        const struct gsn_point c = gsn_phantom_slot_centre_um(&plan, k % 12);

        most_turn = fmax(most_turn, fabs(plan.section[k].theta) * 180 / M_PI);
        most_shift = fmax(most_shift, fabs(plan.section[k].centre_px.x * 16 - c.x));
        most_shift = fmax(most_shift, fabs(plan.section[k].centre_px.y * 16 - c.y));
    }
    CHECK(most_turn > 8 && most_turn <= 10);
    CHECK(most_shift > 270 && most_shift <= 300);
}

static void check_same_section(const struct gsn_phantom_section *a,
                               const struct gsn_phantom_section *b)
{
    CHECK(memcmp(&a->to_panel, &b->to_panel, sizeof a->to_panel) == 0);
    CHECK(a->flip == b->flip && a->shows == b->shows && a->decoys == b->decoys);
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        CHECK(a->mark[i].missing == b->mark[i].missing);
        CHECK(a->mark[i].centre.x == b->mark[i].centre.x && a->mark[i].ratio == b->mark[i].ratio);
    }
    for (int i = 0; i < a->decoys; i++)
        CHECK(a->decoy[i].kind == b->decoy[i].kind && a->decoy[i].at_um.x == b->decoy[i].at_um.x);
}

static void check_same_but_for_the_stain(const char *level)
{
    struct gsn_phantom_plan s01, s02, s03;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S01", level, 5, 16, &s01, &err), err);
    CHECK_OK(gsn_phantom_plan_make("S02", level, 5, 16, &s02, &err), err);
    CHECK_OK(gsn_phantom_plan_make("S03", level, 5, 16, &s03, &err), err);
    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
        CHECK(s01.section[k].theta != s02.section[k].theta);
        check_same_section(&s02.section[k], &s03.section[k]);
    }
    CHECK(s02.defects == s03.defects);
    for (size_t i = 0; i < s02.defects; i++) {
        CHECK(s02.defect[i].kind == s03.defect[i].kind && s02.defect[i].k == s03.defect[i].k);
        CHECK(s02.defect[i].at.x == s03.defect[i].at.x);
    }
    CHECK(s03.specimen.depth == s02.specimen.depth);
    for (int i = 0; i < GSN_PHANTOM_PANELS; i++) {
        CHECK_NEAR(s03.batch[i].red_gain, 1.15 * s02.batch[i].red_gain, 1e-12);
        CHECK(memcmp(s03.batch[i].dye, s02.batch[i].dye, sizeof s02.batch[i].dye) == 0);
        CHECK(memcmp(s03.batch[i].white, s02.batch[i].white, sizeof s02.batch[i].white) == 0);
    }
}

TEST(another_stain_changes_nothing_else)
{
    check_same_but_for_the_stain("L1");
    check_same_but_for_the_stain("L2");
    check_same_but_for_the_stain("L3");
}

TEST(what_does_not_exist_is_refused_in_one_sentence)
{
    static const struct {
        const char *specimen, *level;
        double px_um;
        int code;
        const char *says;
    } refused[] = {
        { "S02", "L4", 16, GSN_E_NOTFOUND, "no level L4" },
        { "S09", "L1", 16, GSN_E_NOTFOUND, "no specimen S09" },
        { "S02", "L1", 3, GSN_E_LIMIT, "a pixel of 3 um" },
        { "S02", "L1", 100, GSN_E_LIMIT, "a pixel of 100 um" },
        { "S02", "L1", NAN, GSN_E_LIMIT, "a pixel of" },
    };

    for (size_t i = 0; i < sizeof refused / sizeof *refused; i++) {
        struct gsn_phantom_plan plan = { .width = 77 };
        struct gsn_error err = { 0 };

        CHECK(gsn_phantom_plan_make(refused[i].specimen, refused[i].level, 1, refused[i].px_um,
                                    &plan, &err) == refused[i].code);
        CHECK(strstr(err.text, refused[i].says));
        CHECK(!strchr(err.text, '\n'));
        CHECK(plan.width == 77);
    }
}
