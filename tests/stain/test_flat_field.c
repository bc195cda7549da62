/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "tests/stain/paint.h"
#include "pipeline/stain/flat_field.h"

static const struct scan even = { GSN_LIGHT_CODES_LINEAR, { 248, 244, 238 }, 0, 1.5 };

/* Tissue in 4 x 3 slots as on a panel; each takes this share of the side of its slot. */
static void cover(struct gsn_image *image, const struct scan *scan, double side,
                  const double amount[3], struct dice *dice)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();

    for (uint32_t y = 0; y < image->height; y++) {
        for (uint32_t x = 0; x < image->width; x++) {
            const double u = fmod((x + 0.5) * 4 / image->width, 1) - 0.5;
            const double v = fmod((y + 0.5) * 3 / image->height, 1) - 0.5;
            const double wave = 0.6 + 0.4 * sin(x * 0.31) * cos(y * 0.17);

            if (fabs(u) < side / 2 && fabs(v) < side / 2)
                paint(image, x, y, scan, &dyes,
                      (const double[3]){ amount[0] * wave, amount[1] * wave, amount[2] }, dice);
        }
    }
}

/* The largest error of the glass anywhere in the picture, as a share of the light. */
static double worst_error(const struct gsn_flat_field *glass, const struct scan *scan,
                          const struct gsn_image *image)
{
    double worst = 0;

    for (uint32_t y = 0; y < image->height; y += 3) {
        for (uint32_t x = 0; x < image->width; x += 3) {
            for (unsigned c = 0; c < 3; c++) {
                const double white = gsn_light_of_sample(scan->light, (unsigned)scan->white[c], 8);
                const double truth = white * scan_light(scan, image, x, y);

                worst = fmax(worst, fabs(gsn_flat_field_at(glass, x, y, c) / truth - 1));
            }
        }
    }
    return worst;
}

TEST(bare_glass_is_measured_to_a_tenth_of_a_percent)
{
    struct dice dice = { 1 };
    gsn_auto(gsn_image) image = paint_glass(400, 300, 8, &even, &dice);
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;

    CHECK_OK(gsn_flat_field_estimate(image, even.light, &glass, &err), err);
    CHECK(worst_error(&glass, &even, image) < 0.001);
    CHECK_NEAR(glass.white[0], 248, 0.2);
    CHECK_NEAR(glass.white[2], 238, 0.2);
    CHECK(glass.fraction > 0.97);
    /* 1.5 codes, and the rounding to whole ones, in units of optical density. */
    CHECK_NEAR(glass.noise_od, sqrt(1.5 * 1.5 + 1 / 12.0) / 243 / log(10), 4e-4);
    CHECK_NEAR(glass.overexposed, 0, 0.001);
}

/* Case 11. */
TEST(uneven_light_is_followed_in_both_meanings_of_the_samples)
{
    static const double falloff[] = { 0.02, 0.06, 0.15 };

    for (int i = 0; i < 3; i++) {
        for (int light = 0; light < 2; light++) {
            const struct scan scan = { (enum gsn_light)light, { 248, 244, 238 }, falloff[i], 1.2 };
            struct dice dice = { 2 };
            gsn_auto(gsn_image) image = paint_glass(460, 312, 8, &scan, &dice);
            struct gsn_error err = { 0 };
            struct gsn_flat_field glass;

            cover(image, &scan, 0.6, (const double[3]){ 0.4, 0.3, 0.05 }, &dice);
            CHECK_OK(gsn_flat_field_estimate(image, scan.light, &glass, &err), err);
            /* Light of 1 - x has a logarithm of -x - x^2/2: at the darkest corner x is 0.18, and
             * what a quadratic cannot follow there is 0.8 %. */
            CHECK(worst_error(&glass, &scan, image) < (i < 2 ? 0.003 : 0.008));
        }
    }
}

TEST(seventy_per_cent_of_tissue_do_not_move_the_glass)
{
    static const double stain[4][3] = {
        { 0.5, 0.3, 0.1 }, { 0, 0.08, 0 }, { 0.05, 0.05, 0 }, { 0.02, 0.02, 0 }
    };

    for (int i = 0; i < 4; i++) {
        struct dice dice = { 3 };
        gsn_auto(gsn_image) image = paint_glass(460, 312, 8, &even, &dice);
        struct gsn_error err = { 0 };
        struct gsn_flat_field glass;

        cover(image, &even, sqrt(0.7), stain[i], &dice);
        CHECK_OK(gsn_flat_field_estimate(image, even.light, &glass, &err), err);
        CHECK(worst_error(&glass, &even, image) < 0.003);
        CHECK_NEAR(glass.fraction, 0.3, 0.08);
    }
}

static void rectangle(struct gsn_image *image, uint32_t x0, uint32_t x1, uint32_t y0, uint32_t y1,
                      const uint8_t code[3])
{
    for (uint32_t y = y0; y < y1; y++)
        for (uint32_t x = x0; x < x1; x++)
            memcpy((uint8_t *)image->samples + ((size_t)y * image->width + x) * 3, code, 3);
}

