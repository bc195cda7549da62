/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/worker/import.h"

#include "storage/catalog.h"
#include "storage/queue.h"
#include "tests/check.h"
#include "tests/systemd/worker/bench_job.h"

TEST(a_wrong_job_is_refused_with_its_sentence_and_leaves_no_specimen)
{
    static const struct {
        const char *job; /* NULL: there is none */
        int code;
        const char *says;
    } cases[] = {
        { NULL, GSN_E_NOTFOUND, "has no job.json" },
        { "{\"specimen\": \"a\",", GSN_E_INPUT, "job.json: line 1" },
        { "{\"specimen\": \"a\", \"px_um\": -1}", GSN_E_INPUT, "\"px_um\"" },
        { "{\"specimen\": \"a\", \"region\": \"../roi.mhd\"}", GSN_E_INPUT,
          "names \"../roi.mhd\": a file must lie beside job.json" },
        { "{\"specimen\": \"a\", \"region\": \"..\"}", GSN_E_INPUT, "must lie beside job.json" },
        { "{\"specimen\": \"a\", \"region\": \"/etc/passwd\"}", GSN_E_INPUT, "must lie beside" },
        { "{\"specimen\": \"a\", \"region\": \"\"}", GSN_E_INPUT, "must lie beside job.json" },
        { "{\"specimen\": \"a\", \"region\": \"roi.mhd\"}", GSN_E_INPUT, "roi.mhd" },
        { "{\"specimen\": \"a\", \"kind\": \"volume\", \"file\": \"v.mhd\"}", GSN_E_INPUT,
          "v.mhd" },
        { "{\"specimen\": \"a\", \"kind\": \"tile\", \"file\": \"t.png\", \"reference\": "
          "\"../m.png\"}",
          GSN_E_INPUT, "" },
    };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_rows) rows = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        gsn_auto_mem(char) folder = gsn_format("in%zu", i);
        int r;

        bench_write(&scratch, folder, "notes.txt", "-", 1);
        if (cases[i].job)
            bench_write_job(&scratch, folder, cases[i].job);
        r = bench_import(&scratch, store, folder, 0, &heard, &counts, &err);
        if (r != cases[i].code || !strstr(err.text, cases[i].says))
            fail_msg("%s\nis %d: %s", cases[i].job ? cases[i].job : "none", r, err.text);
    }
    /* A corrected job must not meet a half-made specimen of the same name. */
    CHECK_OK(gsn_specimen_list(store, &rows, &err), err);
    CHECK(rows->count == 0);
}

TEST(another_job_for_the_same_name_needs_the_word_replace)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_row) row = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_job(&scratch, "in", "{\"specimen\": \"a\", \"week\": 2}");
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    bench_write_job(&scratch, "in", "{\"specimen\": \"a\", \"week\": 4}");
    CHECK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err) == GSN_E_INPUT);
    CHECK_OK(bench_import(&scratch, store, "in", 1, &heard, &counts, &err), err);
    CHECK_OK(gsn_specimen_get(store, "a", &row, &err), err);
    CHECK_NEAR(row->week, 4, 0);
}

/* New settings can change what is found on a panel, so every panel is looked at again. */
TEST(replaced_settings_ask_for_all_panels_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct gsn_job_options options = { .mesher = GSN_MESHER, .owner = "test", .threads = 1 };
    gsn_auto(gsn_job_rows) jobs = NULL;
    gsn_auto(gsn_panel_rows) panels = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_panel(&scratch, "in", "P01.png", 1, 0.6);
    bench_write_job(&scratch, "in", "{\"specimen\": \"a\", \"px_um\": 12, \"layout\": [2, 2]}");
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK_OK(gsn_job_next(store, &options, &err), err);
    bench_write_job(&scratch, "in", "{\"specimen\": \"a\", \"px_um\": 24, \"layout\": [2, 2]}");
    CHECK_OK(bench_import(&scratch, store, "in", 1, &heard, &counts, &err), err);
    CHECK(counts.again == 1 && counts.taken == 0);
    CHECK_OK(gsn_queue_list(store, &jobs, &err), err);
    CHECK(jobs->count == 2 && strcmp(jobs->at[0].kind, "panel") == 0);
    CHECK(strcmp(jobs->at[0].state, "waiting") == 0);
    CHECK_OK(gsn_job_next(store, &options, &err), err);
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK_NEAR(panels->at[0].px_um, 24, 0);
}

/* A volume's header and the file it keeps its voxels in come together. */
TEST(a_mask_brings_the_file_of_its_voxels)
{
    static const char header[] = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = "
                                 "MET_UCHAR\nElementDataFile = roi.raw\n";
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_job(&scratch, "in", "{\"specimen\": \"a\", \"region\": \"roi.mhd\"}");
    bench_write(&scratch, "in", "roi.mhd", header, sizeof header - 1);
    CHECK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err) < 0);
    CHECK(strstr(err.text, "roi.raw") != NULL);
    bench_write(&scratch, "in", "roi.raw", "\1\1\1\1\1\1\1\1", 8);
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(counts.attached == 2);
}

/* It lies among the panels and is none; its bytes are kept. */
TEST(a_calibration_panel_is_kept_and_is_no_panel)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto(gsn_attachment_rows) attached = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_panel(&scratch, "in", "P01.png", 1, 0.6);
    bench_write_job(&scratch, "in", "{\"specimen\": \"a\", \"calibration\": \"C01.png\"}");
    CHECK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "names \"C01.png\": there is no such file"));
    bench_write_panel(&scratch, "in", "C01.png", 2, 0.6);
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(counts.taken == 1 && counts.attached == 1);
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK(panels->count == 1 && strcmp(panels->at[0].file_name, "P01.png") == 0);
    CHECK_OK(gsn_attachment_list(store, 1, &attached, &err), err);
    CHECK(attached->count == 1 && strcmp(attached->at[0].name, "C01.png") == 0);
}

static int64_t waiting(struct gsn_store *store)
{
    struct gsn_job_counts counts = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_queue_counts(store, &counts, &err), err);
    return counts.waiting;
}

TEST(a_folder_in_which_nothing_is_new_asks_for_nothing)
{
    static const char header[] = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 2\nElementType = "
                                 "MET_UCHAR\nElementDataFile = roi.raw\n";
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    bench_write_job(&scratch, "in", "{\"specimen\": \"a\", \"region\": \"roi.mhd\"}");
    bench_write(&scratch, "in", "roi.mhd", header, sizeof header - 1);
    bench_write(&scratch, "in", "roi.raw", "\1\1\1\1\1\1\1\1", 8);
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(waiting(store) == 1);
    CHECK_OK(gsn_queue_claim(store, "t", 1, 60, 0, &job, &err), err);
    CHECK_OK(gsn_queue_done(store, job, &err), err);
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(waiting(store) == 0);
    bench_write(&scratch, "in", "roi.raw", "\1\1\1\1\1\1\1\0", 8);
    CHECK_OK(bench_import(&scratch, store, "in", 0, &heard, &counts, &err), err);
    CHECK(waiting(store) == 1);
}
