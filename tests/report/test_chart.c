/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/report/chart.h"
#include "tests/report/sample.h"

static size_t count(const char *text, const char *piece)
{
    size_t n = 0;

    for (const char *at = strstr(text, piece); at; at = strstr(at + 1, piece))
        n++;
    return n;
}

TEST(steps_are_one_two_or_five)
{
    CHECK_NEAR(gsn_chart_step(10, 5), 2, 1e-12);
    CHECK_NEAR(gsn_chart_step(60, 12), 5, 1e-12);
    CHECK_NEAR(gsn_chart_step(1, 10), 0.1, 1e-12);
    CHECK_NEAR(gsn_chart_step(0.7, 5), 0.2, 1e-12);
    CHECK_NEAR(gsn_chart_step(1300, 5), 500, 1e-9);
    CHECK_NEAR(gsn_chart_step(4.1, 5), 1, 1e-12);
}

TEST(every_mark_found_in_a_posed_section_has_one_dot)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    const struct gsn_report *report = sample_report(sample);
    gsn_auto_report_text text = { .bytes = NULL };
    size_t marks = 0;

    for (size_t i = 0; i < report->section_count; i++)
        for (int k = 0; k < 3; k++)
            marks += report->sections[i].posed && report->sections[i].marker_found[k];
    gsn_chart_residuals(&text, report);
    CHECK(!text.failed);
    CHECK(count(text.bytes, "<title>Section") == marks + 2); /* and two sections without a pose */
    CHECK(count(text.bytes, "has no pose") == 2);
    CHECK(!strstr(text.bytes, "nan") && !strstr(text.bytes, "inf"));
    sample_free(sample);
}

/* The coordinates are the closed form of the frame: 0 is at y = 214, the top line at y = 34. */
TEST(bars_are_as_high_as_their_counts)
{
    static const size_t bin[2] = { 10, 5 };
    const struct gsn_report_units units = { 0, 1, bin, 2, 0.1, 0.4, 0.9 };
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_chart_densities(&text, &units);
    assert_non_null(strstr(text.bytes, "y=\"34.0\" width=\"246.0\" height=\"180.0\""));
    assert_non_null(strstr(text.bytes, "y=\"124.0\" width=\"246.0\" height=\"90.0\""));
    assert_non_null(strstr(text.bytes, "0.000 to 0.500: 10"));
    assert_non_null(strstr(text.bytes, "median 0.400"));
}

TEST(nothing_to_draw_draws_nothing_wrong)
{
    const struct gsn_report_units none = { 0, 0, NULL, 0, (double)NAN, (double)NAN, (double)NAN };
    const struct gsn_report empty = { .specimen = "x" };
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_chart_densities(&text, &none);
    CHECK(text.size == 0);
    gsn_chart_residuals(&text, &empty);
    CHECK(!strstr(text.bytes, "nan") && !strstr(text.bytes, "inf"));
}

TEST(the_bars_of_a_loss_are_its_densities)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_chart_loss(&text, 0.8, 0.5);
    assert_non_null(strstr(text.bytes, "width=\"320.0\""));
    assert_non_null(strstr(text.bytes, "width=\"200.0\""));
}
