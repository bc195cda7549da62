/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a PTP initiator must survive (the devices in the field), each a test of its own: the real
 * source and the real spool, over a device model whose faults are switched on one by one. */
#include "acquire/ptp_source.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "acquire/ptp_session.h"
#include "tests/acquire/ptp_bench.h"
#include "tests/check.h"

enum { TURNS = BENCH_TURNS, MIB = 1 << 20 };

TEST(a_faultless_scanner_is_taken_in_byte_for_byte)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ 0 }, &bench);
    CHECK(bench.bus.halts_cleared == 0 && bench.bus.cancels == 0 && bench.bus.resets == 0);
    CHECK(strcmp(gsn_source_device(bench.source), "1209:0001 SN0001") == 0);
}

TEST(data_and_response_in_one_transfer_are_told_apart)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .merge_response = true }, &bench);
    CHECK(bench.bus.cancels == 0 && bench.bus.resets == 0);
}

TEST(the_length_field_is_never_trusted)
{
    for (unsigned at = 1; at < 16; at++) {
        bench_auto bench;

        bench_take_three(
            &(struct ptp_faults){ .lying_length_at = at, .merge_response = at % 3 == 0 }, &bench);
    }
}

TEST(header_and_data_in_separate_transfers_belong_together)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .split_header = true }, &bench);
    CHECK(bench.bus.cancels == 0 && bench.bus.resets == 0);
}

TEST(a_leftover_empty_packet_before_a_response_is_passed_over)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .leftover_zlp = true }, &bench);
    CHECK(bench.bus.cancels == 0 && bench.bus.resets == 0);
}

TEST(a_forgotten_empty_packet_is_not_missed)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .no_zlp = true }, &bench);
    CHECK(bench.bus.cancels == 0 && bench.bus.resets == 0);
}

TEST(short_transfers_are_put_together)
{
    static const size_t sizes[] = { 7, 12, 64, 100, 511 };

    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        bench_auto bench;

        bench_take_three(&(struct ptp_faults){ .short_reads = sizes[i] }, &bench);
        CHECK(bench.bus.resets == 0);
    }
}

TEST(data_that_end_early_are_asked_for_again)
{
    for (unsigned at = 2; at < 16; at++) {
        bench_auto bench;

        bench_take_three(&(struct ptp_faults){ .short_data_at = at }, &bench);
    }
}

TEST(a_session_left_open_by_a_crash_is_gone_on_with)
{
    bench_auto bench;

    bench_init(&bench, NULL);
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    {
        /* Whoever opened this one never closed it. */
        struct gsn_ptp_transport *transport = NULL;
        gsn_auto(gsn_ptp_session) session = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(memory_transport_open(&bench.bus, &transport, &err), err);
        CHECK_OK(gsn_ptp_session_new(transport, &session, &err), err);
        CHECK_OK(gsn_ptp_session_open(session, &err), err);
        transport->ops->close(transport->self);
    }
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(bench.bus.resets == 0);
}

TEST(a_replug_with_the_session_still_open_is_gone_on_with)
{
    bench_auto bench;

    bench_init(&bench, &(struct ptp_faults){ .session_stays_open = true });
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    ptp_model_unplug(bench.model);
    bench_turn(&bench);
    CHECK(bench.away == 1);
    ptp_model_replug(bench.model);
    (void)bench_scan(&bench, "P02.TIF", 3000, 2, NULL, 0);
    CHECK(bench_work(&bench, TURNS));
    CHECK(bench.again == 0 && bench.bus.resets == 0);
}

TEST(a_device_that_introduces_itself_only_in_a_session_is_asked_there)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .info_needs_session = true }, &bench);
    CHECK(bench.bus.resets == 0);
}

/* A scan on the second card. */
static void add_far_scan(struct bench *bench)
{
    struct bench_object *const object = bench_scan(bench, "P02.TIF", 2000, 2, NULL, 0);

    ptp_model_remove(bench->model, object->handle);
    object->handle = ptp_model_add(bench->model,
                                   &(struct ptp_object){ .name = object->name,
                                                         .date = "20260101T120000",
                                                         .format = PTP_TIFF,
                                                         .size = object->size,
                                                         .bytes = object->bytes,
                                                         .storage = 1 },
                                   0);
}

