/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A responder that means harm: random bytes, and true answers with bytes changed, cut off, doubled
 * or put in. Whatever it says, the source neither crashes nor hangs, and a call that fails leaves
 * its outputs as they were. */
#include "acquire/ptp_source.h"

#include <stdlib.h>
#include <string.h>

#include "acquire/ptp_wire.h"
#include "tests/check.h"
#include "tests/device/dice.h"
#include "tests/device/memory_transport.h"
#include "tests/device/ptp_model.h"

enum { RUNS = 400, TURNS = 12, OBJECTS = 4, MOST_TRANSFERS = 2000000, MOST_MS = 3600 * 1000 };

/* Stands between a true responder and the bus. */
struct liar {
    const struct usb_model *truth;
    struct usb_model usb;
    struct dice dice;
    unsigned every;  /* one transfer in so many is tampered with; 0: none */
    bool senseless;  /* nothing but random bytes */
    uint8_t last[4]; /* transaction */
};

static long liar_out(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    struct liar *const liar = self;

    memcpy(liar->last, bytes + 8, 4);
    return liar->truth->out(liar->truth->self, endpoint, bytes, size);
}

static long liar_control(void *self, const uint8_t setup[8], const uint8_t *out, size_t out_size,
                         uint8_t *in, size_t in_size)
{
    struct liar *const liar = self;

    return liar->truth->control(liar->truth->self, setup, out, out_size, in, in_size);
}

static void liar_tick(void *self, int64_t now_ms)
{
    struct liar *const liar = self;

    liar->truth->tick(liar->truth->self, now_ms);
}

static void fill(struct liar *liar, uint8_t *bytes, size_t size)
{
    for (size_t i = 0; i < size; i += 8) {
        const uint64_t eight = roll(&liar->dice);

        memcpy(bytes + i, &eight, size - i < 8 ? size - i : 8);
    }
}

/* Random bytes, often with a header that nearly makes sense. */
static long talk_nonsense(struct liar *liar, uint8_t *buffer, size_t size)
{
    const size_t given = below(&liar->dice, 50) ? below(&liar->dice, 600) % (size + 1) : size;

    if (below(&liar->dice, 6) == 0)
        return USB_MODEL_NAK;
    if (below(&liar->dice, 20) == 0)
        return USB_MODEL_STALL;
    fill(liar, buffer, given);
    if (given >= GSN_PTP_HEADER && below(&liar->dice, 4)) {
        const size_t length = below(&liar->dice, 2) ? given : below(&liar->dice, 100000);

        for (size_t i = 0; i < 4; i++)
            buffer[i] = (uint8_t)(length >> 8 * i);
        buffer[4] = (uint8_t)(1 + below(&liar->dice, 4));
        buffer[5] = 0;
        buffer[6] = (uint8_t)(1 + below(&liar->dice, 32));
        buffer[7] = below(&liar->dice, 2) ? 0x20 : 0x10;
        memcpy(buffer + 8, liar->last, 4);
    }
    return (long)given;
}

/* Changes what truly was to be said. */
static long tamper(struct liar *liar, uint8_t *buffer, size_t size, size_t got)
{
    switch (below(&liar->dice, 7)) {
    case 0: /* a few bytes, mostly of the header and of the counts behind it */
        for (unsigned n = 1 + below(&liar->dice, 4); n > 0 && got > 0; n--)
            buffer[below(&liar->dice, 1 + (unsigned)got) % (got < 24 ? got : 24)] =
                (uint8_t)roll(&liar->dice);
        return (long)got;
    case 1:
        for (unsigned n = 1 + below(&liar->dice, 40); n > 0 && got > 0; n--)
            buffer[roll(&liar->dice) % got] = (uint8_t)roll(&liar->dice);
        return (long)got;
    case 2: /* cut off */
        return (long)(got ? roll(&liar->dice) % got : 0);
    case 3: { /* more */
        const size_t more = (size - got) ? roll(&liar->dice) % (size - got) : 0;

        fill(liar, buffer + got, more);
        return (long)(got + more);
    }
    case 4:
        return USB_MODEL_STALL;
    case 5:
        return USB_MODEL_NAK;
    default:
        fill(liar, buffer, got);
        return (long)got;
    }
}

static long liar_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    struct liar *const liar = self;
    long got;

    if (liar->senseless)
        return talk_nonsense(liar, buffer, size);
    got = liar->truth->in(liar->truth->self, endpoint, buffer, size);
    if (got < 0 || liar->every == 0 || below(&liar->dice, liar->every) != 0)
        return got;
    return tamper(liar, buffer, size, (size_t)got);
}

static void stand_between(struct liar *liar, struct ptp_model *model, uint64_t seed)
{
    *liar = (struct liar){ .truth = ptp_model_usb(model),
                           .dice = { seed },
                           .senseless = seed % 4 == 0,
                           .every = 2 + (unsigned)(seed % 17) * 3 };
    liar->usb = *liar->truth;
    liar->usb.self = liar;
    liar->usb.out = liar_out;
    liar->usb.in = liar_in;
    liar->usb.control = liar_control;
    liar->usb.tick = liar_tick;
}

