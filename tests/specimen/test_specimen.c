/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/process.h"

#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/stain/stain_vectors.h"
#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"
#include "tests/specimen/flags.h"
#include "tests/specimen/often.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

static const struct gsn_specimen_options OPTIONS = { .mesher = GSN_MESHER, .threads = 1 };

#define TREATED_JOB                                                                                \
    "{\"specimen\": \"treated\", \"baseline\": \"control\", \"thresholds\": [0.5], \"lens\": "     \
    "4, " DRAWN_JOB_HEAD ", \"region\": " DRAWN_REGION "}"
#define TREATED_MARKS_JOB                                                                          \
    "{\"specimen\": \"treated\", \"baseline\": \"control\", \"registration\": "                    \
    "\"marks\", " DRAWN_JOB_HEAD ", \"region\": " DRAWN_REGION "}"

static struct gsn_specimen_result *worked(const struct drawn_specimen *d, unsigned threads)
{
    const struct gsn_specimen_options how = { .mesher = GSN_MESHER, .threads = threads };
    struct gsn_specimen_result *result = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_process(&d->specimen, &how, &result, &err), err);
    return result;
}

static double measure(const struct gsn_specimen_result *result, const char *name)
{
    for (size_t i = 0; i < result->measure_count; i++)
        if (strcmp(result->measure[i].name, name) == 0)
            return result->measure[i].value;
    return NAN;
}

static int has_measure(const struct gsn_specimen_result *result, const char *name)
{
    return isfinite(measure(result, name)) != 0;
}

/* gives: the report, parsed. Its page is one whole document that holds the verdict's reason. */
static json_t *report_of(const struct gsn_specimen_result *result)
{
    json_error_t where;
    json_t *root = json_loadb(result->json, result->json_size, JSON_REJECT_DUPLICATES, &where);

    if (!root)
        fail_msg("report.json line %d: %s", where.line, where.text);
    CHECK(strlen(result->html) == result->html_size);
    CHECK(strncasecmp(result->html, "<!doctype html>", 15) == 0);
    CHECK(strstr(result->html, "</html>") != NULL);
    CHECK(result->withheld ==
          (strcmp(json_string_value(json_object_get(root, "verdict")), "withheld") == 0));
    /* Quotes look different on a page. */
    gsn_auto_mem(char) reason =
        gsn_format("%.*s", (int)strcspn(result->message, "\""), result->message);

    CHECK(!result->withheld || (reason[0] && strstr(result->html, reason) != NULL));
    return root;
}

static int has_text(const json_t *array, const char *words)
{
    for (size_t i = 0; i < json_array_size(array); i++)
        if (strstr(json_string_value(json_array_get(array, i)), words))
            return 1;
    return 0;
}

static const char *text_at(const json_t *root, const char *key)
{
    const char *text = json_string_value(json_object_get(root, key));

    return text ? text : "";
}

/* A strip of tissue beside the region, on every section. */
#define REFERENCE(density)                                                                         \
    ", \"reference\": {\"tissue\": {\"shape\": \"box\", \"min\": [-264, 216, 0], \"max\": "        \
    "[264, 384, 288]}, \"density\": " #density "}"
#define WITH_REGION(more)                                                                          \
    "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD ", \"region\": " DRAWN_REGION more "}"

/* What no marks lay is not laid by tissue either. */
#define MARKS_JOB WITH_REGION(", \"registration\": \"marks\"")

/* A control whose region held red alone, and that hands no more on. */
static const struct gsn_specimen_control RED = { .region_od = { 0.1186, 0.3551, 0.3249 } };

/* The control's figures as a store would hand them on. */
static struct gsn_specimen_baseline baseline_of(const struct gsn_specimen_result *control)
{
    return (struct gsn_specimen_baseline){ .name = "control",
                                           .specimens = 1,
                                           .control = &control->colours,
                                           .mean_density = measure(control, "mean_density"),
                                           .mean_density_error =
                                               has_measure(control, "mean_density_error")
                                                   ? measure(control, "mean_density_error")
                                                   : 0,
                                           .section_error =
                                               has_measure(control, "section_error")
                                                   ? measure(control, "section_error")
                                                   : 0,
                                           .volume_mm3 = measure(control, "region_volume"),
                                           .definition = control->definition,
                                           .dyes = control->dyes };
}

