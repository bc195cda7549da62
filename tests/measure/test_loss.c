/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/distributions.h"
#include "pipeline/measure/loss.h"

#include <string.h>

#include "pipeline/measure/stats.h"
#include "tests/check.h"

static struct gsn_loss_side side(const char *name, double mean)
{
    return (struct gsn_loss_side){ .name = name,
                                   .definition = "fuchsin concentration 1",
                                   .dyes = "phantom 1",
                                   .mean = mean,
                                   .volume_um3 = 2.5e9 };
}

TEST(relative_per_cent_and_points_are_both_given)
{
    const struct gsn_loss_side control = side("S00", 0.40), treated = side("S02", 0.30);
    struct gsn_loss loss;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_loss(&control, &treated, 0.95, &loss, &err), err);
    CHECK_NEAR(loss.percent, 25.0, 1e-12);
    CHECK_NEAR(loss.points, 10.0, 1e-12);
    CHECK(!loss.has_interval);
}

TEST(no_change_is_no_loss_and_a_gain_is_negative)
{
    const struct gsn_loss_side control = side("S00", 0.40), gained = side("S01", 0.50);
    struct gsn_loss loss;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_loss(&control, &control, 0.95, &loss, &err), err);
    CHECK_NEAR(loss.percent, 0.0, 0.0);
    CHECK_OK(gsn_loss(&control, &gained, 0.95, &loss, &err), err);
    CHECK_NEAR(loss.percent, -25.0, 1e-12);
    CHECK_NEAR(loss.points, -10.0, 1e-12);
}

TEST(standard_errors_give_fiellers_interval_with_student_for_few_animals)
{
    struct gsn_loss_side control = side("saline", 0.40), treated = side("particles", 0.30);
    struct gsn_loss known, few;
    struct gsn_error err = { 0 };
    double low, high;

    control.standard_error = 0.02;
    treated.standard_error = 0.03;
    CHECK_OK(gsn_loss(&control, &treated, 0.95, &known, &err), err);
    CHECK(known.has_interval);
    CHECK_OK(gsn_fieller(0.30, 9e-4, 0.40, 4e-4, gsn_normal_quantile(0.975), &low, &high, &err),
             err);
    CHECK_NEAR(known.percent_low, 100.0 * (1.0 - high), 1e-10);
    CHECK_NEAR(known.percent_high, 100.0 * (1.0 - low), 1e-10);

    control.freedom = treated.freedom = 4.0;
    CHECK_OK(gsn_loss(&control, &treated, 0.95, &few, &err), err);
    CHECK(few.percent_low < known.percent_low && few.percent_high > known.percent_high);
}

static void check_refused(const struct gsn_loss_side *control, const struct gsn_loss_side *treated,
                          int code, const char *words)
{
    struct gsn_loss loss, before;
    struct gsn_error err = { 0 };

    memset(&loss, 0x5a, sizeof loss);
    before = loss;
    CHECK(gsn_loss(control, treated, 0.95, &loss, &err) == code);
    CHECK(memcmp(&loss, &before, sizeof loss) == 0);
    if (!strstr(err.text, words))
        fail_msg("\"%s\" does not say \"%s\"", err.text, words);
}

TEST(what_cannot_be_compared_is_refused_by_name)
{
    const struct gsn_loss_side control = side("S00", 0.40);
    struct gsn_loss_side other = side("S02", 0.30);

    other.volume_um3 *= 1.0011;
    check_refused(&control, &other, GSN_E_INPUT,
                  "the regions differ: S00 has 2.5 mm3 (not known how), S02 has");
    other = side("S02", 0.30);
    other.definition = "area fraction 1";
    check_refused(&control, &other, GSN_E_INPUT, "the density definitions differ");
    other = side("S02", 0.30);
    other.dyes = "batch 7";
    check_refused(&control, &other, GSN_E_INPUT, "the dye vectors differ");
    other = side("S02", NAN);
    check_refused(&control, &other, GSN_E_INPUT, "S02: mean");
    other = side("S02", 0.30);
    other.standard_error = -1.0;
    check_refused(&control, &other, GSN_E_INPUT, "S02: standard error");
}

/* A band 180 um wide about two roots of unlike size is one region on two animals. */
TEST(regions_that_one_rule_laid_are_compared_whatever_their_size)
{
    struct gsn_loss_side control = side("S00", 0.40), other = side("S02", 0.30);
    struct gsn_loss loss;
    struct gsn_error err = { 0 };

    control.volume_um3 = 0.612e9;
    other.volume_um3 = 0.555e9;
    control.region = other.region = "180 to 630 um from the surface of the root";
    CHECK_OK(gsn_loss(&control, &other, 0.95, &loss, &err), err);
    CHECK_NEAR(loss.percent, 25, 1e-12);
    other.region = "0 to 630 um from the surface of the root";
    check_refused(&control, &other, GSN_E_INPUT, "S02 has 0.555 mm3 (0 to 630 um");
    control.region = "";
    check_refused(&control, &other, GSN_E_INPUT, "S00 has 0.612 mm3 (not known how)");
}

TEST(a_region_of_the_same_size_up_to_rounding_is_the_same)
{
    const struct gsn_loss_side control = side("S00", 0.40);
    struct gsn_loss_side other = side("S02", 0.30);
    struct gsn_loss loss;
    struct gsn_error err = { 0 };

    other.volume_um3 *= 0.9991;
    CHECK_OK(gsn_loss(&control, &other, 0.95, &loss, &err), err);
}

/* Case 53. */
TEST(a_baseline_near_zero_withholds_the_loss)
{
    struct gsn_loss_side nothing = side("S00", 1e-7), thin = side("S03", 0.05);
    struct gsn_loss_side treated = side("S02", 0.30);

    check_refused(&nothing, &treated, GSN_E_WITHHELD, "too near zero");
    thin.standard_error = 0.03;
    treated.standard_error = 0.01;
    check_refused(&thin, &treated, GSN_E_WITHHELD, "baseline S03");
}
