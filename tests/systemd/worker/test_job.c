/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/worker/job.h"

#include "pipeline/core/hash.h"
#include "storage/audit_log.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "tests/check.h"
#include "tests/systemd/worker/bench_job.h"

#include <jansson.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static const struct gsn_job_options OPTIONS = {
    .mesher = GSN_MESHER, .decoder = GSN_DECODER, .owner = "test", .threads = 1
};

#define HEAD                                                                                       \
    "\"px_um\": 24, \"layout\": [2, 2], \"panels\": 2, \"transfer\": \"linear\", \"thresholds\": " \
    "[0.5], \"markers_um\": " DRAWN_MARKS_JSON
#define REGION                                                                                     \
    ", \"region\": {\"shape\": \"box\", \"min\": [-240, -144, 0], \"max\": [240, 144, 192]}"

/* A folder with two good panels. */
static void write_specimen(const struct gsn_scratch *scratch, const char *name, const char *more,
                           double density)
{
    gsn_auto_mem(char) job = gsn_format("{\"specimen\": \"%s\", " HEAD "%s}", name, more);

    bench_write_job(scratch, name, job);
    bench_write_panel(scratch, name, "P01.png", 1, density);
    bench_write_panel(scratch, name, "P02.png", 2, density);
}

static struct gsn_import_counts take(const struct gsn_scratch *scratch, struct gsn_store *store,
                                     const char *folder)
{
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    CHECK_OK(bench_import(scratch, store, folder, 0, &heard, &counts, &err), err);
    return counts;
}

/* Works until the queue is empty; returns the number of jobs done. Fails the test when a job fails
 * or when most are not enough. */
static unsigned work_all(struct gsn_store *store, unsigned most)
{
    struct gsn_error err = { 0 };

    for (unsigned done = 0;; done++) {
        const int r = gsn_job_next(store, &OPTIONS, &err);

        if (r == GSN_E_NOTFOUND)
            return done;
        CHECK_OK(r, err);
        if (done == most)
            fail_msg("the queue is not empty after %u jobs", most);
    }
}

static int64_t specimen_id(struct gsn_store *store, const char *name)
{
    gsn_auto(gsn_specimen_row) row = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_get(store, name, &row, &err), err);
    return row->id;
}

static struct gsn_run_row *latest(struct gsn_store *store, const char *name)
{
    struct gsn_run_row *run = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_run_latest(store, specimen_id(store, name), NULL, &run, &err), err);
    return run;
}

static double measure(struct gsn_store *store, const struct gsn_run_row *run, const char *name)
{
    gsn_auto(gsn_measure_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_measure_list(store, run->id, &rows, &err), err);
    for (size_t i = 0; i < rows->count; i++)
        if (strcmp(rows->at[i].name, name) == 0)
            return rows->at[i].value;
    return NAN;
}

/* The bytes of a file of the store, after their hash was compared with the row's. gives. */
static uint8_t *stored(const struct gsn_scratch *scratch, const char *relative, const char *sha256,
                       size_t *ret_size)
{
    uint8_t *bytes = NULL;
    struct gsn_digest digest;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_read(gsn_scratch_path(scratch, relative), 1 << 26, &bytes, ret_size, &err),
             err);
    CHECK_OK(gsn_sha256(bytes, *ret_size, &digest, &err), err);
    CHECK(strcmp(digest.hex, sha256) == 0);
    return bytes;
}

static void check_report(const struct gsn_scratch *scratch, const struct gsn_run_row *run)
{
    size_t size;
    gsn_auto_mem(uint8_t) html = stored(scratch, run->report_path, run->report_sha256, &size);
    gsn_auto_mem(uint8_t) json = stored(scratch, run->json_path, run->json_sha256, &size);
    json_t *root = json_loadb((const char *)json, size, JSON_REJECT_DUPLICATES, NULL);

    CHECK(root != NULL && strstr((const char *)html, "</html>") != NULL);
    json_decref(root);
}