TEST(the_loss_of_two_drawn_specimens_is_that_of_their_densities)
{
    drawn_auto control, treated;

    drawn_specimen_even(&control, DRAWN_JOB, 0.8);
    drawn_specimen_even(&treated, TREATED_JOB, 0.6);
    gsn_auto(gsn_specimen_result) base = worked(&control, 1);

    treated.specimen.baseline = baseline_of(base);
    gsn_auto(gsn_specimen_result) result = worked(&treated, 1);
    json_t *root = report_of(result);

    CHECK(!base->withheld && !result->withheld);
    CHECK_NEAR(measure(base, "mean_density"), 0.8, 0.004);
    CHECK_NEAR(measure(base, "region_volume"), 576e-3 * 336e-3 * 192e-3, 1e-6);
    CHECK_NEAR(measure(base, "coverage"), 1, 0);
    CHECK_NEAR(measure(result, "mean_density"), 0.6, 0.004);
    CHECK_NEAR(measure(result, "loss"), 25, 0.5);
    CHECK_NEAR(measure(result, "loss"),
               100 * (1 - measure(result, "mean_density") / measure(base, "mean_density")), 1e-9);
    CHECK_NEAR(measure(result, "loss_points"), 20, 0.5);
    CHECK(!has_measure(base, "loss"));
    CHECK_NEAR(json_number_value(json_object_get(root, "loss_percent")), 25, 0.5);
    CHECK(result->pose_count == 12 && result->stain_count == 3);
    CHECK(strcmp(text_at(root, "verdict"), "reported with warnings") == 0);
    CHECK(has_text(json_object_get(root, "warnings"), "not used: \"lens\""));
    /* Nobody measured the dyes, and no untreated tissue is drawn. */
    CHECK(has_text(json_object_get(root, "warnings"), "volumes above a density are withheld"));
    CHECK(json_array_size(json_object_get(root, "warnings")) == 2);
    /* All sections are drawn alike, so their tissue says nothing of their order. */
    CHECK(strstr(result->json, "a swap of two sections may not show") != NULL);
    CHECK(json_array_size(json_object_get(root, "sections")) == 12);
    json_decref(root);

    /* The same bytes on another number of threads. */
    gsn_auto(gsn_specimen_result) two = worked(&treated, 2);

    CHECK(two->json_size == result->json_size &&
          memcmp(two->json, result->json, two->json_size) == 0);
    CHECK(two->html_size == result->html_size &&
          memcmp(two->html, result->html, two->html_size) == 0);
}

/* Case 41. Panels that were stained 15 % stronger and 10 % paler read alike. */
TEST(a_reference_tissue_takes_the_strength_of_the_stain_out_panel_by_panel)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, (double[]){ 0.5, 0.5 * 1.15, 0.5 * 0.9 }[i]);
    drawn_specimen_init(&d, WITH_REGION(REFERENCE(0.5)), panels, 3);
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);
    json_t *root = report_of(result);

    CHECK(!result->withheld);
    CHECK_NEAR(measure(result, "mean_density"), 0.5, 0.003);
    CHECK(strstr(result->definition, "reference 0.5") != NULL);
    CHECK(strstr(result->json, "panel 2: 1.1") != NULL);
    json_decref(root);
}

