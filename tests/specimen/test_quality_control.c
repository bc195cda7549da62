/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Panels that were drawn, then spoilt by lamp, dust, bath or knife; what the report says of it. */
#include "pipeline/specimen/reconstruction.h"
#include "pipeline/specimen/quality_control.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/specimen/process.h"
#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"

#include <stdio.h>
#include <string.h>

#define DENSITY 0.8
#define JOB_WITH(more)                                                                             \
    "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD ", \"region\": " DRAWN_REGION more "}"

typedef void spoil(unsigned panel, struct gsn_image *image);

static void nothing(unsigned panel, struct gsn_image *image)
{
    (void)panel;
    (void)image;
}

static void dim(struct gsn_image *image, uint32_t x, uint32_t y, double by)
{
    uint8_t *at = (uint8_t *)image->samples + 3 * ((size_t)y * image->width + x);

    for (int c = 0; c < 3; c++)
        at[c] = (uint8_t)(by * at[c] + 0.5);
}

/* gives: three panels of one density, spoilt after their sections were found. */
static void specimen_of(struct drawn_specimen *d, const char *job, spoil *spoilt)
{
    drawn_specimen_even(d, job, DENSITY);
    for (unsigned i = 0; i < 3; i++) {
        const struct drawn_panel panel = drawn_panel_of(i + 1, 24, DENSITY);
        gsn_auto(gsn_image) image = drawn_panel_image(&panel);
        struct gsn_error err = { 0 };
        uint8_t *png = NULL;

        spoilt(i + 1, image);
        CHECK_OK(gsn_png_encode(image, &png, &d->panel[i].size, &err), err);
        gsn_free(d->png[i]);
        d->png[i] = png;
    }
}

static struct gsn_specimen_result *worked(const struct drawn_specimen *d)
{
    const struct gsn_specimen_options how = { .mesher = GSN_MESHER, .threads = 1 };
    struct gsn_specimen_result *result = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_process(&d->specimen, &how, &result, &err), err);
    return result;
}

static double mean_density(const struct gsn_specimen_result *result)
{
    for (size_t i = 0; i < result->measure_count; i++)
        if (strcmp(result->measure[i].name, "mean_density") == 0)
            return result->measure[i].value;
    return NAN;
}

TEST(clean_panels_have_nothing_to_say)
{
    drawn_auto d;

    specimen_of(&d,
                JOB_WITH(", \"yellow_to_red\": [0.3, 0.45], \"stained\": \"2026-03-01\", "
                         "\"scanned\": \"2026-03-29\""),
                nothing);
    gsn_auto(gsn_specimen_result) result = worked(&d);

    CHECK(strstr(result->json, "\"warnings\": []") != NULL);
    CHECK(strstr(result->json, "panel 1: glass even to 0.00") != NULL);
    CHECK(strstr(result->json, "yellow to red 0.38") != NULL);
}

static void flicker(unsigned panel, struct gsn_image *image)
{
    for (uint32_t y = 90; panel == 2 && y < 132; y++)
        for (uint32_t x = 0; x < image->width; x++)
            dim(image, x, y, 0.95);
}

/* Case 8. A fifth of the rows of one panel have 5 % less light. */
TEST(a_lamp_that_flickers_asks_for_another_scan)
{
    drawn_auto d;

    specimen_of(&d, JOB_WITH(""), flicker);
    gsn_auto(gsn_specimen_result) result = worked(&d);
    const char *at = strstr(result->json, "panel 2: the blank glass drifts by ");
    double percent = 0;

    CHECK(at && sscanf(at, "panel 2: the blank glass drifts by %lf %%", &percent) == 1);
    CHECK(percent > 3.5 && percent < 6.5);
    CHECK(strstr(at, "from row to row within the scan, and 2.3 % are allowed: the lamp flickers or "
                     "was still warming up; let it warm up and scan the panel again") != NULL);
    CHECK(!strstr(result->json, "panel 1: the blank glass drifts"));
    CHECK(!strstr(result->json, "panel 3: the blank glass drifts"));
}

