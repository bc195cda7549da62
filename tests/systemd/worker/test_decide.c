/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What becomes of a panel when a person has answered what it asked. */
#include "systemd/worker/job.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/core/file.h"
#include "storage/decision.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/result.h"
#include "tests/check.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/systemd/worker/bench_job.h"

#include <math.h>
#include <string.h>

static const struct gsn_job_options OPTIONS = { .mesher = GSN_MESHER,
                                                .decoder = GSN_DECODER,
                                                .owner = "test" };

static const char JOB[] = "{\"specimen\": \"x\", \"layout\": [2, 2], \"panels\": 2, \"px_um\": 24, "
                          "\"markers_um\": " DRAWN_MARKS_JSON "}";

static void work(struct gsn_store *store)
{
    struct gsn_error err = { 0 };

    while (gsn_job_next(store, &OPTIONS, &err) >= 0) {
    }
}

static void take(const struct gsn_scratch *scratch, struct gsn_store *store, const char *job)
{
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_job(scratch, "in", job);
    CHECK_OK(bench_import(scratch, store, "in", 0, &heard, &counts, &err), err);
    work(store);
}

static void write_drawn(const struct gsn_scratch *scratch, const char *name,
                        const struct drawn_panel *panel)
{
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(panel, &size);

    bench_write(scratch, "in", name, png, size);
}

static void say(struct gsn_store *store, int64_t number, int64_t slot, const char *answer,
                struct gsn_point at)
{
    const struct gsn_decision_row row = { .number = number,
                                          .slot = slot,
                                          .answer = answer,
                                          .x_px = at.x,
                                          .y_px = at.y,
                                          .actor = "ana",
                                          .reason = "",
                                          .time = 1 };
    struct gsn_error err = { 0 };
    int again = -1;

    CHECK_OK(gsn_decision_put(store, "x", &row, &again, &err), err);
    CHECK(again == 0);
    work(store);
}

static struct gsn_panel_rows *panels_of(struct gsn_store *store)
{
    struct gsn_panel_rows *rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_panel_list(store, 1, &rows, &err), err);
    return rows;
}

static void check_section(struct gsn_store *store, int64_t slot, const char *state,
                          const char *flags)
{
    gsn_auto(gsn_section_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_section_list(store, 1, &rows, &err), err);
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].slot == slot) {
            assert_string_equal(rows->at[i].state, state);
            assert_string_equal(rows->at[i].flags, flags);
            return;
        }
    fail_msg("there is no slot %lld", (long long)slot);
}

static int64_t latest_run(struct gsn_store *store)
{
    gsn_auto(gsn_run_row) run = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_run_latest(store, 1, NULL, &run, &err), err);
    return run->id;
}

/* Case 27. */
TEST(an_accepted_cut_brings_both_sections_in_and_another_report)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    int64_t run;

    panel.section[0].shift_um.x = 330;
    panel.section[1].shift_um.x = -330;
    panel.section[0].turn_deg = panel.section[1].turn_deg = 0;
    write_drawn(&scratch, "P01.png", &panel);
    take(&scratch, store, JOB);
    check_section(store, 1, "held", "touching");
    check_section(store, 2, "held", "touching");
    check_section(store, 3, "found", "");
    run = latest_run(store);

    say(store, 1, 2, "cut", (struct gsn_point){ 0, 0 });
    check_section(store, 1, "found", "parted");
    check_section(store, 2, "found", "parted");
    CHECK(latest_run(store) > run);
    say(store, 1, 2, "hold", (struct gsn_point){ 0, 0 });
    check_section(store, 1, "held", "touching");
}

/* Case 26. */
TEST(a_loose_piece_gets_its_slot_or_is_dismissed)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    static const uint8_t ROSE[3] = { 200, 70, 100 };
    struct gsn_error err = { 0 };
    size_t size;
    uint8_t *bytes = NULL;

    panel.section[1].missing = 1;
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);
    for (uint32_t i = 0; i < 12 * 12; i++)
        memcpy((uint8_t *)image->samples +
                   3 * ((size_t)(50 + i / 12) * image->width + 160 + i % 12),
               ROSE, 3);
    CHECK_OK(gsn_png_encode(image, &bytes, &size, &err), err);
    gsn_auto_mem(uint8_t) png = bytes;
    bench_write(&scratch, "in", "P01.png", png, size);
    take(&scratch, store, JOB);
    check_section(store, 2, "missing", "");
    check_section(store, 5, "held", "scrap");

    say(store, 1, 5, "dismiss", (struct gsn_point){ 166, 56 });
    check_section(store, 2, "missing", "");
    check_section(store, 5, "empty", "scrap decided");
    say(store, 1, 5, "slot 2", (struct gsn_point){ 166, 56 });
    check_section(store, 2, "needs-eye", "no-marks");
    check_section(store, 5, "empty", "scrap decided");
    /* Said of another place, it is about another piece. */
    say(store, 1, 5, "dismiss", (struct gsn_point){ 10, 10 });
    check_section(store, 5, "held", "scrap");
}

