/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/normalisation.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

enum { CELLS = 600, MOST_PANELS = 5, SIDES = 4, MOST_LINES = MOST_PANELS * (SIDES - 1) };

/* A block in cells: what tissue is, and what every panel makes of it. Each panel has SIDES groups
 * of three sections. */
struct block {
    size_t panels;
    struct gsn_gain_offset stain[MOST_PANELS];
    double drift;  /* of the tissue, relative, per group */
    double noise;  /* of a cell */
    double lesion; /* loss of a tenth of the cells from the third panel on */
};

static double tissue(size_t cell)
{
    static const double kinds[] = { 0.2, 0.42, 0.55, 0.85, 0.9 };

    return kinds[cell % 5] * (1 + 0.05 * sin((double)cell));
}

static void measure(const struct block *b, size_t panel, size_t group, struct dice *dice,
                    double *value)
{
    const double k = (double)(panel * SIDES + group);

    for (size_t i = 0; i < CELLS; i++) {
        const double lost = panel >= 2 && i % 10 == 3 ? b->lesion : 0;
        const double truth = tissue(i) * (1 + b->drift * k) * (1 - lost);

        value[i] =
            b->stain[panel].gain * truth + b->stain[panel].offset + b->noise * dice_normal(dice);
    }
}

static int chain(const struct block *b, struct dice *dice, struct gsn_gain_offset *level,
                 struct gsn_gain_fit *fit, struct gsn_error *err)
{
    static const double at[2] = { 0.2, 0.88 };
    static double value[MOST_PANELS][SIDES][CELLS];
    struct gsn_gain_line step[MOST_PANELS], within[MOST_LINES];
    size_t lines = 0;
    int r = GSN_OK;

    for (size_t p = 0; p < b->panels; p++)
        for (size_t g = 0; g < SIDES; g++)
            measure(b, p, g, dice, value[p][g]);
    for (size_t p = 0; p < b->panels && r >= 0; p++) {
        for (size_t g = 0; g + 1 < SIDES && r >= 0; g++) {
            r = gsn_gain_line(value[p][g], value[p][g + 1], CELLS, &within[lines], err);
            within[lines++].lag = 3;
        }
        if (r >= 0 && p + 1 < b->panels)
            r = gsn_gain_line(value[p][SIDES - 1], value[p + 1][0], CELLS, &step[p], err);
        step[p].lag = 3;
    }
    return r < 0 ? r : gsn_gain_chain(step, b->panels - 1, within, lines, at, level, fit, err);
}

/* The stain on the scale of the panels' mean. */
static struct gsn_gain_offset truth_of(const struct block *b, size_t panel)
{
    struct gsn_gain_offset mean = { 0 };

    for (size_t p = 0; p < b->panels; p++) {
        mean.gain += b->stain[p].gain / (double)b->panels;
        mean.offset += b->stain[p].offset / (double)b->panels;
    }
    return (struct gsn_gain_offset){ b->stain[panel].gain / mean.gain,
                                     b->stain[panel].offset -
                                         b->stain[panel].gain / mean.gain * mean.offset };
}

static const struct block STAINED = {
    .panels = 5,
    .stain = { { 0.9, 0.03 }, { 1.17, 0 }, { 1.0, 0.08 }, { 1.1, -0.09 }, { 0.97, 0.01 } },
    .noise = 0.01
};

static void check_levels(const struct block *b, double tolerance)
{
    struct dice dice = { 11 };
    struct gsn_gain_offset level[MOST_PANELS];
    struct gsn_gain_fit fit;
    struct gsn_error err = { 0 };

    CHECK_OK(chain(b, &dice, level, &fit, &err), err);
    for (size_t p = 0; p < b->panels; p++) {
        const struct gsn_gain_offset truth = truth_of(b, p);

        for (double d = 0.2; d < 1; d += 0.3)
            CHECK_NEAR(level[p].gain * d + level[p].offset, truth.gain * d + truth.offset,
                       tolerance);
    }
    CHECK(fit.kept > 0.99);
}

TEST(factors_and_offsets_of_panels_are_given_back)
{
    check_levels(&STAINED, 0.004);
}

TEST(what_tissue_does_by_itself_is_not_taken_for_stain)
{
    struct block b = STAINED;

    b.drift = -0.004; /* a percent and a half per panel */
    check_levels(&b, 0.012);
}

/* A tenth of the tissue is gone from the third panel on: the stain's step says nothing of it. */
TEST(a_loss_across_a_boundary_is_not_taken_for_stain)
{
    struct block b = STAINED;

    b.lesion = 0.5;
    check_levels(&b, 0.006);
}