/* Case 11. What is left of uneven light is printed with every report: here a falloff that the
 * glass's surface follows, and a band that it does not. */
TEST(what_is_left_of_the_light_is_shown)
{
    drawn_auto d;
    double even = 1, spoilt = 0;

    specimen_of(&d, JOB_WITH(""), flicker);
    gsn_auto(gsn_specimen_result) result = worked(&d);
    const char *one = strstr(result->json, "panel 1: glass even to ");
    const char *two = strstr(result->json, "panel 2: glass even to ");

    CHECK(one && two);
    CHECK(sscanf(one, "panel 1: glass even to %lf", &even) == 1);
    CHECK(sscanf(two, "panel 2: glass even to %lf", &spoilt) == 1);
    print_message("  %g, with a band %g\n", even, spoilt);
    CHECK(even < 0.005 && spoilt > 2 * even);
}

static const uint32_t SPECK[2][2] = { { 54, 60 }, { 108, 150 } }; /* tissue, and glass */

static void soil(unsigned panel, struct gsn_image *image)
{
    (void)panel;
    for (int k = 0; k < 2; k++)
        for (uint32_t y = SPECK[k][1] - 1; y <= SPECK[k][1] + 1; y++)
            for (uint32_t x = SPECK[k][0] - 1; x <= SPECK[k][0] + 1; x++)
                dim(image, x, y, 0.6);
}

static void soil_two(unsigned panel, struct gsn_image *image)
{
    if (panel < 3)
        soil(panel, image);
}

/* Case 10. */
TEST(dust_of_the_scanner_is_masked_on_every_panel_and_asks_for_cleaning)
{
    drawn_auto d;

    specimen_of(&d, JOB_WITH(""), soil);
    gsn_auto(gsn_specimen_result) result = worked(&d);

    CHECK(strstr(result->json, "2 spots are dark at the same place of all 3 panels, at (") != NULL);
    CHECK(strstr(result->json, "dirt on the scanner's glass or sensor. They are masked; clean it "
                               "before the next panel") != NULL);
    CHECK(strstr(result->json, "\"dust\"") != NULL);
    CHECK(strstr(result->json, "dark at this place of every panel") != NULL);
    CHECK_NEAR(mean_density(result), DENSITY, 0.004);
}

TEST(what_only_some_panels_have_is_no_dust_of_the_scanner)
{
    drawn_auto d;

    specimen_of(&d, JOB_WITH(""), soil_two);
    gsn_auto(gsn_specimen_result) result = worked(&d);

    CHECK(!strstr(result->json, "at the same place of all"));
    CHECK(!strstr(result->json, "\"dust\""));
}

static void nothing_but(const char *job, const char *said)
{
    drawn_auto d;

    specimen_of(&d, job, nothing);
    gsn_auto(gsn_specimen_result) result = worked(&d);

    if (!strstr(result->json, said))
        fail_msg("not said: %s", said);
}

/* Case 42. The panels were drawn with 0.34 (1 - 0.55 d) of yellow over 0.62 d of red. */
TEST(a_bath_beyond_its_batchs_limits_says_which_dye_was_lost)
{
    nothing_but(JOB_WITH(", \"yellow_to_red\": [0.2, 0.3]"),
                "panel 3: yellow dye is 0.38 times the red, the batch's limits are 0.2 to 0.3: red "
                "was washed out (differentiated too long) or yellow rinsed too little; compare "
                "with the batch's control glass");
    nothing_but(JOB_WITH(", \"yellow_to_red\": [0.5, 0.6]"),
                "the batch's limits are 0.5 to 0.6: yellow was washed out (in water) or red "
                "differentiated too little");
}

/* Case 43. */
TEST(a_stain_that_waited_for_its_scan_is_told)
{
    nothing_but(JOB_WITH(", \"stained\": \"2026-01-05\", \"scanned\": \"2026-06-01\""),
                "stained on 2026-01-05 and scanned on 2026-06-01, 147 days later: picro-fuchsin "
                "fades, and what has faded looks like loss; compare only with a control of the "
                "same age");
}

