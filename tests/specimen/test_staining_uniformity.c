/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/normalisation.h"

#include "tests/check.h"

enum { SIDE = 64 };

/* One section on panel 1 that fills half of its box: glass, pale tissue and a tenth of strong. */
static void draw(struct gsn_plane *plane, double strong)
{
    for (size_t i = 0; i < SIDE * SIDE; i++)
        plane->value[i] = (float)(i % 2 ? 0.01 : i % 20 == 0 ? strong : 0.3);
    plane->value[0] = NAN;
}

TEST(the_strength_of_a_section_is_that_of_its_strongest_tissue)
{
    float value[SIDE * SIDE];
    struct gsn_plane plane = { SIDE, SIDE, value };
    struct gsn_error err = { 0 };
    double strength = 7;

    draw(&plane, 0.9);
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