TEST(panels_that_differ_by_noise_alone_stay_as_they_are)
{
    struct block even = { .panels = 5, .noise = 0.02 };
    struct dice dice = { 12 };
    struct gsn_gain_offset level[MOST_PANELS];
    struct gsn_gain_fit fit;
    struct gsn_error err = { 0 };
    double worst = 0, kept = 0;

    for (size_t p = 0; p < 5; p++)
        even.stain[p] = (struct gsn_gain_offset){ 1, 0 };
    for (int draw = 0; draw < 40; draw++) {
        CHECK_OK(chain(&even, &dice, level, &fit, &err), err);
        kept += fit.kept / 40;
        for (size_t p = 0; p < 5; p++)
            worst = fmax(worst, fabs(level[p].gain * 0.85 + level[p].offset - 0.85));
    }
    CHECK(worst < 0.004);
    CHECK(kept < 0.35);
}

/* 200 draws: the error that is said is the error that is made. */
TEST(the_error_said_is_the_error_made)
{
    struct block b = STAINED;
    struct dice dice = { 13 };
    const double share[5] = { 0.25, 0.5, 0.25, 0, 0 };
    struct gsn_error err = { 0 };
    double squares = 0, said = 0;

    b.noise = 0.05;
    for (int draw = 0; draw < 200; draw++) {
        struct gsn_gain_offset level[MOST_PANELS];
        struct gsn_gain_fit fit;
        double off = 0;

        CHECK_OK(chain(&b, &dice, level, &fit, &err), err);
        for (size_t p = 0; p < 5; p++) {
            const struct gsn_gain_offset truth = truth_of(&b, p);
            const double seen = truth.gain * 0.8 + truth.offset;

            off += share[p] * ((seen - level[p].offset) / level[p].gain - 0.8);
        }
        squares += off * off / 200;
        said += pow(gsn_gain_error(&fit, share, 0.8), 2) / 200;
    }
    CHECK(sqrt(said) > 0.8 * sqrt(squares) && sqrt(said) < 1.6 * sqrt(squares));
}

TEST(one_panel_is_its_own_scale)
{
    struct block one = { .panels = 1, .stain = { { 1.2, 0.05 } }, .noise = 0.01 };
    const double share[MOST_PANELS] = { 0.5, 0.5 };
    struct dice dice = { 14 };
    struct gsn_gain_offset level[MOST_PANELS];
    struct gsn_gain_fit fit;
    struct gsn_error err = { 0 };

    one.stain[0] = (struct gsn_gain_offset){ 1.2, 0.05 };
    for (int i = 0; i < 3; i++)
        one.drift = 0.001 * i;
    CHECK(chain(&one, &dice, level, &fit, &err) == GSN_E_STAIN); /* three lines do not tell */
    one.panels = 2;
    one.stain[1] = one.stain[0];
    CHECK_OK(chain(&one, &dice, level, &fit, &err), err);
    CHECK_NEAR(level[0].gain, level[1].gain, 0.01);
    CHECK_NEAR(gsn_gain_error(&fit, share, 0.8), 0, 0);
}

TEST(tissue_all_of_one_density_tells_no_line)
{
    double x[CELLS], y[CELLS];
    struct dice dice = { 15 };
    struct gsn_gain_line line = { .slope = -7 };
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < CELLS; i++) {
        x[i] = 0.8 + 0.01 * dice_normal(&dice);
        y[i] = 0.9 + 0.01 * dice_normal(&dice);
    }
    CHECK(gsn_gain_line(x, y, CELLS, &line, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "all of one density, so gain and offset"));
    CHECK(gsn_gain_line(x, y, 99, &line, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "only 99 cells of tissue are seen on both sides"));
    CHECK(line.slope == -7);
}

TEST(dense_and_pale_that_change_places_are_refused)
{
    const struct gsn_gain_line within[4] = {
        { 1, 0.001, 3, 500 }, { 1, -0.001, 3, 500 }, { 1.001, 0, 3, 500 }, { 0.999, 0, 3, 500 }
    };
    const struct gsn_gain_line turned = { -0.5, 0.9, 3, 500 };
    const double at[2] = { 0.2, 0.88 };
    struct gsn_gain_offset level[2] = { { -7, 0 }, { -7, 0 } };
    struct gsn_gain_fit fit = { .kept = -7 };
    struct gsn_error err = { 0 };

    CHECK(gsn_gain_chain(&turned, 1, within, 4, at, level, &fit, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "look at the poses"));
    CHECK(gsn_gain_chain(&turned, 1, within, 3, at, level, &fit, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "only 3 times"));
    CHECK(level[0].gain == -7 && fit.kept == -7);
}

