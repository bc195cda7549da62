/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/study/index_page.h"

#include "tests/check.h"

#include <math.h>
#include <string.h>

static struct gsn_study_specimen specimen(const char *name, double loss)
{
    struct gsn_study_specimen s = { .name = name,
                                    .animal = name,
                                    .group = "drug",
                                    .week = 2,
                                    .control = "placebo",
                                    .loss = loss,
                                    .loss_lower = loss - 3,
                                    .loss_upper = loss + 2,
                                    .page = "reports/a/0123/report.html",
                                    .key = "",
                                    .finished = 1764115200,
                                    .first = 1764115200 };

    for (size_t m = 0; m < GSN_STUDY_MEASURES; m++)
        s.value[m] = s.error[m] = NAN;
    for (size_t k = 0; k < GSN_BENCH_FIGURES; k++)
        s.bench[k] = NAN;
    s.value[0] = 0.5;
    return s;
}

/* gives */
static char *page_of(const struct gsn_study_specimen *specimens, size_t count, const char *page)
{
    const struct gsn_study_input input = {
        .name = "<study>", .version = "1", .specimen = specimens, .specimen_count = count
    };
    const struct gsn_index_study study = { &input, page };
    struct gsn_error err = { 0 };
    char *bytes = NULL;
    size_t size;

    CHECK_OK(gsn_index_page(&study, 1, "1.2", &bytes, &size, &err), err);
    CHECK(strlen(bytes) == size);
    return bytes;
}

TEST(a_row_has_the_loss_its_interval_and_the_day)
{
    const struct gsn_study_specimen one = specimen("R07", 40.5);
    gsn_auto_mem(char) page = page_of(&one, 1, "studies/a%2525b/index.html");

    assert_non_null(strstr(page, "<a href=\"reports/a/0123/report.html\">R07</a>"));
    assert_non_null(strstr(page, "40.5 %<br><span class=\"soft\">37.5 to 42.5</span>"));
    assert_non_null(strstr(page, "2025-11-26"));
    assert_non_null(strstr(page, "<a href=\"studies/a%2525b/index.html\">&lt;study&gt;</a>"));
    assert_null(strstr(page, "Needs a person"));
}

/* 0 and 42 % are the ends of the scale: 3 and 147 of 150 px. */
TEST(intervals_are_drawn_on_one_scale)
{
    const struct gsn_study_specimen two[] = { specimen("a", 40), specimen("b", 3) };
    gsn_auto_mem(char) page = page_of(two, 2, NULL);

    assert_non_null(strstr(page, "M129.9 11.0H147.0"));
    assert_non_null(strstr(page, "M3.0 11.0H20.1"));
    assert_non_null(strstr(page, "0 to 42 %"));
}

TEST(a_loss_without_an_interval_stands_on_the_scale_too)
{
    struct gsn_study_specimen two[] = { specimen("a", 40), specimen("b", 20) };
    gsn_auto_mem(char) page = NULL;

    for (int i = 0; i < 2; i++)
        two[i].loss_lower = two[i].loss_upper = NAN;
    page = page_of(two, 2, NULL);
    assert_non_null(strstr(page, "0 to 40 %"));
    assert_non_null(strstr(page, "cx=\"147.0\""));
    assert_non_null(strstr(page, "cx=\"75.0\"")); /* halfway */
}

TEST(a_loss_is_withheld_by_a_report_and_not_before_there_is_one)
{
    struct gsn_study_specimen one = specimen("late", NAN);
    gsn_auto_mem(char) reported = page_of(&one, 1, NULL);

    one.page = NULL;
    gsn_auto_mem(char) waiting = page_of(&one, 1, NULL);

    assert_non_null(strstr(reported, ">withheld<"));
    assert_null(strstr(waiting, ">withheld<"));
}

TEST(what_has_no_figure_needs_a_person_unless_one_left_it_out)
{
    struct gsn_study_specimen two[] = { specimen("late", NAN), specimen("broken", NAN) };

    two[0].left_out = "withheld: no \"baseline\"";
    two[1].left_out = "excluded by mueller";
    two[1].excluded = 1;
    gsn_auto_mem(char) page = page_of(two, 2, NULL);

    assert_non_null(strstr(page, "<b>1</b> need a person"));
    assert_non_null(strstr(page, "<b>1</b> excluded"));
    assert_non_null(strstr(page, "withheld: no &quot;baseline&quot;"));
    assert_null(strstr(page, "excluded by mueller"));
    assert_null(strstr(page, "<svg"));
}

/* From 250 codes on the 26th to 240 ten days later, steps of 5: 235 to 255, so that 250 lies a
 * quarter below the upper end: 34 + 116 / 4. */
TEST(what_the_bench_was_like_is_drawn_by_the_day)
{
    struct gsn_study_specimen two[] = { specimen("a", 40), specimen("b", 3) };

    two[0].bench[GSN_BENCH_WHITE] = 250;
    two[1].bench[GSN_BENCH_WHITE] = 240;
    two[1].bench[GSN_BENCH_FLE] = 1; /* one alone says nothing of a drift */
    two[1].first += 10 * 86400;
    gsn_auto_mem(char) page = page_of(two, 2, NULL);

    assert_non_null(strstr(page, "The bench, day by day"));
    assert_non_null(strstr(page, "text-anchor=\"start\">2025-11-26<"));
    assert_non_null(strstr(page, "text-anchor=\"end\">2025-12-06<"));
    assert_non_null(strstr(page, "cx=\"56.0\" cy=\"63.0\" r=\"3\"><title>a: 250.0 codes<"));
    assert_non_null(strstr(page, "cx=\"546.0\" cy=\"121.0\" r=\"3\"><title>b: 240.0 codes<"));
    assert_non_null(strstr(page, "class=\"median\" d=\"M56.0 92.0H546.0\""));
    assert_null(strstr(page, "FLE"));
}

TEST(a_store_without_specimens_says_what_to_do)
{
    gsn_auto_mem(char) page = page_of(NULL, 0, NULL);

    assert_non_null(strstr(page, "gieson import FOLDER"));
}

static int make_once(struct gsn_error *err)
{
    const struct gsn_study_specimen one = specimen("a", 40);
    const struct gsn_study_input input = {
        .name = "s", .version = "1", .specimen = &one, .specimen_count = 1
    };
    const struct gsn_index_study study = { &input, NULL };
    gsn_auto_mem(char) bytes = NULL;
    size_t size;

    return gsn_index_page(&study, 1, "1", &bytes, &size, err);
}

TEST(running_out_of_memory_leaves_nothing_behind)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(make_once(&err), err);
}
