/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/phantom/planning.h"

enum { SEEDS = 60, DRAWN = SEEDS * GSN_PHANTOM_SECTIONS };

static struct gsn_phantom_plan plan_of(const char *level, uint64_t seed)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S02", level, seed, 16, &plan, &err), err);
    return plan;
}

/* Mean and deviation of what is added. */
struct sample {
    double count, sum, squares;
};

static void take(struct sample *sample, double value)
{
    sample->count++;
    sample->sum += value;
    sample->squares += value * value;
}

static double deviation(const struct sample *s)
{
    return sqrt(s->squares / s->count - (s->sum / s->count) * (s->sum / s->count));
}

/* Within four standard errors of a share. */
static void check_share(double count, double of, double share)
{
    CHECK_NEAR(count / of, share, 4 * sqrt(share * (1 - share) / of));
}

/* Within four standard errors of a normal deviation, sd / sqrt(2 n). */
static void check_deviation(const struct sample *s, double sd)
{
    CHECK_NEAR(deviation(s), sd, 4 * sd / sqrt(2 * s->count));
    CHECK_NEAR(s->sum / s->count, 0, 4 * sd / sqrt(s->count));
}

TEST(poses_are_drawn_as_the_table_of_levels_says)
{
    struct sample turn = { 0 }, ratio = { 0 }, size = { 0 };
    int halves = 0, flips = 0;

    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L2", seed);

        for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
            const struct gsn_phantom_section *s = &plan.section[k];
            const int half = fabs(s->theta) > M_PI / 2;

            halves += half;
            flips += s->flip;
            take(&turn, (s->theta - (half ? M_PI : 0)) * 180 / M_PI);
            take(&ratio, s->sx - s->sy);
            take(&size, (s->sx + s->sy) / 2 - 1);
        }
    }
    check_share(halves, DRAWN, .05);
    check_share(flips, DRAWN, .03);
    check_deviation(&turn, 12);
    /* Two axes of .004 each: their difference .004 sqrt 2, their mean .004 / sqrt 2 beside .008. */
    check_deviation(&ratio, .004 * sqrt(2));
    check_deviation(&size, hypot(.008, .004 / sqrt(2)));
}

TEST(marks_are_drawn_as_the_table_of_levels_says)
{
    struct sample wander = { 0 };
    int missing = 0;

    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L2", seed);

        for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++)
            for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
                const struct gsn_phantom_mark *m = &plan.section[k].mark[i];

                missing += m->missing;
                take(&wander, m->centre.x - gsn_phantom_geometry()->mark[i].x);
                take(&wander, m->centre.y - gsn_phantom_geometry()->mark[i].y);
                CHECK(m->radius_um >= 67.5 && m->radius_um <= 82.5);
                CHECK(m->ratio >= 1 && m->ratio <= 1.15);
            }
    }
    /* A section mounted twice repeats its marks: a little fewer are independent. */
    check_share(missing, 3 * DRAWN, .03);
    check_deviation(&wander, 2);
}

TEST(batches_are_drawn_as_the_table_of_levels_says)
{
    struct sample red = { 0 }, yellow = { 0 }, white = { 0 }, turn = { 0 };

    for (uint64_t seed = 0; seed < 8 * SEEDS; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L2", seed);

        for (int i = 0; i < GSN_PHANTOM_PANELS; i++) {
            const struct gsn_phantom_batch *b = &plan.batch[i];
            double plain[3], dot = 0, length = 0;

            gsn_phantom_dye_vector(GSN_PHANTOM_RED, plain);
            for (int c = 0; c < 3; c++) {
                dot += plain[c] * b->dye[GSN_PHANTOM_RED][c];
                length += b->dye[GSN_PHANTOM_RED][c] * b->dye[GSN_PHANTOM_RED][c];
                CHECK(b->white[c] <= 254);
            }
            CHECK_NEAR(length, 1, 1e-9);
            take(&red, log(b->red_gain));
            take(&yellow, log(b->yellow_gain));
            take(&white, b->white[2] / gsn_phantom_white[2] - 1);
            take(&turn, acos(dot) * 180 / M_PI);
        }
    }
    check_deviation(&red, .10);
    check_deviation(&yellow, .15);
    check_deviation(&white, .01);
    /* The angle is the size of a normal one: its root mean square is the deviation. */
    CHECK_NEAR(sqrt(turn.squares / turn.count), 2, 4 * 2 / sqrt(2 * turn.count));
}

