/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the model puts on the bus, byte by byte, against the container layout of the Still Image
 * class and ISO 15740 written out by hand. */
#include "tests/device/ptp_model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/device/wire.h"

enum { OUT = 0x02, IN = 0x81, EVENT = 0x83, PACKET = 512, ROOM = 1 << 16 };

static uint8_t buffer[ROOM], picture[ROOM];
static uint32_t transaction;

static long ask(struct ptp_model *model, uint16_t operation, uint32_t a, uint32_t b, uint32_t c)
{
    const struct usb_model *const usb = ptp_model_usb(model);
    uint8_t command[24];

    wire_put32(command, sizeof command);
    wire_put16(command + 4, 1);
    wire_put16(command + 6, operation);
    wire_put32(command + 8, ++transaction);
    wire_put32(command + 12, a);
    wire_put32(command + 16, b);
    wire_put32(command + 20, c);
    return usb->out(usb->self, OUT, command, sizeof command);
}

static long in(struct ptp_model *model, uint8_t endpoint, size_t size)
{
    const struct usb_model *const usb = ptp_model_usb(model);

    memset(buffer, 0xee, sizeof buffer);
    return usb->in(usb->self, endpoint, buffer, size);
}

static long control(struct ptp_model *model, uint8_t type, uint8_t request, uint8_t index)
{
    static const uint8_t cancel[6] = { 0x01, 0x40 };
    const struct usb_model *const usb = ptp_model_usb(model);
    const uint8_t setup[8] = { type, request, 0, 0, index, 0, request == 0x64 ? 6 : 0, 0 };

    return usb->control(usb->self, setup, cancel, request == 0x64 ? 6 : 0, buffer, 64);
}

/* A response of this code, and nothing more in the transfer. */
static void responds(struct ptp_model *model, uint16_t code)
{
    const long got = in(model, IN, PACKET);

    CHECK(got >= 12 && wire_get32(buffer) == (uint32_t)got);
    CHECK(wire_get16(buffer + 4) == 3);
    if (wire_get16(buffer + 6) != code)
        fail_msg("answered %04x, not %04x", wire_get16(buffer + 6), code);
}

static uint32_t add(struct ptp_model *model, const char *name, size_t size, int announce)
{
    for (size_t i = 0; i < sizeof picture; i++)
        picture[i] = (uint8_t)(i * 31 + i / 256);
    return ptp_model_add(model,
                         &(struct ptp_object){ .name = name,
                                               .date = "20260101T120000",
                                               .format = PTP_TIFF,
                                               .size = size,
                                               .bytes = picture },
                         announce);
}

/* With an open session. */
static struct ptp_model *start(const struct ptp_faults *faults)
{
    struct ptp_model *const model = ptp_model_new("SN0001", faults);

    transaction = 0;
    (void)ask(model, 0x1002, 1, 0, 0);
    responds(model, 0x2001);
    return model;
}

/* Sends the question for the whole object and reads header and bytes in transfers of this size. */
static void pulls(struct ptp_model *model, uint32_t handle, size_t size, size_t piece)
{
    size_t done = 0;

    CHECK(ask(model, 0x1009, handle, 0, 0) == 24);
    for (long got = 1; got > 0 && done < size + 12; done += (size_t)got) {
        got = in(model, IN, piece);
        CHECK(got > 0);
        if (done == 0) {
            CHECK(wire_get32(buffer) == size + 12 && wire_get16(buffer + 4) == 2);
            CHECK(memcmp(buffer + 12, picture, (size_t)got - 12) == 0);
        } else {
            CHECK(memcmp(buffer, picture + done - 12, (size_t)got) == 0);
        }
    }
    CHECK(done == size + 12);
}

TEST(an_object_comes_whole_in_any_size_of_transfer)
{
    static const size_t sizes[] = { 1, 499, 501, 1000, 4095, 20000 };
    struct ptp_model *const model = start(NULL);

    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        const uint32_t handle = add(model, "a.tif", sizes[i], 0);

        for (size_t piece = PACKET; piece <= 16 * PACKET; piece *= 4) {
            pulls(model, handle, sizes[i], piece);
            responds(model, 0x2001);
        }
    }
    CHECK(ptp_model_asked(model, 0x1009) == 18);
    ptp_model_free(model);
}

TEST(a_block_of_whole_packets_ends_with_an_empty_one)
{
    struct ptp_model *const model = start(NULL);
    const uint32_t handle = add(model, "a.tif", PACKET - 12, 0);

    pulls(model, handle, PACKET - 12, PACKET);
    CHECK(in(model, IN, PACKET) == 0);
    responds(model, 0x2001);
    pulls(model, handle, PACKET - 12, 2 * PACKET); /* the empty packet ends this very transfer */
    responds(model, 0x2001);
    CHECK(in(model, IN, PACKET) == USB_MODEL_NAK);
    ptp_model_free(model);
}

