/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/stain/reference.h"
#include "tests/stain/paint.h"

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