static void count_panel(const struct gsn_phantom_plan *plan, int panel)
{
    const struct gsn_phantom_level *level = &plan->level;
    int gone = 0, dealt = 0;

    for (size_t i = 0; i < plan->defects; i++) {
        const struct gsn_phantom_defect *d = &plan->defect[i];
        const int again = i > 0 && plan->defect[i - 1].kind == d->kind &&
                          plan->defect[i - 1].at.x == d->at.x &&
                          plan->defect[i - 1].at.y == d->at.y;

        if (plan->section[d->k].panel != panel)
            continue;
        gone += d->kind >= GSN_PHANTOM_ACCIDENTS;
        dealt += d->kind < GSN_PHANTOM_ACCIDENTS && !again;
    }
    if (panel == plan->missing_panel) {
        CHECK(gone == GSN_PHANTOM_SLOTS && dealt == 0);
        return;
    }
    CHECK(gone >= level->missing_least && gone <= level->missing_most);
    CHECK(dealt >= level->defects_least && dealt <= level->defects_most);
}

TEST(each_panel_loses_one_section_and_has_two_or_three_defects)
{
    int duplicates = 0;

    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L2", seed);
        int seen[GSN_PHANTOM_DEFECT_KINDS] = { 0 };

        for (int panel = 1; panel <= GSN_PHANTOM_PANELS; panel++)
            count_panel(&plan, panel);
        for (size_t i = 0; i < plan.defects; i++)
            seen[plan.defect[i].kind]++;
        for (int kind = 0; kind < GSN_PHANTOM_ACCIDENTS; kind++)
            CHECK(seen[kind] > 0);
        for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
            const int shows = plan.section[k].shows;

            CHECK(shows == k || shows == -1 || (shows == k - 1 && k % GSN_PHANTOM_SLOTS > 0));
            duplicates += shows == k - 1;
        }
    }
    CHECK(duplicates > SEEDS / 2 && duplicates < 2 * SEEDS);
}

TEST(a_bad_day_loses_two_or_three_of_twelve_and_has_six_to_eight_defects)
{
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L3", seed);

        CHECK(plan.level.missing_least == 2 && plan.level.missing_most == 3);
        CHECK(plan.level.defects_least == 6 && plan.level.defects_most == 8);
        CHECK(plan.defects < GSN_PHANTOM_DEFECTS_MOST);
        for (int panel = 1; panel <= GSN_PHANTOM_PANELS; panel++)
            count_panel(&plan, panel);
        for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
            const int shows = plan.section[k].shows;

            CHECK(shows == k || shows == -1 || plan.section[k - 1].shows == k - 1);
        }
    }
}

TEST(sections_that_touch_lie_side_by_side)
{
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L2", seed);

        for (size_t i = 0; i + 1 < plan.defects; i++) {
            const int k = plan.defect[i].k;
            const struct gsn_phantom_section *left = &plan.section[k];

            if (plan.defect[i].kind != GSN_PHANTOM_TOUCHING ||
                plan.defect[i + 1].kind != GSN_PHANTOM_TOUCHING)
                continue;
            CHECK(plan.defect[i + 1].k == k + 1 && k % 4 < 3);
            CHECK(left[0].shows == k && left[1].shows == k + 1);
            /* Twice the longer half axis, less where they are tilted, more where they lie across.
             */
            CHECK_NEAR((left[1].centre_px.x - left[0].centre_px.x) * 16, 5300, 400);
        }
    }
}

TEST(no_decoy_lies_on_a_mark)
{
    int count[GSN_PHANTOM_DECOYS_MOST + 1] = { 0 };

    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L2", seed);

        for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
            const struct gsn_phantom_section *s = &plan.section[k];

            count[s->decoys]++;
            for (int i = 0; i < s->decoys; i++)
                for (int j = 0; j < GSN_PHANTOM_MARKS; j++) {
                    const struct gsn_point p = gsn_affine_apply(&s->to_panel, s->mark[j].centre);

                    CHECK(hypot(p.x * 16 - s->decoy[i].at_um.x, p.y * 16 - s->decoy[i].at_um.y) >
                          300);
                    CHECK(s->decoy[i].radius_um >= 40 && s->decoy[i].radius_um <= 130);
                }
        }
    }
    for (int i = 0; i <= 2; i++)
        check_share(count[i], DRAWN, 1 / 3.0);
}

TEST(a_careful_bench_has_perfect_marks_and_nothing_goes_wrong)
{
    const struct gsn_phantom_plan plan = plan_of("L1", 7);

    CHECK(plan.defects == 0);
    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++) {
        CHECK(plan.section[k].shows == k && plan.section[k].decoys == 0);
        for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
            const struct gsn_phantom_mark *m = &plan.section[k].mark[i];

            CHECK(!m->missing && m->radius_um == 75 && m->ratio == 1);
            CHECK(m->centre.x == gsn_phantom_geometry()->mark[i].x);
        }
    }
}
