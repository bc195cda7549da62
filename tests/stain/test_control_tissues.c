/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/normalisation.h"

#include "pipeline/core/robust.h"
#include "tests/check.h"
#include "tests/stain/paint.h"

#include <math.h>
#include <string.h>

enum { PANELS = 5, SECTIONS = 9, DENSE = 0, LOOSE = 1, MIDDLE = 2 };

/* Steps that are known badly, so that their errors are seen beside the sections' noise. */
static struct gsn_gain_fit fit_of(double step, double drift)
{
    struct gsn_gain_fit fit = { .at = { 0.2, 0.9 }, .steps = PANELS - 1 };
    const double shape[3] = { 0.16, 0.2, 1 }; /* of pale, both, dense */

    for (int k = 0; k < 3; k++) {
        fit.covariance[k] = step * step * shape[k];
        fit.drift_covariance[k] = drift * drift * shape[k];
    }
    for (int i = 0; i < PANELS - 1; i++)
        fit.lag[i] = 3 + i;
    return fit;
}

static const double SHARE[PANELS] = { 0.3, 0.5, 0.2 };
static const double AT_UM = 430;

/* ---- one draw ------------------------------------------------------------------------------ */

/* What the steps are off by at density 0.2 and 0.9: a draw with the covariance of fit. */
static void draw_pair(struct dice *dice, const double c[3], double ret[2])
{
    const double a = dice_normal(dice), b = dice_normal(dice), l = sqrt(c[0]);

    ret[0] = l * a;
    ret[1] = c[1] / l * a + sqrt(c[2] - c[1] * c[1] / c[0]) * b;
}

/* What the levels of the panels are off by at a density, as they were stepped. */
struct lifts {
    double of[PANELS][2];
};

static struct lifts draw_lifts(struct dice *dice, const struct gsn_gain_fit *fit)
{
    struct lifts lifts = { 0 };
    double drift[2];

    draw_pair(dice, fit->drift_covariance, drift);
    for (int p = 1; p < PANELS; p++) {
        double step[2];

        draw_pair(dice, fit->covariance, step);
        for (int k = 0; k < 2; k++)
            lifts.of[p][k] = lifts.of[p - 1][k] + step[k] + fit->lag[p - 1] * drift[k];
    }
    return lifts;
}

static double lift_at(const struct lifts *lifts, int panel, double density)
{
    const double u = (density - 0.2) / 0.7;

    return (1 - u) * lifts->of[panel][0] + u * lifts->of[panel][1];
}

/* Against what the region is off by at that density. */
static double off_region(const struct lifts *lifts, int panel, double density)
{
    double region = 0;

    for (int p = 0; p < PANELS; p++)
        region += SHARE[p] * lift_at(lifts, p, density);
    return lift_at(lifts, panel, density) - region;
}

/* A tissue that thins along the block by a slope of its own, on panels from..PANELS-1. */
static size_t draw_tissue(struct dice *dice, const struct lifts *lifts, double density, int from,
                          struct gsn_control_seen seen[PANELS])
{
    const double slope = 1e-4 * density * dice_normal(dice);
    size_t n = 0;

    for (int p = from; p < PANELS; p++) {
        double section[SECTIONS], mean = 0;
        struct gsn_control_seen *s = &seen[n++];

        *s = (struct gsn_control_seen){ .panel = (size_t)p,
                                        .z_um = 144 + 288 * p,
                                        .sections = SECTIONS };
        for (int i = 0; i < SECTIONS; i++) {
            section[i] = density * (1 + 0.02 * dice_normal(dice)) + slope * (s->z_um - AT_UM) +
                         off_region(lifts, p, density);
            mean += section[i] / SECTIONS;
        }
        for (int i = 0; i < SECTIONS; i++)
            s->square += (section[i] - mean) * (section[i] - mean);
        s->value = gsn_order_pick(section, SECTIONS, SECTIONS / 2);
    }
    return n;
}

static const double DENSITY[GSN_CONTROL_TISSUES] = { 0.85, 0.2, 0.55 };