/* Cases 5 and 31: two scans of one number; one is chosen, both are kept. */
TEST(one_of_two_scans_is_chosen)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct drawn_panel fine = drawn_panel_of(1, 24, 0.8), pale = drawn_panel_of(1, 24, 0.7);
    gsn_auto(gsn_panel_rows) before = NULL;
    gsn_auto(gsn_panel_rows) after = NULL;
    gsn_auto(gsn_panel_rows) other = NULL;
    gsn_auto_mem(char) first = NULL;
    gsn_auto_mem(char) second = NULL;

    write_drawn(&scratch, "a-P01.png", &fine);
    write_drawn(&scratch, "b-P01.png", &pale);
    take(&scratch, store, JOB);
    before = panels_of(store);
    CHECK(before->count == 2);
    assert_string_equal(before->at[0].state, "held");
    CHECK(strstr(before->at[0].message, "another scan of panel 1 is used, b-P01.png: both show the "
                                        "same glass"));
    assert_string_equal(before->at[1].state, "registered");
    first = gsn_format("use %s", before->at[0].sha256);
    second = gsn_format("use %s", before->at[1].sha256);

    say(store, 1, 0, first, (struct gsn_point){ 0, 0 });
    say(store, 1, 0, second, (struct gsn_point){ 0, 0 });
    after = panels_of(store);
    assert_string_equal(after->at[1].state, "registered");
    assert_string_equal(after->at[0].state, "held");
    assert_string_equal(after->at[0].message,
                        "another scan of panel 1 was chosen; this one is kept beside it");
    say(store, 1, 0, first, (struct gsn_point){ 0, 0 });
    other = panels_of(store);
    assert_string_equal(other->at[0].state, "registered");
    assert_string_equal(other->at[1].state, "held");
}

/* Two rows of three, with as much glass above as below: only a person can say which they are. */
TEST(the_slot_of_the_first_section_releases_a_panel)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);
    gsn_auto(gsn_image) tall = NULL;
    gsn_auto(gsn_panel_rows) before = NULL;
    gsn_auto(gsn_panel_rows) after = NULL;
    gsn_auto_mem(uint8_t) png = NULL;
    const size_t row = 3 * (size_t)image->width;
    const uint32_t above = image->height * 9 / 20;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_image_new(image->width, image->height + 2 * above, 3, 8, &tall, &err), err);
    for (uint32_t y = 0; y < tall->height; y++) {
        const int glass = y < above || y >= above + image->height;

        memcpy((uint8_t *)tall->samples + y * row,
               (const uint8_t *)image->samples + (glass ? y % 4 : y - above) * row, row);
    }
    CHECK_OK(gsn_png_encode(tall, &png, &size, &err), err);
    bench_write(&scratch, "in", "P01.png", png, size);
    take(&scratch, store,
         "{\"specimen\": \"x\", \"layout\": [3, 2], \"panels\": 2, \"px_um\": 24, "
         "\"markers_um\": " DRAWN_MARKS_JSON "}");
    before = panels_of(store);
    assert_string_equal(before->at[0].state, "held");
    CHECK(strstr(before->at[0].message, "the sections found (4) fit 3 x 2 slots in two ways, and "
                                        "which cannot be told: the first of them lies in slot 1 or "
                                        "in slot 3; look at the glass and say in which"));
    say(store, 1, 0, "first 3", (struct gsn_point){ 0, 0 });
    after = panels_of(store);
    assert_string_equal(after->at[0].state, "registered");
    check_section(store, 2, "missing", "");
    for (int64_t slot = 3; slot <= 6; slot++)
        check_section(store, slot, "found", "");
}

/* ---- which pose -------------------------------------------------------------------------- */

static const char JOB_OF_ONE[] =
    "{\"specimen\": \"x\", \"layout\": [2, 2], \"panels\": 1, \"px_um\": 24, "
    "\"transfer\": \"linear\", \"markers_um\": " DRAWN_MARKS_JSON
    ", \"region\": {\"shape\": \"box\", \"min\": [-288, -168, 0], \"max\": [288, 168, 96]}}";

