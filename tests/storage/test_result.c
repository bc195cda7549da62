/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/result.h"

#include <math.h>
#include <sqlite3.h>
#include <string.h>

#include "tests/storage/bench.h"

static int64_t begin(struct gsn_store *store, int64_t specimen, const char *key)
{
    const struct gsn_run_row run = { .specimen_id = specimen,
                                     .key = key,
                                     .version = "0.1.0",
                                     .inputs_json = "[]",
                                     .parameters_json = "{}" };
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);
    return id;
}

static const struct gsn_measure_row measures[] = {
    { .name = "loss_percent", .value = 0.1 + 0.2, .lower = NAN, .upper = 1.0 / 3, .unit = "%" },
    { .name = "density", .value = -0.0, .lower = 5e-324, .upper = 1.7e308, .unit = "" },
};

static struct gsn_run_end whole_end(const struct gsn_pose_row *pose,
                                    const struct gsn_stain_row *stain)
{
    return (struct gsn_run_end){ .state = "reported",
                                 .report_path = "reports/S/1.html",
                                 .report_sha256 = "aa",
                                 .json_path = "reports/S/1.json",
                                 .json_sha256 = "bb",
                                 .event_head = "cc",
                                 .measures = measures,
                                 .measure_count = 2,
                                 .poses = pose,
                                 .pose_count = 1,
                                 .stains = stain,
                                 .stain_count = 1 };
}

TEST(a_finished_run_reads_back_to_the_last_bit)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) got = NULL;
    gsn_auto(gsn_pose_rows) poses = NULL;
    gsn_auto(gsn_stain_rows) stains = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t panel = bench_add_panel(store, specimen, 1);
    const int64_t id = begin(store, specimen, "key");
    const struct gsn_pose_row pose = {
        id, panel, 4, 9, 1.0 / 3, 2.0 / 3, 3, 4, 5, 6, 1, 0, 7, NAN
    };
    const struct gsn_stain_row stain = {
        id, panel, { 0.9, 0.8, 0.7 }, { 1, 2, 3, 4, 5, 6, 7, 8, 1.0 / 9 }, "named set 1"
    };
    const struct gsn_run_end end = whole_end(&pose, &stain);

    CHECK_OK(gsn_run_finish(store, id, &end, NOON + 60, &err), err);
    CHECK_OK(gsn_run_get(store, id, &run, &err), err);
    CHECK(run->specimen_id == specimen && run->started == NOON && run->finished == NOON + 60);
    CHECK(strcmp(run->key, "key") == 0 && strcmp(run->state, "reported") == 0);
    CHECK(strcmp(run->version, "0.1.0") == 0 && strcmp(run->inputs_json, "[]") == 0);
    CHECK(strcmp(run->parameters_json, "{}") == 0 && strcmp(run->message, "") == 0);
    CHECK(strcmp(run->report_path, "reports/S/1.html") == 0);
    CHECK(strcmp(run->report_sha256, "aa") == 0 && strcmp(run->json_sha256, "bb") == 0);
    CHECK(strcmp(run->json_path, "reports/S/1.json") == 0);
    CHECK(strcmp(run->event_head, "cc") == 0);

    CHECK_OK(gsn_measure_list(store, id, &got, &err), err);
    CHECK(got->count == 2);
    CHECK(strcmp(got->at[0].name, "loss_percent") == 0 && strcmp(got->at[0].unit, "%") == 0);
    CHECK_NEAR(got->at[0].value, 0.1 + 0.2, 0);
    CHECK(got->at[0].lower != got->at[0].lower);
    CHECK_NEAR(got->at[0].upper, 1.0 / 3, 0);
    CHECK_NEAR(got->at[1].lower, 5e-324, 0);
    CHECK_NEAR(got->at[1].upper, 1.7e308, 0);

    CHECK_OK(gsn_pose_list(store, id, &poses, &err), err);
    CHECK(poses->count == 1 && poses->at[0].tre_um != poses->at[0].tre_um);
    poses->at[0].tre_um = pose.tre_um;
    CHECK(memcmp(&poses->at[0], &pose, sizeof pose) == 0);
    CHECK_OK(gsn_stain_list(store, id, &stains, &err), err);
    CHECK(stains->count == 1 && strcmp(stains->at[0].source, "named set 1") == 0);
    CHECK(memcmp(stains->at[0].white, stain.white, sizeof stain.white) == 0);
    CHECK(memcmp(stains->at[0].vector, stain.vector, sizeof stain.vector) == 0);
}

