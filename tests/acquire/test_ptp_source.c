/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A PTP scanner as a source: folders, keys, what changes, what is gone, and what is told of it. */
#include "acquire/ptp_source.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "acquire/ptp_wire.h"
#include "tests/acquire/ptp_bench.h"
#include "tests/check.h"

enum { TURNS = BENCH_TURNS, MIB = 1 << 20 };

static uint32_t add_folder(struct bench *bench, const char *name, uint32_t parent)
{
    return ptp_model_add(
        bench->model, &(struct ptp_object){ .name = name, .format = PTP_FOLDER, .parent = parent },
        0);
}

TEST(folders_are_walked_and_what_is_no_picture_gets_one_notice)
{
    bench_auto bench;
    static uint8_t bytes[900];
    const uint8_t *shown = bytes;
    struct bench_object *object;
    unsigned said = 0;
    uint32_t folder;

    bench_init(&bench, NULL);
    folder = add_folder(&bench, "100SCANS", add_folder(&bench, "DCIM", 0));
    (void)ptp_model_add(
        bench.model,
        &(struct ptp_object){
            .name = "README.TXT", .format = 0x3004, .size = 5, .bytes = shown, .parent = folder },
        0);
    object = &bench.object[bench.objects++];
    *object = (struct bench_object){ .name = "P01.TIF", .size = sizeof bytes };
    object->bytes = calloc(1, sizeof bytes);
    (void)ptp_model_add(bench.model,
                        &(struct ptp_object){ .name = "P01.TIF",
                                              .date = "20260101T120000",
                                              .format = 0x3000, /* undefined, but so called */
                                              .size = sizeof bytes,
                                              .bytes = shown,
                                              .parent = folder },
                        0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(strstr(bench.key[0], "/DCIM/100SCANS/P01.TIF/900/20260101T120000"));
    for (int i = 0; i < 5; i++)
        bench_turn(&bench);
    for (size_t i = 0; i < bench.lines; i++)
        said += strstr(bench.line[i].reason, "no picture") != NULL;
    CHECK(said == 1);
    CHECK(bench_told(&bench, "README.TXT", "no picture")->what == GSN_SOURCE_NOTICE);
}

TEST(what_was_taken_is_not_copied_again_after_a_restart)
{
    bench_auto bench;
    uint64_t given;

    bench_take_three(&(struct ptp_faults){ 0 }, &bench);
    given = ptp_model_given(bench.model);
    bench_restart(&bench);
    for (int i = 0; i < 10; i++)
        bench_turn(&bench);
    CHECK(bench.again == 0);
    CHECK(ptp_model_given(bench.model) - given < 20000);
}

TEST(without_a_date_of_capture_it_is_copied_again_and_recognised)
{
    static const char *const dates[] = { "", "19800101T000000", "20200101T000000" };

    for (size_t i = 0; i < 3; i++) {
        bench_auto bench;

        bench_init(&bench, NULL);
        (void)bench_scan(&bench, "P01.TIF", 3000, 1, dates[i], 0);
        bench_open(&bench);
        CHECK(bench_work(&bench, TURNS));
        CHECK(bench.keys == 0);
        bench_restart(&bench);
        for (int n = 0; n < 10; n++)
            bench_turn(&bench);
        CHECK(bench.again == 1);
    }
}

TEST(two_that_would_share_a_key_are_both_taken)
{
    bench_auto bench;

    bench_init(&bench, NULL);
    (void)bench_scan(&bench, "SCAN.TIF", 3000, 1, NULL, 0);
    (void)bench_scan(&bench, "SCAN.TIF", 3000, 2, NULL, 0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(bench.keys == 0);
}

TEST(what_vanished_is_told_once)
{
    bench_auto bench;
    struct bench_object *object;
    unsigned said = 0;

    bench_init(&bench, NULL);
    object = bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    bench_open(&bench);
    bench_turn(&bench);
    ptp_model_remove(bench.model, object->handle);
    for (int i = 0; i < 6; i++)
        bench_turn(&bench);
    for (size_t i = 0; i < bench.lines; i++)
        said += bench.line[i].what == GSN_SOURCE_GONE;
    CHECK(said == 1 && object->taken == 0);
}

/* Puts itself between the source and the model, and changes one kind of question. */
struct meddler {
    const struct usb_model *truth;
    struct usb_model usb;
    uint16_t operation;
    size_t parameter; /* which one is changed; 0 is the first */
    uint32_t from, to;
    bool swallows; /* instead: the device never hears of it */
    unsigned swallowed;
    bool root_only; /* "everywhere" is taken for "in the root" as well */
};

static long meddle(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    struct meddler *const meddler = self;
    const size_t at = GSN_PTP_HEADER + 4 * meddler->parameter;
    uint8_t changed[GSN_PTP_LONGEST_RESPONSE];

    memcpy(changed, bytes, size);
    if (meddler->root_only && at + 4 <= size && gsn_ptp_get32(bytes + at) == 0)
        memset(changed + at, 0xFF, 4);
    if (gsn_ptp_get16(bytes + 6) == meddler->operation && at + 4 <= size &&
        gsn_ptp_get32(bytes + at) == meddler->from) {
        meddler->swallowed += meddler->swallows;
        if (meddler->swallows)
            return (long)size;
        for (size_t i = 0; i < 4; i++)
            changed[at + i] = (uint8_t)(meddler->to >> 8 * i);
    }
    return meddler->truth->out(meddler->truth->self, endpoint, changed, size);
}

static long pass_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    const struct meddler *const meddler = self;

    return meddler->truth->in(meddler->truth->self, endpoint, buffer, size);
}

static long pass_control(void *self, const uint8_t setup[8], const uint8_t *out, size_t out_size,
                         uint8_t *in, size_t in_size)
{
    const struct meddler *const meddler = self;

    return meddler->truth->control(meddler->truth->self, setup, out, out_size, in, in_size);
}

static void pass_tick(void *self, int64_t now_ms)
{
    const struct meddler *const meddler = self;

    meddler->truth->tick(meddler->truth->self, now_ms);
}

static void stand_between(struct meddler *meddler, struct bench *bench)
{
    meddler->truth = bench->bus.model;
    meddler->usb = *meddler->truth;
    meddler->usb.self = meddler;
    meddler->usb.out = meddle;
    meddler->usb.in = pass_in;
    meddler->usb.control = pass_control;
    meddler->usb.tick = pass_tick;
    bench->bus.model = &meddler->usb;
}

/* qemu's usb-mtp and umtp-responder take "everywhere" for "in the root". */
TEST(a_device_that_lists_its_root_alone_is_walked)
{
    struct meddler meddler = {
        .operation = GSN_PTP_GET_OBJECT_HANDLES, .parameter = 2, .from = 0, .to = UINT32_MAX
    };
    static uint8_t bytes[900];
    bench_auto bench;
    struct bench_object *object;
    uint32_t folder;

    bench_init(&bench, NULL);
    folder = add_folder(&bench, "B", add_folder(&bench, "A", 0));
    object = bench_scan(&bench, "P01.TIF", sizeof bytes, 1, NULL, 0);
    ptp_model_remove(bench.model, object->handle);
    (void)ptp_model_add(bench.model,
                        &(struct ptp_object){ .name = "P01.TIF",
                                              .date = "20260101T120000",
                                              .format = PTP_TIFF,
                                              .size = sizeof bytes,
                                              .bytes = object->bytes,
                                              .parent = folder },
                        0);
    stand_between(&meddler, &bench);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(strstr(bench.key[0], "/A/B/P01.TIF/"));
}

TEST(an_object_that_silences_the_device_when_described_is_set_aside)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_INFO, .swallows = true };
    bench_auto bench;
    unsigned resets;

    bench_init(&bench, NULL);
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    meddler.from = bench_scan(&bench, "P02.TIF", 3000, 2, NULL, 0)->handle;
    (void)bench_scan(&bench, "P03.TIF", 3000, 3, NULL, 0);
    stand_between(&meddler, &bench);
    bench_open(&bench);
    for (int i = 0; i < 10; i++)
        bench_turn(&bench);
    CHECK(bench.object[0].taken == 1 && bench.object[1].taken == 0 && bench.object[2].taken == 1);
    CHECK(bench_told(&bench, "object 00000002", "did not answer")->what == GSN_SOURCE_WAITING);
    resets = bench.bus.resets;
    CHECK(resets > 0 && resets < 4);
    meddler.swallows = false;
    meddler.to = meddler.from;
    for (int i = 0; i < 400 && !bench_is_complete(&bench); i++) {
        bench_turn(&bench);
        memory_bus_sleep(&bench.bus, 10000);
    }
    CHECK(bench_is_complete(&bench) && bench.again == 0);
}