TEST(a_white_label_with_text_and_pen_do_not_pull_it)
{
    static const uint8_t paper[3] = { 255, 255, 255 }, ink[3] = { 20, 20, 25 },
                         pen[3] = { 200, 20, 40 };
    const struct scan scan = { GSN_LIGHT_CODES_LINEAR, { 215, 212, 206 }, 0.05, 1.2 };
    struct dice dice = { 4 };
    gsn_auto(gsn_image) image = paint_glass(460, 312, 8, &scan, &dice);
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;

    cover(image, &scan, 0.6, (const double[3]){ 0.4, 0.3, 0.05 }, &dice);
    rectangle(image, 0, 40, 0, 312, paper);
    for (uint32_t y = 30; y < 280; y += 8)
        rectangle(image, 8, 30, y, y + 4, ink);
    rectangle(image, 150, 400, 100, 106, pen);
    CHECK_OK(gsn_flat_field_estimate(image, scan.light, &glass, &err), err);
    CHECK(worst_error(&glass, &scan, image) < 0.003);
}

/* Case 9. */
TEST(too_little_glass_is_refused_and_the_share_named)
{
    struct dice dice = { 5 };
    gsn_auto(gsn_image) image = paint_glass(460, 312, 8, &even, &dice);
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass = { .width = 77 };

    cover(image, &even, 0.96, (const double[3]){ 0.02, 0.25, 0.02 }, &dice);
    CHECK(gsn_flat_field_estimate(image, even.light, &glass, &err) == GSN_E_STAIN);
    assert_non_null(strstr(err.text, "% of this picture is blank glass; at least 15 % is needed"));
    CHECK(glass.width == 77);
}

TEST(a_picture_without_any_light_is_refused)
{
    gsn_auto(gsn_image) image = NULL;
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass = { .width = 77 };

    CHECK_OK(gsn_image_new(100, 100, 3, 16, &image, &err), err);
    CHECK(gsn_flat_field_estimate(image, GSN_LIGHT_SRGB, &glass, &err) == GSN_E_STAIN);
    CHECK(glass.width == 77);
}

TEST(overexposed_glass_is_told)
{
    const struct scan scan = { GSN_LIGHT_CODES_LINEAR, { 255, 250, 240 }, 0, 0.5 };
    struct dice dice = { 6 };
    gsn_auto(gsn_image) image = paint_glass(200, 200, 16, &scan, &dice);
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;

    CHECK_OK(gsn_flat_field_estimate(image, scan.light, &glass, &err), err);
    CHECK_NEAR(glass.overexposed, 0.5, 0.02);
}

TEST(grey_and_tiny_pictures_are_refused)
{
    gsn_auto(gsn_image) grey = NULL;
    gsn_auto(gsn_image) tiny = NULL;
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass;

    CHECK_OK(gsn_image_new(100, 100, 1, 8, &grey, &err), err);
    CHECK_OK(gsn_image_new(15, 100, 3, 8, &tiny, &err), err);
    CHECK(gsn_flat_field_estimate(grey, GSN_LIGHT_SRGB, &glass, &err) == GSN_E_INPUT);
    CHECK(gsn_flat_field_estimate(tiny, GSN_LIGHT_SRGB, &glass, &err) == GSN_E_INPUT);
}

static int estimate_once(const struct gsn_image *image, struct gsn_error *err)
{
    struct gsn_flat_field glass;

    return gsn_flat_field_estimate(image, GSN_LIGHT_SRGB, &glass, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct dice dice = { 1 };
    gsn_auto(gsn_image) image = paint_glass(32, 32, 8, &even, &dice);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(estimate_once(image, &err), err);
}

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
    struct gsn_flat_field glass;

    CHECK_OK(gsn_flat_field_given(40, 30, GSN_LIGHT_SRGB, white, &glass, &err), err);
    CHECK_NEAR(gsn_flat_field_at(&glass, 0, 0, 1), pow((245 / 255.0 + 0.055) / 1.055, 2.4), 1e-12);
    CHECK_NEAR(gsn_flat_field_at(&glass, 39, 29, 1), gsn_flat_field_at(&glass, 20, 7, 1), 0);
    CHECK_NEAR(glass.white[2], 234, 0);
    CHECK_NEAR(glass.fraction, 0, 0);
}

TEST(a_black_white_is_refused)
{
    struct gsn_error err = { 0 };
    struct gsn_flat_field glass = { .width = 77 };

    CHECK(gsn_flat_field_given(4, 4, GSN_LIGHT_SRGB, (const double[3]){ 255, 0, 255 }, &glass,
                               &err) == GSN_E_INPUT);
    CHECK(gsn_flat_field_given(4, 4, GSN_LIGHT_SRGB, (const double[3]){ NAN, 9, 9 }, &glass,
                               &err) == GSN_E_INPUT);
    CHECK(glass.width == 77);
}
