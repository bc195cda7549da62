/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_session.h"

#include <stdlib.h>
#include <string.h>

#include "acquire/ptp_device.h"
#include "acquire/ptp_exchange.h"
#include "tests/check.h"
#include "tests/device/memory_transport.h"
#include "tests/device/ptp_model.h"

enum { MIB = 1 << 20, MOST_LOG = 64 };

/* A scanner in memory, and a tap on its pipes that writes down what was asked for. */
struct tap {
    struct ptp_model *model;
    struct memory_bus bus;
    struct gsn_ptp_transport *inner, outer;
    struct gsn_ptp_transport_ops ops;
    size_t count;
    size_t asked[MOST_LOG]; /* bytes of each bulk-in read */
    uint32_t transaction;   /* of the last command */
    struct gsn_ptp_session *session;
};

static int tapped_send(void *self, const void *bytes, size_t size, unsigned timeout_ms,
                       struct gsn_error *err)
{
    struct tap *const tap = self;

    tap->transaction = gsn_ptp_get32((const uint8_t *)bytes + 8);
    return tap->inner->ops->send(tap->inner->self, bytes, size, timeout_ms, err);
}

static int tapped_receive(void *self, enum gsn_ptp_pipe pipe, void *buffer, size_t size,
                          unsigned timeout_ms, size_t *ret_got, struct gsn_error *err)
{
    struct tap *const tap = self;

    if (pipe == GSN_PTP_IN && tap->count < MOST_LOG)
        tap->asked[tap->count++] = size;
    return tap->inner->ops->receive(tap->inner->self, pipe, buffer, size, timeout_ms, ret_got, err);
}

static int tapped_clear(void *self, enum gsn_ptp_pipe pipe, struct gsn_error *err)
{
    struct tap *const tap = self;

    return tap->inner->ops->clear_halt(tap->inner->self, pipe, err);
}

static int tapped_cancel(void *self, uint32_t transaction, struct gsn_error *err)
{
    struct tap *const tap = self;

    return tap->inner->ops->cancel(tap->inner->self, transaction, err);
}

static int tapped_reset(void *self, struct gsn_error *err)
{
    struct tap *const tap = self;

    return tap->inner->ops->reset(tap->inner->self, err);
}

static int tapped_status(void *self, uint16_t *ret_code, struct gsn_error *err)
{
    struct tap *const tap = self;

    return tap->inner->ops->status(tap->inner->self, ret_code, err);
}

static void tap_init(struct tap *tap, const struct ptp_faults *faults)
{
    struct gsn_error err = { 0 };

    *tap = (struct tap){ .model = ptp_model_new("SN0001", faults) };
    tap->bus.model = ptp_model_usb(tap->model);
    CHECK_OK(memory_transport_open(&tap->bus, &tap->inner, &err), err);
    tap->ops = (struct gsn_ptp_transport_ops){ .send = tapped_send,
                                               .receive = tapped_receive,
                                               .clear_halt = tapped_clear,
                                               .cancel = tapped_cancel,
                                               .reset = tapped_reset,
                                               .status = tapped_status };
    tap->outer = *tap->inner;
    tap->outer.ops = &tap->ops;
    tap->outer.self = tap;
    CHECK_OK(gsn_ptp_session_new(&tap->outer, &tap->session, &err), err);
}

static void tap_done(struct tap *tap)
{
    gsn_ptp_session_free(tap->session);
    tap->inner->ops->close(tap->inner->self);
    ptp_model_free(tap->model);
}

#define tap_auto __attribute__((cleanup(tap_done))) struct tap

static uint8_t *make_bytes(size_t size)
{
    uint8_t *const bytes = malloc(size);

    for (size_t i = 0; bytes && i < size; i++)
        bytes[i] = (uint8_t)(i * 2654435761u >> 13);
    return bytes;
}

static uint32_t add_object(struct tap *tap, const uint8_t *bytes, size_t size)
{
    return ptp_model_add(
        tap->model,
        &(struct ptp_object){ .name = "P01.TIF", .format = PTP_TIFF, .size = size, .bytes = bytes },
        0);
}

TEST(a_session_opens_with_transaction_zero_and_counts_from_one)
{
    const struct gsn_ptp_request info = { .operation = GSN_PTP_GET_DEVICE_INFO };
    struct gsn_ptp_response response;
    struct gsn_error err = { 0 };
    tap_auto tap;
    uint8_t bytes[1000];
    size_t got;

    tap_init(&tap, NULL);
    CHECK_OK(gsn_ptp_session_open(tap.session, &err), err);
    CHECK(tap.transaction == 0 && gsn_ptp_session_number(tap.session) == 1);
    for (uint32_t n = 1; n < 4; n++) {
        CHECK_OK(gsn_ptp_ask(tap.session, &info, bytes, sizeof bytes, &got, &response, &err), err);
        CHECK(tap.transaction == n);
    }
    gsn_ptp_session_close(tap.session);
    CHECK_OK(gsn_ptp_ask(tap.session, &info, bytes, sizeof bytes, &got, &response, &err), err);
    CHECK(tap.transaction == 1 && gsn_ptp_session_number(tap.session) == 2);
}

