/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/calibration.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

enum { RED, YELLOW, DARK };

/* An even patch of so much of each dye, its cells off by noise. */
static struct gsn_patch patch_of(enum gsn_patch_kind kind, unsigned place, double red,
                                 double yellow, double dark, double noise, struct dice *dice)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_patch patch = { .kind = kind, .row = 1, .place = place };

    for (int i = 0; i < GSN_PATCH_CELLS; i++)
        for (int c = 0; c < 3; c++)
            patch.od[i][c] = red * dyes.red[c] + yellow * dyes.yellow[c] + dark * dyes.dark[c] +
                             noise * dice_normal(dice);
    for (int c = 0; c < 3; c++)
        patch.floor_od[c] = 0.0005;
    return patch;
}

struct panel {
    struct gsn_patch patch[8];
    size_t count;
};

static struct panel panel_of(double noise, uint64_t seed)
{
    struct dice dice = { seed };

    return (struct panel){ .patch = { patch_of(GSN_PATCH_RED, 1, 0.6, 0, 0, noise, &dice),
                                      patch_of(GSN_PATCH_YELLOW, 2, 0, 0.35, 0, noise, &dice),
                                      patch_of(GSN_PATCH_DARK, 3, 0, 0, 0.45, noise, &dice) },
                           .count = 3 };
}

static double apart_deg(const double a[3], const double b[3])
{
    return acos(fmin(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], 1)) * 180 / M_PI;
}

static int fit(const struct panel *panel, struct gsn_dyes_fit *ret_fit, struct gsn_error *err)
{
    const struct gsn_dyes_prior expected = gsn_dyes_prior_builtin(GSN_LIGHT_CODES_LINEAR);

    return gsn_calibration_dyes(panel->patch, panel->count, &expected, ret_fit, err);
}

/* Without noise the line through the origin is the vector itself, however strong the patch is. */
TEST(clean_patches_give_the_vectors_they_were_painted_with)
{
    const struct gsn_dyes truth = gsn_dyes_builtin();
    struct panel panel = panel_of(0, 1);
    struct dice dice = { 1 };
    struct gsn_error err = { 0 };
    struct gsn_dyes_fit seen;

    panel.patch[panel.count++] = patch_of(GSN_PATCH_RED, 4, 0.2, 0, 0, 0, &dice);
    CHECK_OK(fit(&panel, &seen, &err), err);
    CHECK(apart_deg(seen.dyes.red, truth.red) < 1e-5);
    CHECK(apart_deg(seen.dyes.yellow, truth.yellow) < 1e-5);
    CHECK(apart_deg(seen.dyes.dark, truth.dark) < 1e-5);
    assert_string_equal(seen.dyes.name, "calibrated-1");
    /* Only the floor is left: 0.0005 both ways. */
    CHECK_NEAR(seen.deviation_deg[DARK], sqrt(2) * 0.0005 / 0.45 * 180 / M_PI, 1e-6);
}

/* Errors in their own deviations, over many panels: 1 when the covariance is honest. */
TEST(the_covariance_is_what_noise_does_to_the_vectors)
{
    enum { PANELS = 300 };
    const struct gsn_dyes truth = gsn_dyes_builtin();
    double squares[3] = { 0 };

    for (uint64_t seed = 1; seed <= PANELS; seed++) {
        struct panel panel = panel_of(0.005, seed);
        struct gsn_error err = { 0 };
        struct gsn_dyes_fit seen;
        const double *v[3] = { seen.dyes.red, seen.dyes.yellow, seen.dyes.dark };
        const double *t[3] = { truth.red, truth.yellow, truth.dark };

        for (size_t i = 0; i < panel.count; i++)
            memset(panel.patch[i].floor_od, 0, sizeof panel.patch[i].floor_od);
        CHECK_OK(fit(&panel, &seen, &err), err);
        for (int k = 0; k < 3; k++)
            squares[k] += pow(apart_deg(v[k], t[k]) / seen.deviation_deg[k], 2) / PANELS;
    }
    for (int k = 0; k < 3; k++)
        CHECK_NEAR(sqrt(squares[k]), 1, 0.12);
}