/* Slot 3 lacks its second mark, so that it may lie in several ways. */
static struct drawn_panel doubtful_panel(double density)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, density);

    panel.section[2].no_marks = 2;
    return panel;
}

static struct gsn_candidate_rows *candidates_of(struct gsn_store *store)
{
    struct gsn_candidate_rows *rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_candidate_list(store, 1, &rows, &err), err);
    return rows;
}

/* gives: as `gieson decide` writes it. */
static char *pose_answer(const struct gsn_candidate_row *c, const char *sha256)
{
    char mark[3][40];

    for (int m = 0; m < 3; m++)
        if (c->marker[m].found)
            (void)snprintf(mark[m], sizeof mark[m], "%.1f,%.1f", c->marker[m].x_px,
                           c->marker[m].y_px);
        else
            (void)snprintf(mark[m], sizeof mark[m], "-");
    return gsn_format("pose %lld of %s %s %s %s %s", (long long)c->number, sha256,
                      c->mirrored ? "down" : "up", mark[0], mark[1], mark[2]);
}

/* gives: report.json of the latest run. */
static char *latest_report(struct gsn_store *store)
{
    gsn_auto(gsn_run_row) run = NULL;
    struct gsn_error err = { 0 };
    gsn_auto_mem(char) path = NULL;
    uint8_t *bytes = NULL;
    size_t size;
    char *text;

    CHECK_OK(gsn_run_latest(store, 1, NULL, &run, &err), err);
    path = gsn_format("%s/%s", gsn_store_dir(store), run->json_path);
    CHECK_OK(gsn_file_read(path, 1 << 24, &bytes, &size, &err), err);
    text = gsn_format("%.*s", (int)size, (const char *)bytes);
    gsn_free(bytes);
    return text;
}

static struct gsn_pose_row pose_of(struct gsn_store *store, int64_t slot)
{
    gsn_auto(gsn_pose_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_pose_list(store, latest_run(store), &rows, &err), err);
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].slot == slot)
            return rows->at[i];
    fail_msg("slot %lld has no pose", (long long)slot);
    return (struct gsn_pose_row){ 0 };
}

TEST(a_pose_that_a_person_chose_is_used_and_the_report_says_who)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct drawn_panel panel = doubtful_panel(0.8);
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto(gsn_candidate_rows) before = NULL;
    gsn_auto(gsn_candidate_rows) after = NULL;
    gsn_auto_mem(char) first_report = NULL;
    gsn_auto_mem(char) second_report = NULL;
    gsn_auto_mem(char) answer = NULL;
    struct gsn_pose_row was, is;

    write_drawn(&scratch, "P01.png", &panel);
    take(&scratch, store, JOB_OF_ONE);
    panels = panels_of(store);
    before = candidates_of(store);
    check_section(store, 3, "needs-eye", "two-marks");
    CHECK(before->count >= 2 && before->count <= 4);
    for (size_t i = 0; i < before->count; i++) {
        CHECK(before->at[i].slot == 3 && before->at[i].chosen == 0);
        CHECK(i == 0 || before->at[i].share <= before->at[i - 1].share);
        CHECK(before->at[i].error_um > 0);
        CHECK(before->at[i].marker[0].found && !before->at[i].marker[1].found);
    }
    first_report = latest_report(store);
    CHECK(strstr(first_report, "\"decisions\": []") != NULL);
    was = pose_of(store, 3);

    answer = pose_answer(&before->at[1], panels->at[0].sha256);
    say(store, 1, 3, answer, (struct gsn_point){ 0, 0 });
    check_section(store, 3, "found",
                  before->at[1].mirrored ? "two-marks mirrored decided" : "two-marks decided");
    after = candidates_of(store);
    CHECK(after->count == before->count);
    CHECK(after->at[1].chosen == 1 && after->at[0].chosen == 0);
    is = pose_of(store, 3);
    CHECK(is.flipped == before->at[1].flipped && is.rotated180 == before->at[1].rotated180);
    CHECK(fabs(is.m00 - was.m00) > 1 || fabs(is.m01 - was.m01) > 1);
    second_report = latest_report(store);
    CHECK(strstr(second_report, "\"answer\": \"pose 2\"") != NULL);
    CHECK(strstr(second_report, "\"by\": \"ana\"") != NULL);
    CHECK(strstr(second_report, "\"time\": \"1970-01-01 00:00 UTC\"") != NULL);
    CHECK(strstr(second_report, "\"effect\": \"used\"") != NULL);

    say(store, 1, 3, "", (struct gsn_point){ 0, 0 });
    check_section(store, 3, "needs-eye", "two-marks");
    is = pose_of(store, 3);
    CHECK(is.m00 == was.m00 && is.m01 == was.m01 && is.m02 == was.m02);
}

