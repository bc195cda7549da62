/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/ingest/intake.h"

#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/bench.h"
#include "storage/audit_log.h"
#include "storage/scan.h"
#include "storage/sql.h"
#include "tests/check.h"
#include "tests/storage/bench.h"

/* SOI and EOI around nothing. */
static const char picture[] = "\xff\xd8\xff\xd9";
enum { SIZE = sizeof picture - 1 };

/* A store, a spool and a hot folder of one test. */
struct stage {
    struct gsn_scratch scratch;
    struct gsn_store *store;
    struct gsn_spool *spool;
    struct gsn_source *source;
    struct gsn_intake intake;
    int64_t now;
};

static void write_picture(const struct stage *stage, const char *name, const char *bytes,
                          size_t size)
{
    struct gsn_error err = { 0 };
    char path[64];

    (void)snprintf(path, sizeof path, "hot/%s", name);
    CHECK_OK(gsn_file_write(gsn_scratch_path(&stage->scratch, path), bytes, size, &err), err);
}

static void stage_begin(struct stage *stage, uint64_t reserve)
{
    struct gsn_error err = { 0 };
    char address[200];

    *stage = (struct stage){ .scratch = gsn_scratch_new() };
    const struct gsn_source_options options = { .settle_ms = 0,
                                                .patience_ms = 0,
                                                .is_known = gsn_intake_is_known,
                                                .on_read = gsn_intake_on_read,
                                                .context = &stage->intake };

    stage->store = bench_open(&stage->scratch, GSN_STORE_CREATE);
    CHECK_OK(gsn_file_mkdir(gsn_scratch_path(&stage->scratch, "hot"), &err), err);
    CHECK_OK(gsn_spool_open(stage->scratch.dir, reserve, &stage->spool, &err), err);
    (void)snprintf(address, sizeof address, "hot:%s/hot", stage->scratch.dir);
    stage->intake =
        (struct gsn_intake){ .name = "flatbed", .store = stage->store, .spool = stage->spool };
    CHECK_OK(gsn_source_open(address, &options, &stage->source, &err), err);
    stage->intake.source = stage->source;
}

static void stage_done(struct stage *stage)
{
    gsn_source_free(stage->source);
    gsn_spool_free(stage->spool);
    gsn_store_free(stage->store);
    gsn_scratch_remove(&stage->scratch);
}
#define auto_stage __attribute__((cleanup(stage_done))) struct stage

/* Two looks; gives what the second tells. */
static struct gsn_source_events *look(struct stage *stage)
{
    struct gsn_source_events *events = NULL;
    struct gsn_error err = { 0 };
    int ended = 0;

    for (int i = 0; i < 2; i++) {
        gsn_source_events_free(events);
        CHECK_OK(gsn_source_poll(stage->source, stage->now++, &events, &ended, &err), err);
    }
    return events;
}

static int64_t ask(const struct stage *stage, const char *sql)
{
    struct gsn_error err = { 0 };
    int64_t value = -1;

    /* As the service does at the end of a round. */
    CHECK_OK(gsn_scan_commit_staged(stage->store, &err), err);
    CHECK_OK(gsn_sql_int(stage->store, sql, SQL_NO_ARGS, &value, &err), err);
    return value;
}

static unsigned ready(struct stage *stage)
{
    gsn_auto(gsn_source_events) events = look(stage);
    unsigned count = 0;

    for (size_t i = 0; i < events->count; i++)
        count += events->at[i].what == GSN_SOURCE_READY;
    return count;
}

/* Takes the first READY item. */
static int take(struct stage *stage, enum gsn_intake_fault *ret_fault, struct gsn_error *err)
{
    gsn_auto(gsn_source_events) events = look(stage);
    struct gsn_intake_taken taken;

    for (size_t i = 0; i < events->count; i++)
        if (events->at[i].what == GSN_SOURCE_READY)
            return gsn_intake_take(&stage->intake, &events->at[i], NOON, &taken, ret_fault, err);
    fail_msg("nothing is ready");
    return 0;
}

static void is_taken(struct stage *stage)
{
    enum gsn_intake_fault fault = GSN_FAULT_ITEM;
    struct gsn_error err = { 0 };

    CHECK_OK(take(stage, &fault, &err), err);
    CHECK(fault == GSN_FAULT_NONE);
}