TEST(a_device_that_hangs_when_asked_for_all_storages_is_asked_for_each)
{
    bench_auto bench;

    bench_init(&bench, &(struct ptp_faults){ .no_list_of_all = true });
    (void)bench_scan(&bench, "P01.TIF", 1000, 1, NULL, 0);
    add_far_scan(&bench);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(bench.bus.resets == 0);
}

TEST(a_device_that_does_not_name_its_storages_is_asked_for_all)
{
    bench_auto bench;

    bench_init(&bench, &(struct ptp_faults){ .no_storage_ids = true });
    (void)bench_scan(&bench, "P01.TIF", 1000, 1, NULL, 0);
    add_far_scan(&bench);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(ptp_model_asked(bench.model, GSN_PTP_GET_STORAGE_IDS) > 0);
}

TEST(a_storage_that_is_closed_keeps_nobody)
{
    bench_auto bench;

    bench_init(&bench, &(struct ptp_faults){ .closed_storage = 2 });
    (void)bench_scan(&bench, "P01.TIF", 1000, 1, NULL, 0);
    add_far_scan(&bench);
    bench_open(&bench);
    for (int i = 0; i < 10; i++)
        bench_turn(&bench);
    CHECK(bench.object[0].taken == 1 && bench.object[1].taken == 0);
    ptp_model_set_faults(bench.model, &(struct ptp_faults){ 0 });
    CHECK(bench_work(&bench, TURNS));
}

TEST(an_object_is_taken_only_when_it_stopped_growing)
{
    bench_auto bench;
    struct bench_object *object;

    bench_init(&bench, &(struct ptp_faults){ .size_zero_first = true, .changed_flood = 200 });
    bench_open(&bench);
    bench_turn(&bench);
    object = bench_scan(&bench, "P01.TIF", 50000, 1, NULL, 1);
    for (int i = 0; i < 20; i++)
        bench_turn(&bench);
    CHECK(object->taken == 0 && bench.foreign == 0);
    CHECK(bench_told(&bench, "P01.TIF", "second look"));
    ptp_model_complete(bench.model, object->handle);
    CHECK(bench_work(&bench, TURNS));
    /* A flood is one hint: nobody asks as often as he is told. */
    CHECK(ptp_model_asked(bench.model, GSN_PTP_GET_OBJECT_INFO) < 60);
}

TEST(an_empty_object_waits_and_keeps_nobody_waiting)
{
    bench_auto bench;
    const struct bench_line *line;

    bench_init(&bench, NULL);
    (void)ptp_model_add(bench.model,
                        &(struct ptp_object){ .name = "EMPTY.TIF", .format = PTP_TIFF }, 0);
    (void)bench_scan(&bench, "P01.TIF", 1000, 1, NULL, 0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    line = bench_told(&bench, "EMPTY.TIF", "is empty as yet");
    CHECK(line && line->what == GSN_SOURCE_WAITING);
}

TEST(lying_and_missing_events_do_not_matter)
{
    static const struct ptp_faults kinds[] = { { .no_events = true },
                                               { .hidden_events = true },
                                               { .wrong_event_handle = true } };

    for (size_t i = 0; i < 3; i++) {
        bench_auto bench;

        bench_init(&bench, &kinds[i]);
        bench_open(&bench);
        bench_turn(&bench);
        for (int n = 0; n < 3; n++) {
            char name[32];

            (void)snprintf(name, sizeof name, "P%02d.TIF", n);
            (void)bench_scan(&bench, name, 4000, (unsigned)n, NULL, 1);
            bench_turn(&bench);
        }
        CHECK(bench_work(&bench, TURNS));
        CHECK(bench.again == 0);
    }
}

TEST(a_name_that_is_used_again_is_another_object)
{
    bench_auto bench;
    struct bench_object *object;
    uint32_t handle;

    bench_init(&bench, &(struct ptp_faults){ .no_events = true });
    object = bench_scan(&bench, "P01.TIF", 4000, 1, NULL, 0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    handle = object->handle;
    ptp_model_remove(bench.model, handle);
    (void)bench_scan(&bench, "P01.TIF", 5000, 2, NULL, 0);
    CHECK(bench_work(&bench, TURNS));
}

TEST(a_halted_endpoint_is_cleared_and_read_once_more)
{
    for (unsigned at = 1; at < 30; at++) {
        bench_auto bench;

        bench_take_three(&(struct ptp_faults){ .stall_at = at }, &bench);
        CHECK(bench.bus.halts_cleared == 1 && bench.bus.resets == 0);
    }
}

TEST(an_endpoint_that_halts_again_and_again_still_gives_everything)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .stall_every = 3 }, &bench);
    CHECK(bench.bus.resets == 0);
}

