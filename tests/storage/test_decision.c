/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/decision.h"

#include <math.h>
#include <string.h>

#include "storage/catalog.h"
#include "storage/audit_log.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "tests/storage/bench.h"

static struct gsn_decision_row answer(int64_t number, int64_t slot, const char *text)
{
    return (struct gsn_decision_row){ .number = number,
                                      .slot = slot,
                                      .answer = text,
                                      .x_px = 12.5,
                                      .y_px = NAN,
                                      .actor = "ana",
                                      .reason = "looked at the glass",
                                      .time = NOON };
}

static int put(struct gsn_store *store, int64_t number, int64_t slot, const char *text)
{
    const struct gsn_decision_row row = answer(number, slot, text);
    struct gsn_error err = { 0 };
    int again = -1;

    CHECK_OK(gsn_decision_put(store, "S01", &row, &again, &err), err);
    return again;
}

static size_t count_events(struct gsn_store *store, char *ret_last, size_t size)
{
    gsn_auto(gsn_event_rows) events = NULL;
    struct gsn_error err = { 0 };
    size_t count = 0;

    CHECK_OK(gsn_event_list(store, 0, &events, &err), err);
    for (size_t i = 0; i < events->count; i++) {
        if (strcmp(events->at[i].kind, "decide") != 0)
            continue;
        count++;
        (void)snprintf(ret_last, size, "%s: %s: %s", events->at[i].actor, events->at[i].subject,
                       events->at[i].text);
    }
    return count;
}

/* Cases 61 and 67. */
TEST(an_answer_is_kept_once_and_the_diary_has_them_all)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S01", "treated", "");
    gsn_auto(gsn_decision_rows) rows = NULL;
    gsn_auto(gsn_decision_rows) after = NULL;
    struct gsn_error err = { 0 };
    char last[300] = "";

    CHECK(put(store, 3, 6, "cut") == 0);
    CHECK(count_events(store, last, sizeof last) == 1);
    assert_string_equal(last, "ana: S01: panel 3, slot 6: cut; looked at the glass");
    CHECK(put(store, 3, 6, "cut") == 1);
    CHECK(count_events(store, last, sizeof last) == 1);
    CHECK(put(store, 3, 6, "hold") == 0);
    CHECK(count_events(store, last, sizeof last) == 2);
    assert_string_equal(last,
                        "ana: S01: panel 3, slot 6: hold, instead of cut; looked at the glass");
    CHECK(put(store, 1, 0, "lost") == 0);
    CHECK_OK(gsn_decision_list(store, specimen, &rows, &err), err);
    CHECK(rows->count == 2);
    CHECK(rows->at[0].number == 1 && rows->at[0].slot == 0);
    assert_string_equal(rows->at[0].answer, "lost");
    assert_string_equal(rows->at[1].answer, "hold");
    CHECK(rows->at[1].x_px == 12.5 && isnan(rows->at[1].y_px));

    CHECK(put(store, 3, 6, "") == 0);
    CHECK(put(store, 3, 6, "") == 1);
    CHECK(count_events(store, last, sizeof last) == 4);
    assert_string_equal(
        last, "ana: S01: panel 3, slot 6: taken back, instead of hold; looked at the glass");
    CHECK_OK(gsn_decision_list(store, specimen, &after, &err), err);
    CHECK(after->count == 1);
}

TEST(an_answer_about_nobody_is_refused_and_leaves_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct gsn_decision_row row = answer(1, 1, "cut");
    struct gsn_error err = { 0 };
    char last[300];
    int again = 55;

    CHECK(gsn_decision_put(store, "nobody", &row, &again, &err) == GSN_E_NOTFOUND);
    CHECK(again == 55 && count_events(store, last, sizeof last) == 0);
}

static int put_and_list(struct gsn_store *store, struct gsn_error *err)
{
    const struct gsn_decision_row row = answer(1, 2, "slot 3");
    gsn_auto(gsn_decision_rows) rows = NULL;
    int again, r = gsn_decision_put(store, "S01", &row, &again, err);

    return r < 0 ? r : gsn_decision_list(store, 1, &rows, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S01", "treated", "");
    CHECK_EVERY_OOM(put_and_list(store, &err), err);
}