/* Sections that scatter by 2 % tell the gain no better: the interval is that of the two gains. */
TEST(the_interval_on_the_loss_holds_the_error_of_the_gains)
{
    struct drawn_panel panels[2][3];
    drawn_auto control, treated;

    for (unsigned i = 0; i < 6; i++) {
        panels[i / 3][i % 3] = drawn_panel_of(i % 3 + 1, 24, i < 3 ? 0.6 : 0.62);
        for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++)
            panels[i / 3][i % 3].section[slot].density *= slot % 2 ? 1.02 : 0.98;
    }
    drawn_specimen_init(&control, WITH_REGION(", \"tolerance\": 0.1" REFERENCE(0.6)), panels[0], 3);
    drawn_specimen_init(
        &treated, WITH_REGION(", \"tolerance\": 0.1, \"baseline\": \"control\"" REFERENCE(0.6)),
        panels[1], 3);
    gsn_auto(gsn_specimen_result) base = worked(&control, 1);

    treated.specimen.baseline = baseline_of(base);
    gsn_auto(gsn_specimen_result) result = worked(&treated, 1);
    const struct gsn_specimen_measure *loss = NULL;
    /* Four sections that scatter by 2 % of 2 sqrt(4 / 3) on each of three panels, on both sides. */
    const double each = 0.02 * sqrt(4 / 3.0) / 2 / sqrt(3);
    /* Each of the eight that cross the region is 4 % off the middle of its neighbours, which is off
     * by 1.5 times its variance. */
    const double section = 0.04 / sqrt(1.5) / sqrt(8);

    for (size_t i = 0; i < result->measure_count; i++)
        if (strcmp(result->measure[i].name, "loss") == 0)
            loss = &result->measure[i];
    assert_non_null(loss);
    CHECK_NEAR(measure(base, "mean_density_error") / measure(base, "mean_density"), each, 5e-4);
    CHECK_NEAR(measure(base, "section_error") / measure(base, "mean_density"), section, 5e-4);
    CHECK_NEAR(loss->value, 0, 0.5);
    CHECK_NEAR(loss->upper - loss->lower, 2 * 1.96 * 100 * hypot(each, section) * sqrt(2), 0.5);
    CHECK(strstr(result->json, "95 %, stain, white, dye vectors and sections") != NULL);
}

/* Case 12. Tissue so dark that the red dye leaves no light at all in green and blue. */
TEST(a_section_that_is_clipped_is_held_and_the_share_is_said)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.8);
    panels[1].section[2].density = 7;
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);

    CHECK(strstr(result->json, "clipped-") != NULL);
    CHECK(strstr(result->json, "too much of it is clipped: scan its panel again") != NULL);
    CHECK_NEAR(measure(result, "mean_density"), 0.8, 0.01);
}

/* Cases 41 and 50. */
TEST(batches_are_not_compared_without_a_reference)
{
    drawn_auto control, treated, apart;

    drawn_specimen_even(&control, WITH_REGION(", \"batch\": \"A\""), 0.8);
    drawn_specimen_even(&treated, WITH_REGION(", \"batch\": \"A\", \"baseline\": \"control\""),
                        0.6);
    drawn_specimen_even(&apart, WITH_REGION(", \"batch\": \"B\", \"baseline\": \"control\""), 0.6);
    gsn_auto(gsn_specimen_result) base = worked(&control, 1);

    treated.specimen.baseline = baseline_of(base);
    apart.specimen.baseline = baseline_of(base);
    gsn_auto(gsn_specimen_result) same = worked(&treated, 1);
    gsn_auto(gsn_specimen_result) other = worked(&apart, 1);
    json_t *root = report_of(other);

    CHECK_NEAR(measure(same, "loss"), 25, 0.5);
    CHECK(!has_measure(other, "loss"));
    CHECK(has_text(json_object_get(root, "warnings"), "batches not comparable: the control was"));
    json_decref(root);
}

/* Case 41. */
TEST(a_reference_that_shows_too_little_withholds_the_loss_and_says_so)
{
    drawn_auto d;

    drawn_specimen_even(&d,
                        WITH_REGION(", \"baseline\": \"control\", \"reference\": {\"tissue\": "
                                    "{\"shape\": \"box\", \"min\": [-264, 216, 0], \"max\": "
                                    "[264, 384, 48]}, \"density\": 0.5}"),
                        0.6);
    d.specimen.baseline = (struct gsn_specimen_baseline){ .name = "control",
                                                          .specimens = 1,
                                                          .control = &RED,
                                                          .mean_density = 0.5,
                                                          .volume_mm3 = 1,
                                                          .definition = "",
                                                          .dyes = "" };
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);
    json_t *root = report_of(result);

    CHECK(!has_measure(result, "loss"));
    CHECK(strstr(result->definition, "reference") == NULL);
    CHECK(has_text(json_object_get(root, "warnings"),
                   "batches not comparable: panel 1: the reference tissue shows on 2 sections"));
    json_decref(root);
}