TEST(a_busy_device_is_asked_again_later)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .busy_count = 6 }, &bench);
    CHECK(bench.bus.cancels == 0 && bench.bus.resets == 0);
}

TEST(a_device_busy_for_long_is_said_once_and_taken_up_again)
{
    bench_auto bench;
    const struct bench_line *line;
    unsigned said = 0;

    bench_take_three(&(struct ptp_faults){ .busy_count = 40 }, &bench);
    line = bench_told(&bench, NULL, "busy");
    CHECK(line && line->what == GSN_SOURCE_NOTICE);
    for (size_t i = 0; i < bench.lines; i++)
        said += strstr(bench.line[i].reason, "busy") != NULL;
    CHECK(said == 1);
    CHECK(bench.bus.resets == 0);
}

TEST(pieces_are_of_one_mebibyte_at_most)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .crash_above = MIB }, &bench);
    CHECK(bench.bus.resets == 0);
    CHECK(ptp_model_asked(bench.model, GSN_PTP_GET_OBJECT) == 0);
}

TEST(firmware_that_large_requests_crash_gets_smaller_ones)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .crash_above = 100000 }, &bench);
    CHECK(bench.bus.resets > 0);
}

/* Case 1. */
TEST(an_unplugged_object_comes_in_whole_after_the_replug)
{
    bench_auto bench;
    uint64_t given;

    bench_init(&bench, &(struct ptp_faults){ .unplug_at_byte = 3 * MIB, .new_handles = true });
    (void)bench_scan(&bench, "P01.TIF", 5 * MIB, 1, NULL, 0);
    bench_open(&bench);
    for (int i = 0; i < TURNS && bench.away == 0; i++)
        bench_turn(&bench);
    CHECK(bench.away == 1 && bench.failed_copies == 1);
    given = ptp_model_given(bench.model);
    CHECK(given < 4 * MIB);
    ptp_model_set_faults(bench.model, &(struct ptp_faults){ .new_handles = true });
    ptp_model_replug(bench.model);
    CHECK(bench_work(&bench, TURNS));
    CHECK(bench.again == 0);
    /* The copy went on where it was: what was here did not cross the bus again. */
    CHECK(ptp_model_given(bench.model) < 6 * MIB);
}

TEST(a_device_without_partial_reads_is_streamed)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .no_partial = true, .no_partial64 = true }, &bench);
    /* One question an object: the stream goes on from read to read. */
    CHECK(ptp_model_asked(bench.model, GSN_PTP_GET_OBJECT) == 3);
    CHECK(bench.bus.cancels == 0 && bench.bus.resets == 0);
}

TEST(a_stream_that_breaks_is_begun_again)
{
    for (unsigned at = 8; at < 20; at++) {
        bench_auto bench;

        bench_take_three(
            &(struct ptp_faults){ .no_partial = true, .no_partial64 = true, .short_data_at = at },
            &bench);
    }
}

static void make_byte(void *context, uint64_t offset, uint8_t *buffer, size_t size)
{
    (void)context;
    for (size_t i = 0; i < size; i++)
        buffer[i] = (uint8_t)((offset + i) * 2654435761u >> 24 ^ (offset + i) >> 32);
}

static const uint64_t large_size = UINT64_C(5) << 30;

static uint64_t find_large(struct bench *bench)
{
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error err = { 0 };
    int ended;

    memory_bus_sleep(&bench->bus, 2000);
    CHECK_OK(gsn_source_poll(bench->source, bench->bus.now_ms, &events, &ended, &err), err);
    for (size_t i = 0; i < events->count; i++) {
        if (events->at[i].what == GSN_SOURCE_READY && events->at[i].size == large_size)
            return events->at[i].item;
    }
    return 0;
}