TEST(without_the_empty_packet_the_response_comes_in_the_same_transfer)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .no_zlp = true });
    const uint32_t handle = add(model, "a.tif", PACKET - 12, 0);

    CHECK(ask(model, 0x1009, handle, 0, 0) == 24);
    CHECK(in(model, IN, 2 * PACKET) == PACKET + 12);
    CHECK(wire_get16(buffer + PACKET + 4) == 3);
    pulls(model, handle, PACKET - 12, PACKET);
    responds(model, 0x2001);
    ptp_model_free(model);
}

TEST(merged_split_short_and_leftover_packets_are_what_they_say)
{
    struct ptp_model *model = start(&(struct ptp_faults){ .merge_response = true });
    uint32_t handle = add(model, "a.tif", 100, 0);

    (void)ask(model, 0x1009, handle, 0, 0);
    CHECK(in(model, IN, PACKET) == 112 + 12 && wire_get16(buffer + 112 + 4) == 3);
    ptp_model_set_faults(model, &(struct ptp_faults){ .split_header = true });
    (void)ask(model, 0x1009, handle, 0, 0);
    CHECK(in(model, IN, PACKET) == 12 && wire_get32(buffer) == 112);
    CHECK(in(model, IN, PACKET) == 100 && memcmp(buffer, picture, 100) == 0);
    responds(model, 0x2001);
    ptp_model_set_faults(model, &(struct ptp_faults){ .short_reads = 40 });
    pulls(model, handle, 100, PACKET);
    responds(model, 0x2001);
    ptp_model_set_faults(model, &(struct ptp_faults){ .leftover_zlp = true });
    pulls(model, handle, 100, PACKET);
    CHECK(in(model, IN, PACKET) == 0);
    responds(model, 0x2001);
    ptp_model_free(model);
}

TEST(a_stalled_endpoint_waits_for_its_clearing_and_loses_nothing)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .stall_at = 2 });
    const uint32_t handle = add(model, "a.tif", 100, 0);

    (void)ask(model, 0x1009, handle, 0, 0);
    CHECK(in(model, IN, PACKET) == USB_MODEL_STALL && in(model, IN, PACKET) == USB_MODEL_STALL);
    CHECK(control(model, 0xa1, 0x67, 0) == 8 && wire_get32(buffer + 4) == IN);
    CHECK(control(model, 0x02, 1, IN) == 0);
    CHECK(in(model, IN, PACKET) == 112 && memcmp(buffer + 12, picture, 100) == 0);
    responds(model, 0x2001);
    ptp_model_free(model);
}

TEST(wrong_late_silent_and_lying_answers_hit_one_transaction)
{
    struct ptp_model *const model =
        start(&(struct ptp_faults){ .wrong_id_at = 2, .late_at = 3, .silent_at = 5 });

    (void)ask(model, 0x1004, 0, 0, 0);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer + 8) == 2 + 0x100);
    responds(model, 0x2001);
    (void)ask(model, 0x1004, 0, 0, 0); /* late: not before the next question */
    CHECK(in(model, IN, PACKET) == USB_MODEL_NAK);
    (void)ask(model, 0x1004, 0, 0, 0);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer + 8) == 3);
    responds(model, 0x2001);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer + 8) == 4);
    responds(model, 0x2001);
    (void)ask(model, 0x1004, 0, 0, 0);
    CHECK(in(model, IN, PACKET) == USB_MODEL_NAK);
    ptp_model_set_faults(model, &(struct ptp_faults){ .lying_length_at = 4, .short_data_at = 7 });
    (void)ask(model, 0x1004, 0, 0, 0);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer) == 5);
    responds(model, 0x2001);
    (void)ask(model, 0x1004, 0, 0, 0);
    CHECK(in(model, IN, PACKET) == 16 && wire_get32(buffer) == 20);
    responds(model, 0x2001);
    ptp_model_free(model);
}

TEST(a_late_answer_comes_when_the_time_is_told)
{
    struct ptp_model *const model = start(NULL);
    const struct usb_model *const usb = ptp_model_usb(model);

    ptp_model_set_faults(model, &(struct ptp_faults){ .late_ms = 50 });
    usb->tick(usb->self, 1000);
    (void)ask(model, 0x1003, 0, 0, 0);
    usb->tick(usb->self, 1049);
    CHECK(in(model, IN, PACKET) == USB_MODEL_NAK);
    usb->tick(usb->self, 1050);
    responds(model, 0x2001);
    ptp_model_free(model);
}