/* Turns without copying until something is ready; returns its item and size. */
static uint64_t find_ready(struct bench *bench)
{
    for (int i = 0; i < 5; i++) {
        gsn_auto(gsn_source_events) events = NULL;
        struct gsn_error err = { 0 };
        int ended;

        memory_bus_sleep(&bench->bus, 1000);
        CHECK_OK(gsn_source_poll(bench->source, bench->bus.now_ms, &events, &ended, &err), err);
        for (size_t n = 0; n < events->count; n++) {
            if (events->at[n].what == GSN_SOURCE_READY)
                return events->at[n].item;
        }
    }
    return 0;
}

/* From now on, who asks about the one is told about the other. */
static void describe_another(struct meddler *meddler, struct bench *bench)
{
    meddler->from = bench->object[0].handle;
    meddler->to = ptp_model_add(bench->model,
                                &(struct ptp_object){ .name = "P99.TIF", .format = PTP_TIFF }, 0);
}

static int count(void *context, uint64_t item, uint64_t offset, int r)
{
    (void)item;
    (void)offset;
    (void)r;
    ++*(unsigned *)context;
    return 0;
}

/* Without partial reads a copy that goes on has to skip gigabytes of a slow device first. */
TEST(skipping_to_where_a_copy_goes_on_gives_signs_of_life)
{
    struct gsn_error err = { 0 };
    unsigned signs = 0;
    uint8_t byte;
    bench_auto bench;
    uint64_t item;
    size_t got;

    bench_init(&bench, &(struct ptp_faults){ .no_partial = true, .no_partial64 = true });
    (void)bench_scan(&bench, "P01.TIF", 4 * MIB, 1, NULL, 0);
    bench_open(&bench);
    item = find_ready(&bench);
    gsn_source_free(bench.source);
    bench.options.is_known = NULL;
    bench.options.on_read = count;
    bench.options.context = &signs;
    bench_open(&bench);
    item = find_ready(&bench);
    signs = 0;
    CHECK_OK(gsn_source_read(bench.source, item, 4 * MIB - 1, &byte, 1, &got, &err), err);
    CHECK(got == 1 && signs >= 4 * MIB / 65536);
}