static int one_line(struct gsn_error *err)
{
    double x[CELLS], y[CELLS];
    struct gsn_gain_line line;

    for (size_t i = 0; i < CELLS; i++)
        y[i] = 1.1 * (x[i] = tissue(i));
    return gsn_gain_line(x, y, CELLS, &line, err);
}

TEST(running_out_of_memory_is_said)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(one_line(&err), err);
}

TEST(a_fifth_of_holes_or_ink_does_not_pull_the_reference)
{
    struct dice dice = { 3 };
    double values[1000];

    for (size_t i = 0; i < 1000; i++)
        values[i] =
            i % 5 == 0 ? (i % 2 ? 0 : 0.5 + 0.1 * dice_even(&dice)) : 0.5 + 0.1 * dice_even(&dice);
    CHECK_NEAR(gsn_reference_red(values, 1000), 0.55, 0.01);
    const double none = gsn_reference_red(values, 0);

    CHECK(none != none);
    values[0] = 7;
    CHECK_NEAR(gsn_reference_red(values, 1), 7, 0);
}

TEST(the_reference_grows_in_proportion_to_the_stain)
{
    struct dice dice = { 4 };
    double plain[500], strong[500];

    for (size_t i = 0; i < 500; i++) {
        plain[i] = exp(0.5 * dice_normal(&dice));
        strong[i] = 1.15 * plain[i];
    }
    CHECK_NEAR(gsn_reference_red(strong, 500) / gsn_reference_red(plain, 500), 1.15, 1e-12);
}

/* 1000 panels of twelve sections whose reference scatters by 3 %: the error said is the error made.
 */
TEST(the_error_of_a_gain_is_what_sections_disagree_by)
{
    struct dice dice = { 5 };
    struct gsn_error err = { 0 };
    double squares = 0, said = 0;

    for (size_t i = 0; i < 1000; i++) {
        struct gsn_reference_section sections[13] = { { 99, 49 } }; /* too small to speak */
        struct gsn_stain_gain gain;

        for (size_t k = 1; k < 13; k++)
            sections[k] =
                (struct gsn_reference_section){ 0.55 * 1.15 * (1 + 0.03 * dice_normal(&dice)),
                                                400 };
        CHECK_OK(gsn_stain_reference(sections, 13, 0.55, &gain, &err), err);
        CHECK(gain.sections == 12 && gain.pixels == 4800u);
        squares += (gain.gain - 1.15) * (gain.gain - 1.15) / 1000;
        said += gain.error * gain.error / 1000;
    }
    CHECK_NEAR(sqrt(squares), 1.15 * 0.03 / sqrt(12), 0.0008);
    CHECK_NEAR(sqrt(said), sqrt(squares), 0.0008);
}

TEST(too_small_and_too_pale_a_reference_is_refused)
{
    const struct gsn_reference_section small[3] = { { 0.5, 400 }, { 0.5, 400 }, { 0.5, 49 } };
    const struct gsn_reference_section pale[3] = { { 0.04, 400 }, { 0.05, 400 }, { 0.05, 400 } };
    struct gsn_stain_gain gain = { .gain = -7 };
    struct gsn_error err = { 0 };

    CHECK(gsn_stain_reference(small, 3, 0.5, &gain, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "the reference tissue shows on 2 sections, at least 3"));
    CHECK(gsn_stain_reference(pale, 3, 0.5, &gain, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "holds next to no red (density 0.05)"));
    CHECK_NEAR(gain.gain, -7, 0);
}

TEST(a_panel_without_reference_takes_the_others_mean_and_their_scatter)
{
    const struct gsn_stain_gain gains[4] = {
        { 1.1, 0.01, 12, 999 }, { 1, 0, 0, 0 }, { 1.2, 0.01, 12, 999 }, { 1.3, 0.01, 12, 999 }
    };
    struct gsn_stain_gain other = { .gain = -7 };
    struct gsn_error err = { 0 };

    CHECK(gsn_stain_gain_of_others(gains, 2, &other, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "was measured on 1 panel,"));
    CHECK_NEAR(other.gain, -7, 0);
    CHECK_OK(gsn_stain_gain_of_others(gains, 4, &other, &err), err);
    CHECK_NEAR(other.gain, 1.2, 1e-12);
    CHECK_NEAR(other.error, sqrt(0.01 * 4 / 3 + 3e-4 / 9), 1e-12);
    CHECK(other.sections == 0);
}
