/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How a panel lies travels with it from its own job to its specimen's, in the store. */
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "systemd/worker/job.h"
#include "systemd/worker/specimen_job.h"
#include "tests/check.h"
#include "tests/specimen/drawn_label.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/systemd/worker/bench_job.h"

#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const struct gsn_job_options OPTIONS = { .mesher = GSN_MESHER,
                                                .owner = "test",
                                                .threads = 1 };

/* The region lies beside the axis, where tissue is denser than on the other side. */
#define MEAN_DENSITY (0.6 * (1 + DRAWN_SLOPE * 240))
static const char JOB[] =
    "{\"specimen\": \"a\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 2, "
    "\"transfer\": \"linear\", \"thresholds\": [0.5], \"markers_um\": " DRAWN_MARKS_JSON ", "
    "\"region\": {\"shape\": \"box\", \"min\": [0, -144, 0], \"max\": [480, 144, 192]}}";

enum { PANELS = 2, ALL_JOBS = PANELS + 1 };

/* Two panels that lie on their heads, in the queue. */
static struct gsn_store *taken_in(const struct gsn_scratch *scratch)
{
    struct gsn_store *store = bench_open(scratch, GSN_STORE_CREATE);
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_job(scratch, "in", JOB);
    for (unsigned number = 1; number <= PANELS; number++) {
        struct drawn_panel panel = drawn_panel_of(number, 24, 0.6);
        const char name[] = { 'P', '0', (char)('0' + number), '.', 'p', 'n', 'g', '\0' };
        size_t size;

        panel.quarters = 2;
        gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

        bench_write(scratch, "in", name, png, size);
    }
    CHECK_OK(bench_import(scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(counts.taken == PANELS);
    drawn_label_lies(0, 2);
    return store;
}

/* Does so many jobs, all well; what is left waits. */
static void work(struct gsn_store *store, unsigned jobs)
{
    struct gsn_error err = { 0 };

    for (unsigned i = 0; i < jobs; i++)
        CHECK_OK(gsn_job_next(store, &OPTIONS, &err), err);
}

static void check_idle(struct gsn_store *store)
{
    struct gsn_error err = { 0 };

    CHECK(gsn_job_next(store, &OPTIONS, &err) == GSN_E_NOTFOUND);
}

static struct gsn_run_row *latest(struct gsn_store *store)
{
    struct gsn_run_row *run = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_run_latest(store, 1, NULL, &run, &err), err);
    return run;
}

static void check_density(struct gsn_store *store, const struct gsn_run_row *run)
{
    gsn_auto(gsn_measure_rows) rows = NULL;
    struct gsn_error err = { 0 };
    double density = 0;

    CHECK(strcmp(run->state, "reported") == 0);
    CHECK_OK(gsn_measure_list(store, run->id, &rows, &err), err);
    for (size_t i = 0; i < rows->count; i++)
        if (strcmp(rows->at[i].name, "mean_density") == 0)
            density = rows->at[i].value;
    CHECK_NEAR(density, MEAN_DENSITY, 0.004);
}

static struct gsn_panel_rows *panels_of(struct gsn_store *store)
{
    struct gsn_panel_rows *panels = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK(panels->count == PANELS);
    return panels;
}

/* As a gieson of the seventh schema left it. */
static void forget_turns(const struct gsn_scratch *scratch)
{
    CHECK(bench_raw(scratch, "UPDATE panel SET mirrored = NULL, quarters = NULL, turn_note = ''") ==
          0);
}

static void ask_for_specimen(struct gsn_store *store)
{
    struct gsn_error err = { 0 };
    int64_t id;

    CHECK_OK(gsn_queue_add(store, 1, 0, &id, &err), err);
}

/* Case 16. */
TEST(a_specimen_is_measured_as_its_panels_were_examined_though_no_label_can_be_read_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = taken_in(&scratch);

    work(store, PANELS);
    gsn_auto(gsn_panel_rows) panels = panels_of(store);

    for (size_t i = 0; i < PANELS; i++) {
        CHECK(strcmp(panels->at[i].state, "registered") == 0 && panels->at[i].turn_known);
        CHECK(panels->at[i].quarters == 2 && panels->at[i].mirrored == 0);
        assert_string_equal(panels->at[i].turn_note,
                            "turned by 180 degrees: the code on its label stood on its head");
    }
    drawn_label_fails();
    work(store, 1);
    check_idle(store);
    gsn_auto(gsn_run_row) run = latest(store);

    check_density(store, run);
    CHECK(drawn_label_asked() == PANELS);
}

TEST(panels_that_an_older_gieson_looked_at_are_looked_at_again_before_they_are_used)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = taken_in(&scratch);
    struct gsn_verdict verdict = { 0 };
    struct gsn_error err = { 0 };