/* A choice that no longer fits: of another scan, of spots that are not there, of a section that is
 * not there. Each is named, and what the picture says is used. */
TEST(a_choice_that_does_not_fit_any_more_is_named_and_not_used)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct drawn_panel panel = doubtful_panel(0.8);
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto(gsn_panel_rows) told = NULL;
    gsn_auto(gsn_panel_rows) gone = NULL;
    gsn_auto(gsn_candidate_rows) rows = NULL;
    gsn_auto(gsn_candidate_rows) still = NULL;
    gsn_auto_mem(char) elsewhere = NULL;
    gsn_auto_mem(char) nowhere = NULL;
    gsn_auto_mem(char) report = NULL;
    struct gsn_candidate_row moved;
    struct gsn_pose_row was, is;

    write_drawn(&scratch, "P01.png", &panel);
    take(&scratch, store, JOB_OF_ONE);
    panels = panels_of(store);
    rows = candidates_of(store);
    was = pose_of(store, 3);
    elsewhere = pose_answer(&rows->at[1], bench_digest(77));
    say(store, 1, 3, elsewhere, (struct gsn_point){ 0, 0 });
    check_section(store, 3, "needs-eye", "two-marks decision-void");
    told = panels_of(store);
    CHECK(strstr(told->at[0].message,
                 "the pose that was chosen for slot 3 was said of another scan "
                 "and is not used: choose again"));
    report = latest_report(store);
    CHECK(strstr(report, "panel 1, slot 3: the pose that ana chose on 1970-01-01 00:00 UTC is not "
                         "used: nothing that is found there has those marks; choose again"));
    is = pose_of(store, 3);
    CHECK(is.m00 == was.m00 && is.m02 == was.m02);

    moved = rows->at[1];
    moved.marker[0].x_px += 30;
    nowhere = pose_answer(&moved, panels->at[0].sha256);
    say(store, 1, 3, nowhere, (struct gsn_point){ 0, 0 });
    check_section(store, 3, "needs-eye", "two-marks decision-void");
    gone = panels_of(store);
    CHECK(strstr(gone->at[0].message, "slot 3 fits nothing that is found there and is not used"));
    still = candidates_of(store);
    CHECK(still->count == rows->count && still->at[1].chosen == 0);
}

/* Of three marks that contradict the stack a person names two. */
TEST(two_of_three_marks_can_be_chosen)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto(gsn_section_rows) sections = NULL;
    gsn_auto(gsn_candidate_rows) rows = NULL;
    gsn_auto_mem(char) answer = NULL;
    struct gsn_candidate_row pair = { .number = 1 };
    struct gsn_error err = { 0 };

    write_drawn(&scratch, "P01.png", &panel);
    take(&scratch, store, JOB_OF_ONE);
    panels = panels_of(store);
    CHECK_OK(gsn_section_list(store, 1, &sections, &err), err);
    for (int m = 0; m < 2; m++)
        pair.marker[m] = sections->at[1].marker[m];
    answer = pose_answer(&pair, panels->at[0].sha256);
    say(store, 1, 2, answer, (struct gsn_point){ 0, 0 });
    check_section(store, 2, "found", "two-marks decided");
    rows = candidates_of(store);
    CHECK(rows->count == 4 && rows->at[2].chosen == 1);
    assert_string_equal(rows->at[2].differs, "on two marks, without mark 3");
}

/* Texts that are no answer of ours are passed over. */
TEST(a_pose_of_an_unknown_form_changes_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct drawn_panel panel = doubtful_panel(0.8);
    static const char *const texts[] = { "pose", "pose x", "pose 1 of abc up - - -", "pose 1 of ",
                                         "pose 0 of " };
    gsn_auto(gsn_panel_rows) panels = NULL;

    write_drawn(&scratch, "P01.png", &panel);
    take(&scratch, store, JOB_OF_ONE);
    panels = panels_of(store);
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++) {
        gsn_auto_mem(char) text = gsn_format("%s%s%s", texts[i], i >= 3 ? panels->at[0].sha256 : "",
                                             i >= 3 ? " up 12,3 4.0,5.0 -" : "");

        say(store, 1, 3, text, (struct gsn_point){ 0, 0 });
        check_section(store, 3, "needs-eye", "two-marks");
    }
}