TEST(without_the_baselines_result_the_figures_stand_and_the_loss_does_not)
{
    drawn_auto d;

    drawn_specimen_even(&d, TREATED_JOB, 0.6);
    gsn_auto(gsn_specimen_result) result = worked(&d, 2);
    json_t *root = report_of(result);

    CHECK(result->withheld);
    CHECK(strcmp(result->message, "the baseline control has no result yet: import and run it") ==
          0);
    CHECK(json_is_null(json_object_get(root, "loss_percent")));
    CHECK(strcmp(text_at(root, "loss_reason"), result->message) == 0);
    CHECK_NEAR(measure(result, "mean_density"), 0.6, 0.004);
    json_decref(root);
}

/* It was run, and is itself withheld: to import it again would not help. */
TEST(a_withheld_baseline_is_not_called_missing)
{
    drawn_auto d;

    drawn_specimen_even(&d, TREATED_JOB, 0.6);
    d.specimen.baseline = (struct gsn_specimen_baseline){ .name = "control", .withheld = 1 };
    gsn_auto(gsn_specimen_result) result = worked(&d, 2);

    CHECK(result->withheld);
    CHECK(strcmp(result->message, "the baseline control was run and its own figure is withheld: "
                                  "settle what its report says, then run again") == 0);
}

/* A region of which less than 90 % was seen has figures, but no loss. */
/* dyes outlives d. */
static void draw_gaps(struct drawn_specimen *d, const char *job, struct drawn_panel panels[3],
                      const struct gsn_dyes *dyes)
{
    drawn_specimen_init(d, job, panels, 3);
    d->specimen.baseline =
        (struct gsn_specimen_baseline){ .name = "control",
                                        .specimens = 1,
                                        .control = &RED,
                                        .mean_density = 0.8,
                                        .volume_mm3 = 576e-3 * 336e-3 * 192e-3,
                                        .definition =
                                            "collagen-equivalent density (red dye by unmixing)",
                                        .dyes = dyes->name };
}

/* Cases 25 and 29. */
TEST(lost_sections_are_bridged_counted_and_said)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct drawn_panel panels[3];
    drawn_auto d, control;

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.6);
    panels[1].section[0].missing = panels[1].section[2].missing = 1;
    drawn_specimen_even(&control, DRAWN_JOB, 0.8);
    draw_gaps(&d, TREATED_JOB, panels, &dyes);
    gsn_auto(gsn_specimen_result) base = worked(&control, 2);

    d.specimen.baseline = baseline_of(base);
    gsn_auto(gsn_specimen_result) gaps = worked(&d, 2);
    json_t *root = report_of(gaps);

    CHECK(!gaps->withheld);
    CHECK_NEAR(measure(gaps, "coverage"), 0.75, 1e-9);
    CHECK_NEAR(measure(gaps, "mean_density"), 0.6, 0.004);
    CHECK_NEAR(measure(gaps, "loss"), 25, 0.5);
    CHECK(has_text(json_object_get(root, "warnings"),
                   "2 expected sections are missing; nothing was moved up to close the gap"));
    CHECK(has_text(json_object_get(root, "warnings"),
                   "25.0 % of the region of interest was not seen and is bridged from the sections "
                   "beside it"));
    CHECK(json_array_size(json_object_get(root, "exclusions")) == 1);
    CHECK(strstr(gaps->json, "2 sections: 2.1, 2.3") != NULL);
    CHECK(strstr(gaps->json, "the slot is empty; the gap is kept at its place") != NULL);
    json_decref(root);
}

/* Cases 20 and 21. */
TEST(sections_that_lack_marks_are_doubtful_or_held_and_said)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.6);
    panels[1].section[1].no_marks = 2;
    panels[2].section[1].no_marks = 6;
    drawn_specimen_init(&d, MARKS_JOB, panels, 3);
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);

    CHECK(strstr(result->json, "1 section was laid by two marks only: compare with the "
                               "neighbours") != NULL);
    CHECK(strstr(result->json, "1 section is held and not used") != NULL);
    CHECK(strstr(result->json, "fewer than two marks were found: look at it") != NULL);
}