TEST(a_device_unplugged_in_mid_object_is_gone_until_it_is_plugged_in)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .unplug_at_byte = 2000 });
    const uint32_t handle = add(model, "a.tif", 10000, 0);

    (void)ask(model, 0x1009, handle, 0, 0);
    CHECK(in(model, IN, PACKET) == PACKET);
    CHECK(in(model, IN, 4 * PACKET) == USB_MODEL_GONE);
    CHECK(ask(model, 0x1004, 0, 0, 0) == USB_MODEL_GONE);
    ptp_model_set_faults(model, NULL);
    ptp_model_replug(model);
    (void)ask(model, 0x1004, 0, 0, 0);
    responds(model, 0x2003); /* the session went with the plug */
    ptp_model_free(model);
}

TEST(a_session_that_stays_open_is_said_so)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .session_stays_open = true });

    ptp_model_unplug(model);
    ptp_model_replug(model);
    (void)ask(model, 0x1002, 7, 0, 0);
    responds(model, 0x201e);
    CHECK(wire_get32(buffer + 12) == 1);
    ptp_model_free(model);
}

static void never_asked(void *context, uint64_t offset, uint8_t *bytes, size_t size)
{
    (void)context;
    for (size_t i = 0; i < size; i++)
        bytes[i] = (uint8_t)((offset + i) % 251);
}

TEST(objects_over_four_gib_tell_their_size_by_the_property_alone)
{
    const uint64_t size = UINT64_C(5) << 30, offset = (UINT64_C(4) << 30) + 5;
    struct ptp_model *const model = start(NULL);
    const struct usb_model *const usb = ptp_model_usb(model);
    const struct ptp_object big = { .name = "big.tif", .size = size, .read = never_asked };
    uint8_t partial[28] = { 28, 0, 0, 0, 1, 0, 0xc1, 0x95, 99 };
    const uint32_t handle = ptp_model_add(model, &big, 0);

    (void)ask(model, 0x1008, handle, 0, 0);
    CHECK(in(model, IN, PACKET) > 12 + 52 && wire_get32(buffer + 12 + 8) == UINT32_MAX);
    responds(model, 0x2001);
    (void)ask(model, 0x9803, handle, 0xdc04, 0);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer + 12) == 1u << 30);
    CHECK(wire_get32(buffer + 16) == 1);
    responds(model, 0x2001);
    wire_put32(partial + 12, handle);
    wire_put32(partial + 16, (uint32_t)offset);
    wire_put32(partial + 20, (uint32_t)(offset >> 32));
    wire_put32(partial + 24, 10);
    CHECK(usb->out(usb->self, OUT, partial, 28) == 28);
    CHECK(in(model, IN, PACKET) == 22 && buffer[12] == offset % 251);
    responds(model, 0x2001);
    CHECK(wire_get32(buffer + 12) == 10);
    ptp_model_free(model);
}

TEST(what_grows_is_never_whole_before_it_is_complete)
{
    struct ptp_model *const model =
        start(&(struct ptp_faults){ .size_zero_first = true, .changed_flood = 2 });
    const uint32_t handle = add(model, "a.tif", 1000, 1);
    uint32_t last = 0;

    for (int look = 0; look < 5; look++) {
        (void)ask(model, 0x1008, handle, 0, 0);
        CHECK(in(model, IN, PACKET) > 64);
        CHECK(look == 0 ? wire_get32(buffer + 20) == 0 : wire_get32(buffer + 20) > last);
        last = wire_get32(buffer + 20);
        responds(model, 0x2001);
    }
    CHECK(last < 1000);
    ptp_model_complete(model, handle);
    (void)ask(model, 0x1008, handle, 0, 0);
    CHECK(in(model, IN, PACKET) > 64 && wire_get32(buffer + 20) == 1000);
    for (int i = 0; i < 4; i++) {
        CHECK(in(model, EVENT, 64) == 16 && wire_get32(buffer + 12) == handle);
        CHECK(wire_get16(buffer + 6) == (i == 0 ? 0x4002 : 0x4007));
    }
    CHECK(in(model, EVENT, 64) == USB_MODEL_NAK);
    ptp_model_free(model);
}