static const struct gsn_panel_row *panel_named(const struct gsn_panel_rows *rows, const char *name)
{
    for (size_t i = 0; i < rows->count; i++)
        if (strcmp(rows->at[i].file_name, name) == 0)
            return &rows->at[i];
    fail_msg("there is no panel %s", name);
    return NULL;
}

static void check_panel(const struct gsn_panel_rows *rows, const char *name, const char *state,
                        const char *code, const char *says)
{
    const struct gsn_panel_row *row = panel_named(rows, name);

    if (strcmp(row->state, state) != 0 || strcmp(row->code, code) != 0 ||
        !strstr(row->message, says))
        fail_msg("%s is %s (%s): %s", name, row->state, row->code, row->message);
}

/* Everything that can come in one folder: good panels, one cut off, one without a number, one
 * beyond the stated number, two of one number, an empty file and one that is no picture. */
static void write_awkward(const struct gsn_scratch *scratch)
{
    const struct drawn_panel panel = drawn_panel_of(3, 24, 0.6);
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

    bench_write_job(scratch, "in",
                    "{\"specimen\": \"a\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 5, "
                    "\"transfer\": \"linear\", \"thresholds\": [0.5], "
                    "\"markers_um\": " DRAWN_MARKS_JSON REGION "}");
    bench_write_panel(scratch, "in", "P01.png", 1, 0.6);
    bench_write_panel(scratch, "in", "P02.png", 2, 0.6);
    bench_write(scratch, "in", "P03.png", png, size / 2);
    bench_write_panel(scratch, "in", "scan.png", 4, 0.6);
    bench_write_panel(scratch, "in", "P04.png", 4, 0.5);
    bench_write_panel(scratch, "in", "P04_rescan.png", 4, 0.55);
    bench_write_panel(scratch, "in", "P09.png", 9, 0.6);
    bench_write(scratch, "in", "P05.png", "", 0);
}

/* Cases 31 and 32. */
TEST(awkward_panels_cost_only_themselves)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) panels = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;
    int64_t asked = 0;

    write_awkward(&scratch);
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(counts.taken == 7 && counts.again == 0 && counts.held == 1);
    CHECK(strstr(heard.text, "scan.png: its name holds no panel number") != NULL);
    CHECK(strstr(heard.text, "P05.png: ") != NULL && strstr(heard.text, "P03.png: ") != NULL);
    CHECK(work_all(store, 20) == 8);
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK(panels->count == 7);
    check_panel(panels, "P01.png", "registered", "", "");
    check_panel(panels, "P02.png", "registered", "", "");
    check_panel(panels, "P03.png", "refused", "input", "");
    CHECK(panel_named(panels, "P03.png")->message[0] != '\0');
    check_panel(panels, "scan.png", "held", "withheld", "no panel number");
    check_panel(panels, "P09.png", "held", "withheld",
                "panel number 9, but job.json says there "
                "are 5");
    check_panel(panels, "P04.png", "held", "spare",
                "another scan of panel 4 is used, P04_rescan.png: both show the same glass (12 "
                "marks agree to ");
    check_panel(panels, "P04_rescan.png", "registered", "", "");

    gsn_auto(gsn_run_row) run = latest(store, "a");

    CHECK(strcmp(run->state, "reported") == 0);
    CHECK_NEAR(measure(store, run, "mean_density"), 0.6, 0.004);
    check_report(&scratch, run);

    /* The same folder again brings nothing new and asks for nothing; asked for, the report is the
     * same. */
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(counts.taken == 0 && counts.again == 7);
    CHECK(work_all(store, 20) == 0);
    CHECK_OK(gsn_queue_add(store, run->specimen_id, 0, &asked, &err), err);
    CHECK(work_all(store, 20) == 1);
    gsn_auto(gsn_run_row) again = latest(store, "a");

    CHECK(strcmp(again->json_sha256, run->json_sha256) == 0);
    CHECK(strcmp(again->report_sha256, run->report_sha256) == 0);
    CHECK(strcmp(again->report_path, run->report_path) == 0);
    gsn_panel_rows_free(gsn_steal(&panels));
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK(panels->count == 7);
}