/* No marks: the report stands, by tissue, and says what that cannot know. */
TEST(a_stack_without_marks_goes_to_a_report_by_tissue)
{
    struct drawn_panel panels[3];
    drawn_auto d;
    const json_t *registration;

    for (unsigned p = 0; p < 3; p++) {
        panels[p] = drawn_panel_of(p + 1, 24, 0.7);
        for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
            panels[p].section[slot].no_marks = 7;
            panels[p].section[slot].lopsided = 1;
            panels[p].section[slot].grain = 4 * p + slot + 1;
        }
    }
    drawn_specimen_init(
        &d,
        "{\"specimen\": \"drawn\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 3, "
        "\"transfer\": \"linear\", \"registration\": \"tissue\", \"frame\": [2, 2], "
        "\"region\": {\"shape\": \"cylinder\", \"centre\": [3900, 1300], \"radius\": "
        "300, \"z\": [48, 240]}}",
        panels, 3);
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);
    json_t *root = report_of(result);

    CHECK(!result->withheld && result->pose_count == 12);
    /* The waves of the drawn structure leave some of its mean. */
    CHECK_NEAR(measure(result, "mean_density"), 0.7, 0.1);
    registration = json_object_get(root, "registration");
    CHECK(strcmp(text_at(registration, "by"), "tissue") == 0);
    CHECK(json_is_null(json_object_get(registration, "fle_um")));
    CHECK(json_is_null(json_object_get(registration, "worst_residual_um")));
    CHECK(json_number_value(json_object_get(registration, "comparison_um")) > 0);
    CHECK(json_integer_value(json_object_get(registration, "sections_posed")) == 12);
    CHECK(has_text(json_object_get(root, "warnings"), "laid by their tissue alone"));
    CHECK(has_text(json_object_get(root, "warnings"), "a block that is bent or slanted"));
    CHECK(strstr(result->html, "the upright picture of panel 2"));
    json_decref(root);
}

/* Case 22. Spots that could be the marks as well as those that were chosen: nothing is chosen. */
TEST(a_section_whose_marks_could_be_others_is_held_and_said)
{
    drawn_auto d;

    drawn_specimen_even(&d, MARKS_JOB, 0.6);
    struct gsn_panel_section *s = &d.findings[1]->section[2];

    for (size_t m = 0; m < GSN_FIDUCIALS; m++)
        s->mark[m] = (struct gsn_fiducial){ .found = 0 };
    s->sighting = GSN_SIGHT_NEEDS_EYE;
    s->flags = gsn_flags_of_text("ambiguous-marks");
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);

    CHECK(strstr(result->json, "more than one choice of marks fits the triangle: look at it") !=
          NULL);
}

static double predicted(const struct gsn_specimen_result *result, size_t section)
{
    json_t *root = report_of(result);
    const json_t *row = json_array_get(json_object_get(root, "sections"), section);
    const double tre = json_number_value(json_object_get(row, "predicted_tre_um"));

    json_decref(root);
    return tre;
}

/* Case 23. A mark of which only a part is left is known ten times worse along one axis. */
TEST(a_torn_mark_weighs_less_and_its_section_has_a_larger_error)
{
    drawn_auto whole, torn;

    drawn_specimen_even(&whole, DRAWN_JOB, 0.6);
    drawn_specimen_even(&torn, DRAWN_JOB, 0.6);
    torn.findings[1]->section[2].mark[0].cov_xx += 1;
    gsn_auto(gsn_specimen_result) before = worked(&whole, 1);
    gsn_auto(gsn_specimen_result) after = worked(&torn, 1);

    print_message("  predicted_tre_um: %.2f whole, %.2f torn\n", predicted(before, 6),
                  predicted(after, 6));
    CHECK(predicted(after, 6) > 1.2 * predicted(before, 6));
}

