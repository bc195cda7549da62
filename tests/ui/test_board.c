/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/board.h"

#include "ui/text.h"

#include <locale.h>
#include <string.h>

#include "tests/storage/bench.h"

#define CHECK_WORDS(call, words)                                                                   \
    do {                                                                                           \
        gsn_auto_mem(char) said = call;                                                            \
        CHECK(said &&strcmp(said, words) == 0);                                                    \
    } while (0)

TEST(ages_are_told_in_the_unit_that_fits)
{
    CHECK_WORDS(gsn_look_age(NOON, 0), "");
    CHECK_WORDS(gsn_look_age(NOON, NOON + 5), "now"); /* another machine's clock */
    CHECK_WORDS(gsn_look_age(NOON, NOON - 59), "now");
    CHECK_WORDS(gsn_look_age(NOON, NOON - 60), "1 min");
    CHECK_WORDS(gsn_look_age(NOON, NOON - 3599), "59 min");
    CHECK_WORDS(gsn_look_age(NOON, NOON - 3600), "1 h");
    CHECK_WORDS(gsn_look_age(NOON, NOON - 48 * 3600 + 1), "47 h");
    CHECK_WORDS(gsn_look_age(NOON, NOON - 48 * 3600), "2 d");
}

TEST(progress_says_as_much_as_is_known)
{
    CHECK_WORDS(gsn_look_progress("", 0, 0, NAN), "starting");
    CHECK_WORDS(gsn_look_progress("fit", 0, 0, NAN), "fit");
    CHECK_WORDS(gsn_look_progress("fit", 1, 3, NAN), "fit 33 %");
    CHECK_WORDS(gsn_look_progress("fit", 1, 2, 89), "fit 50 %, 89 s left");
    CHECK_WORDS(gsn_look_progress("fit", 1, 2, 90), "fit 50 %, 2 min left");
    CHECK_WORDS(gsn_look_progress("fit", 1, 2, 3 * 3600), "fit 50 %, 3 h left");
}

TEST(sizes_are_told_in_the_unit_that_fits)
{
    CHECK_WORDS(gsn_look_bytes(0), "0.0 kB");
    CHECK_WORDS(gsn_look_bytes(999949), "999.9 kB");
    CHECK_WORDS(gsn_look_bytes(999951), "1.0 MB");
    CHECK_WORDS(gsn_look_bytes(5000000000), "5.0 GB");
}

TEST(every_state_has_a_symbol_of_one_column_and_an_unknown_one_too)
{
    static const char *const states[] = { "waiting", "working",   "reported",  "withheld",
                                          "failed",  "refused",   "held",      "unfiled",
                                          "trouble", "away",      "ready",     "paused",
                                          "off",     "receiving", "needs-eye", "?" };

    for (size_t i = 0; i < sizeof states / sizeof states[0]; i++)
        CHECK(strlen(gsn_look_of(states[i])->symbol) == 1);
    CHECK(strcmp(gsn_look_of("failed")->state, "failed") == 0);
}

TEST(what_is_not_ascii_becomes_marks_of_the_same_width)
{
    char text[] = "\xc3\x9c a \xe6\xb5\x8b e\xcc\x81 \xff!";

    (void)setlocale(LC_CTYPE, "C.UTF-8");
    gsn_text_ascii(text);
    CHECK(strcmp(text, "? a ?? e ?!") == 0);
}

TEST(a_line_ends_at_its_last_blank_or_is_cut_and_is_never_empty)
{
    CHECK(gsn_text_fit("one two three", 8) == 7);
    CHECK(gsn_text_fit("one two", 80) == 7);
    CHECK(gsn_text_fit("abcdefgh", 3) == 3);
    CHECK(gsn_text_fit("abc", 0) == 1);
    CHECK(gsn_text_fit("", 5) == 0);
}

/* ---- the board --------------------------------------------------------------------------- */

static void run_sql(const struct gsn_scratch *scratch, const char *sql)
{
    CHECK(bench_raw(scratch, sql) == 0);
}

/* One of everything: a source, a trouble, an unfiled scan, specimens in every state. */
static void fill(const struct gsn_scratch *scratch, struct gsn_store *store)
{
    static const char *const names[] = { "done", "waits", "works", "failed" };
    static const char *const states[] = { "done", "waiting", "running", "failed" };

    for (unsigned i = 0; i < 4; i++) {
        const int64_t id = bench_add_specimen(store, names[i], "group", "");
        const int64_t panel = bench_add_panel(store, id, 1);
        gsn_auto_mem(char) sql = gsn_format(
            "INSERT INTO job (kind, specimen_id, panel_id, state, stage, done, total, message) "
            "VALUES ('panel', %lld, %lld, '%s', 'decode', 1, 2, 'why')",
            (long long)id, (long long)panel, states[i]);

        run_sql(scratch, sql);
    }
    (void)bench_add_specimen(store, "empty", "group", "");
    run_sql(scratch,
            "INSERT INTO source VALUES ('s', 'hot:/x', 'd', 'receiving', '', 'a.jpg', 1, 2, 3);"
            "INSERT INTO source VALUES ('gone', 'hot:/y', '', 'off', '', '', 0, 0, 3);"
            "INSERT INTO trouble VALUES ('s', 'b.jpg', 'it is torn', 'scan it again', 1, 2, 2);"
            "INSERT INTO run (specimen_id, key, version, inputs_json, parameters_json, state, "
            "report_path, started, finished) VALUES (1, 'k', '1', '{}', '{}', 'running', 'r', 1, "
            "2);"
            "INSERT INTO measure (run_id, name, value, lower, upper, unit) VALUES "
            "(1, 'loss', 20.5, 18, 23.25, '%');"
            "UPDATE run SET state = 'reported';"
            "INSERT INTO scan VALUES (7, 's', 'd', 'c.jpg', '', 'panel', "
            "substr(hex(zeroblob(32)), 1, 64), 5, '', 'unfiled', 'nobody knows', NULL, 4);"
            "UPDATE panel SET state = 'registered' WHERE specimen_id = 1;"
            "INSERT INTO section (id, panel_id, slot, serial, state, flags, candidates) VALUES "
            "(4099, 1, 3, 5, 'needs-eye', '', '[{\"chosen\": 0}, {\"chosen\": 0}]'),"
            "(4100, 1, 4, 6, 'found', '', '[{\"chosen\": 0}, {\"chosen\": 1}]');");
}