TEST(a_picture_is_durable_in_the_ledger_and_acknowledged)
{
    auto_stage stage;
    struct gsn_digest digest;
    gsn_auto_mem(char) path = NULL;
    gsn_auto(gsn_scan_row) scan = NULL;
    struct gsn_error err = { 0 };
    struct stat st;

    stage_begin(&stage, 0);
    write_picture(&stage, "x.jpg", picture, SIZE);
    is_taken(&stage);
    CHECK_OK(gsn_sha256(picture, SIZE, &digest, &err), err);
    CHECK_OK(gsn_scan_commit_staged(stage.store, &err), err);
    CHECK_OK(gsn_scan_get(stage.store, 1, &scan, &err), err);
    CHECK(strcmp(scan->sha256, digest.hex) == 0 && scan->size == SIZE);
    CHECK(strcmp(scan->source, "flatbed") == 0 && strcmp(scan->name, "x.jpg") == 0);
    CHECK(strcmp(scan->state, "unfiled") == 0);
    CHECK_OK(gsn_store_object_path(stage.store, digest.hex, &path, &err), err);
    CHECK(stat(path, &st) == 0 && st.st_size == SIZE);
    CHECK(ready(&stage) == 0);
}

TEST(a_loose_file_named_after_a_specimen_is_filed)
{
    auto_stage stage;

    stage_begin(&stage, 0);
    (void)bench_add_specimen(stage.store, "GVP-D-S02", "g", "");
    write_picture(&stage, "GVP-D-S02-P03.jpg", picture, SIZE);
    is_taken(&stage);
    CHECK(ask(&stage, "SELECT number FROM panel") == 3);
    CHECK(ask(&stage, "SELECT count(*) FROM scan WHERE state = 'filed' AND panel_id = 1") == 1);
}

TEST(a_picture_that_was_taken_is_not_offered_to_a_later_process)
{
    auto_stage stage;
    gsn_auto(gsn_source) later = NULL;
    struct gsn_error err = { 0 };
    const struct gsn_source_options options = { .is_known = gsn_intake_is_known,
                                                .context = &stage.intake };

    stage_begin(&stage, 0);
    write_picture(&stage, "x.jpg", picture, SIZE);
    is_taken(&stage);
    CHECK_OK(gsn_source_open(gsn_source_address(stage.source), &options, &later, &err), err);
    gsn_source_free(stage.source);
    stage.source = gsn_steal(&later);
    CHECK(ready(&stage) == 0);
}

static void log_picture(const struct stage *stage, const char *subject, const char *facts)
{
    const struct gsn_scan_row row = { .source = "camera",
                                      .device = "",
                                      .name = facts,
                                      .key = "",
                                      .subject = subject,
                                      .sha256 = bench_digest(1),
                                      .size = 1,
                                      .facts = facts };
    struct gsn_error err = { 0 };
    int64_t id;
    int again;

    CHECK_OK(gsn_scan_stage(stage->store, &row, 0, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_scan_commit_staged(stage->store, &err), err);
}

static int recall_once(const struct stage *stage, struct gsn_error *err)
{
    struct gsn_source_options options = { .settle_ms = 0 };
    struct gsn_intake_past past;
    const int r = gsn_intake_recall(stage->store, "camera", &past, &options, err);

    gsn_intake_past_done(&past);
    return r;
}

TEST(a_later_process_tells_the_source_what_was_taken_last)
{
    auto_stage stage;
    struct gsn_source_options options = { .settle_ms = 0 };
    struct gsn_intake_past past;
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    CHECK_OK(gsn_intake_recall(stage.store, "camera", &past, &options, &err), err);
    for (int i = 0; i < GSN_SUBJECTS; i++)
        CHECK(options.last_facts[i] == NULL);
    gsn_intake_past_done(&past);
    log_picture(&stage, "panel", "{\"n\":1}");
    log_picture(&stage, "panel", "{\"n\":2}");
    log_picture(&stage, "blank", "{\"n\":3}");
    CHECK_OK(gsn_intake_recall(stage.store, "camera", &past, &options, &err), err);
    CHECK(strcmp(options.last_facts[GSN_SUBJECT_PANEL], "{\"n\":2}") == 0);
    CHECK(strcmp(options.last_facts[GSN_SUBJECT_BLANK], "{\"n\":3}") == 0);
    CHECK(options.last_facts[GSN_SUBJECT_DARK] == NULL);
    gsn_intake_past_done(&past);
    CHECK_EVERY_OOM(recall_once(&stage, &err), err);
}

TEST(a_disk_below_its_reserve_takes_nothing_and_everything_later)
{
    auto_stage stage;
    enum gsn_intake_fault fault = GSN_FAULT_NONE;
    struct gsn_error err = { 0 };

    stage_begin(&stage, UINT64_MAX / 2);
    write_picture(&stage, "x.jpg", picture, SIZE);
    CHECK(take(&stage, &fault, &err) == GSN_E_LIMIT && fault == GSN_FAULT_ROOM);
    CHECK(strstr(err.text, "below its reserve"));
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 0 && ready(&stage) == 1);
    gsn_spool_free(stage.spool);
    CHECK_OK(gsn_spool_open(stage.scratch.dir, 0, &stage.spool, &err), err);
    stage.intake.spool = stage.spool;
    is_taken(&stage);
}