TEST(dust_on_a_patch_does_not_turn_its_vector)
{
    const struct gsn_dyes truth = gsn_dyes_builtin();
    struct panel panel = panel_of(0.002, 5);
    struct gsn_error err = { 0 };
    struct gsn_dyes_fit seen;

    for (int i = 7; i < 11; i++)
        panel.patch[0].od[i][0] += 0.5;
    CHECK_OK(fit(&panel, &seen, &err), err);
    CHECK(apart_deg(seen.dyes.red, truth.red) < 0.2);
}

/* A dye without a patch stays where it is expected, as uncertain as that. */
TEST(a_dye_without_a_patch_is_as_expected)
{
    const struct gsn_dyes_prior expected = gsn_dyes_prior_builtin(GSN_LIGHT_CODES_LINEAR);
    struct panel panel = panel_of(0.002, 6);
    struct gsn_error err = { 0 };
    struct gsn_dyes_fit seen;

    panel.count = 2;
    CHECK_OK(fit(&panel, &seen, &err), err);
    CHECK(memcmp(seen.dyes.dark, expected.dyes.dark, sizeof seen.dyes.dark) == 0);
    CHECK_NEAR(seen.deviation_deg[DARK], sqrt(2) * expected.deviation_deg[DARK], 1e-9);
    CHECK(seen.deviation_deg[RED] < 0.3);
}

TEST(patches_that_are_no_single_dye_are_refused_with_the_reason)
{
    struct dice dice = { 3 };
    const struct {
        size_t at;
        struct gsn_patch patch;
        const char *says;
    } cases[] = {
        { 0, patch_of(GSN_PATCH_YELLOW, 1, 0, 0.3, 0, 0, &dice), "no patch of red alone" },
        { 0, patch_of(GSN_PATCH_RED, 1, 0.08, 0, 0, 0, &dice),
          "patch 1 of row 1 (red) is too pale to have a hue" },
        { 0, patch_of(GSN_PATCH_RED, 1, 0.35, 0.3, 0, 0, &dice),
          "red) is 12.3 degrees from where that dye is expected" },
        { 1, patch_of(GSN_PATCH_YELLOW, 2, 0.5, 0, 0, 0, &dice),
          "the patches of red and yellow show one dye (they are 0.0 degrees apart)" },
        { 2, patch_of(GSN_PATCH_DARK, 3, 0.2, 0.4, 0, 0, &dice),
          "patch 3 of row 1 is stated to be dark but is nearer to yellow" },
        { 3, patch_of(GSN_PATCH_RED, 4, 0.12, 0.05, 0, 0, &dice),
          "patch 4 of row 1 does not agree with the other patches of red" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct panel panel = panel_of(0, 1);
        struct gsn_dyes_fit seen = { .pixels = 77 };
        struct gsn_error err = { 0 };

        panel.patch[cases[i].at] = cases[i].patch;
        panel.count = cases[i].at < 3 ? 3 : 4;
        CHECK(fit(&panel, &seen, &err) == GSN_E_STAIN);
        CHECK(seen.pixels == 77);
        if (!strstr(err.text, cases[i].says))
            fail_msg("\"%s\" is not in \"%s\"", cases[i].says, err.text);
    }
}

/* Haematoxylin as Ruifrok and Johnston measured it (2001), 28 degrees from the built-in dark. */
TEST(another_counterstain_is_a_dark_dye)
{
    static const double haematoxylin[3] = { 0.650, 0.704, 0.286 };
    struct panel panel = panel_of(0, 1);
    struct gsn_dyes_fit seen;
    struct gsn_error err = { 0 };

    for (int i = 0; i < GSN_PATCH_CELLS; i++)
        for (int c = 0; c < 3; c++)
            panel.patch[2].od[i][c] = 0.45 * haematoxylin[c];
    CHECK_OK(fit(&panel, &seen, &err), err);
    for (int c = 0; c < 3; c++)
        CHECK_NEAR(seen.dyes.dark[c], haematoxylin[c], 1e-3);
    CHECK(seen.moved_deg[DARK] > 20);
}

/* Red on one half, yellow on the other. */
TEST(a_patch_of_two_hues_is_refused)
{
    struct panel panel = panel_of(0, 1);
    struct gsn_dyes_fit seen;
    struct gsn_error err = { 0 };

    memcpy(panel.patch[0].od, panel.patch[1].od, sizeof panel.patch[0].od / 2);
    CHECK(fit(&panel, &seen, &err) == GSN_E_STAIN);
    CHECK(strstr(err.text, "patch 1 of row 1 (red) is of mixed hues"));
}

/* Five standards as the phantom paints them, stained stronger by gain. */
static struct panel wedge_of(double gain, double wrong)
{
    struct panel panel = { .count = 5 };
    struct dice dice = { 9 };

    for (unsigned i = 0; i < 5; i++) {
        const double density = 0.25 * i;

        panel.patch[i] =
            patch_of(GSN_PATCH_STANDARD, i + 1, 0.62 * gain * (i == 2 ? density + wrong : density),
                     0.34 * (1 - 0.55 * density), 0, 0.001, &dice);
        panel.patch[i].density = density;
    }
    return panel;
}

TEST(standards_tell_how_strong_the_stain_is)
{
    static const double gains[] = { 0.7, 1, 1.35 };
    const struct gsn_dyes dyes = gsn_dyes_builtin();

    for (size_t i = 0; i < sizeof gains / sizeof gains[0]; i++) {
        const struct panel panel = wedge_of(gains[i], 0);
        struct gsn_stain_gain gain;
        struct gsn_error err = { 0 };
        double zero;

        CHECK_OK(gsn_calibration_gain(panel.patch, 5, &dyes, &gain, &zero, &err), err);
        CHECK_NEAR(gain.gain, gains[i], 0.003);
        CHECK(gain.sections == 5 && gain.error > 0 && gain.error < 0.01);
        CHECK_NEAR(zero, 0, 0.003);
    }
}

TEST(standards_that_follow_no_line_are_refused)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const struct panel bent = wedge_of(1, 0.2), even = panel_of(0, 1);
    struct gsn_stain_gain gain = { .sections = 9 };
    struct gsn_error err = { 0 };
    double zero = 4;

    CHECK(gsn_calibration_gain(bent.patch, 5, &dyes, &gain, &zero, &err) == GSN_E_STAIN);
    CHECK(strstr(err.text, "do not follow their densities: patch 3 of row 1 (density 0.5)"));
    CHECK(gsn_calibration_gain(even.patch, 3, &dyes, &gain, &zero, &err) == GSN_E_STAIN);
    CHECK(strstr(err.text, "none of its standards holds collagen"));
    CHECK(gain.sections == 9 && zero == 4);
}

