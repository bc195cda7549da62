/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/staining_uniformity.h"

#include "tests/check.h"
#include "tests/stain/paint.h"

#include <string.h>

enum { SIDE = 120 };

static int tone_of(const double amount[3], int masked, struct gsn_stain_amounts *ret,
                   struct gsn_error *err)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    const struct gsn_pixel_box box = { 10, 0, SIDE - 10, SIDE };
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) green = NULL;
    gsn_auto(gsn_plane) blue = NULL;
    gsn_auto(gsn_plane) density = NULL;
    int r = gsn_plane_new(SIDE, SIDE, &red, err);

    if (r < 0 || (r = gsn_plane_new(SIDE, SIDE, &green, err)) < 0 ||
        (r = gsn_plane_new(SIDE, SIDE, &blue, err)) < 0 ||
        (r = gsn_plane_new(SIDE, SIDE, &density, err)) < 0)
        return r;
    struct gsn_plane *od[3] = { red, green, blue };

    for (size_t i = 0; i < SIDE * SIDE; i++)
        for (int c = 0; c < 3; c++) {
            /* The lower half is glass; a quarter of the rest is masked and very red. */
            const int glass = i > SIDE * SIDE / 2, hidden = masked && i % 4 == 0;

            od[c]->value[i] = glass
                                  ? 0
                                  : (float)((hidden ? 3 : amount[0]) * dyes.red[c] +
                                            amount[1] * dyes.yellow[c] + amount[2] * dyes.dark[c]);
            density->value[i] = hidden ? NAN : 0;
        }
    return gsn_stain_amounts_of(od, density, &dyes, &box, ret, err);
}

TEST(the_tone_is_what_was_painted_without_glass_and_masked)
{
    const double amount[3] = { 0.5, 0.2, 0.1 };
    struct gsn_error err = { 0 };
    struct gsn_stain_amounts tone;

    CHECK_OK(tone_of(amount, 1, &tone, &err), err);
    for (int k = 0; k < 3; k++)
        CHECK_NEAR(tone.amount[k], amount[k], 1e-5);
    CHECK_NEAR(gsn_stain_amounts_yellow_to_red(&tone), 0.4, 1e-4);
    CHECK_EVERY_OOM(tone_of(amount, 1, &tone, &err), err);
}

TEST(sums_weigh_by_pixels_and_little_tissue_has_no_ratio)
{
    const struct gsn_stain_amounts a = { { 0.4, 0.2, 0.1 }, 3000 }, b = { { 0.8, 0.2, 0.3 }, 1000 };
    const struct gsn_stain_amounts none = { .pixels = 0 }, pale = { { 0.001, 0.2, 0 }, 3000 };
    const struct gsn_stain_amounts sum = gsn_stain_amounts_sum(&a, &b),
                                   same = gsn_stain_amounts_sum(&a, &none);

    CHECK_NEAR(sum.amount[0], 0.5, 1e-12);
    CHECK_NEAR(sum.amount[2], 0.15, 1e-12);
    CHECK(sum.pixels == 4000 && same.pixels == 3000);
    CHECK_NEAR(same.amount[1], 0.2, 1e-12);
    CHECK(isnan(gsn_stain_amounts_yellow_to_red(&none)) &&
          isnan(gsn_stain_amounts_yellow_to_red(&pale)));
}

static void usual(struct gsn_stain_amounts tone[12], double scatter)
{
    for (int i = 0; i < 12; i++) {
        const double by = exp(scatter * sin(2.4 * i));

        tone[i] = (struct gsn_stain_amounts){ { 0.5 * by, 0.2 * by, 0.08 * by }, 5000 };
    }
}

/* Case 46. */
TEST(a_section_whose_dyes_are_stronger_together_is_thick)
{
    struct gsn_stain_amounts tone[12];

    usual(tone, 0.02);
    for (int k = 0; k < 3; k++) {
        tone[3].amount[k] = 1.4 * (double[]){ 0.5, 0.2, 0.08 }[k];
        tone[8].amount[k] = 0.7 * (double[]){ 0.5, 0.2, 0.08 }[k];
    }
    CHECK_NEAR(gsn_stain_amounts_thickness(tone, 12, 3), 1.4, 0.05);
    CHECK_NEAR(gsn_stain_amounts_thickness(tone, 12, 8), 0.7, 0.03);
    for (size_t i = 0; i < 12; i++)
        CHECK((gsn_stain_amounts_thickness(tone, 12, i) != 1) == (i == 3 || i == 8));
    /* A bath that is stronger as a whole is no knife. */
    for (int i = 0; i < 12; i++)
        for (int k = 0; k < 3; k++)
            tone[i].amount[k] *= 2;
    CHECK_NEAR(gsn_stain_amounts_thickness(tone, 12, 3), 1.4, 0.05);
    CHECK_NEAR(gsn_stain_amounts_thickness(tone, 12, 4), 1, 0);
}

TEST(what_one_dye_does_alone_or_all_sections_do_is_no_thickness)
{
    struct gsn_stain_amounts tone[12];

    usual(tone, 0.02);
    tone[3].amount[0] *= 1.5; /* more fibres */
    CHECK_NEAR(gsn_stain_amounts_thickness(tone, 12, 3), 1, 0);
    usual(tone, 0.15); /* they all scatter */
    for (size_t i = 0; i < 12; i++)
        CHECK_NEAR(gsn_stain_amounts_thickness(tone, 12, i), 1, 0);
    usual(tone, 0.02);
    for (int k = 0; k < 3; k++)
        tone[1].amount[k] *= 1.4;
    CHECK_NEAR(gsn_stain_amounts_thickness(tone, 4, 1), 1, 0); /* too few to compare with */
    tone[1].pixels = 10;
    CHECK_NEAR(gsn_stain_amounts_thickness(tone, 12, 1), 1, 0);
}