/* One file that did not fit used to stop everything behind it. */
TEST(a_file_that_does_not_fit_is_its_own_fault_and_the_next_goes_on)
{
    auto_stage stage;
    enum gsn_intake_fault fault = GSN_FAULT_NONE;
    struct gsn_error err = { 0 };
    struct statvfs fs;

    stage_begin(&stage, 0);
    CHECK(statvfs(stage.scratch.dir, &fs) == 0);
    gsn_spool_free(stage.spool);
    CHECK_OK(gsn_spool_open(stage.scratch.dir,
                            (uint64_t)fs.f_bavail * fs.f_frsize - ((uint64_t)512 << 20),
                            &stage.spool, &err),
             err);
    stage.intake.spool = stage.spool;
    write_picture(&stage, "a.jpg", picture, SIZE);
    CHECK(truncate(gsn_scratch_path(&stage.scratch, "hot/a.jpg"), 1 << 30) == 0);
    CHECK(take(&stage, &fault, &err) == GSN_E_LIMIT && fault == GSN_FAULT_SIZE);
    CHECK(strstr(err.text, "below its reserve"));
    CHECK(truncate(gsn_scratch_path(&stage.scratch, "hot/a.jpg"), (1 << 30) + 1) == 0);
    CHECK(take(&stage, &fault, &err) == GSN_E_LIMIT && fault == GSN_FAULT_SIZE);
    CHECK(strcmp(err.text, "a.jpg has 1073741825 bytes, and no file may have more than 1073741824 "
                           "(1 GiB)") == 0);
    CHECK(unlink(gsn_scratch_path(&stage.scratch, "hot/a.jpg")) == 0);
    write_picture(&stage, "b.jpg", picture, SIZE);
    is_taken(&stage);
}

TEST(what_the_store_refuses_is_not_acknowledged)
{
    auto_stage stage;
    enum gsn_intake_fault fault = GSN_FAULT_NONE;
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    write_picture(&stage, "x.jpg", picture, SIZE);
    CHECK(bench_raw(&stage.scratch, "ALTER TABLE scan RENAME TO lost") == 0);
    CHECK(take(&stage, &fault, &err) < 0 && fault == GSN_FAULT_STORE);
    CHECK(ready(&stage) == 1);
    CHECK(bench_raw(&stage.scratch, "ALTER TABLE lost RENAME TO scan") == 0);
    is_taken(&stage);
}

TEST(an_empty_file_is_its_own_fault_and_is_left_where_it_is)
{
    auto_stage stage;
    enum gsn_intake_fault fault = GSN_FAULT_NONE;
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    write_picture(&stage, "x.jpg", "", 0);
    stage.intake.delete_there = 1;
    CHECK(take(&stage, &fault, &err) == GSN_E_INPUT && fault == GSN_FAULT_ITEM);
    CHECK(strstr(err.text, "x.jpg is empty") && ready(&stage) == 1);
    stage.intake.delete_there = 0;
    CHECK(take(&stage, &fault, &err) == GSN_E_INPUT && ready(&stage) == 0);
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 0);
}