TEST(a_device_that_is_silent_is_woken_with_signs_of_life)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_INFO, .swallows = true };
    unsigned signs = 0;
    bench_auto bench;

    bench_init(&bench, NULL);
    meddler.from = bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0)->handle;
    stand_between(&meddler, &bench);
    bench.options.is_known = NULL;
    bench.options.on_read = count;
    bench.options.context = &signs;
    bench_open(&bench);
    CHECK(find_ready(&bench) == 0);
    CHECK(signs > 10);
}

TEST(what_changed_while_it_was_read_is_not_delivered)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_INFO };
    struct gsn_error err = { 0 };
    uint8_t bytes[3000];
    bench_auto bench;
    uint64_t item;
    size_t got = 77;

    bench_init(&bench, NULL);
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    stand_between(&meddler, &bench);
    bench_open(&bench);
    item = find_ready(&bench);
    CHECK_OK(gsn_source_read(bench.source, item, 0, bytes, 1000, &got, &err), err);
    describe_another(&meddler, &bench);
    CHECK(gsn_source_read(bench.source, item, got, bytes, 2000, &got, &err) == GSN_E_BUSY);
    CHECK(got == 1000 && strstr(err.text, "P01.TIF"));
    CHECK(gsn_source_acknowledge(bench.source, item, &err) == GSN_E_NOTFOUND);
}