static struct gsn_control_tissues draw(struct dice *dice, const struct gsn_gain_fit *fit,
                                       const int from[GSN_CONTROL_TISSUES])
{
    const struct gsn_control_frame frame = { fit, SHARE, AT_UM };
    const struct lifts lifts = draw_lifts(dice, fit);
    struct gsn_control_seen seen[GSN_CONTROL_TISSUES][PANELS];
    const struct gsn_control_seen *const list[GSN_CONTROL_TISSUES] = { seen[0], seen[1], seen[2] };
    size_t count[GSN_CONTROL_TISSUES];
    struct gsn_control_tissues tissues;

    for (int t = 0; t < GSN_CONTROL_TISSUES; t++)
        count[t] = draw_tissue(dice, &lifts, DENSITY[t], from[t], seen[t]);
    gsn_control_tissues_at(&frame, list, count, &tissues);
    return tissues;
}

/* ---- one specimen -------------------------------------------------------------------------- */

/* 600 draws of a block whose middle tissue is seen on the last two panels only, off the region: the
 * errors said, and what two tissues' have in common, are those made. */
TEST(errors_of_tissues_are_the_ones_made_and_so_is_what_they_have_in_common)
{
    enum { DRAWS = 600 };
    static const int from[] = { 0, 0, 3 };
    const struct gsn_gain_fit fit = fit_of(0.03, 0.002);
    double made[GSN_CONTROL_TISSUES][GSN_CONTROL_TISSUES] = { { 0 } };
    double said[GSN_CONTROL_TISSUES][GSN_CONTROL_TISSUES] = { { 0 } };
    struct dice dice = { 71 };

    for (int d = 0; d < DRAWS; d++) {
        const struct gsn_control_tissues t = draw(&dice, &fit, from);

        for (int i = 0; i < GSN_CONTROL_TISSUES; i++)
            for (int j = 0; j < GSN_CONTROL_TISSUES; j++) {
                made[i][j] += (t.value[i] - DENSITY[i]) * (t.value[j] - DENSITY[j]) / DRAWS;
                said[i][j] += t.covariance[i][j] / DRAWS;
            }
    }
    for (int i = 0; i < GSN_CONTROL_TISSUES; i++) {
        CHECK(sqrt(said[i][i] / made[i][i]) > 0.92 && sqrt(said[i][i] / made[i][i]) < 1.25);
        for (int j = 0; j < i; j++)
            CHECK_NEAR(made[i][j], said[i][j], 0.12 * sqrt(said[i][i] * said[j][j]));
    }
    CHECK(sqrt(said[MIDDLE][MIDDLE]) > 0.03); /* two panels that agree do not make it known */
    CHECK(sqrt(said[DENSE][DENSE]) < 0.006);  /* on the region's own panels steps do not matter */
}

/* Panels that agree by chance say no less what their sections scatter by, all of them together. */
TEST(two_panels_that_agree_are_not_known_better_than_their_sections_scatter)
{
    const struct gsn_gain_fit fit = fit_of(0.001, 0);
    const struct gsn_control_frame frame = { &fit, SHARE, 288 };
    const struct gsn_control_seen alike[] = { { 0, 144, 0.6, 9, 8 * 0.0004 },
                                              { 1, 432, 0.6, 9, 8 * 0.0004 } };
    const struct gsn_control_seen *const list[GSN_CONTROL_TISSUES] = { alike, NULL, NULL };
    struct gsn_control_tissues t;

    gsn_control_tissues_at(&frame, list, (const size_t[]){ 2, 0, 0 }, &t);
    CHECK_NEAR(t.value[DENSE], 0.6, 1e-12);
    /* A median of 9 with deviation 0.02, twice: 0.02 sqrt(1.57 / 18). */
    CHECK_NEAR(gsn_control_tissue_error(&t, DENSE), 0.02 * sqrt(1.57 / 18), 2e-4);
    CHECK(isnan(t.value[LOOSE]) && isnan(t.covariance[LOOSE][DENSE]));
}