TEST(what_vanishes_or_changes_is_told_by_the_next_look)
{
    auto_stage stage;
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_intake_taken taken;
    enum gsn_intake_fault fault = GSN_FAULT_NONE;
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    write_picture(&stage, "x.jpg", picture, SIZE);
    events = look(&stage);
    CHECK(events->count == 1 && events->at[0].what == GSN_SOURCE_READY);
    gsn_scratch_append(gsn_scratch_path(&stage.scratch, "hot/x.jpg"), picture, SIZE);
    CHECK(gsn_intake_take(&stage.intake, &events->at[0], NOON, &taken, &fault, &err) == GSN_E_BUSY);
    CHECK(fault == GSN_FAULT_LATER && ask(&stage, "SELECT count(*) FROM scan") == 0);
    is_taken(&stage);
}

static int break_off(void *context, uint64_t offset)
{
    (void)offset;
    return ++*(int *)context;
}

TEST(a_copy_that_is_broken_off_takes_nothing)
{
    auto_stage stage;
    enum gsn_intake_fault fault = GSN_FAULT_NONE;
    struct gsn_error err = { 0 };
    int told = 0;

    stage_begin(&stage, 0);
    write_picture(&stage, "x.jpg", picture, SIZE);
    stage.intake.on_copy = break_off;
    stage.intake.context = &told;
    CHECK(take(&stage, &fault, &err) == GSN_E_BUSY && fault == GSN_FAULT_LATER && told == 1);
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 0 && ready(&stage) == 1);
    stage.intake.on_copy = NULL;
    is_taken(&stage);
}

static int take_once(struct stage *stage, const struct gsn_source_event *event,
                     struct gsn_error *err)
{
    struct gsn_intake_taken taken;
    enum gsn_intake_fault fault;

    return gsn_intake_take(&stage->intake, event, NOON, &taken, &fault, err);
}

TEST(running_out_of_memory_takes_a_picture_once_or_not_at_all)
{
    auto_stage stage;
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    write_picture(&stage, "x.jpg", picture, SIZE);
    events = look(&stage);
    CHECK(events->count == 1);
    CHECK_EVERY_OOM(take_once(&stage, &events->at[0], &err), err);
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 1 && ready(&stage) == 0);
}

/* ---- where the device is to delete its copy ---------------------------------------------- */

/* A device with one object, which counts what it is told. */
struct device {
    const char *bytes;
    size_t size;
    int acknowledged, kept, known;
};

static int device_poll(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                       struct gsn_error *err)
{
    const struct device *const device = self;
    const struct gsn_source_event event = { .what = GSN_SOURCE_READY,
                                            .item = 1,
                                            .name = "P01.TIF",
                                            .reason = "",
                                            .size = device->size,
                                            .key = "key" };

    (void)now_ms;
    *ret_ended = 0;
    return gsn_source_emit(events, &event, err);
}

static int device_read(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                       size_t *ret_got, struct gsn_error *err)
{
    const struct device *const device = self;
    const size_t left = offset < device->size ? device->size - (size_t)offset : 0;

    (void)item;
    (void)err;
    *ret_got = left < size ? left : size;
    memcpy(buffer, device->bytes + offset, *ret_got);
    return GSN_OK;
}

static int device_acknowledge(void *self, uint64_t item, struct gsn_error *err)
{
    (void)item;
    (void)err;
    ((struct device *)self)->acknowledged++;
    return GSN_OK;
}

static int device_keep(void *self, uint64_t item, struct gsn_error *err)
{
    (void)item;
    (void)err;
    ((struct device *)self)->kept++;
    return GSN_OK;
}

static void device_close(void *self)
{
    (void)self;
}

static const struct gsn_source_ops device_ops = { .kind = "device",
                                                  .poll = device_poll,
                                                  .read = device_read,
                                                  .acknowledge = device_acknowledge,
                                                  .keep = device_keep,
                                                  .close = device_close };