/* The reads a recorded camera allows: one packet, 64 KiB, whole packets, the rest, the response. */
TEST(reads_are_asked_for_as_the_header_says)
{
    static const size_t truth[] = { 512, 65536, 2048, 512, 512 };
    const size_t size = 68182;
    uint8_t *const bytes = make_bytes(size), *const read = malloc(size);
    struct gsn_ptp_response response;
    struct gsn_error err = { 0 };
    tap_auto tap;
    size_t got;

    tap_init(&tap, NULL);
    CHECK_OK(gsn_ptp_session_open(tap.session, &err), err);
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT,
                                             1,
                                             { add_object(&tap, bytes, size) } };
    tap.count = 0;
    CHECK_OK(gsn_ptp_ask(tap.session, &request, read, size, &got, &response, &err), err);
    CHECK(got == size && response.code == GSN_PTP_OK && memcmp(read, bytes, size) == 0);
    CHECK(tap.count == 5 && memcmp(tap.asked, truth, sizeof truth) == 0);
    free(bytes);
    free(read);
}

/* Every size around packets and pieces, under every way of cutting data into transfers. */
TEST(sizes_around_packets_and_pieces_come_whole)
{
    static const struct ptp_faults ways[] = {
        { 0 },
        { .merge_response = true },
        { .split_header = true },
        { .leftover_zlp = true },
        { .no_zlp = true },
        { .merge_response = true, .split_header = true },
        { .split_header = true, .no_zlp = true, .leftover_zlp = true },
        { .short_reads = 300 },
        { .merge_response = true, .short_reads = 512 },
    };
    static const size_t about[] = { 12, 512, 1024, 65536, 65536 + 512, 131072 };
    uint8_t *const bytes = make_bytes(200000), *const read = malloc(200000);

    for (size_t way = 0; way < sizeof ways / sizeof ways[0]; way++) {
        struct gsn_error err = { 0 };
        tap_auto tap;

        tap_init(&tap, &ways[way]);
        for (size_t i = 0; i < sizeof about / sizeof about[0]; i++) {
            for (size_t size = about[i] > 25 ? about[i] - 25 : 1; size < about[i] + 14; size++) {
                const uint32_t handle = add_object(&tap, bytes, size);
                const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT, 1, { handle } };
                struct gsn_ptp_response response;
                size_t got = 0;

                CHECK_OK(gsn_ptp_ask(tap.session, &request, read, size, &got, &response, &err),
                         err);
                CHECK(got == size && memcmp(read, bytes, size) == 0);
                ptp_model_remove(tap.model, handle);
            }
        }
        CHECK(tap.bus.cancels == 0 && tap.bus.resets == 0);
    }
    free(bytes);
    free(read);
}

/* A responder that tells no length of data, as one must for objects over 4 GiB. */
struct untold {
    const struct usb_model *truth;
    struct usb_model usb;
};

static long untold_out(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    const struct untold *const untold = self;

    return untold->truth->out(untold->truth->self, endpoint, bytes, size);
}

static long untold_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    const struct untold *const untold = self;
    const long got = untold->truth->in(untold->truth->self, endpoint, buffer, size);

    if (got >= GSN_PTP_HEADER && gsn_ptp_get16(buffer + 4) == GSN_PTP_DATA_BLOCK &&
        gsn_ptp_get16(buffer + 6) == GSN_PTP_GET_OBJECT)
        memset(buffer, 0xFF, 4);
    return got;
}

static long untold_control(void *self, const uint8_t setup[8], const uint8_t *out, size_t out_size,
                           uint8_t *in, size_t in_size)
{
    const struct untold *const untold = self;

    return untold->truth->control(untold->truth->self, setup, out, out_size, in, in_size);
}

static void untold_tick(void *self, int64_t now_ms)
{
    const struct untold *const untold = self;

    untold->truth->tick(untold->truth->self, now_ms);
}