TEST(folders_cards_and_deletion)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .no_list_of_all = true });
    const uint32_t folder =
        ptp_model_add(model, &(struct ptp_object){ .name = "DCIM", .format = PTP_FOLDER }, 0);
    const uint32_t first =
        ptp_model_add(model, &(struct ptp_object){ .name = "\xc3\xa4.tif", .parent = folder }, 0);
    const uint32_t second =
        ptp_model_add(model, &(struct ptp_object){ .name = "b.tif", .storage = 1 }, 0);

    (void)ask(model, 0x1004, 0, 0, 0);
    CHECK(in(model, IN, PACKET) == 24 && wire_get32(buffer + 20) == 0x20001);
    responds(model, 0x2001);
    (void)ask(model, 0x1007, 0x10001, 0, folder);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer + 16) == first);
    responds(model, 0x2001);
    (void)ask(model, 0x1007, 0x20001, 0, UINT32_MAX);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer + 16) == second);
    responds(model, 0x2001);
    (void)ask(model, 0x1008, first, 0, 0);
    CHECK(in(model, IN, PACKET) > 64 && wire_get32(buffer + 12 + 38) == folder);
    CHECK(memcmp(buffer + 64, "\x06\xe4\0.\0t\0i\0f\0\0", 13) == 0);
    responds(model, 0x2001);
    (void)ask(model, 0x100b, folder, 0, 0);
    responds(model, 0x2012);
    (void)ask(model, 0x100b, first, 0, 0);
    responds(model, 0x2001);
    CHECK(!ptp_model_has(model, first) && ptp_model_count(model) == 2);
    (void)ask(model, 0x1007, UINT32_MAX, 0, 0);
    responds(model, 0x2008);
    (void)ask(model, 0x1007, 0x20001, 0, UINT32_MAX);
    CHECK(in(model, IN, PACKET) == USB_MODEL_NAK);
    ptp_model_free(model);
}

TEST(busy_crashed_and_bad_are_answered_so)
{
    struct ptp_model *const model = start(&(struct ptp_faults){
        .busy_count = 2, .crash_above = 100, .bad_object = 1, .silent_at = 0 });
    const uint32_t bad = add(model, "bad.tif", 1000, 0), good = add(model, "good.tif", 1000, 0);

    for (int i = 0; i < 2; i++) {
        (void)ask(model, 0x1009, bad, 0, 0);
        responds(model, 0x2019);
    }
    (void)ask(model, 0x1009, bad, 0, 0);
    responds(model, 0x2002);
    (void)ask(model, 0x101b, good, 0, 101);
    CHECK(in(model, IN, PACKET) == USB_MODEL_NAK);
    CHECK(ask(model, 0x1004, 0, 0, 0) == USB_MODEL_NAK);
    CHECK(control(model, 0x21, 0x66, 0) == 0);
    (void)ask(model, 0x1002, 1, 0, 0);
    responds(model, 0x2001);
    (void)ask(model, 0x101b, good, 900, 100);
    CHECK(in(model, IN, PACKET) == 112 && memcmp(buffer + 12, picture + 900, 100) == 0);
    CHECK(control(model, 0x21, 0x64, 0) == 0); /* cancelled before its response came */
    CHECK(control(model, 0xa1, 0x67, 0) == 4 && wire_get16(buffer + 2) == 0x2019);
    CHECK(control(model, 0xa1, 0x67, 0) == 4 && wire_get16(buffer + 2) == 0x2001);
    CHECK(in(model, IN, PACKET) == USB_MODEL_NAK);
    ptp_model_free(model);
}

TEST(a_buffer_that_ends_inside_a_packet_is_overrun)
{
    struct ptp_model *const model = start(NULL);
    const uint32_t handle = add(model, "a.tif", 1000, 0);

    (void)ask(model, 0x1009, handle, 0, 0);
    CHECK(in(model, IN, 100) == USB_MODEL_BABBLE);
    ptp_model_free(model);
}

/* Asks without parameters but these and demands a response without data. */
static void answers(struct ptp_model *model, uint16_t operation, uint32_t a, uint32_t b, uint32_t c,
                    uint16_t code)
{
    (void)ask(model, operation, a, b, c);
    responds(model, code);
}

/* Whether a 16-bit number is in one of the lists of DeviceInfo. */
static bool is_listed(struct ptp_model *model, uint16_t number)
{
    long got;

    (void)ask(model, 0x1001, 0, 0, 0);
    got = in(model, IN, PACKET);
    CHECK(got > 12);
    for (long at = 12; at + 1 < got; at++)
        if (wire_get16(buffer + at) == number) {
            responds(model, 0x2001);
            return true;
        }
    responds(model, 0x2001);
    return false;
}