/* Reads the one picture of a device that deletes what is taken, to its end; the picture's item. */
static uint64_t read_one(struct meddler *meddler, struct bench *bench)
{
    struct gsn_error err = { 0 };
    uint8_t bytes[3000];
    uint64_t item;
    size_t got = 0;

    bench_init(bench, NULL);
    bench->options.delete_there = 1;
    (void)bench_scan(bench, "P01.TIF", sizeof bytes, 1, NULL, 0);
    stand_between(meddler, bench);
    bench_open(bench);
    item = find_ready(bench);
    CHECK_OK(gsn_source_read(bench->source, item, 0, bytes, sizeof bytes, &got, &err), err);
    CHECK(got == sizeof bytes);
    return item;
}

TEST(what_is_kept_is_not_deleted_and_comes_again_when_it_changes)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_INFO };
    struct gsn_error err = { 0 };
    bench_auto bench;
    uint64_t item;

    item = read_one(&meddler, &bench);
    CHECK_OK(gsn_source_keep(bench.source, item, &err), err);
    CHECK(gsn_source_keep(bench.source, item, &err) == GSN_E_NOTFOUND);
    describe_another(&meddler, &bench);
    CHECK(find_ready(&bench) != item);
    CHECK(ptp_model_asked(bench.model, GSN_PTP_DELETE_OBJECT) == 0);
}

TEST(what_changed_after_it_was_read_is_not_deleted)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_INFO };
    struct gsn_error err = { 0 };
    bench_auto bench;
    uint64_t item;

    item = read_one(&meddler, &bench);
    describe_another(&meddler, &bench);
    CHECK_OK(gsn_source_acknowledge(bench.source, item, &err), err);
    CHECK(ptp_model_asked(bench.model, GSN_PTP_DELETE_OBJECT) == 0);
}

/* The handle of a deletion that was not answered may be another object's after a reset. */
TEST(a_deletion_is_not_asked_for_again_without_looking)
{
    struct meddler meddler = { .operation = GSN_PTP_DELETE_OBJECT, .swallows = true };
    bench_auto bench;
    struct bench_object *object;

    bench_init(&bench, NULL);
    bench.options.delete_there = 1;
    object = bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    meddler.from = meddler.to = object->handle;
    stand_between(&meddler, &bench);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(meddler.swallowed == 1 && bench.bus.resets == 0);
    meddler.swallows = false;
    memory_bus_sleep(&bench.bus, 60000);
    bench_turn(&bench);
    CHECK(!ptp_model_has(bench.model, object->handle));
}

static void read_whole(struct bench *bench, uint64_t item, size_t size)
{
    struct gsn_error err = { 0 };
    uint8_t bytes[8000];
    size_t got = 0;

    CHECK_OK(gsn_source_read(bench->source, item, 0, bytes, sizeof bytes, &got, &err), err);
    CHECK(got == size);
}

