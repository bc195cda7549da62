/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A PTP responder whose answers the input spoils: one byte for each transfer says whether it is
 * left as it truly is, cut, overwritten, stalled, withheld or replaced, and the bytes behind say
 * with what. When the input is used up all is true again, so that what was spoilt meets what is
 * right. The readers of datasets get the input alone. No call that fails changes its outputs, and
 * nothing goes on for ever. */
#include "acquire/ptp_source.h"

#include <string.h>

#include "acquire/ptp_wire.h"
#include "tests/device/memory_transport.h"
#include "tests/device/ptp_model.h"
#include "tests/fuzz/hold.h"

enum { TURNS = 3, PIECE = 4096, MOST_TRANSFERS = 200000, OBJECTS = 3 };

struct spoiler {
    const struct usb_model *truth;
    struct usb_model usb;
    const uint8_t *at;
    size_t left;
};

static uint8_t next_byte(struct spoiler *spoiler)
{
    if (spoiler->left == 0)
        return 0;
    spoiler->left--;
    return *spoiler->at++;
}

static size_t copy_bytes(struct spoiler *spoiler, uint8_t *to, size_t most)
{
    const size_t count = most < spoiler->left ? most : spoiler->left;

    if (count > 0)
        memcpy(to, spoiler->at, count);
    spoiler->at += count;
    spoiler->left -= count;
    return count;
}

static long answer_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    struct spoiler *const spoiler = self;
    const uint8_t how = next_byte(spoiler);
    long got;

    if (how >= 250)
        return (long)copy_bytes(spoiler, buffer,
                                next_byte(spoiler) < size ? 64 % (size + 1) : size);
    if (how >= 244)
        return USB_MODEL_NAK;
    if (how >= 238)
        return USB_MODEL_STALL;
    got = spoiler->truth->in(spoiler->truth->self, endpoint, buffer, size);
    if (got <= 0 || how < 160)
        return got;
    if (how < 180)
        return (long)(next_byte(spoiler) % (unsigned long)(got + 1));
    for (unsigned n = how < 210 ? 1 : 4; n > 0; n--) {
        const size_t where = next_byte(spoiler) % (size_t)got;

        buffer[where] = next_byte(spoiler);
    }
    return got;
}

static long pass_out(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    const struct spoiler *const spoiler = self;

    return spoiler->truth->out(spoiler->truth->self, endpoint, bytes, size);
}

static long pass_control(void *self, const uint8_t setup[8], const uint8_t *out, size_t out_size,
                         uint8_t *in, size_t in_size)
{
    const struct spoiler *const spoiler = self;

    return spoiler->truth->control(spoiler->truth->self, setup, out, out_size, in, in_size);
}

static void pass_tick(void *self, int64_t now_ms)
{
    const struct spoiler *const spoiler = self;

    spoiler->truth->tick(spoiler->truth->self, now_ms);
}

static void read_datasets(const uint8_t *bytes, size_t size)
{
    struct gsn_ptp_device_info device;
    struct gsn_ptp_object_info object;
    struct gsn_ptp_event event;
    uint64_t value;
    uint32_t count;

    if (gsn_ptp_read_device_info(bytes, size, &device, NULL) >= 0)
        HOLD(device.operation_count <= GSN_PTP_OPERATIONS && strlen(device.model) < GSN_PTP_TEXT);
    if (gsn_ptp_read_object_info(bytes, size, &object, NULL) >= 0)
        HOLD(strlen(object.name) < GSN_PTP_TEXT);
    if (gsn_ptp_read_list(bytes, size, &count, NULL) >= 0)
        HOLD(4 + 4 * (size_t)count <= size);
    (void)gsn_ptp_read_event(bytes, size, &event, NULL);
    (void)gsn_ptp_read_u64(bytes, size, &value, NULL);
}

static void add_objects(struct ptp_model *model)
{
    static const uint8_t bytes[PIECE];
    static const char *const names[OBJECTS] = { "FOLDER", "P01.TIF", "P02.TIF" };
    uint32_t folder = 0;

    for (size_t i = 0; i < OBJECTS; i++) {
        const int is_folder = i == 0;
        const struct ptp_object object = { .name = names[i],
                                           .date = "20260101T120000",
                                           .format = is_folder ? PTP_FOLDER : PTP_TIFF,
                                           .size = is_folder ? 0 : PIECE / (i + 1),
                                           .bytes = is_folder ? NULL : bytes,
                                           .parent = folder };
        const uint32_t handle = ptp_model_add(model, &object, 1);

        folder = is_folder ? handle : folder;
    }
}

static void take_turn(struct gsn_source *source, struct memory_bus *bus)
{
    struct gsn_source_events *events = NULL;
    struct gsn_error err = { 0 };
    uint8_t buffer[PIECE];
    int ended = 7;
    const int r = gsn_source_poll(source, bus->now_ms, &events, &ended, &err);

    if (r < 0)
        HOLD(!events && ended == 7 && err.code == r && err.text[0]);
    for (size_t i = 0; r >= 0 && i < events->count; i++) {
        size_t got = 77;

        if (events->at[i].what != GSN_SOURCE_READY)
            continue;
        if (gsn_source_read(source, events->at[i].item, 0, buffer, sizeof buffer, &got, &err) < 0)
            HOLD(got == 77);
        else
            HOLD(got <= sizeof buffer);
        (void)gsn_source_acknowledge(source, events->at[i].item, &err);
    }
    gsn_source_events_free(events);
    memory_bus_sleep(bus, 1500);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    static const struct gsn_source_options options = { .settle_ms = 1000 };
    struct ptp_model *const model = ptp_model_new("SN0001", NULL);
    struct spoiler spoiler = { .truth = ptp_model_usb(model), .at = bytes, .left = size };
    struct memory_bus bus = { .model = &spoiler.usb };
    const struct gsn_ptp_opener door = { memory_opener, &bus };
    struct gsn_source *source = NULL;
    struct gsn_error err = { 0 };
    void *self = NULL;

    read_datasets(bytes, size);
    spoiler.usb = *spoiler.truth;
    spoiler.usb.self = &spoiler;
    spoiler.usb.in = answer_in;
    spoiler.usb.out = pass_out;
    spoiler.usb.control = pass_control;
    spoiler.usb.tick = pass_tick;
    add_objects(model);
    HOLD(gsn_ptp_source_new(&door, &options, &self, &err) >= 0);
    HOLD(gsn_source_make(&gsn_ptp_source_ops, self, "ptp:any", &options, &source, &err) >= 0);
    for (int i = 0; i < TURNS; i++)
        take_turn(source, &bus);
    HOLD(bus.transfers < MOST_TRANSFERS);
    gsn_source_free(source);
    ptp_model_free(model);
    return 0;
}