/* The figures are the same whoever decodes; a panel that does harm to its decoder is refused. */
TEST(a_decoder_apart_changes_nothing_and_a_harmful_panel_costs_only_itself)
{
    const struct gsn_job_options here = { .mesher = GSN_MESHER, .owner = "test", .threads = 1 };
    struct gsn_job_options attacked = OPTIONS;
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) panels = NULL;
    struct gsn_verdict verdict = { 0 };
    struct gsn_error err = { 0 };

    attacked.decoder = GSN_MISBEHAVING;
    write_specimen(&scratch, "a", "", 0.6);
    (void)take(&scratch, store, "a");
    CHECK_OK(gsn_job_next(store, &attacked, &err), err);
    CHECK(work_all(store, 9) == 2);
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    check_panel(panels, "P01.png", "refused", "input", "an answer that cannot be");
    check_panel(panels, "P02.png", "registered", "", "");
    gsn_auto(gsn_run_row) run = latest(store, "a");

    CHECK_OK(bench_verify(store, run->id, &here, &verdict, &err), err);
    CHECK(verdict.same_inputs && verdict.same_json && verdict.same_html);
}

/* Case 31: two glasses of one number. */
TEST(a_held_panel_is_released_by_importing_it_under_its_right_name)
{
    static const char job[] = "{\"specimen\": \"a\", \"px_um\": 24, \"layout\": [2, 2], "
                              "\"transfer\": \"linear\", \"thresholds\": [0.5], "
                              "\"markers_um\": " DRAWN_MARKS_JSON REGION "}";
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) panels = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_job(&scratch, "in", job);
    bench_write_panel(&scratch, "in", "P01.png", 1, 0.6);
    bench_write_panel(&scratch, "in", "P02.png", 2, 0.6);
    bench_write_panel(&scratch, "in", "P02_b.png", 3, 0.55);
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(work_all(store, 20) == 4);
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    check_panel(panels, "P02.png", "held", "withheld",
                "claimed by P02_b.png as well, which shows another glass: say which to use, or "
                "rename one and import again");

    bench_write_job(&scratch, "renamed", job);
    bench_write_panel(&scratch, "renamed", "P03.png", 3, 0.55);
    CHECK_OK(bench_import(&scratch, store, "renamed", 0, &heard, &counts, &err), err);
    CHECK(counts.taken == 0 && counts.again == 1);
    CHECK(work_all(store, 20) == 3);
    gsn_panel_rows_free(gsn_steal(&panels));
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK(panels->count == 3);
    check_panel(panels, "P02.png", "registered", "", "");
    check_panel(panels, "P03.png", "registered", "", "");
    CHECK(panel_named(panels, "P03.png")->number == 3);
}

/* The queue has a specimen whose work needs a program that is not installed, and panels that do
 * not. */