    work(store, ALL_JOBS);
    gsn_auto(gsn_run_row) run = latest(store);

    check_density(store, run);
    forget_turns(&scratch);
    /* To verify a run keeps nothing, so it looks at them for itself. */
    CHECK_OK(bench_verify(store, run->id, &OPTIONS, &verdict, &err), err);
    CHECK(verdict.findings == 0 && verdict.same_json && verdict.same_html);
    check_idle(store); /* nobody asked for anything */

    ask_for_specimen(store);
    work(store, 1 + ALL_JOBS); /* the specimen, which waits for its panels, and then all */
    check_idle(store);
    CHECK(drawn_label_asked() == 3 * PANELS);
    gsn_auto(gsn_panel_rows) panels = panels_of(store);

    for (size_t i = 0; i < PANELS; i++)
        CHECK(panels->at[i].turn_known && panels->at[i].quarters == 2);
    gsn_auto(gsn_run_row) again = latest(store);

    CHECK(again->id > run->id);
    assert_string_equal(again->json_sha256, run->json_sha256);
    assert_string_equal(again->report_sha256, run->report_sha256);
    CHECK_OK(bench_verify(store, again->id, &OPTIONS, &verdict, &err), err);
    CHECK(verdict.same_inputs && verdict.same_json && verdict.same_html);
}

/* Its own job fails, and the specimen is worked without it instead of waiting for ever. */
TEST(a_panel_that_cannot_be_looked_at_again_is_named_and_holds_nothing_up)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = taken_in(&scratch);
    gsn_auto_mem(char) path = NULL;
    struct gsn_error err = { 0 };

    work(store, ALL_JOBS);
    gsn_auto(gsn_panel_rows) panels = panels_of(store);

    CHECK_OK(gsn_store_object_path(store, panels->at[1].sha256, &path, &err), err);
    CHECK(chmod(path, 0644) == 0);
    gsn_scratch_overwrite(path, 1000, "\x5a\xa5", 2);
    forget_turns(&scratch);
    ask_for_specimen(store);
    work(store, 2);
    CHECK(gsn_job_next(store, &OPTIONS, &err) == GSN_E_IO);
    work(store, 1);
    check_idle(store);
    gsn_auto(gsn_run_row) run = latest(store);
    gsn_auto_mem(uint8_t) json = NULL;
    size_t size;

    CHECK_OK(gsn_file_read(gsn_scratch_path(&scratch, run->json_path), 1 << 26, &json, &size, &err),
             err);
    CHECK(strstr((const char *)json, "P02.png was not used: its own job failed"));
}

/* A claimed job of a specimen whose panels an older gieson looked at. */
static struct gsn_job_row *claimed(const struct gsn_scratch *scratch, struct gsn_store *store)
{
    struct gsn_job_row *job = NULL;
    struct gsn_error err = { 0 };

    work(store, ALL_JOBS);
    forget_turns(scratch);
    ask_for_specimen(store);
    CHECK_OK(gsn_queue_claim(store, "test", getpid(), 600, gsn_queue_clock(), &job, &err), err);
    return job;
}

static void check_all_are_looked_at(struct gsn_store *store, const struct gsn_job_row *job)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_job(store, job, &OPTIONS, NULL, &err), err);
    work(store, ALL_JOBS); /* each panel once, and the specimen */
    check_idle(store);
    CHECK(drawn_label_asked() == 2 * PANELS);
}

TEST(panels_are_asked_for_all_or_none)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = taken_in(&scratch);
    gsn_auto(gsn_job_row) job = claimed(&scratch, store);
    struct gsn_job_counts counts;
    struct gsn_error err = { 0 };

    CHECK(bench_raw(&scratch, "CREATE TRIGGER full BEFORE UPDATE ON panel WHEN NEW.number = 2 "
                              "BEGIN SELECT RAISE(ABORT, 'full'); END") == 0);
    CHECK(gsn_specimen_job(store, job, &OPTIONS, NULL, &err) < 0);
    CHECK(strstr(err.text, "full"));
    CHECK_OK(gsn_queue_counts(store, &counts, &err), err);
    CHECK(counts.waiting == 0 && counts.running == 1);
    CHECK(bench_raw(&scratch, "DROP TRIGGER full") == 0);
    check_all_are_looked_at(store, job);
}

TEST(running_out_of_memory_while_panels_are_asked_for_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = taken_in(&scratch);
    gsn_auto(gsn_job_row) job = claimed(&scratch, store);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(gsn_specimen_job(store, job, &OPTIONS, NULL, &err), err);
    work(store, ALL_JOBS);
    check_idle(store);
}