static int make(struct gsn_store *store, struct gsn_board **ret_board, struct gsn_error *err)
{
    gsn_auto(gsn_snapshot) snapshot = NULL;
    const int r = gsn_snapshot_take(store, &snapshot, err);

    return r < 0 ? r : gsn_board_make(snapshot, ret_board, err);
}

/* "heading|name state|..." of all lines. gives. */
static char *told(const struct gsn_board *board)
{
    char *all = gsn_strdup("");

    for (size_t i = 0; i < board->count; i++) {
        const struct gsn_board_line *line = &board->at[i];
        char *more = gsn_format("%s%s%s%s|", all, line->name, line->state ? " " : "",
                                line->state ? line->state : "");

        gsn_free(all);
        all = more;
    }
    return all;
}

TEST(a_board_says_what_comes_in_what_needs_a_person_and_specimens_by_urgency)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_board) board = NULL;
    struct gsn_error err = { 0 };

    fill(&scratch, store);
    CHECK_OK(make(store, &board, &err), err);
    CHECK_WORDS(
        told(board),
        "COMES IN|s receiving||NEEDS YOU|b.jpg trouble|scan it again|c.jpg unfiled|"
        "gieson file 7 SPECIMEN --panel N||SPECIMENS|failed failed|panel 1 failed|"
        "works working|panel 1 working|waits waiting|panel 1 waiting|empty waiting|done reported|"
        "section 1.3 needs-eye|");
}

/* The one line of this name, or NULL. */
static const struct gsn_board_line *line_of(const struct gsn_board *board, const char *name)
{
    const struct gsn_board_line *found = NULL;

    for (size_t i = 0; i < board->count; i++) {
        if (strcmp(board->at[i].name, name) != 0)
            continue;
        CHECK(!found);
        found = &board->at[i];
    }
    return found;
}

TEST(what_waits_for_work_says_so_and_what_waits_for_panels_too)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_board) board = NULL;
    const struct gsn_board_line *waits, *empty;
    struct gsn_error err = { 0 };

    fill(&scratch, store);
    CHECK_OK(make(store, &board, &err), err);
    waits = line_of(board, "waits");
    empty = line_of(board, "empty");
    CHECK(waits && waits->action && strcmp(waits->action, "gieson run") == 0);
    CHECK(empty && !empty->action && strcmp(empty->detail, "no panel yet") == 0);
}

TEST(what_is_measured_says_its_loss_with_what_it_lies_between)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_board) board = NULL;
    const struct gsn_board_line *done;
    struct gsn_error err = { 0 };
    int told = 0;

    fill(&scratch, store);
    CHECK_OK(make(store, &board, &err), err);
    done = line_of(board, "done");
    CHECK(done && strcmp(done->detail, "1/1 panels, loss 20.50 %") == 0);
    for (size_t i = 0; i < GSN_BOARD_FACTS && done->fact[i]; i++)
        told |= strcmp(done->fact[i], "loss      20.50 % (18.00 to 23.25)") == 0;
    CHECK(told);
}

TEST(a_section_that_needs_an_eye_names_the_command_that_settles_it)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_board) board = NULL;
    struct gsn_error err = { 0 };

    fill(&scratch, store);
    CHECK_OK(make(store, &board, &err), err);

    const struct gsn_board_line *line = &board->at[board->count - 1];

    CHECK(line->kind == GSN_BOARD_DOUBT && gsn_board_is_part(line) && gsn_board_is_item(line));
    CHECK(strcmp(line->action, "gieson decide done 1.3 pose N") == 0);
    CHECK(strcmp(line->detail, "2 poses to choose from for section 1.3") == 0);
    CHECK(line->specimen == 1);
}

TEST(keys_tell_all_lines_apart)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_board) board = NULL;
    struct gsn_error err = { 0 };
    size_t items = 0;

    fill(&scratch, store);
    CHECK_OK(make(store, &board, &err), err);
    for (size_t i = 0; i < board->count; i++) {
        items += gsn_board_is_item(&board->at[i]) != 0;
        CHECK(!gsn_board_is_item(&board->at[i]) == !board->at[i].key);
        for (size_t j = 0; board->at[i].key && j < i; j++)
            CHECK(!board->at[j].key || strcmp(board->at[i].key, board->at[j].key) != 0);
    }
    CHECK(items > 2);
}

TEST(an_empty_store_says_what_to_do)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_board) board = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(make(store, &board, &err), err);
    CHECK_WORDS(told(board), "no specimen yet: `gieson import FOLDER` takes one in|");
}

TEST(a_store_that_cannot_be_asked_is_refused_and_the_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_board *board = NULL;
    struct gsn_error err = { 0 };

    run_sql(&scratch, "DROP TABLE trouble");
    CHECK(make(store, &board, &err) == GSN_E_STORE);
    CHECK(board == NULL && err.text[0]);
}

static int make_once(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_board) board = NULL;

    return make(store, &board, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    fill(&scratch, store);
    CHECK_EVERY_OOM(make_once(store, &err), err);
}
