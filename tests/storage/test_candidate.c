/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/decision.h"

#include <math.h>
#include <string.h>

#include "storage/result.h"
#include "tests/storage/bench.h"

static struct gsn_candidate_row candidate(int64_t slot, double share, const char *differs)
{
    struct gsn_candidate_row row = { .slot = slot,
                                     .flipped = 1,
                                     .mirrored = 1,
                                     .share = share,
                                     .error_um = NAN,
                                     .differs = differs };

    for (int m = 0; m < 2; m++)
        row.marker[m] = (struct gsn_fiducial_row){ 1, 812.37 + m, 400.5, 7.5, .01, -.002, .03, .9 };
    return row;
}

/* A panel with three slots. */
static int64_t add_sections(struct gsn_store *store, int64_t specimen, unsigned number)
{
    const int64_t panel = bench_add_panel(store, specimen, number);
    struct gsn_section_row sections[3];
    struct gsn_error err = { 0 };

    for (int i = 0; i < 3; i++)
        sections[i] = (struct gsn_section_row){ .slot = i + 1,
                                                .serial = 3 * number + (unsigned)i,
                                                .state = "needs-eye",
                                                .flags = "two-marks" };
    CHECK_OK(gsn_section_replace(store, panel, sections, 3, &err), err);
    CHECK_OK(gsn_panel_set_state(store, panel, "registered", NULL, NULL, &err), err);
    return panel;
}

static size_t count_all(struct gsn_store *store)
{
    gsn_auto(gsn_candidate_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_candidate_list(store, 1, &rows, &err), err);
    return rows->count;
}

TEST(candidates_come_back_as_they_were_put_and_in_order)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S01", "treated", "");
    const int64_t panel = add_sections(store, specimen, 1);
    const struct gsn_candidate_row rows[] = { candidate(3, 0.9, "a \"quoted\" \\ text, \xc2\xb5"),
                                              candidate(3, 0.1, "turned"),
                                              candidate(1, NAN, "first") };
    gsn_auto(gsn_candidate_rows) back = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_candidate_replace(store, panel, rows, 3, &err), err);
    CHECK_OK(gsn_candidate_list(store, specimen, &back, &err), err);
    CHECK(back->count == 3);
    CHECK(back->at[0].slot == 1 && back->at[0].number == 1 && isnan(back->at[0].share));
    CHECK(back->at[1].slot == 3 && back->at[1].number == 1 && back->at[1].share == 0.9);
    CHECK(back->at[2].slot == 3 && back->at[2].number == 2 && back->at[2].panel_id == panel);
    assert_string_equal(back->at[1].differs, rows[0].differs);
    CHECK(back->at[1].flipped == 1 && back->at[1].mirrored == 1 && back->at[1].rotated180 == 0);
    CHECK(isnan(back->at[1].error_um) && back->at[1].marker[1].found == 1 &&
          back->at[1].marker[2].found == 0);
    CHECK(back->at[1].marker[1].x_px == 813.37 && back->at[1].marker[0].cov_xy == -.002);
}

TEST(they_go_when_the_panel_is_looked_at_again_and_others_stay)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S01", "treated", "");
    const int64_t one = add_sections(store, specimen, 1), two = add_sections(store, specimen, 2);
    const struct gsn_candidate_row row = candidate(2, 0.5, "x");
    const struct gsn_section_row section = { .slot = 2, .state = "found", .flags = "" };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_candidate_replace(store, one, &row, 1, &err), err);
    CHECK_OK(gsn_candidate_replace(store, two, &row, 1, &err), err);
    CHECK_OK(gsn_candidate_replace(store, two, &row, 1, &err), err);
    CHECK(count_all(store) == 2);
    CHECK_OK(gsn_section_replace(store, one, &section, 1, &err), err);
    CHECK(count_all(store) == 1);
    CHECK_OK(gsn_candidate_replace(store, two, NULL, 0, &err), err);
    CHECK(count_all(store) == 0);
}

TEST(candidates_of_no_section_are_refused_and_the_old_ones_stay)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S01", "treated", "");
    const int64_t panel = add_sections(store, specimen, 1);
    const struct gsn_candidate_row fine = candidate(2, 0.5, "x");
    const struct gsn_candidate_row rows[] = { candidate(1, 1, "y"), candidate(9, 1, "z") };
    gsn_auto(gsn_candidate_rows) back = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_candidate_replace(store, panel, &fine, 1, &err), err);
    CHECK(gsn_candidate_replace(store, panel, rows, 2, &err) == GSN_E_NOTFOUND);
    assert_string_equal(err.text, "panel 1 has no section in slot 9");
    CHECK_OK(gsn_candidate_list(store, specimen, &back, &err), err);
    CHECK(back->count == 1 && back->at[0].slot == 2);
}

static size_t count_doubts(struct gsn_store *store)
{
    gsn_auto(gsn_doubt_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_overview_doubts(store, &rows, &err), err);
    return rows->count;
}

/* In doubt until somebody said which, and again when that could not be used. */
TEST(what_a_person_is_to_choose_is_listed_until_it_is_chosen)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S01", "treated", "");
    const int64_t panel = add_sections(store, specimen, 1);
    struct gsn_candidate_row rows[] = { candidate(2, 0.6, "x"), candidate(2, 0.4, "y") };
    struct gsn_section_row section = { .slot = 2, .state = "needs-eye", .flags = "decision-void" };
    const struct gsn_decision_row said = { .number = 1,
                                           .slot = 2,
                                           .answer = "pose 1 of x",
                                           .x_px = NAN,
                                           .y_px = NAN,
                                           .actor = "ana",
                                           .reason = "" };
    gsn_auto(gsn_doubt_rows) doubts = NULL;
    struct gsn_error err = { 0 };
    int again;

    CHECK(count_doubts(store) == 0);
    CHECK_OK(gsn_candidate_replace(store, panel, rows, 2, &err), err);
    CHECK_OK(gsn_overview_doubts(store, &doubts, &err), err);
    CHECK(doubts->count == 1 && doubts->at[0].panel == 1 && doubts->at[0].slot == 2);
    CHECK(doubts->at[0].candidates == 2 && doubts->at[0].specimen_id == specimen);
    CHECK_OK(gsn_decision_put(store, "S01", &said, &again, &err), err);
    CHECK(count_doubts(store) == 0);
    CHECK_OK(gsn_section_replace(store, panel, &section, 1, &err), err);
    CHECK_OK(gsn_candidate_replace(store, panel, rows, 2, &err), err);
    CHECK(count_doubts(store) == 1);
    rows[1].chosen = 1;
    CHECK_OK(gsn_candidate_replace(store, panel, rows, 2, &err), err);
    CHECK(count_doubts(store) == 0);
}

static int put_and_list(struct gsn_store *store, struct gsn_error *err)
{
    const struct gsn_candidate_row row = candidate(2, 0.5, "x");
    gsn_auto(gsn_candidate_rows) rows = NULL;
    gsn_auto(gsn_doubt_rows) doubts = NULL;
    int r = gsn_candidate_replace(store, 1, &row, 1, err);

    if (r >= 0)
        r = gsn_candidate_list(store, 1, &rows, err);
    return r < 0 ? r : gsn_overview_doubts(store, &doubts, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    (void)add_sections(store, bench_add_specimen(store, "S01", "treated", ""), 1);
    CHECK_EVERY_OOM(put_and_list(store, &err), err);
}