/* Case 49. */
TEST(a_loss_needs_most_of_the_region)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct drawn_panel panels[3];
    drawn_auto d;

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.6);
    panels[1].section[0].missing = panels[1].section[2].missing = 1;
    panels[2].section[0].missing = 1;
    draw_gaps(&d, TREATED_JOB, panels, &dyes);
    gsn_auto(gsn_specimen_result) gaps = worked(&d, 2);

    CHECK(gaps->withheld);
    CHECK(strcmp(gaps->message,
                 "only 62 % of the region of interest was measured; the rest could only be bridged "
                 "from the sections beside it") == 0);
    CHECK(!has_measure(gaps, "loss"));
    CHECK_NEAR(measure(gaps, "coverage"), 0.625, 1e-9);
}

static void check_panel_named(int baseline, const char *ends)
{
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct drawn_panel panels[3];
    drawn_auto d;

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.6);
    for (unsigned k = 0; k < 4; k++)
        panels[1].section[k].no_marks = 6;
    draw_gaps(&d, TREATED_MARKS_JOB, panels, &dyes);
    if (!baseline)
        d.specimen.baseline = (struct gsn_specimen_baseline){ .name = "control" };
    gsn_auto(gsn_specimen_result) gaps = worked(&d, 2);

    CHECK(gaps->withheld);
    assert_non_null(strstr(gaps->message, "panel 2 of 3 without a section that is used (P02.png); "
                                          "so only 50 % of the region of interest "));
    assert_string_equal(gaps->message + strlen(gaps->message) - strlen(ends), ends);
}

/* A whole panel that is not there is named, with what to do, beside what else is lacking. */
TEST(a_panel_that_gives_nothing_is_named_where_the_loss_is_withheld)
{
    check_panel_named(1, "");
    check_panel_named(0, "; the baseline control has no result yet: import and run it");
}

/* Each panel that gives nothing has its own reason, and each reason its own remedy. */
TEST(panels_that_are_lost_refused_held_or_have_not_come_are_told_apart)
{
    static const char job[] = "{\"specimen\": \"drawn\", \"px_um\": 24, \"layout\": [2, 2], "
                              "\"panels\": 5, \"transfer\": \"linear\", "
                              "\"markers_um\": " DRAWN_MARKS_JSON ", \"region\": " DRAWN_REGION "}";
    static const struct gsn_specimen_decision lost = { .panel = 4, .answer = "lost" };
    drawn_auto d;

    drawn_specimen_even(&d, job, 0.6);
    for (size_t i = 1; i < 3; i++) {
        d.panel[i].section_count = 0;
        d.panel[i].state = i == 1 ? "refused" : "held";
    }
    d.specimen.decision = &lost;
    d.specimen.decision_count = 1;
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);

    CHECK(result->withheld);
    assert_non_null(strstr(
        result->message, "panel 2 of 5 refused (P02.png); panel 3 of 5 held (P03.png); panel 4 of "
                         "5 lost; panel 5 of 5 not come: import what is missing, or say `gieson "
                         "decide SPECIMEN PANEL lost`; so only "));
}

