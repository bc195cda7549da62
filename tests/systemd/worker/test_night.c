/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/worker/job_inputs.h"
#include "systemd/worker/job.h"

#include "storage/queue.h"
#include "storage/result.h"
#include "systemd/worker/specimen_job.h"
#include "tests/storage/bench.h"

#include <string.h>
#include <unistd.h>

static const char JOB[] = "{\"specimen\": \"S01\", \"px_um\": 16, \"panels\": 2}";

/* A specimen with one panel that has been read. */
static int64_t add(struct gsn_store *store, const char *name, const char *baseline)
{
    struct gsn_specimen_row row = bench_specimen(name, name, baseline);
    struct gsn_error err = { 0 };
    int64_t id = 0;

    row.job_json = JOB;
    CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "test", NOON, &id, &err), err);
    CHECK_OK(gsn_panel_set_state(store, bench_add_panel(store, id, 1), "registered", "", "", &err),
             err);
    return id;
}

/* As if its job had been worked now. */
static void report(struct gsn_store *store, int64_t id, const char *own_key)
{
    gsn_auto_mem(char) parameters = gsn_format("{\"own_key\": \"%s\"}", own_key);
    struct gsn_digest key = { "" };
    struct gsn_run_row run = { .specimen_id = id,
                               .key = key.hex,
                               .version = "1",
                               .inputs_json = "{}",
                               .parameters_json = parameters };
    const struct gsn_run_end end = { .state = "withheld", .report_path = "r", .json_path = "j" };
    struct gsn_error err = { 0 };
    int64_t run_id = 0;

    CHECK_OK(gsn_job_inputs_key_now(store, id, &key, &err), err);
    CHECK_OK(gsn_run_begin(store, &run, NOON, &run_id, &err), err);
    CHECK_OK(gsn_run_finish(store, run_id, &end, NOON, &err), err);
}

static size_t ask(struct gsn_store *store)
{
    struct gsn_error err = { 0 };
    size_t count = 0;

    CHECK_OK(gsn_job_ask_changed(store, &count, &err), err);
    return count;
}

/* Claims the job that waits and ends it so. */
static void end_job(struct gsn_store *store, int64_t specimen, int fails)
{
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_queue_claim(store, "test", getpid(), 60, NOON, &job, &err), err);
    CHECK(job->specimen_id == specimen && job->panel_id == 0);
    if (fails)
        CHECK_OK(gsn_queue_fail(store, job, GSN_E_MESH, "no mesh", &err), err);
    else
        CHECK_OK(gsn_queue_done(store, job, &err), err);
}

TEST(a_specimen_without_a_report_is_asked_for_once)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t id = add(store, "S01", "");

    CHECK(ask(store) == 1);
    CHECK(ask(store) == 0); /* it waits already */
    end_job(store, id, 0);
    report(store, id, "k");
    CHECK(ask(store) == 0);
}

TEST(other_panels_and_other_settings_are_a_change)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t id = add(store, "S01", "");
    struct gsn_specimen_row row = bench_specimen("S01", "S01", "");
    struct gsn_error err = { 0 };
    int64_t same = 0;

    report(store, id, "k");
    CHECK(ask(store) == 0);
    (void)bench_add_panel(store, id, 2);
    CHECK(ask(store) == 1);
    end_job(store, id, 0);
    report(store, id, "k");
    row.job_json = "{\"specimen\": \"S01\", \"px_um\": 17, \"panels\": 2}";
    CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REPLACE, "test", NOON, &same, &err), err);
    CHECK(ask(store) == 1);
}

TEST(another_baseline_is_a_change)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t control = add(store, "control", "");
    const int64_t treated = add(store, "treated", "control");

    report(store, control, "old");
    report(store, treated, "k");
    CHECK(ask(store) == 0);
    report(store, control, "new");
    CHECK(ask(store) == 1);
    end_job(store, treated, 0);
}

TEST(what_failed_stays_failed)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t id = add(store, "S01", "");

    CHECK(ask(store) == 1);
    end_job(store, id, 1);
    CHECK(ask(store) == 0);
}

TEST(a_specimen_that_waits_for_its_first_panel_is_left_alone)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    (void)bench_add_specimen(store, "S01", "control", "");
    CHECK(ask(store) == 0);
}

TEST(a_store_that_cannot_be_asked_is_refused_and_the_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    size_t count = 7;

    (void)add(store, "S01", "");
    CHECK(bench_raw(&scratch, "DROP TABLE attachment") == 0);
    CHECK(gsn_job_ask_changed(store, &count, &err) == GSN_E_STORE);
    CHECK(count == 7 && err.text[0]);
}

static int ask_once(struct gsn_store *store, struct gsn_error *err)
{
    size_t count;

    return gsn_job_ask_changed(store, &count, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    report(store, add(store, "S01", ""), "k");
    CHECK_EVERY_OOM(ask_once(store, &err), err);
}