static void reads_large(const struct ptp_faults *faults, const uint64_t *offsets, size_t count)
{
    bench_auto bench;
    uint64_t item = 0;

    bench_init(&bench, faults);
    (void)ptp_model_add(bench.model,
                        &(struct ptp_object){ .name = "LARGE.TIF",
                                              .date = "20260101T120000",
                                              .format = PTP_TIFF,
                                              .size = large_size,
                                              .read = make_byte },
                        0);
    bench_open(&bench);
    for (int i = 0; i < 4 && item == 0; i++)
        item = find_large(&bench);
    CHECK(item != 0);
    for (size_t i = 0; i < count; i++) {
        uint8_t bytes[5000], truth[5000];
        struct gsn_error err = { 0 };
        size_t got = 0;

        CHECK_OK(gsn_source_read(bench.source, item, offsets[i], bytes, sizeof bytes, &got, &err),
                 err);
        CHECK(got > 0);
        make_byte(NULL, offsets[i], truth, got);
        CHECK(memcmp(bytes, truth, got) == 0);
    }
}

TEST(objects_over_four_gibibytes_are_read_to_their_end)
{
    static const uint64_t offsets[] = { 0, UINT32_MAX - 2500, UINT64_C(1) << 32,
                                        (UINT64_C(5) << 30) - 100 };

    reads_large(&(struct ptp_faults){ 0 }, offsets, 4);
}

TEST(a_stream_over_four_gibibytes_tells_no_length_and_is_read)
{
    static const uint64_t offsets[] = { 0, 5000, 70000, 70000 + 5000, 40 << 20 };

    reads_large(&(struct ptp_faults){ .no_partial = true, .no_partial64 = true }, offsets, 5);
}

TEST(an_object_that_is_too_large_to_tell_waits_with_its_reason)
{
    bench_auto bench;

    bench_init(&bench, &(struct ptp_faults){ .no_properties = true });
    (void)ptp_model_add(
        bench.model,
        &(struct ptp_object){
            .name = "LARGE.TIF", .format = PTP_TIFF, .size = large_size, .read = make_byte },
        0);
    (void)bench_scan(&bench, "P01.TIF", 1000, 1, NULL, 0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(bench_told(&bench, "LARGE.TIF", "larger than 4 GiB"));
}

/* The device goes on with the older answer whatever it is told, and gives it before the next. */
TEST(late_packets_of_an_older_transaction_are_dropped)
{
    for (unsigned at = 2; at < 20; at++) {
        bench_auto bench;

        bench_init(&bench, &(struct ptp_faults){ .late_at = at });
        bench.bus.no_cancel = 1;
        for (unsigned i = 0; i < 3; i++)
            (void)bench_scan(&bench, (const char *[]){ "P01.TIF", "P02.TIF", "P03.TIF" }[i], 4000,
                             i, NULL, 0);
        bench_open(&bench);
        CHECK(bench_work(&bench, TURNS));
        CHECK(bench.bus.cancels == 1 && bench.bus.resets == 0 && bench.again == 0);
    }
}

TEST(answers_with_a_wrong_transaction_id_are_not_believed)
{
    for (unsigned at = 1; at < 16; at++) {
        bench_auto bench;

        bench_take_three(&(struct ptp_faults){ .wrong_id_at = at }, &bench);
        CHECK(bench.bus.cancels == 1 && bench.bus.resets == 0);
    }
}

TEST(silence_ends_in_a_cancel_and_the_question_again)
{
    for (unsigned at = 1; at < 16; at++) {
        bench_auto bench;

        bench_take_three(&(struct ptp_faults){ .silent_at = at }, &bench);
        CHECK(bench.bus.cancels >= 1 && bench.bus.resets == 0);
    }
}

TEST(slow_answers_are_waited_for)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ .late_ms = 3000 }, &bench);
    CHECK(bench.bus.cancels == 0);
}