/* Takes what the device has and gives why it keeps its copy. */
static void take_of_device(struct device *device, int delete_there, char kept[200])
{
    auto_stage stage;
    gsn_auto(gsn_source) source = NULL;
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_intake_taken taken;
    enum gsn_intake_fault fault;
    struct gsn_error err = { 0 };
    int ended = 0;

    stage_begin(&stage, 0);
    const struct gsn_source_options options = { .on_read = gsn_intake_on_read,
                                                .context = &stage.intake };

    CHECK_OK(gsn_source_make(&device_ops, device, "device:one", &options, &source, &err), err);
    stage.intake.source = source;
    stage.intake.delete_there = delete_there;
    CHECK_OK(gsn_source_poll(source, 0, &events, &ended, &err), err);
    CHECK_OK(gsn_intake_take(&stage.intake, &events->at[0], NOON, &taken, &fault, &err), err);
    CHECK(ask(&stage, "SELECT count(*) FROM scan WHERE name = 'P01.TIF'") == 1);
    device->known = ask(&stage, "SELECT count(*) FROM scan WHERE key = 'key'") == 1;
    (void)snprintf(kept, 200, "%s", taken.kept);
}

TEST(half_a_picture_is_not_known_by_its_key)
{
    struct device whole = { .bytes = picture, .size = SIZE };
    struct device half = { .bytes = picture, .size = SIZE - 1 };
    struct device raw = { .bytes = "raw sensor data", .size = 15 };
    char kept[200];

    take_of_device(&whole, 0, kept);
    take_of_device(&half, 0, kept);
    take_of_device(&raw, 0, kept);
    CHECK(whole.known == 1 && half.known == 0 && raw.known == 1);
}

/* One look of a patient intake at a scanner's object, so many seconds after noon. */
static int take_patiently(struct stage *stage, struct device *device, int64_t after_s,
                          struct gsn_error *err)
{
    const struct gsn_source_options options = { .on_read = gsn_intake_on_read,
                                                .context = &stage->intake };
    gsn_auto(gsn_source) source = NULL;
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_intake_taken taken;
    enum gsn_intake_fault fault;
    int ended = 0, r;

    CHECK_OK(gsn_source_make(&device_ops, device, "ptp:one", &options, &source, err), *err);
    stage->intake.source = source;
    stage->intake.patience_s = 60;
    CHECK_OK(gsn_source_poll(source, 0, &events, &ended, err), *err);
    r = gsn_intake_take(&stage->intake, &events->at[0], NOON + after_s, &taken, &fault, err);
    CHECK(r >= 0 || (r == GSN_E_BUSY && fault == GSN_FAULT_ITEM));
    CHECK(r >= 0 || strstr(err->text, "P01.TIF is not whole yet: the file ends before"));
    return r;
}

TEST(half_a_picture_is_asked_for_again_until_it_is_whole)
{
    auto_stage stage;
    struct device device = { .bytes = picture, .size = SIZE - 1 };
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    CHECK(take_patiently(&stage, &device, 0, &err) == GSN_E_BUSY);
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 0 && device.acknowledged == 0);
    device.size = SIZE;
    CHECK_OK(take_patiently(&stage, &device, 10, &err), err);
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 1 && device.acknowledged == 1);
    gsn_intake_done(&stage.intake);
}

TEST(half_a_picture_that_stays_so_is_taken_after_the_patience)
{
    auto_stage stage;
    static const char begun[] = "\xff\xd8\xff\xfe\x00\x09";
    struct device device = { .bytes = begun, .size = sizeof begun - 2 };
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    CHECK(take_patiently(&stage, &device, 0, &err) == GSN_E_BUSY);
    device.size++; /* it grows: the patience begins anew */
    CHECK(take_patiently(&stage, &device, 50, &err) == GSN_E_BUSY);
    CHECK(take_patiently(&stage, &device, 109, &err) == GSN_E_BUSY);
    CHECK_OK(take_patiently(&stage, &device, 110, &err), err);
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 1 && device.acknowledged == 1);
    gsn_intake_done(&stage.intake);
}