TEST(what_was_measured_too_early_and_not_acknowledged_is_measured_anew)
{
    bench_auto bench;
    struct bench_object *object;
    uint64_t half;

    bench_init(&bench, &(struct ptp_faults){ .measures_once = true });
    object = bench_scan(&bench, "P01.TIF", 8000, 1, NULL, 0);
    ptp_model_write(bench.model, object->handle, 3000);
    bench_open(&bench);
    half = find_ready(&bench);
    ptp_model_write(bench.model, object->handle, 8000);
    read_whole(&bench, half, 3000);
    for (int i = 0; i < 3; i++)
        bench_turn(&bench);
    CHECK(bench_work(&bench, TURNS) && bench.again == 0);
    CHECK(!bench_told(&bench, "P01.TIF", "vanished"));
    CHECK(ptp_model_asked(bench.model, GSN_PTP_OPEN_SESSION) == 2);
}

TEST(what_stays_empty_is_measured_anew_ever_more_rarely)
{
    bench_auto bench;
    struct bench_object *object;

    bench_init(&bench, &(struct ptp_faults){ .measures_once = true, .no_events = true });
    object = bench_scan(&bench, "P01.TIF", 8000, 1, NULL, 0);
    ptp_model_write(bench.model, object->handle, 0);
    bench_open(&bench);
    for (int i = 0; i < 60; i++) {
        bench_turn(&bench);
        memory_bus_sleep(&bench.bus, 10000);
    }
    CHECK(bench_told(&bench, "P01.TIF", "is empty as yet"));
    /* Ten minutes and more: after 5, 10, ..., 640 s. */
    CHECK(ptp_model_asked(bench.model, GSN_PTP_OPEN_SESSION) >= 5);
    CHECK(ptp_model_asked(bench.model, GSN_PTP_OPEN_SESSION) <= 10);
    ptp_model_write(bench.model, object->handle, 8000);
    for (int i = 0; i < 200 && !bench_is_complete(&bench); i++) {
        bench_turn(&bench);
        memory_bus_sleep(&bench.bus, 10000);
    }
    CHECK(bench_is_complete(&bench));
    CHECK(!bench_told(&bench, "P01.TIF", "vanished"));
}

/* Without a date nobody is known again, and everything would be copied again. */
TEST(without_a_key_nothing_is_measured_anew)
{
    bench_auto bench;
    uint64_t item;

    bench_init(&bench, &(struct ptp_faults){ .measures_once = true });
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, "", 0);
    bench_open(&bench);
    item = find_ready(&bench);
    read_whole(&bench, item, 3000);
    CHECK(find_ready(&bench) == item);
    CHECK(ptp_model_asked(bench.model, GSN_PTP_OPEN_SESSION) == 1);
}

TEST(what_was_taken_and_changes_without_a_word_is_noticed)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_INFO };
    bench_auto bench;
    unsigned waiting = 0;

    bench_init(&bench, &(struct ptp_faults){ .no_events = true });
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    stand_between(&meddler, &bench);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    describe_another(&meddler, &bench);
    for (int i = 0; i < 3; i++)
        bench_turn(&bench);
    /* The one that is called so, and the one that is called so now. */
    for (size_t i = 0; i < bench.lines; i++)
        waiting += strcmp(bench.line[i].name, "P99.TIF") == 0 &&
                   strstr(bench.line[i].reason, "second look");
    CHECK(waiting == 2);
}

TEST(after_a_replug_an_object_with_a_key_is_the_same_item)
{
    bench_auto bench;
    uint64_t dated, undated;

    bench_init(&bench, &(struct ptp_faults){ .new_handles = true });
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    bench_open(&bench);
    dated = find_ready(&bench);
    ptp_model_unplug(bench.model);
    bench_turn(&bench);
    ptp_model_replug(bench.model);
    CHECK(dated != 0 && find_ready(&bench) == dated);
    CHECK(bench_work(&bench, TURNS));

    (void)bench_scan(&bench, "P02.TIF", 3000, 2, "", 0);
    undated = find_ready(&bench);
    ptp_model_unplug(bench.model);
    bench_turn(&bench);
    ptp_model_replug(bench.model);
    CHECK(undated != 0 && find_ready(&bench) != undated);
    CHECK(bench_work(&bench, TURNS) && bench.again == 0);
}