TEST(what_is_not_offered_is_neither_listed_nor_answered)
{
    struct ptp_model *const model = start(&(struct ptp_faults){
        .no_partial = true, .no_partial64 = true, .no_properties = true, .no_delete = true });
    const uint32_t handle = add(model, "a.tif", 100, 0);

    CHECK(!is_listed(model, 0x101b) && !is_listed(model, 0x95c1) && !is_listed(model, 0x9803));
    answers(model, 0x101b, handle, 0, 10, 0x2005);
    answers(model, 0x95c1, handle, 0, 0, 0x2005);
    answers(model, 0x9803, handle, 0xdc04, 0, 0x2005);
    answers(model, 0x100b, handle, 0, 0, 0x200d);
    answers(model, 0x9999, 0, 0, 0, 0x2005);
    CHECK(ptp_model_has(model, handle));
    ptp_model_set_faults(model, NULL);
    CHECK(is_listed(model, 0x101b) && is_listed(model, 0x95c1) && is_listed(model, 0x9803));
    ptp_model_free(model);
}

TEST(who_insists_on_a_session_says_nothing_before)
{
    struct ptp_model *const model =
        ptp_model_new("SN0001", &(struct ptp_faults){ .info_needs_session = true });

    answers(model, 0x1001, 0, 0, 0, 0x2003);
    answers(model, 0x1002, 0, 0, 0, 0x201d);
    answers(model, 0x1002, 1, 0, 0, 0x2001);
    CHECK(is_listed(model, 0x1009));
    answers(model, 0x1003, 0, 0, 0, 0x2001);
    answers(model, 0x1004, 0, 0, 0, 0x2003);
    ptp_model_free(model);
}

TEST(events_can_be_missing_hidden_and_wrong)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .no_events = true });

    (void)add(model, "a.tif", 100, 1);
    CHECK(in(model, EVENT, 64) == USB_MODEL_NAK && is_listed(model, 0x4002));
    ptp_model_set_faults(model,
                         &(struct ptp_faults){ .hidden_events = true, .wrong_event_handle = true });
    (void)add(model, "b.tif", 100, 1);
    CHECK(!is_listed(model, 0x4002));
    CHECK(in(model, EVENT, 64) == 16 && !ptp_model_has(model, wire_get32(buffer + 12)));
    CHECK(in(model, EVENT, 64) == 16 && wire_get32(buffer + 12) == 2);
    ptp_model_remove(model, 2);
    CHECK(in(model, EVENT, 64) == 16 && wire_get16(buffer + 6) == 0x4003);
    answers(model, 0x1009, 2, 0, 0, 0x2009);
    ptp_model_free(model);
}

TEST(handles_can_change_with_the_plug_and_folders_follow)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .new_handles = true });
    const uint32_t folder =
        ptp_model_add(model, &(struct ptp_object){ .name = "DCIM", .format = PTP_FOLDER }, 0);
    const uint32_t child =
        ptp_model_add(model, &(struct ptp_object){ .name = "a.tif", .parent = folder }, 0);

    ptp_model_unplug(model);
    ptp_model_replug(model);
    answers(model, 0x1002, 1, 0, 0, 0x2001);
    CHECK(!ptp_model_has(model, folder) && !ptp_model_has(model, child));
    (void)ask(model, 0x1007, UINT32_MAX, 0, UINT32_MAX);
    CHECK(in(model, IN, PACKET) == 20);
    const uint32_t moved = wire_get32(buffer + 16);

    responds(model, 0x2001);
    (void)ask(model, 0x1007, UINT32_MAX, 0, moved);
    CHECK(in(model, IN, PACKET) == 20 && ptp_model_has(model, wire_get32(buffer + 16)));
    responds(model, 0x2001);
    ptp_model_free(model);
}

TEST(every_nth_transfer_can_stall)
{
    struct ptp_model *const model = start(NULL);
    const uint32_t handle = add(model, "a.tif", 4000, 0);
    unsigned stalls = 0;
    long total = 0;

    ptp_model_set_faults(model, &(struct ptp_faults){ .stall_every = 3 });
    (void)ask(model, 0x1009, handle, 0, 0);
    while (total < 4012) {
        const long got = in(model, IN, PACKET);

        if (got == USB_MODEL_STALL) {
            stalls++;
            CHECK(control(model, 0x02, 1, IN) == 0);
        } else {
            CHECK(got > 0);
            total += got;
        }
    }
    CHECK(total == 4012 && stalls == 4);
    ptp_model_free(model);
}

TEST(huge_lies_about_the_length_are_told_too)
{
    struct ptp_model *const model = start(&(struct ptp_faults){ .lying_length_at = 1 });

    (void)ask(model, 0x1004, 0, 0, 0);
    CHECK(in(model, IN, PACKET) == 20 && wire_get32(buffer) == 0x7fffffff);
    responds(model, 0x2001);
    ptp_model_free(model);
}