/* Next to no red, and grain: dense tissue is known no worse for it. */
TEST(pale_tissue_that_scatters_says_nothing_of_dense_tissue)
{
    const struct gsn_gain_fit fit = fit_of(1e-6, 0);
    const double share[PANELS] = { 1 };
    const struct gsn_control_frame frame = { &fit, share, 144 };
    const struct gsn_control_seen dense = { 0, 144, 0.9, 9, 8 * 0.0001 };
    const struct gsn_control_seen pale = { 0, 144, 0.001, 9, 8 * 0.0009 };
    const struct gsn_control_seen *const list[GSN_CONTROL_TISSUES] = { &dense, &pale, NULL };
    struct gsn_control_tissues t;

    gsn_control_tissues_at(&frame, list, (const size_t[]){ 1, 1, 0 }, &t);
    CHECK_NEAR(gsn_control_tissue_error(&t, LOOSE), 0.03 * sqrt(1.57 / 9), 2e-4);
    /* Their squares are pooled, so it is at most what both scatter by together. */
    CHECK(gsn_control_tissue_error(&t, DENSE) >= 0.01 * sqrt(1.57 / 9));
    CHECK(gsn_control_tissue_error(&t, DENSE) <= sqrt(0.0001 + 0.0009) * sqrt(1.57 / 9) + 2e-4);
}

/* Region on panel 0, tissue on panel 2: two steps, a drift over both lags, and what tissue may
 * change by over the distance. */
TEST(a_tissue_two_panels_off_is_as_uncertain_as_the_steps_between)
{
    const struct gsn_gain_fit fit = fit_of(0.03, 0.004);
    const double share[PANELS] = { 1 };
    const struct gsn_control_frame frame = { &fit, share, 144 };
    const struct gsn_control_seen far = { 2, 720, 0.9, 10, 0 };
    const struct gsn_control_seen *const list[GSN_CONTROL_TISSUES] = { &far, NULL, NULL };
    const double steps = 2 * 0.0009, drift = 0.004 * (3 + 4), thins = 1e-4 * 0.9 * 576;
    struct gsn_control_tissues t;

    gsn_control_tissues_at(&frame, list, (const size_t[]){ 1, 0, 0 }, &t);
    CHECK_NEAR(t.value[DENSE], 0.9, 1e-12);
    CHECK_NEAR(t.covariance[DENSE][DENSE], steps + drift * drift + thins * thins, 2e-6);
}

/* Where steps are exact, the straight line through the panels is read at the region's height. */
TEST(a_tissue_that_runs_along_the_block_is_told_where_the_region_lies)
{
    const struct gsn_gain_fit fit = fit_of(1e-6, 0);
    const struct gsn_control_frame frame = { &fit, SHARE, 420 };
    struct gsn_control_seen panel[PANELS];

    for (int p = 0; p < PANELS; p++)
        panel[p] = (struct gsn_control_seen){ (size_t)p, 144 + 288 * p,
                                              0.9 - 5e-5 * (144 + 288 * p), 10, 1e-5 };
    for (size_t from = 0; from < 2; from++) {
        const struct gsn_control_seen *const list[GSN_CONTROL_TISSUES] = { panel + from, NULL,
                                                                           NULL };
        struct gsn_control_tissues t;

        gsn_control_tissues_at(&frame, list, (const size_t[]){ PANELS - from, 0, 0 }, &t);
        CHECK_NEAR(t.value[DENSE], 0.9 - 5e-5 * 420, 2e-4);
        CHECK(gsn_control_tissue_error(&t, DENSE) < 1e-3);
    }
}

/* ---- two specimens ------------------------------------------------------------------------- */

static const struct gsn_gain_offset SPREAD = { 0.06, 0.03 };

static struct gsn_control_tissues tissues_of(double error)
{
    struct gsn_control_tissues t = { .value = { 0.85, 0.2, 0.55 } };

    for (int i = 0; i < GSN_CONTROL_TISSUES; i++)
        t.covariance[i][i] = error * error;
    return t;
}

static struct gsn_control_tissues stained(const struct gsn_control_tissues *there, double gain,
                                          double offset)
{
    struct gsn_control_tissues here = *there;

    for (int i = 0; i < GSN_CONTROL_TISSUES; i++)
        here.value[i] = gain * there->value[i] + offset;
    return here;
}