TEST(after_a_replug_a_bad_object_without_a_key_is_still_set_aside)
{
    bench_auto bench;
    unsigned asked;

    bench_init(&bench, &(struct ptp_faults){ .bad_object = 1, .new_handles = true });
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, "", 0);
    bench_open(&bench);
    for (int i = 0; i < 8; i++)
        bench_turn(&bench);
    CHECK(bench_told(&bench, "P01.TIF", "General Error (0x2002)"));
    asked = ptp_model_asked(bench.model, GSN_PTP_GET_PARTIAL_OBJECT);
    ptp_model_unplug(bench.model);
    bench_turn(&bench);
    ptp_model_replug(bench.model);
    for (int i = 0; i < 8; i++)
        bench_turn(&bench);
    CHECK(ptp_model_asked(bench.model, GSN_PTP_GET_PARTIAL_OBJECT) == asked);
}

TEST(after_a_reset_a_handle_is_asked_about_before_its_bytes_are_believed)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_INFO };
    struct gsn_error err = { 0 };
    static uint8_t bytes[MIB];
    bench_auto bench;
    uint64_t item;
    size_t got = 77;

    bench_init(&bench, &(struct ptp_faults){ .crash_above = 100000 });
    (void)bench_scan(&bench, "P01.TIF", 2 * MIB, 1, NULL, 0);
    stand_between(&meddler, &bench);
    bench_open(&bench);
    item = find_ready(&bench);
    describe_another(&meddler, &bench);
    CHECK(gsn_source_read(bench.source, item, 0, bytes, sizeof bytes, &got, &err) == GSN_E_BUSY);
    CHECK(bench.bus.resets > 0 && got == 77);
}

TEST(a_folder_that_is_refused_keeps_nobody_and_loses_nothing)
{
    struct meddler meddler = { .operation = GSN_PTP_GET_OBJECT_HANDLES,
                               .parameter = 2,
                               .root_only = true };
    bench_auto bench;
    unsigned said = 0;
    uint32_t folder;

    bench_init(&bench, NULL);
    folder = add_folder(&bench, "100SCANS", 0);
    (void)ptp_model_add(
        bench.model,
        &(struct ptp_object){ .name = "EMPTY.TIF", .format = PTP_TIFF, .parent = folder }, 0);
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    stand_between(&meddler, &bench);
    meddler.from = meddler.to = folder;
    bench_open(&bench);
    bench_turn(&bench);
    CHECK(bench_told(&bench, "EMPTY.TIF", "second look"));
    CHECK(!bench_told(&bench, "100SCANS", ""));
    meddler.to = 0x77777777;
    CHECK(bench_work(&bench, TURNS));
    CHECK(!bench_told(&bench, NULL, "vanished"));
    for (size_t i = 0; i < bench.lines; i++)
        said += strstr(bench.line[i].reason, "does not list") != NULL;
    CHECK(said == 1);
    CHECK(bench_told(&bench, "100SCANS", "does not list")->what == GSN_SOURCE_NOTICE);
}

/* Nothing is left out in silence: the one that is too many has its notice, once. */
TEST(more_folders_than_are_walked_are_told_by_name)
{
    enum { WALKED = 4096 };
    bench_auto bench;
    unsigned said = 0;

    bench_init(&bench, NULL);
    for (int i = 0; i <= WALKED; i++) {
        char name[32];

        (void)snprintf(name, sizeof name, "F%04d", i);
        (void)add_folder(&bench, name, 0);
    }
    bench_open(&bench);
    for (int i = 0; i < 3; i++)
        bench_turn(&bench);
    for (size_t i = 0; i < bench.lines; i++)
        said += strstr(bench.line[i].reason, "more than 4096") != NULL;
    CHECK(said == 1);
    CHECK(bench_told(&bench, "F4096", "delete old folders")->what == GSN_SOURCE_NOTICE);
}