static struct gsn_reconstruction *cut(double first, double second)
{
    struct gsn_reconstruction *a = gsn_alloc_array(1, sizeof *a);

    a->poses.section_count = 12;
    a->poses.section = gsn_alloc_array(12, sizeof *a->poses.section);
    a->densities.section_count = 12;
    a->densities.section = gsn_alloc_array(12, sizeof *a->densities.section);
    for (unsigned i = 0; i < 12; i++) {
        a->poses.section[i].seen.serial = i;
        a->densities.section[i].thickness = i == 3 ? first : i == 8 ? second : 1;
    }
    return a;
}

static int words_of(const struct gsn_reconstruction *a, struct gsn_quality_sentences *words)
{
    const struct gsn_protocol none = { .days_to_scan = NAN };

    return gsn_quality_sentences(&a->poses, &a->densities, &none, words);
}

/* Case 46. */
TEST(a_section_that_was_cut_too_thick_is_suspected)
{
    gsn_auto(gsn_reconstruction) a = cut(1.42, 1);
    gsn_auto(gsn_reconstruction) both = cut(1.42, 0.7);
    struct gsn_quality_sentences one = { 0 }, two = { 0 };

    CHECK(words_of(a, &one) == GSN_OK && one.count == 1);
    assert_string_equal(one.sentence[0],
                        "all dyes of section 3 (1.4 times) differ together from the panel's other "
                        "sections: thickness suspected, look at the knife; its density is not "
                        "corrected");
    CHECK(words_of(both, &two) == GSN_OK && two.count == 1);
    CHECK(strstr(two.sentence[0], "sections 3 (1.4 times), 8 (0.7 times) differ together") != NULL);
    gsn_quality_sentences_done(&one);
    gsn_quality_sentences_done(&two);
}

/* A quarter of panel 2 is ink, and a little more. */
TEST(a_panel_that_is_mostly_ink_is_asked_about)
{
    gsn_auto(gsn_reconstruction) a = cut(1, 1);
    const struct gsn_specimen_panel given = { .number = 2 };
    struct gsn_quality_sentences none = { 0 }, one = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new_unseen(
                 &(struct gsn_lattice){ .nx = 1, .ny = 1, .nz = 1, .step_um = { 1, 1, 1 } },
                 &a->densities.grid, &err),
             err);
    a->densities.panel_count = 1;
    a->densities.panel = gsn_alloc_array(1, sizeof *a->densities.panel);
    a->densities.panel[0].given = &given;
    a->densities.panel[0].opened = 1;
    for (unsigned i = 0; i < 12; i++) {
        a->poses.section[i].panel = i < 8 ? 2 : 1;
        a->densities.section[i].masked.outline_um2 = 8e6;
        a->densities.section[i].masked.area_um2[5] = i < 8 ? 2e6 : 8e6;
    }
    CHECK(words_of(a, &none) == GSN_OK && none.count == 0);
    a->densities.section[3].masked.area_um2[5] = 3e6;
    CHECK(words_of(a, &one) == GSN_OK && one.count == 1);
    assert_string_equal(one.sentence[0],
                        "panel 2: 27 % of its tissue has a colour that the dyes do not explain and "
                        "is left out as ink; if it is not drawn upon, it was stained by other dyes "
                        "than those that the job goes by: state a calibration panel, or \"dyes\": "
                        "\"estimate\"");
    gsn_quality_sentences_done(&none);
    gsn_quality_sentences_done(&one);
}

static int words_once(const struct gsn_reconstruction *a, struct gsn_error *err)
{
    struct gsn_quality_sentences words = { 0 };
    const int r = words_of(a, &words);

    gsn_quality_sentences_done(&words);
    return r < 0 ? gsn_fail(err, r, "out of memory") : r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_reconstruction) a = cut(1.42, 0.7);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(words_once(a, &err), err);
}