TEST(two_specimens_are_linked_by_tissue_that_nobody_treated)
{
    const struct gsn_control_tissues there = tissues_of(0.004);
    struct gsn_control_tissues here = stained(&there, 1.15, 0.02);
    struct gsn_batch_calibration link;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_batch_calibrate(&here, &there, &SPREAD, &link, &err), err);
    CHECK(link.tissues == 3 && link.disagreement < 0.5);
    CHECK_NEAR(link.gain * 0.84 + link.offset, 1.15 * 0.84 + 0.02, 0.01);
    CHECK_NEAR(gsn_batch_calibration_error(&link, 0.84), 0.84 * 0.02 * sqrt(2), 0.008);
    /* One that is not seen in both does not take part. */
    here.value[MIDDLE] = (double)NAN;
    CHECK_OK(gsn_batch_calibrate(&here, &there, &SPREAD, &link, &err), err);
    CHECK(link.tissues == 2);
    CHECK_NEAR(link.gain * 0.84 + link.offset, 1.15 * 0.84 + 0.02, 0.012);
}

/* Even baths say that a difference of a percent is the animal's; a wide one is the stain's still.
 */
TEST(even_baths_leave_the_animals_their_differences)
{
    const struct gsn_gain_offset none = { 0, 0 };
    const struct gsn_control_tissues there = tissues_of(0.002);
    struct gsn_control_tissues here = stained(&there, 1.02, 0);
    struct gsn_batch_calibration link;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_batch_calibrate(&here, &there, &none, &link, &err), err);
    CHECK_NEAR(link.gain * 0.84 + link.offset, 0.84, 0.002);
    here = stained(&there, 1.15, 0);
    CHECK_OK(gsn_batch_calibrate(&here, &there, &none, &link, &err), err);
    CHECK_NEAR(link.gain * 0.84 + link.offset, 1.15 * 0.84, 0.015);
}

/* Two tissues of like error tell what lies between them as well as their mean does, and one that
 * they share as well as one. */
TEST(an_error_that_tissues_share_is_not_counted_as_two_witnesses)
{
    const struct gsn_gain_offset wide = { 0.5, 0.5 };
    const struct gsn_control_tissues there = tissues_of(0.002);
    struct gsn_control_tissues here = there;
    struct gsn_batch_calibration apart, shared;
    struct gsn_error err = { 0 };

    here.value[LOOSE] = (double)NAN;
    here.covariance[DENSE][DENSE] = here.covariance[MIDDLE][MIDDLE] = 0.01;
    CHECK_OK(gsn_batch_calibrate(&here, &there, &wide, &apart, &err), err);
    here.covariance[DENSE][MIDDLE] = here.covariance[MIDDLE][DENSE] = 0.0099;
    CHECK_OK(gsn_batch_calibrate(&here, &there, &wide, &shared, &err), err);
    CHECK_NEAR(gsn_batch_calibration_error(&apart, 0.7), 0.1 / sqrt(2), 0.005);
    CHECK_NEAR(gsn_batch_calibration_error(&shared, 0.7), 0.1, 0.005);
}

/* Case 41. */
TEST(a_tissue_that_changed_shows_as_disagreement)
{
    const struct gsn_control_tissues there = tissues_of(0.004);
    struct gsn_control_tissues here = there;
    struct gsn_batch_calibration link = { .gain = -7 };
    struct gsn_error err = { 0 };

    here.value[MIDDLE] *= 0.75;
    CHECK_OK(gsn_batch_calibrate(&here, &there, &SPREAD, &link, &err), err);
    CHECK(link.disagreement > 2);
    link.gain = -7;
    here.value[DENSE] = here.value[LOOSE] = (double)NAN;
    CHECK(gsn_batch_calibrate(&here, &there, &SPREAD, &link, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "share 1 kind of untreated tissue"));
    CHECK(link.gain == -7);
}

TEST(errors_that_contradict_each_other_are_refused)
{
    const struct gsn_control_tissues there = tissues_of(0.004);
    struct gsn_control_tissues here = there;
    struct gsn_batch_calibration link = { .gain = -7 };
    struct gsn_error err = { 0 };

    here.covariance[DENSE][LOOSE] = here.covariance[LOOSE][DENSE] = 1;
    CHECK(gsn_batch_calibrate(&here, &there, &SPREAD, &link, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "contradict each other"));
    CHECK(link.gain == -7);
}