TEST(a_program_that_is_missing_costs_the_jobs_that_need_it_and_says_so)
{
    struct gsn_job_options lacking = OPTIONS;
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_job_rows) jobs = NULL;
    struct gsn_verdict verdict = { 0 };
    struct gsn_error err = { 0 };
    size_t again = 0;

    lacking.mesher = NULL;
    lacking.lacks_mesher = "there is no gieson-mesh";
    write_specimen(&scratch, "a", "", 0.6);
    (void)take(&scratch, store, "a");
    CHECK_OK(gsn_job_next(store, &lacking, &err), err);
    CHECK_OK(gsn_job_next(store, &lacking, &err), err);
    CHECK(gsn_job_next(store, &lacking, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text, "specimen a: there is no gieson-mesh");
    CHECK(gsn_job_next(store, &lacking, &err) == GSN_E_NOTFOUND);
    CHECK_OK(gsn_queue_list(store, &jobs, &err), err);
    for (size_t i = 0; i < jobs->count; i++) {
        const struct gsn_job_row *const job = &jobs->at[i];
        const int is_panel = strcmp(job->kind, "panel") == 0;

        CHECK(strcmp(job->state, is_panel ? "done" : "failed") == 0);
        assert_string_equal(job->message, is_panel ? "" : lacking.lacks_mesher);
    }

    /* It is installed. */
    CHECK_OK(gsn_queue_retry(store, 0, &again, &err), err);
    CHECK(again == 1 && work_all(store, 9) == 1);
    gsn_auto(gsn_run_row) run = latest(store, "a");

    CHECK(bench_verify(store, run->id, &lacking, &verdict, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text, lacking.lacks_mesher);
    CHECK(verdict.run == 0);

    /* Without the other one there is nothing that a panel could be done with. */
    lacking.lacks_decoder = "there is no gieson-decode";
    write_specimen(&scratch, "b", "", 0.7);
    (void)take(&scratch, store, "b");
    CHECK(gsn_job_next(store, &lacking, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text, "panel b, P01.png: there is no gieson-decode");
}

static void damage(struct gsn_store *store, const char *sha256)
{
    gsn_auto_mem(char) path = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_store_object_path(store, sha256, &path, &err), err);
    CHECK(chmod(path, 0644) == 0);
    gsn_scratch_overwrite(path, 1000, "\x5a\xa5", 2);
}

TEST(a_finished_run_can_be_verified_and_a_damaged_object_is_named)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto(gsn_job_rows) jobs = NULL;
    struct gsn_verdict verdict = { 0 };
    struct gsn_error err = { 0 };
    const struct gsn_job_row *job;
    int64_t id;

    write_specimen(&scratch, "a", REGION, 0.6);
    write_specimen(&scratch, "b", "", 0.7); /* no region: quick */
    (void)take(&scratch, store, "a");
    CHECK(work_all(store, 9) == 3);
    gsn_auto(gsn_run_row) run = latest(store, "a");

    CHECK_OK(bench_verify(store, run->id, &OPTIONS, &verdict, &err), err);
    CHECK(verdict.same_inputs && verdict.same_json && verdict.same_html);
    CHECK(verdict.run == run->id && strcmp(verdict.was, verdict.is) == 0);
    CHECK(strcmp(verdict.was, run->json_sha256) == 0);
    CHECK(bench_verify(store, 99, &OPTIONS, &verdict, &err) == GSN_E_NOTFOUND);

    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    damage(store, panels->at[1].sha256);
    CHECK(bench_verify(store, run->id, &OPTIONS, &verdict, &err) == GSN_E_IO);
    CHECK(strstr(err.text, "is damaged: its bytes no longer have this hash") != NULL);

    /* The panel's own job fails with the sentence; another specimen is worked all the same. */
    (void)take(&scratch, store, "b");
    CHECK_OK(gsn_queue_add(store, 1, panels->at[1].id, &id, &err), err);
    CHECK(gsn_job_next(store, &OPTIONS, &err) == GSN_E_IO);
    CHECK(strstr(err.text, "panel a, P02.png: the stored object ") == err.text);
    CHECK_OK(gsn_queue_list(store, &jobs, &err), err);
    job = &jobs->at[0];
    for (size_t i = 0; i < jobs->count; i++)
        if (jobs->at[i].id == id)
            job = &jobs->at[i];
    CHECK(strcmp(job->state, "failed") == 0 && strcmp(job->code, "io") == 0);
    CHECK(strstr(job->message, "is damaged") != NULL);
    CHECK(work_all(store, 9) == 3);
    gsn_auto(gsn_run_row) other = latest(store, "b");

    CHECK(strcmp(other->state, "withheld") == 0);
    check_report(&scratch, other);
    check_report(&scratch, run);

    /* Importing the original again mends the object, and the failed job passes. */
    size_t retried;

    (void)take(&scratch, store, "a");
    CHECK_OK(gsn_queue_retry(store, 0, &retried, &err), err);
    CHECK(retried == 1 && work_all(store, 9) == 2);
    gsn_auto(gsn_run_row) mended = latest(store, "a");

    CHECK(strcmp(mended->json_sha256, run->json_sha256) == 0);
}