/* What is said is why the first thing failed, with how often, and not what followed from it. */
TEST(the_headline_is_the_first_cause_and_not_its_last_consequence)
{
#define PIXELS "job.json states pixels of 12 um, but by the triangle of its marks they are "
#define LABEL "its label says GVP-D-S01-P0"
    static const struct {
        const char *state[3], *message[3];
        const char *says;
    } cases[] = {
        { { "held", "held", "held" },
          { PIXELS "16 um: put \"px_um\" right", PIXELS "16.01 um: put \"px_um\" right",
            PIXELS "15.99 um: put \"px_um\" right" },
          "3 of 3 panels held: " PIXELS "16 um: put \"px_um\" right" },
        { { "held", "held", "held" },
          { LABEL "1, but it came as panel 1 of drawn", LABEL "2, but it came as panel 2 of drawn",
            LABEL "3, but it came as panel 3 of drawn" },
          "3 of 3 panels held: " LABEL "1, but it came as panel 1 of drawn" },
        { { "refused", "held", "held" },
          { "truncated JPEG: the data end at byte 17", PIXELS "16 um", PIXELS "16 um" },
          "2 of 3 panels held: " PIXELS
          "16 um; panel 1 of 3 refused (P01.png): truncated JPEG: the "
          "data end at byte 17" },
        { { "refused", "refused", "refused" },
          { "no picture: it begins with \"hello\"", "no picture: it begins with \"hello\"",
            "no picture: it begins with \"hello\"" },
          "3 of 3 panels refused: no picture: it begins with \"hello\"" },
    };

    for (size_t i = 0; i <= sizeof cases / sizeof cases[0]; i++) {
        const int none = i == sizeof cases / sizeof cases[0];
        drawn_auto d;

        drawn_specimen_even(&d, DRAWN_JOB, 0.6);
        for (size_t p = 0; p < 3 && !none; p++) {
            d.panel[p].section_count = 0;
            d.panel[p].state = cases[i].state[p];
            d.panel[p].message = cases[i].message[p];
        }
        d.specimen.panel_count = none ? 0 : 3;
        gsn_auto(gsn_specimen_result) result = worked(&d, 1);
        json_t *root = report_of(result);

        CHECK(result->withheld);
        assert_string_equal(result->message,
                            none ? "no panel has come: put the pictures of the panels beside "
                                   "job.json and import the folder again"
                                 : cases[i].says);
        assert_string_equal(json_string_value(json_object_get(root, "verdict_reason")),
                            result->message);
        json_decref(root);
    }
}

/* Withheld reports: no figure, the reason, and still every section and panel. */
struct withheld_case {
    const char *job, *says;
    int no_marks, refused;
};

static void check_withheld(const struct withheld_case *c)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    for (unsigned i = 0; i < 12; i++) {
        if (i % 4 == 0)
            panels[i / 4] = drawn_panel_of(i / 4 + 1, 24, 0.6);
        panels[i / 4].section[i % 4].no_marks = c->no_marks ? 7 : 0;
    }
    drawn_specimen_init(&d, c->job, panels, 3);
    for (size_t i = 0; c->refused && i < 3; i++) {
        d.panel[i].section_count = 0;
        d.panel[i].state = "refused";
        d.panel[i].message = "the file is cut off";
    }
    gsn_auto(gsn_specimen_result) result = worked(&d, 1);
    json_t *root = report_of(result);

    CHECK(result->withheld);
    if (!strstr(result->message, c->says))
        fail_msg("%s\nsays: %s", c->job, result->message);
    CHECK(!has_measure(result, "mean_density"));
    CHECK(json_is_null(json_object_get(root, "loss_percent")));
    if (c->refused)
        CHECK(has_text(json_object_get(root, "warnings"),
                       "P01.png, P02.png, P03.png were not used: the file is cut off"));
    json_decref(root);
}

TEST(a_withheld_report_is_whole_and_says_why)
{
    static const struct withheld_case cases[] = {
        { "{\"specimen\": \"x\", " DRAWN_JOB_HEAD "}", "add \"region\" to job.json", 0, 0 },
        { DRAWN_JOB, "mark", 1, 0 },
        { DRAWN_JOB, "", 0, 1 },
        { "{\"specimen\": \"x\", " DRAWN_JOB_HEAD
          ", \"region\": {\"shape\": \"box\", \"min\": [0, 0, 900], \"max\": [99, 99, 990]}}",
          "does not lie in this block", 0, 0 },
        { "{\"specimen\": \"x\", " DRAWN_JOB_HEAD
          ", \"region\": {\"shape\": \"box\", \"min\": [5000, 0, 48], \"max\": [5200, 200, "
          "240]}}",
          "only 0 % of the region of interest has data", 0, 0 },
        { "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"transfer\": \"linear\", "
          "\"marker_um\": " DRAWN_MARKS_JSON ", \"region\": " DRAWN_REGION "}",
          "but \"markers_um\" is not stated in job.json; it has keys that are not used: "
          "\"marker_um\"",
          0, 0 },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++)
        check_withheld(&cases[i]);
}