TEST(a_run_ends_as_a_whole_or_not_at_all)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_measure_rows) got = NULL;
    gsn_auto(gsn_run_row) run = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t id = begin(store, specimen, "key");
    const struct gsn_pose_row pose = { .panel_id = 77, .slot = 1 };
    const struct gsn_measure_row twice[] = { measures[0], measures[0] };
    struct gsn_run_end end = { .state = "reported", .measures = twice, .measure_count = 2 };

    CHECK(gsn_run_finish(store, id, &end, NOON, &err) == GSN_E_INPUT);
    CHECK(strncmp(err.text, "run 1: ", 7) == 0);
    end.measure_count = 1;
    end.state = "sold";
    CHECK(gsn_run_finish(store, id, &end, NOON, &err) == GSN_E_INPUT);
    end.state = "reported";
    end.poses = &pose;
    end.pose_count = 1;
    CHECK(gsn_run_finish(store, id, &end, NOON, &err) == GSN_E_INPUT);
    CHECK_OK(gsn_measure_list(store, id, &got, &err), err);
    CHECK(got->count == 0);
    CHECK_OK(gsn_run_get(store, id, &run, &err), err);
    CHECK(strcmp(run->state, "running") == 0 && run->finished == 0);
}

/* Case 60. */
TEST(a_finished_run_never_changes)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t id = begin(store, specimen, "key");
    const struct gsn_run_end end = { .state = "withheld", .message = "too few sections" };

    CHECK_OK(gsn_run_finish(store, id, &end, NOON, &err), err);
    CHECK(gsn_run_finish(store, id, &end, NOON, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "run 1 is finished already") == 0);
    CHECK(gsn_run_finish(store, 99, &end, NOON, &err) == GSN_E_NOTFOUND);
    CHECK(bench_raw(&scratch, "UPDATE run SET state = 'reported'") == SQLITE_CONSTRAINT);
}

TEST(the_latest_run_is_found_by_its_state)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_run_row) any = NULL;
    gsn_auto(gsn_run_row) reported = NULL;
    gsn_auto(gsn_run_rows) all = NULL;
    struct gsn_run_row *none = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t other = bench_add_specimen(store, "T", "g", "");
    const struct gsn_run_end good = { .state = "reported" }, bad = { .state = "failed" };
    int64_t ids[4];

    for (int i = 0; i < 3; i++) {
        ids[i] = begin(store, specimen, "key");
        CHECK_OK(gsn_run_finish(store, ids[i], i < 2 ? &good : &bad, NOON + i, &err), err);
    }
    ids[3] = begin(store, other, "key");
    CHECK_OK(gsn_run_latest(store, specimen, NULL, &any, &err), err);
    CHECK(any->id == ids[2]);
    CHECK_OK(gsn_run_latest(store, specimen, "reported", &reported, &err), err);
    CHECK(reported->id == ids[1]);
    CHECK(gsn_run_latest(store, other, "reported", &none, &err) == GSN_E_NOTFOUND && !none);
    CHECK_OK(gsn_run_list(store, 0, &all, &err), err);
    CHECK(all->count == 4);
}

TEST(a_run_left_by_a_dead_worker_fails_when_the_next_begins)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_run_rows) runs = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t other = bench_add_specimen(store, "T", "g", "");

    (void)begin(store, specimen, "key");
    (void)begin(store, other, "key");
    (void)begin(store, specimen, "key");
    CHECK_OK(gsn_run_list(store, 0, &runs, &err), err);
    CHECK(strcmp(runs->at[0].state, "failed") == 0);
    CHECK(strcmp(runs->at[0].message, "its worker died") == 0);
    CHECK(strcmp(runs->at[1].state, "running") == 0 && strcmp(runs->at[2].state, "running") == 0);
}

TEST(the_poses_of_a_report_survive_a_new_registration)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_pose_rows) poses = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t panel = bench_add_panel(store, specimen, 1);
    const int64_t id = begin(store, specimen, "key");
    const struct gsn_pose_row pose = { .panel_id = panel, .slot = 1, .serial = 1, .m00 = 1 };
    const struct gsn_run_end end = { .state = "reported", .poses = &pose, .pose_count = 1 };

    CHECK_OK(gsn_run_finish(store, id, &end, NOON, &err), err);
    CHECK_OK(gsn_section_replace(store, panel, NULL, 0, &err), err);
    CHECK_OK(gsn_pose_list(store, id, &poses, &err), err);
    CHECK(poses->count == 1);
}

static int finish_once(struct gsn_store *store, int64_t id, const struct gsn_run_end *end,
                       struct gsn_error *err)
{
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) got = NULL;
    int r = gsn_run_finish(store, id, end, NOON, err);

    /* Found out of memory below, the run has ended all the same. */
    if (r == GSN_E_INPUT)
        r = GSN_OK;
    if (r >= 0)
        r = gsn_run_get(store, id, &run, err);
    return r >= 0 ? gsn_measure_list(store, id, &got, err) : r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t id = begin(store, specimen, "key");
    const struct gsn_run_end end = { .state = "reported",
                                     .measures = measures,
                                     .measure_count = 2 };

    CHECK_EVERY_OOM(finish_once(store, id, &end, &err), err);
}