TEST(one_bad_object_does_not_keep_the_others)
{
    bench_auto bench;
    unsigned asked, tries;
    const struct bench_line *line;

    bench_init(&bench, &(struct ptp_faults){ .bad_object = 2 });
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    (void)bench_scan(&bench, "P02.TIF", 3000, 2, NULL, 0);
    (void)bench_scan(&bench, "P03.TIF", 3000, 3, NULL, 0);
    bench_open(&bench);
    CHECK(!bench_work(&bench, 20));
    CHECK(bench.object[0].taken == 1 && bench.object[1].taken == 0 && bench.object[2].taken == 1);
    line = bench_told(&bench, "P02.TIF", "General Error (0x2002)");
    CHECK(line && line->what == GSN_SOURCE_WAITING);
    /* Tried again, but rarely: hours pass. */
    asked = ptp_model_asked(bench.model, GSN_PTP_GET_PARTIAL_OBJECT);
    for (int i = 0; i < 1000; i++) {
        bench_turn(&bench);
        memory_bus_sleep(&bench.bus, 10000);
    }
    tries = ptp_model_asked(bench.model, GSN_PTP_GET_PARTIAL_OBJECT) - asked;
    CHECK(tries >= 5 && tries <= 12);
    /* And when it is well again, it comes in. */
    ptp_model_set_faults(bench.model, NULL);
    for (int i = 0; i < 500 && !bench_is_complete(&bench); i++) {
        bench_turn(&bench);
        memory_bus_sleep(&bench.bus, 10000);
    }
    CHECK(bench_is_complete(&bench));
}

static int held_by_another(void *context, struct gsn_ptp_transport **ret_transport,
                           struct gsn_error *err)
{
    (void)context;
    (void)ret_transport;
    return gsn_fail(err, GSN_E_BUSY, "gvfs-gphoto2-volume-monitor (process 4711) holds it");
}

TEST(who_holds_the_device_is_passed_on)
{
    const struct gsn_ptp_opener opener = { held_by_another, NULL };
    const struct gsn_source_options options = { .settle_ms = 1000 };
    struct gsn_error err = { 0 };
    void *self = NULL;

    CHECK(gsn_ptp_source_new(&opener, &options, &self, &err) == GSN_E_BUSY);
    CHECK(strstr(err.text, "gvfs") && self == NULL);
}

TEST(nothing_is_deleted_on_the_device_unless_asked)
{
    bench_auto bench;

    bench_take_three(&(struct ptp_faults){ 0 }, &bench);
    for (int i = 0; i < 5; i++)
        bench_turn(&bench);
    CHECK(ptp_model_asked(bench.model, GSN_PTP_DELETE_OBJECT) == 0);
    CHECK(ptp_model_count(bench.model) == 3);
}

TEST(what_is_acknowledged_is_deleted_there_when_asked)
{
    bench_auto bench;

    bench_init(&bench, NULL);
    bench.options.delete_there = 1;
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    (void)bench_scan(&bench, "P02.TIF", 3000, 2, NULL, 0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    CHECK(ptp_model_count(bench.model) == 0);
    CHECK(bench_told(&bench, NULL, "vanished") == NULL);
}

TEST(nothing_is_deleted_before_it_is_acknowledged)
{
    bench_auto bench;
    uint8_t bytes[4096];
    struct gsn_error err = { 0 };

    bench_init(&bench, NULL);
    bench.options.delete_there = 1;
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    bench_open(&bench);
    for (int i = 0; i < 5; i++) {
        gsn_auto(gsn_source_events) events = NULL;
        size_t got;
        int ended;

        memory_bus_sleep(&bench.bus, 1000);
        CHECK_OK(gsn_source_poll(bench.source, bench.bus.now_ms, &events, &ended, &err), err);
        if (events->count == 1 && events->at[0].what == GSN_SOURCE_READY)
            CHECK_OK(gsn_source_read(bench.source, events->at[0].item, 0, bytes, sizeof bytes, &got,
                                     &err),
                     err);
    }
    CHECK(ptp_model_asked(bench.model, GSN_PTP_GET_PARTIAL_OBJECT) > 0);
    CHECK(ptp_model_count(bench.model) == 1);
}

TEST(a_device_that_refuses_to_delete_is_told_of_once)
{
    bench_auto bench;
    unsigned said = 0;

    bench_init(&bench, &(struct ptp_faults){ .no_delete = true });
    bench.options.delete_there = 1;
    (void)bench_scan(&bench, "P01.TIF", 3000, 1, NULL, 0);
    bench_open(&bench);
    CHECK(bench_work(&bench, TURNS));
    for (int i = 0; i < 5; i++)
        bench_turn(&bench);
    for (size_t i = 0; i < bench.lines; i++)
        said += strstr(bench.line[i].reason, "Object WriteProtected (0x200D)") != NULL;
    CHECK(said == 1);
    CHECK(bench_told(&bench, "P01.TIF", "delete it there by hand")->what == GSN_SOURCE_NOTICE);
}