TEST(with_no_time_to_settle_it_still_takes_two_looks)
{
    struct gsn_error err = { 0 };
    bench_auto bench;

    bench_init(&bench, NULL);
    bench.options.settle_ms = 0;
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    bench_open(&bench);
    for (int look = 0; look < 2; look++) {
        gsn_auto(gsn_source_events) events = NULL;
        int ended;

        CHECK_OK(gsn_source_poll(bench.source, bench.bus.now_ms, &events, &ended, &err), err);
        CHECK(events->count == 1);
        CHECK(events->at[0].what == (look == 0 ? GSN_SOURCE_WAITING : GSN_SOURCE_READY));
        memory_bus_sleep(&bench.bus, 1000);
    }
}

/* DeviceInfo promises GetPartialObject, but the device does not know it. */
TEST(a_promise_of_partial_reads_that_is_not_kept_is_got_over)
{
    bench_auto bench;

    bench_init(&bench, NULL);
    (void)bench_scan(&bench, "P01.TIF", 2 * MIB, 1, NULL, 0);
    bench_open(&bench);
    for (int i = 0; i < 2; i++)
        bench_turn(&bench);
    /* Offered when it was asked what it offers, and gone since. */
    ptp_model_set_faults(bench.model,
                         &(struct ptp_faults){ .no_partial = true, .no_partial64 = true });
    CHECK(bench_work(&bench, TURNS));
    CHECK(ptp_model_asked(bench.model, GSN_PTP_GET_OBJECT) == 1);
}

TEST(facts_are_what_the_device_said)
{
    bench_auto bench;
    struct gsn_error err = { 0 };
    bool seen = false;

    bench_init(&bench, NULL);
    (void)bench_scan(&bench, "P \"1\"\\.TIF", 3000, 1, NULL, 0);
    bench_open(&bench);
    for (int i = 0; i < 4; i++) {
        gsn_auto(gsn_source_events) events = NULL;
        int ended;

        memory_bus_sleep(&bench.bus, 1000);
        CHECK_OK(gsn_source_poll(bench.source, bench.bus.now_ms, &events, &ended, &err), err);
        if (events->count == 0 || events->at[0].what != GSN_SOURCE_READY)
            continue;
        seen = true;
        CHECK(strcmp(events->at[0].facts,
                     "{\"vendor\":\"1209\",\"product\":\"0001\",\"maker\":\"gieson\","
                     "\"model\":\"Slide Scanner\",\"serial\":\"SN0001\","
                     "\"storage\":\"0x00010001\",\"handle\":\"0x00000001\","
                     "\"name\":\"P \\\"1\\\"\\\\.TIF\",\"format\":\"0x380d\",\"size\":3000,"
                     "\"captured\":\"20260101T120000\"}") == 0);
    }
    CHECK(seen);
}

static int poll_and_read(struct bench *bench, struct gsn_error *err)
{
    const struct gsn_ptp_opener opener = { memory_opener, &bench->bus };
    uint8_t bytes[3000];
    void *self = NULL;
    int r = gsn_ptp_source_new(&opener, &bench->options, &self, err);

    for (int i = 0; r >= 0 && i < 4; i++) {
        gsn_auto(gsn_source_events) events = gsn_alloc_array(1, sizeof *events);
        int ended = 0;
        size_t got;

        memory_bus_sleep(&bench->bus, 1000);
        r = events ? gsn_ptp_source_ops.poll(self, bench->bus.now_ms, events, &ended, err)
                   : gsn_fail(err, GSN_E_NOMEM, "events");
        if (r >= 0 && events->count == 1 && events->at[0].what == GSN_SOURCE_READY)
            r = gsn_ptp_source_ops.read(self, events->at[0].item, 0, bytes, sizeof bytes, &got,
                                        err);
    }
    gsn_ptp_source_ops.close(self);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    bench_auto bench;
    struct gsn_error err = { 0 };

    bench_init(&bench, NULL);
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    CHECK_EVERY_OOM(poll_and_read(&bench, &err), err);
}
