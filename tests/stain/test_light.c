/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/stain/light.h"

TEST(srgb_agrees_with_the_published_values)
{
    /* IEC 61966-2-1: half of the light is code 0.735357, half of the code is 0.214041 of light. */
    CHECK_NEAR(gsn_light_encode(GSN_LIGHT_SRGB, 0.5), 0.735356983052449, 1e-12);
    CHECK_NEAR(gsn_light_of_sample(GSN_LIGHT_SRGB, 10, 8), 10 / 255.0 / 12.92, 1e-15);
    CHECK_NEAR(gsn_light_of_sample(GSN_LIGHT_SRGB, 32768, 16), 0.2140480, 1e-6);
    CHECK_NEAR(gsn_light_of_sample(GSN_LIGHT_SRGB, 255, 8), 1, 1e-15);
}

TEST(every_code_survives_the_way_to_light_and_back)
{
    for (unsigned i = 0; i < 256; i++)
        for (int light = 0; light < 2; light++)
            CHECK_NEAR(255 * gsn_light_encode((enum gsn_light)light,
                                              gsn_light_of_sample((enum gsn_light)light, i, 8)),
                       i, 1e-5);
}

TEST(the_table_holds_the_logarithm_and_reads_zero_as_half_a_code)
{
    struct gsn_error err = { 0 };
    gsn_auto_mem(double) table = NULL;
    gsn_auto_mem(double) deep = NULL;

    CHECK_OK(gsn_light_table(GSN_LIGHT_CODES_LINEAR, 8, &table, &err), err);
    CHECK_NEAR(table[0], log10(0.5 / 255), 1e-14);
    CHECK_NEAR(table[51], log10(0.2), 1e-14);
    CHECK_OK(gsn_light_table(GSN_LIGHT_SRGB, 16, &deep, &err), err);
    CHECK_NEAR(deep[65535], 0, 1e-15);
    CHECK_NEAR(deep[32768], log10(gsn_light_of_sample(GSN_LIGHT_SRGB, 32768, 16)), 1e-14);
}

TEST(a_given_white_is_the_same_everywhere)
{
    const double white[3] = { 255, 245, 234 };
    struct gsn_error err = { 0 };
    struct gsn_glass glass;

    CHECK_OK(gsn_glass_given(40, 30, GSN_LIGHT_SRGB, white, &glass, &err), err);
    CHECK_NEAR(gsn_glass_at(&glass, 0, 0, 1), pow((245 / 255.0 + 0.055) / 1.055, 2.4), 1e-12);
    CHECK_NEAR(gsn_glass_at(&glass, 39, 29, 1), gsn_glass_at(&glass, 20, 7, 1), 0);
    CHECK_NEAR(glass.white[2], 234, 0);
    CHECK_NEAR(glass.fraction, 0, 0);
}

TEST(a_black_white_is_refused)
{
    struct gsn_error err = { 0 };
    struct gsn_glass glass = { .width = 77 };

    CHECK(gsn_glass_given(4, 4, GSN_LIGHT_SRGB, (const double[3]){ 255, 0, 255 }, &glass, &err) ==
          GSN_E_INPUT);
    CHECK(gsn_glass_given(4, 4, GSN_LIGHT_SRGB, (const double[3]){ NAN, 9, 9 }, &glass, &err) ==
          GSN_E_INPUT);
    CHECK(glass.width == 77);
}
