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

/* ---- the strongest stained tissue ---- */

enum { BOX = 64 };

/* One section on panel 1 that fills half of its box: glass, pale tissue and a tenth of strong. */
static void draw_strong(struct gsn_plane *plane, double strong)
{
    for (size_t i = 0; i < BOX * BOX; i++)
        plane->value[i] = (float)(i % 2 ? 0.01 : i % 20 == 0 ? strong : 0.3);
    plane->value[0] = NAN;
}

TEST(the_strength_of_a_section_is_that_of_its_strongest_tissue)
{
    float value[BOX * BOX];
    struct gsn_plane plane = { BOX, BOX, value };
    struct gsn_error err = { 0 };
    double strength = 7;

    draw_strong(&plane, 0.9);
    CHECK_OK(gsn_uniformity_of_section(&plane, &strength, &err), err);
    CHECK_NEAR(strength, 0.9, 1e-6);
    CHECK_EVERY_OOM(gsn_uniformity_of_section(&plane, &strength, &err), err);
    plane.height = 1;
    CHECK_OK(gsn_uniformity_of_section(&plane, &strength, &err), err);
    CHECK(!(strength == strength));
}

TEST(the_strength_of_a_panel_is_the_median_of_its_sections)
{
    double three[] = { 0.9, NAN, 0.5, 0.7 }, none[] = { NAN };

    CHECK_NEAR(gsn_uniformity_of_panel(three, 4), 0.7, 0);
    CHECK(!(gsn_uniformity_of_panel(none, 1) == 0) && isnan(gsn_uniformity_of_panel(none, 1)));
}

TEST(even_baths_add_nothing_and_one_panel_tells_nothing)
{
    const double even[] = { 0.8, 0.8, 0.8 }, one[] = { 0.8, NAN };

    CHECK_NEAR(gsn_uniformity_of(even, 3, 2).error, 0, 1e-12);
    CHECK(gsn_uniformity_of(one, 2, 1).scatter == 0 && gsn_uniformity_of(one, 2, 1).panels == 1);
}

/* Strengths a factor apart have a logarithm's standard deviation in closed form. */
TEST(the_scatter_is_that_of_the_logarithms)
{
    const double apart[] = { 1, 1.1, NAN, 1.21 };
    const struct gsn_uniformity e = gsn_uniformity_of(apart, 4, 2);

    CHECK(e.panels == 3);
    CHECK_NEAR(e.scatter, log(1.1), 1e-12);
    CHECK_NEAR(e.error, 4.303 / 1.96 * log(1.1) / sqrt(2), 1e-9);
}

/* Case 41. Baths drawn with a scatter of a tenth: the error, times 1.96, holds the mean's deviation
 * in 95 of 100, although it is told from five panels. */
TEST(the_error_holds_what_unequal_baths_do)
{
    enum { DRAWS = 4000, PANELS = 5 };
    unsigned seed = 1, held = 0;

    for (int draw_ = 0; draw_ < DRAWS; draw_++) {
        double strength[PANELS], mean = 0;

        for (int p = 0; p < PANELS; p++) {
            double normal = -6;

            for (int k = 0; k < 12; k++) {
                seed = seed * 1664525u + 1013904223u;
                normal += (seed >> 8) / 16777216.0;
            }
            strength[p] = 0.8 * exp(0.1 * normal);
            mean += 0.1 * normal / PANELS;
        }
        held += fabs(mean) <= 1.96 * gsn_uniformity_of(strength, PANELS, PANELS).error;
    }
    CHECK_NEAR((double)held / DRAWS, 0.95, 0.015);
}