/* Case 55. A block of the volume that nobody measured. */
TEST(units_without_samples_are_counted_apart)
{
    static const char job[] = "{\"specimen\": \"v\", \"kind\": \"volume\", \"file\": \"v.mhd\"}";
    const struct gsn_lattice at = { .nx = 24, .ny = 24, .nz = 24, .step_um = { 20, 20, 20 } };
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_protocol) protocol = drawn_protocol(job);
    gsn_auto(gsn_specimen_result) result = NULL;
    struct gsn_error err = { 0 };
    const char *said;
    double without = 0;

    CHECK_OK(gsn_grid_new(&at, &grid, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&at); i++)
        grid->value[i] = i % 24 < 10 && i / 24 % 24 < 10 && i / 576 < 10 ? NAN : 0.5F;
    const struct gsn_specimen specimen = {
        .protocol = protocol, .volume = grid, .baseline = { .name = "" }, .key = "0"
    };

    CHECK_OK(gsn_specimen_process(&specimen, &OPTIONS, &result, &err), err);
    said = strstr(result->json, "\"Micro-units without data\"");
    CHECK(said && sscanf(strstr(said, "\"value\":"), "\"value\": %lf", &without) == 1);
    print_message("  %g units without data\n", without);
    CHECK(without > 0);
    CHECK_NEAR(measure(result, "mean_density"), 0.5, 1e-4);
}

TEST(a_shape_outside_a_volume_is_withheld_and_no_failure_of_the_job)
{
    static const char job[] =
        "{\"specimen\": \"v\", \"kind\": \"volume\", \"file\": \"v.mhd\", \"region\": "
        "{\"shape\": \"sphere\", \"centre\": [9000, 0, 0], \"radius\": 50}}";
    const struct gsn_lattice at = { .nx = 6, .ny = 6, .nz = 6, .step_um = { 20, 20, 20 } };
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_protocol) protocol = drawn_protocol(job);
    gsn_auto(gsn_specimen_result) result = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_grid_new(&at, &grid, &err), err);
    const struct gsn_specimen specimen = {
        .protocol = protocol, .volume = grid, .baseline = { .name = "" }, .key = "0"
    };

    CHECK_OK(gsn_specimen_process(&specimen, &OPTIONS, &result, &err), err);
    CHECK(result->withheld && strstr(result->message, "holds no voxel") != NULL);
    json_decref(report_of(result));
}

TEST(bytes_that_are_gone_fail_the_job_and_give_no_report)
{
    struct gsn_specimen_result *result = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, 0.6);
    d.panel[2].sha256 = "none";
    CHECK(gsn_specimen_process(&d.specimen, &OPTIONS, &result, &err) == GSN_E_NOTFOUND);
    CHECK(result == NULL && strstr(err.text, "panel 3 (P03.png)") != NULL);
}

static int work_once(const struct gsn_specimen *specimen, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_result) result = NULL;

    return gsn_specimen_process(specimen, &OPTIONS, &result, err);
}

TEST(running_out_of_memory_anywhere_is_said_and_leaks_nothing)
{
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, 0.6);
    CHECK_MANY_OOM(work_once(&d.specimen, &err), err, 40, 7);
}

static int summarise_once(const struct gsn_report_inputs *evidence, struct gsn_error *err)
{
    struct gsn_specimen_result *result = gsn_alloc_array(1, sizeof *result);
    int r = result ? gsn_report_build(evidence, result, err)
                   : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    gsn_specimen_result_free(result);
    return r;
}

/* Every text of the report is one allocation; none may go missing unsaid. */
TEST(a_report_never_misses_a_text_for_want_of_memory)
{
    struct drawn_panel panels[3];
    gsn_auto(gsn_reconstruction) assembly = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.6);
    panels[0].section[1].missing = 1;
    panels[1].section[1].no_marks = 6;
    panels[2].section[1].no_marks = 2;
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    CHECK_OK(gsn_reconstruct(&d.specimen, &OPTIONS, &assembly, &err), err);
    const struct gsn_report_inputs evidence = { .specimen = &d.specimen,
                                                .reconstruction = assembly,
                                                .withheld = "there is no analysis" };

    CHECK_EVERY_OOM(summarise_once(&evidence, &err), err);
}