static int gain_once(const struct panel *panel, struct gsn_error *err)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_stain_gain gain;

    return gsn_calibration_gain(panel->patch, panel->count, &dyes, &gain, NULL, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct panel panel = wedge_of(1, 0);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(gain_once(&panel, &err), err);
}

/* A slide whose yellow lies far off, and one that lies where its own error lets it. */
TEST(vectors_apart_by_more_than_their_errors_disagree)
{
    const double little[GSN_DYE_ROTATIONS] = { 0.02, 0.01, 0.02, -0.03, 0.05, 0.02 };
    const double much[GSN_DYE_ROTATIONS] = { 0, 0, 0.4, 0, 0, 0 };
    const struct panel panel = panel_of(0.002, 6);
    struct gsn_dyes_fit calibrated, slide;
    struct gsn_error err = { 0 };
    struct gsn_dyes_apart apart;

    CHECK_OK(fit(&panel, &calibrated, &err), err);
    slide = calibrated;
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        slide.covariance[m][m] = 0.02 * 0.02;
    slide.dyes = gsn_dyes_rotated(&calibrated.dyes, little);
    apart = gsn_dyes_compare(&calibrated, &slide);
    CHECK(!apart.disagree[RED] && !apart.disagree[YELLOW] && !apart.disagree[DARK]);
    CHECK_NEAR(apart.deg[RED], hypot(0.02, 0.01) * 180 / M_PI, 0.01);
    slide.dyes = gsn_dyes_rotated(&calibrated.dyes, much);
    apart = gsn_dyes_compare(&calibrated, &slide);
    CHECK(!apart.disagree[RED] && apart.disagree[YELLOW] && !apart.disagree[DARK]);
    CHECK(apart.deg[YELLOW] > 3 * apart.expected[YELLOW]);
}