static void add_objects(struct ptp_model *model, const uint8_t *bytes)
{
    static const char *const names[OBJECTS] = { "P01.TIF", "FOLDER", "P02.TIF", "P03.TIF" };
    static const uint64_t sizes[OBJECTS] = { 700, 0, 90000, 500 };
    uint32_t folder = 0;

    for (size_t i = 0; i < OBJECTS; i++) {
        const bool is_folder = sizes[i] == 0;
        const uint32_t handle =
            ptp_model_add(model,
                          &(struct ptp_object){ .name = names[i],
                                                .date = "20260101T120000",
                                                .format = is_folder ? PTP_FOLDER : PTP_TIFF,
                                                .size = sizes[i],
                                                .bytes = is_folder ? NULL : bytes,
                                                .parent = folder },
                          1);

        if (is_folder)
            folder = handle;
    }
}

/* Reads an item as far as it lets itself be read; sizes that were lied about are not followed. */
static void read_item(struct gsn_source *source, const struct gsn_source_event *ready)
{
    uint8_t *const buffer = malloc(40000); /* ASan guards its end */
    uint64_t offset = 0;

    for (int pieces = 0; pieces < 8 && offset < ready->size; pieces++) {
        struct gsn_error err = { 0 };
        size_t got = 77;
        const int r = gsn_source_read(source, ready->item, offset, buffer, 40000, &got, &err);

        if (r < 0) {
            CHECK(got == 77 && err.code == r && err.text[0]);
            break;
        }
        CHECK(got <= 40000);
        offset += got;
    }
    free(buffer);
}

static void turn(struct gsn_source *source, struct memory_bus *bus)
{
    struct gsn_source_events *const none = NULL;
    struct gsn_source_events *events = none;
    struct gsn_error err = { 0 };
    int ended = 77;
    const int r = gsn_source_poll(source, bus->now_ms, &events, &ended, &err);

    if (r < 0)
        CHECK(events == none && ended == 77 && err.code == r && err.text[0]);
    for (size_t i = 0; r >= 0 && i < events->count; i++) {
        if (events->at[i].what == GSN_SOURCE_READY)
            read_item(source, &events->at[i]);
    }
    gsn_source_events_free(events);
    memory_bus_sleep(bus, 1500);
}

TEST(whatever_a_responder_says_nothing_crashes_and_nothing_hangs)
{
    static uint8_t bytes[90000];

    for (uint64_t seed = 1; seed <= RUNS; seed++) {
        struct ptp_model *const model = ptp_model_new("SN0001", NULL);
        gsn_auto(gsn_source) source = NULL;
        const struct gsn_source_options options = { .settle_ms = 1000 };
        struct gsn_error err = { 0 };
        struct memory_bus bus = { 0 };
        struct liar liar;
        const struct gsn_ptp_opener opener = { memory_opener, &bus };
        void *self = NULL;

        stand_between(&liar, model, seed);
        bus.model = &liar.usb;
        add_objects(model, bytes);
        CHECK_OK(gsn_ptp_source_new(&opener, &options, &self, &err), err);
        CHECK_OK(gsn_source_make(&gsn_ptp_source_ops, self, "ptp:any", &options, &source, &err),
                 err);
        for (int i = 0; i < TURNS; i++)
            turn(source, &bus);
        if (bus.transfers > MOST_TRANSFERS || bus.now_ms > TURNS * MOST_MS)
            fail_msg("seed %llu: %u transfers in %lld ms", (unsigned long long)seed, bus.transfers,
                     (long long)bus.now_ms);
        gsn_source_free(source);
        source = NULL;
        ptp_model_free(model);
    }
}

/* The readers of datasets alone, on bytes of exactly the size they are told. */
TEST(random_datasets_are_read_or_refused_within_their_bytes)
{
    struct dice dice = { 42 };
    unsigned read = 0;

    for (int i = 0; i < 20000; i++) {
        const size_t size = below(&dice, 200);
        uint8_t *const bytes = malloc(size ? size : 1);
        struct gsn_ptp_device_info device;
        struct gsn_ptp_object_info object;
        struct gsn_ptp_event event;
        uint64_t value;
        uint32_t count;

        for (size_t n = 0; n < size; n++)
            bytes[n] = below(&dice, 2) ? (uint8_t)roll(&dice) : 0;
        read += gsn_ptp_read_device_info(bytes, size, &device, NULL) >= 0;
        read += gsn_ptp_read_object_info(bytes, size, &object, NULL) >= 0;
        if (gsn_ptp_read_list(bytes, size, &count, NULL) >= 0)
            CHECK(4 + 4 * (size_t)count <= size);
        (void)gsn_ptp_read_event(bytes, size, &event, NULL);
        (void)gsn_ptp_read_u64(bytes, size, &value, NULL);
        free(bytes);
    }
    CHECK(read > 100);
}