TEST(data_of_untold_length_end_where_they_end)
{
    static const struct ptp_faults ways[] = {
        { 0 },
        { .merge_response = true },
        { .split_header = true },
        { .no_zlp = true },
        { .leftover_zlp = true },
    };
    static const size_t sizes[] = { 1, 100, 476, 488, 500, 1000, 1012, 5000, 66036, 100000 };
    uint8_t *const bytes = make_bytes(100000), *const read = malloc(100000);

    for (size_t way = 0; way < sizeof ways / sizeof ways[0]; way++) {
        struct gsn_error err = { 0 };
        struct untold untold;
        tap_auto tap;

        tap_init(&tap, &ways[way]);
        untold.truth = tap.bus.model;
        untold.usb = *untold.truth;
        untold.usb.self = &untold;
        untold.usb.in = untold_in;
        untold.usb.out = untold_out;
        untold.usb.control = untold_control;
        untold.usb.tick = untold_tick;
        tap.bus.model = &untold.usb;
        for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
            const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT,
                                                     1,
                                                     { add_object(&tap, bytes, sizes[i]) } };
            struct gsn_ptp_response response;
            size_t got = 0;

            CHECK_OK(gsn_ptp_ask(tap.session, &request, read, 100000, &got, &response, &err), err);
            CHECK(got == sizes[i] && memcmp(read, bytes, got) == 0);
        }
        CHECK(tap.bus.cancels == 0 && tap.bus.resets == 0);
        tap.bus.model = untold.truth;
    }
    free(bytes);
    free(read);
}

TEST(more_data_than_asked_for_are_a_failure_and_not_an_overflow)
{
    uint8_t *const bytes = make_bytes(5000);
    uint8_t *const read = malloc(100); /* ASan guards its end */
    struct gsn_ptp_response response = { .code = 77 };
    struct gsn_error err = { 0 };
    tap_auto tap;
    size_t got = 77;

    tap_init(&tap, NULL);
    CHECK_OK(gsn_ptp_session_open(tap.session, &err), err);
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT,
                                             1,
                                             { add_object(&tap, bytes, 5000) } };
    CHECK(gsn_ptp_ask(tap.session, &request, read, 100, &got, &response, &err) == GSN_E_LIMIT);
    CHECK(got == 77 && response.code == 77);
    free(bytes);
    free(read);
}

TEST(a_question_between_the_pieces_of_a_stream_cancels_it)
{
    const struct gsn_ptp_request info = { .operation = GSN_PTP_GET_DEVICE_INFO };
    uint8_t *const bytes = make_bytes(MIB), answer[1000];
    struct gsn_ptp_response response;
    struct gsn_error err = { 0 };
    tap_auto tap;
    size_t got;

    tap_init(&tap, NULL);
    CHECK_OK(gsn_ptp_session_open(tap.session, &err), err);
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT,
                                             1,
                                             { add_object(&tap, bytes, MIB) } };
    CHECK_OK(gsn_ptp_stream_start(tap.session, &request, &err), err);
    CHECK_OK(gsn_ptp_stream_read(tap.session, answer, sizeof answer, &got, &err), err);
    CHECK(got == sizeof answer && memcmp(answer, bytes, got) == 0);
    CHECK_OK(gsn_ptp_ask(tap.session, &info, answer, sizeof answer, &got, &response, &err), err);
    CHECK(response.code == GSN_PTP_OK && tap.bus.cancels == 1 && tap.bus.resets == 0);
    CHECK(gsn_ptp_stream_read(tap.session, answer, 1, &got, &err) == GSN_E_IO);
    free(bytes);
}

TEST(a_device_that_went_is_not_found)
{
    const struct gsn_ptp_request info = { .operation = GSN_PTP_GET_DEVICE_INFO };
    struct gsn_ptp_response response = { .code = 77 };
    struct gsn_error err = { 0 };
    uint8_t answer[1000];
    tap_auto tap;
    size_t got = 77;

    tap_init(&tap, NULL);
    CHECK_OK(gsn_ptp_session_open(tap.session, &err), err);
    ptp_model_unplug(tap.model);
    CHECK(gsn_ptp_ask(tap.session, &info, answer, sizeof answer, &got, &response, &err) ==
          GSN_E_NOTFOUND);
    CHECK(got == 77 && response.code == 77 && err.text[0]);
}

TEST(packets_of_no_usb_are_refused)
{
    static const size_t sizes[] = { 0, 4, 100, 513, 4096 };
    struct gsn_error err = { 0 };
    tap_auto tap;

    tap_init(&tap, NULL);
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        struct gsn_ptp_transport odd = tap.outer;
        struct gsn_ptp_session *session = NULL;

        odd.packet_size = sizes[i];
        CHECK(gsn_ptp_session_new(&odd, &session, &err) == GSN_E_UNSUPPORTED && !session);
    }
}

/* A responder that always does the same wrong thing. */
struct stubborn {
    struct usb_model usb;
    uint8_t answer[64]; /* with the transaction of the last command put in, where it has a header */
    size_t size;
    long instead; /* what to return in its place, where not 0 */
    bool endless; /* full transfers without an end */
    uint8_t transaction[4];
};

