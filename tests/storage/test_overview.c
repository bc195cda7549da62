/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/result.h"

#include <string.h>
#include <unistd.h>

#include "storage/audit_log.h"
#include "storage/queue.h"
#include "tests/storage/bench.h"

static struct gsn_overview_rows *list(struct gsn_store *store)
{
    struct gsn_overview_rows *rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_overview_list(store, &rows, &err), err);
    return rows;
}

static struct gsn_open_panel_rows *panels(struct gsn_store *store)
{
    struct gsn_open_panel_rows *rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_overview_panels(store, &rows, &err), err);
    return rows;
}

static void set_state(struct gsn_store *store, int64_t panel, const char *state,
                      const char *message)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_panel_set_state(store, panel, state, "", message, &err), err);
}

static int64_t ask(struct gsn_store *store, int64_t specimen, int64_t panel)
{
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_OK(gsn_queue_add(store, specimen, panel, &id, &err), err);
    return id;
}

TEST(an_empty_store_has_no_rows)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_overview_rows) rows = list(store);
    gsn_auto(gsn_open_panel_rows) open = panels(store);

    CHECK(rows->count == 0 && open->count == 0);
}

TEST(panels_and_sections_are_counted_for_their_own_specimen)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t one = bench_add_specimen(store, "S01", "control", "");
    const int64_t two = bench_add_specimen(store, "S02", "treated", "control");
    const int64_t first = bench_add_panel(store, one, 1);
    const struct gsn_section_row sections[] = {
        { .slot = 1, .serial = 1, .state = "found", .flags = "" },
        { .slot = 2, .serial = 2, .state = "missing", .flags = "" },
        { .slot = 3, .serial = 0, .state = "empty", .flags = "" },
    };
    gsn_auto(gsn_overview_rows) rows = NULL;
    struct gsn_error err = { 0 };

    set_state(store, first, "registered", "");
    set_state(store, bench_add_panel(store, one, 2), "refused", "torn");
    set_state(store, bench_add_panel(store, one, 3), "held", "no number");
    (void)bench_add_panel(store, one, 4);
    CHECK_OK(gsn_section_replace(store, first, sections, 3, &err), err);
    rows = list(store);
    CHECK(rows->count == 2 && rows->at[0].id == one && rows->at[1].id == two);
    CHECK(strcmp(rows->at[0].name, "S01") == 0 && strcmp(rows->at[0].group, "control") == 0);
    CHECK(rows->at[0].panels == 4 && rows->at[0].registered == 1 && rows->at[0].refused == 2);
    CHECK(rows->at[0].sections == 2 && rows->at[0].found == 1);
    CHECK(rows->at[1].panels == 0 && rows->at[1].sections == 0 && rows->at[1].run == 0);
    CHECK(isnan(rows->at[1].loss) && rows->at[1].changed == 0 && !rows->at[1].job.state[0]);
}

TEST(the_latest_run_counts_with_its_figures)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t one = bench_add_specimen(store, "S01", "control", "");
    const struct gsn_run_row run = { .specimen_id = one,
                                     .key = bench_digest(1),
                                     .version = "1",
                                     .inputs_json = "{}",
                                     .parameters_json = "{}" };
    const double losses[] = { 10, 20 };
    gsn_auto(gsn_overview_rows) rows = NULL;
    struct gsn_error err = { 0 };
    int64_t id = 0;

    for (int i = 0; i < 2; i++) {
        const struct gsn_measure_row measures[] = {
            { .name = "loss", .value = losses[i], .lower = NAN, .upper = NAN, .unit = "%" },
            { .name = "mean_density", .value = 0.5, .lower = NAN, .upper = NAN, .unit = "" },
        };
        const struct gsn_run_end end = {
            .state = "reported", .report_path = "r.html", .measures = measures, .measure_count = 2
        };

        CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);
        CHECK_OK(gsn_run_finish(store, id, &end, NOON + i, &err), err);
    }
    rows = list(store);
    CHECK(rows->count == 1 && rows->at[0].run == id);
    CHECK(rows->at[0].loss == 20 && rows->at[0].mean_density == 0.5);
    CHECK(strcmp(rows->at[0].run_state, "reported") == 0 && rows->at[0].changed == NOON + 1);
}

TEST(only_panels_that_are_not_settled_are_listed)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t one = bench_add_specimen(store, "S01", "control", "");
    const int64_t settled = bench_add_panel(store, one, 1);
    const int64_t refused = bench_add_panel(store, one, 2);
    const int64_t waits = bench_add_panel(store, one, 3);
    gsn_auto(gsn_open_panel_rows) open = NULL;
    gsn_auto(gsn_overview_rows) rows = NULL;
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_error err = { 0 };

    set_state(store, settled, "registered", "");
    set_state(store, refused, "refused", "torn");
    (void)ask(store, one, waits);
    (void)ask(store, one, 0);
    CHECK_OK(gsn_event_add(store, NOON, "t", "panel", "P.tif", bench_digest(3), &err), err);
    CHECK_OK(gsn_queue_claim(store, "w", getpid(), 60, NOON, &job, &err), err);
    CHECK_OK(gsn_queue_progress(store, job, "decode", 2, 5, 7.5, NOON, &err), err);
    open = panels(store);
    CHECK(open->count == 2 && open->at[0].id == refused && open->at[1].id == waits);
    CHECK(strcmp(open->at[0].message, "torn") == 0 && !open->at[0].job.state[0]);
    CHECK(open->at[0].arrived == 0 && open->at[1].arrived == NOON);
    CHECK(strcmp(open->at[1].job.state, "running") == 0);
    CHECK(strcmp(open->at[1].job.stage, "decode") == 0 && open->at[1].job.eta_s == 7.5);
    CHECK(open->at[1].job.done == 2 && open->at[1].job.total == 5);
    rows = list(store);
    CHECK(strcmp(rows->at[0].job.state, "waiting") == 0 && rows->at[0].changed == NOON);
}

static int list_once(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_overview_rows) rows = NULL;
    gsn_auto(gsn_open_panel_rows) open = NULL;
    const int r = gsn_overview_list(store, &rows, err);

    return r < 0 ? r : gsn_overview_panels(store, &open, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t one = bench_add_specimen(store, "S01", "control", "");
    struct gsn_error err = { 0 };

    set_state(store, bench_add_panel(store, one, 1), "held", "no number");
    CHECK_EVERY_OOM(list_once(store, &err), err);
}

TEST(a_table_that_is_gone_is_refused_and_the_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_overview_rows *rows = NULL;
    struct gsn_error err = { 0 };

    CHECK(bench_raw(&scratch, "DROP TABLE scan") == 0);
    CHECK(gsn_overview_list(store, &rows, &err) == GSN_E_STORE);
    CHECK(rows == NULL && err.text[0]);
}

TEST(another_handles_commit_changes_the_number_of_the_store_and_nothing_else_does)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    int64_t before = 0, same = 0, after = 0;

    CHECK_OK(gsn_store_change(store, &before, &err), err);
    CHECK_OK(gsn_store_change(store, &same, &err), err);
    CHECK(bench_raw(&scratch, "INSERT INTO study (name) VALUES ('x')") == 0);
    CHECK_OK(gsn_store_change(store, &after, &err), err);
    CHECK(before == same && before != after);
}