/* The report is made without a panel whose job failed, names it, and is made again with it. */
TEST(a_panel_that_comes_right_later_brings_its_specimen_back)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(uint8_t) good = NULL;
    struct gsn_error err = { 0 };
    size_t good_size, size, retried;

    write_specimen(&scratch, "a", "", 0.6);
    (void)take(&scratch, store, "a");
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK_OK(gsn_store_object_path(store, panels->at[1].sha256, &path, &err), err);
    CHECK_OK(gsn_file_read(path, 1 << 26, &good, &good_size, &err), err);
    damage(store, panels->at[1].sha256);
    CHECK_OK(gsn_job_next(store, &OPTIONS, &err), err);
    CHECK(gsn_job_next(store, &OPTIONS, &err) == GSN_E_IO);

    /* The report lists every file it rests on; a panel it does not use is only named. */
    CHECK(work_all(store, 3) == 1);
    gsn_auto(gsn_run_row) without = latest(store, "a");
    gsn_auto_mem(uint8_t) json = stored(&scratch, without->json_path, without->json_sha256, &size);

    CHECK(strstr((const char *)json, "P02.png was not used: its own job failed") != NULL);
    gsn_scratch_overwrite(path, 0, good, good_size);
    CHECK_OK(gsn_queue_retry(store, 0, &retried, &err), err);
    CHECK(retried == 1 && work_all(store, 3) == 2);
    gsn_auto(gsn_run_row) with = latest(store, "a");
    gsn_auto_mem(uint8_t) whole = stored(&scratch, with->json_path, with->json_sha256, &size);

    CHECK(with->id > without->id && !strstr((const char *)whole, "was not used"));
    check_report(&scratch, without); /* still there */
}

TEST(a_treated_specimen_is_done_again_when_its_control_is_reported)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    write_specimen(&scratch, "treated", ", \"baseline\": \"control\"" REGION, 0.6);
    write_specimen(&scratch, "control", REGION, 0.8);
    (void)take(&scratch, store, "treated");
    CHECK(work_all(store, 9) == 3);
    gsn_auto(gsn_run_row) before = latest(store, "treated");

    CHECK(strcmp(before->state, "withheld") == 0);
    CHECK(strstr(before->message, "the baseline control has no result yet") == before->message);
    (void)take(&scratch, store, "control");
    CHECK(work_all(store, 9) == 4); /* two panels, the control, the treated one again */
    gsn_auto(gsn_run_row) after = latest(store, "treated");

    CHECK(after->id > before->id && strcmp(after->state, "reported") == 0);
    CHECK_NEAR(measure(store, after, "loss"), 25, 0.5);
    check_report(&scratch, after);
}

/* Of the control's region a third lies on a panel that has not come. */
TEST(a_control_that_is_half_there_gives_no_loss_until_the_rest_comes)
{
    static const char *const region =
        ", \"region\": {\"shape\": \"box\", \"min\": [-240, -144, 0], \"max\": [240, 144, 144]}";
    gsn_auto_mem(char) treated = gsn_format("%s, \"baseline\": \"control\"", region);
    gsn_auto_mem(char) control = gsn_format("{\"specimen\": \"control\", " HEAD "%s}", region);
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    write_specimen(&scratch, "treated", treated, 0.6);
    bench_write_job(&scratch, "control", control);
    bench_write_panel(&scratch, "control", "P01.png", 1, 0.8);
    (void)take(&scratch, store, "control");
    (void)take(&scratch, store, "treated");
    (void)work_all(store, 9);
    gsn_auto(gsn_run_row) before = latest(store, "treated");

    assert_string_equal(before->message, "of the baseline control only 67 % of the region of "
                                         "interest has data: settle what its report says, then run "
                                         "again");
    CHECK(strcmp(before->state, "withheld") == 0);
    bench_write_panel(&scratch, "control", "P02.png", 2, 0.8);
    (void)take(&scratch, store, "control");
    (void)work_all(store, 9);
    gsn_auto(gsn_run_row) after = latest(store, "treated");

    CHECK(strcmp(after->state, "reported") == 0);
    CHECK_NEAR(measure(store, after, "loss"), 25, 0.5);
}