static long stubborn_out(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    (void)endpoint;
    memcpy(((struct stubborn *)self)->transaction, bytes + 8, 4);
    return (long)size;
}

static long stubborn_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    const struct stubborn *const stubborn = self;
    const size_t given = stubborn->size < size ? stubborn->size : size;

    if (stubborn->instead)
        return stubborn->instead;
    if (endpoint == 0x83 && !stubborn->endless)
        return USB_MODEL_NAK;
    memset(buffer, 0x55, stubborn->endless ? size : 0);
    memcpy(buffer, stubborn->answer, given);
    if (given >= 12)
        memcpy(buffer + 8, stubborn->transaction, 4);
    return (long)(stubborn->endless ? size : given);
}

static long stubborn_control(void *self, const uint8_t setup[8], const uint8_t *out,
                             size_t out_size, uint8_t *in, size_t in_size)
{
    static const uint8_t ready[4] = { 4, 0, 0x01, 0x20 };

    (void)self;
    (void)out;
    (void)out_size;
    if (setup[1] != 0x67)
        return 0;
    memcpy(in, ready, in_size < 4 ? in_size : 4);
    return 4;
}

static const uint8_t any_device[18];

/* How asking such a responder ends; the transfers and the time that it took are bounded. */
static int ask_stubborn(struct stubborn *stubborn)
{
    const struct gsn_ptp_request info = { .operation = GSN_PTP_GET_DEVICE_INFO };
    struct gsn_ptp_transport *transport = NULL;
    gsn_auto(gsn_ptp_session) session = NULL;
    struct gsn_ptp_response response = { .code = 77 };
    struct memory_bus bus = { .model = &stubborn->usb };
    struct gsn_error err = { 0 };
    uint8_t *bytes = NULL;
    size_t got = 77;
    int r;

    stubborn->usb = (struct usb_model){ .device = any_device,
                                        .self = stubborn,
                                        .control = stubborn_control,
                                        .out = stubborn_out,
                                        .in = stubborn_in };
    CHECK_OK(memory_transport_open(&bus, &transport, &err), err);
    CHECK_OK(gsn_ptp_session_new(transport, &session, &err), err);
    r = gsn_ptp_fetch(session, &info, 10000, &bytes, &got, &response, &err);
    CHECK(bus.transfers < 20000 && bus.now_ms < 10 * 60 * 1000);
    CHECK(r >= 0 || (got == 77 && response.code == 77 && !bytes && err.text[0]));
    transport->ops->close(transport->self);
    gsn_free(bytes);
    return r;
}

TEST(a_stubborn_responder_is_given_up_in_bounded_time)
{
    static const uint8_t ok[12] = { 12, 0, 0, 0, 3, 0, 0x01, 0x20 };
    static const uint8_t busy[12] = { 12, 0, 0, 0, 3, 0, 0x19, 0x20 };
    static const uint8_t lost[12] = { 12, 0, 0, 0, 3, 0, 0x03, 0x20 };
    static const uint8_t open[12] = { 12, 0, 0, 0, 3, 0, 0x1E, 0x20 };
    static const uint8_t data[12] = { 0xFF, 0xFF, 0xFF, 0xFF, 2, 0, 0x01, 0x10 };
    const struct {
        struct stubborn stubborn;
        const uint8_t *answer;
        int r;
    } cases[] = {
        { { .instead = USB_MODEL_NAK }, NULL, GSN_E_IO },
        { { .instead = USB_MODEL_STALL }, NULL, GSN_E_IO },
        { { .instead = USB_MODEL_BABBLE }, NULL, GSN_E_IO },
        { { .size = 0 }, NULL, GSN_E_IO }, /* nothing but empty packets */
        { { .size = 1 }, NULL, GSN_E_IO },
        { { .size = 64 }, NULL, GSN_E_IO }, /* zeroes */
        { { .endless = true }, NULL, GSN_E_IO },
        { { .size = 12, .endless = true }, data, GSN_E_IO },
        { { .size = 12 }, data, GSN_E_IO },
        { { .size = 12 }, ok, GSN_OK },
        { { .size = 12 }, busy, GSN_E_BUSY },
        { { .size = 12 }, lost, GSN_E_IO },
        { { .size = 12 }, open, GSN_OK },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct stubborn stubborn = cases[i].stubborn;
        int r;

        if (cases[i].answer)
            memcpy(stubborn.answer, cases[i].answer, 12);
        r = ask_stubborn(&stubborn);
        if (r != cases[i].r)
            fail_msg("case %zu ended with %d", i, r);
    }
}