TEST(a_clock_that_is_set_back_makes_no_half_picture_wait_for_years)
{
    auto_stage stage;
    enum { YEAR_S = 365 * 24 * 3600 };
    struct device device = { .bytes = picture, .size = SIZE - 1 };
    struct gsn_error err = { 0 };

    stage_begin(&stage, 0);
    CHECK(take_patiently(&stage, &device, 0, &err) == GSN_E_BUSY);
    CHECK(take_patiently(&stage, &device, -YEAR_S, &err) == GSN_E_BUSY);
    CHECK(take_patiently(&stage, &device, -YEAR_S + 59, &err) == GSN_E_BUSY);
    CHECK_OK(take_patiently(&stage, &device, -YEAR_S + 60, &err), err);
    CHECK(ask(&stage, "SELECT count(*) FROM scan") == 1);
    gsn_intake_done(&stage.intake);
}

TEST(what_is_whole_is_deleted_there)
{
    struct device device = { .bytes = picture, .size = SIZE };
    char kept[200];

    take_of_device(&device, 1, kept);
    CHECK(device.acknowledged == 1 && device.kept == 0 && !kept[0]);
}

TEST(half_a_picture_is_taken_in_and_stays_there)
{
    struct device device = { .bytes = picture, .size = SIZE - 1 };
    char kept[200];

    take_of_device(&device, 1, kept);
    CHECK(device.acknowledged == 0 && device.kept == 1);
    CHECK(strstr(kept, "not deleted there: ") && strstr(kept, "the file ends before"));
}

TEST(what_nobody_can_judge_is_taken_in_and_stays_there)
{
    struct device device = { .bytes = "raw sensor data", .size = 15 };
    char kept[200];

    take_of_device(&device, 1, kept);
    CHECK(device.acknowledged == 0 && device.kept == 1 && strstr(kept, "no PNG"));
}

TEST(where_nothing_is_deleted_half_a_picture_needs_no_word)
{
    struct device device = { .bytes = picture, .size = SIZE - 1 };
    char kept[200];

    take_of_device(&device, 0, kept);
    CHECK(device.acknowledged == 1 && device.kept == 0 && !kept[0]);
}

/* ---- what fails is tried again later each time ------------------------------------------- */

TEST(what_failed_rests_longer_each_time_and_is_forgotten_when_it_came_in)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    __attribute__((cleanup(gsn_failing_done))) struct gsn_failing list = { .store = store,
                                                                           .source = "cam" };
    struct gsn_error err = { 0 };
    int64_t rested = 0;
    int is_new = -1;

    CHECK(!gsn_failing_is_early(&list, "a", 0));
    for (int i = 0; i < 20; i++) {
        int64_t until = 1;

        CHECK_OK(gsn_failing_add(&list, "a", "nonsense", "look", 0, &is_new, &err), err);
        CHECK(is_new == (i == 0));
        while (gsn_failing_is_early(&list, "a", until))
            until *= 2;
        CHECK(until >= rested);
        rested = until;
    }
    CHECK(rested > 60000 && rested <= 2 * 1048576);
    CHECK(!gsn_failing_is_early(&list, "b", 1));
    CHECK_OK(gsn_failing_over(&list, "a", &err), err);
    CHECK_OK(gsn_failing_over(&list, "a", &err), err);
    CHECK(!gsn_failing_is_early(&list, "a", 0));
}

TEST(troubles_of_an_earlier_process_are_known_and_tried_at_once)
{
    static const struct gsn_trouble_row left = {
        .source = "cam", .name = "a", .reason = "r", .action = "look"
    };
    static const struct gsn_trouble_row others = {
        .source = "other", .name = "b", .reason = "r", .action = "look"
    };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    __attribute__((cleanup(gsn_failing_done))) struct gsn_failing list = { .store = store,
                                                                           .source = "cam" };
    gsn_auto(gsn_trouble_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_trouble_put(store, &left, NOON, &err), err);
    CHECK_OK(gsn_trouble_put(store, &others, NOON, &err), err);
    CHECK_OK(gsn_failing_load(&list, &err), err);
    CHECK(list.count == 1 && !gsn_failing_is_early(&list, "a", 0));
    CHECK_OK(gsn_failing_over(&list, "a", &err), err);
    CHECK_OK(gsn_trouble_list(store, &rows, &err), err);
    CHECK(rows->count == 1 && strcmp(rows->at[0].source, "other") == 0);
}