/* Each is the other's baseline. With figures and without, the work ends. */
TEST(baselines_in_a_circle_end)
{
    static const char *const regions[] = { "", REGION };

    for (size_t i = 0; i < 2; i++) {
        scratch_auto scratch = gsn_scratch_new();
        gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
        gsn_auto_mem(char) of_a = gsn_format(", \"baseline\": \"b\"%s", regions[i]);
        gsn_auto_mem(char) of_b = gsn_format(", \"baseline\": \"a\"%s", regions[i]);

        write_specimen(&scratch, "a", of_a, 0.7);
        write_specimen(&scratch, "b", of_b, 0.8);
        (void)take(&scratch, store, "a");
        (void)take(&scratch, store, "b");
        (void)work_all(store, 12);
        gsn_auto(gsn_run_row) a = latest(store, "a");
        gsn_auto(gsn_run_row) b = latest(store, "b");

        CHECK((strcmp(a->state, "reported") == 0) == (i == 1));
        CHECK((strcmp(b->state, "reported") == 0) == (i == 1));
        if (i == 1)
            CHECK_NEAR(measure(store, a, "loss"), 12.5, 0.5);
    }
}

TEST(an_empty_queue_says_so)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    CHECK(gsn_job_next(store, &OPTIONS, &err) == GSN_E_NOTFOUND);
}

/* A child that works the next job in the store and is killed after so many microseconds. */
static void kill_a_worker(const struct gsn_scratch *scratch, long after_us)
{
    const struct timespec wait = { .tv_sec = after_us / 1000000,
                                   .tv_nsec = after_us % 1000000 * 1000 };
    int status;
    const pid_t child = fork();

    CHECK(child >= 0);
    if (child == 0) {
        struct gsn_store *store = NULL;

        if (gsn_store_open(scratch->dir, GSN_STORE_WRITE, &store, NULL) == GSN_OK)
            while (gsn_job_next(store, &OPTIONS, NULL) == GSN_OK)
                ;
        _exit(0);
    }
    (void)nanosleep(&wait, NULL);
    (void)kill(child, SIGKILL);
    CHECK(waitpid(child, &status, 0) == child);
}

static uint8_t *report_after(const struct gsn_scratch *scratch, size_t *ret_size)
{
    gsn_auto(gsn_store) store = bench_open(scratch, GSN_STORE_WRITE);
    gsn_auto(gsn_event_rows) events = NULL;
    struct gsn_event_verdict chain = { 0 };
    struct gsn_error err = { 0 };

    (void)work_all(store, 9);
    gsn_auto(gsn_run_row) run = latest(store, "a");

    CHECK(strcmp(run->state, "reported") == 0);
    CHECK_OK(gsn_event_verify(store, NULL, &chain, &err), err);
    CHECK(chain.broken == 0);
    return stored(scratch, run->json_path, run->json_sha256, ret_size);
}

static void import_alone(const struct gsn_scratch *scratch)
{
    gsn_auto(gsn_store) store = bench_open(scratch, GSN_STORE_CREATE);

    write_specimen(scratch, "a", REGION, 0.6);
    (void)take(scratch, store, "a");
}

/* Case 57. SQLite's handles do not survive a fork, so no store is open while one happens. */
TEST(a_killed_worker_costs_nothing_but_its_time)
{
    /* From a look at the queue to the middle of the fit and the pictures; fewer deaths than give a
     * job up. */
    static const long moments_us[] = { 4000, 60000, 350000, 900000 };
    scratch_auto calm = gsn_scratch_new();
    scratch_auto disturbed = gsn_scratch_new();
    size_t size, other_size;

    import_alone(&calm);
    import_alone(&disturbed);
    for (size_t i = 0; i < sizeof moments_us / sizeof moments_us[0]; i++)
        kill_a_worker(&disturbed, moments_us[i]);
    gsn_auto_mem(uint8_t) json = report_after(&calm, &size);
    gsn_auto_mem(uint8_t) other = report_after(&disturbed, &other_size);

    CHECK(size == other_size && memcmp(json, other, size) == 0);
}
