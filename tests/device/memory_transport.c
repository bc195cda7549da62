/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/memory_transport.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PACKET = 512, STEP_MS = 10, OUT = 0x02, IN = 0x81, EVENT = 0x83, EVENT_ROOM = 1024 };

struct memory {
    struct gsn_ptp_transport transport;
    struct memory_bus *bus;
    uint8_t event[EVENT_ROOM]; /* one that wait() has met */
    size_t event_size;
};

static int gone(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "the device is gone");
}

void memory_bus_sleep(struct memory_bus *bus, int64_t ms)
{
    bus->now_ms += ms;
    if (bus->model->tick)
        bus->model->tick(bus->model->self, bus->now_ms);
}

/* What a model's answer is as the end of a transfer. */
static int judge(long answer, struct gsn_error *err)
{
    if (answer == USB_MODEL_GONE)
        return gone(err);
    if (answer == USB_MODEL_STALL)
        return GSN_PTP_STALLED;
    if (answer == USB_MODEL_BABBLE)
        return gsn_fail(err, GSN_E_IO, "the device babbles");
    return answer == USB_MODEL_NAK ? GSN_PTP_TIMEOUT : GSN_PTP_DONE;
}

static int memory_send(void *self, const void *bytes, size_t size, unsigned timeout_ms,
                       struct gsn_error *err)
{
    struct memory_bus *const bus = ((struct memory *)self)->bus;
    long sent;

    bus->transfers++;
    sent = bus->model->out(bus->model->self, OUT, bytes, size);
    if (sent == USB_MODEL_NAK)
        memory_bus_sleep(bus, timeout_ms);
    return judge(sent, err);
}

static long take_event(struct memory *memory, uint8_t *buffer, size_t size)
{
    const size_t had = memory->event_size;

    if (had == 0 || had > size)
        return memory->bus->model->in(memory->bus->model->self, EVENT, buffer, size);
    memcpy(buffer, memory->event, had);
    memory->event_size = 0;
    return (long)had;
}

static int memory_receive(void *self, enum gsn_ptp_pipe pipe, void *buffer, size_t size,
                          unsigned timeout_ms, size_t *ret_got, struct gsn_error *err)
{
    struct memory *const memory = self;
    struct memory_bus *const bus = memory->bus;
    const int64_t end = bus->now_ms + timeout_ms;
    long got;

    bus->transfers++;
    for (;;) {
        got = pipe == GSN_PTP_EVENT ? take_event(memory, buffer, size)
                                    : bus->model->in(bus->model->self, IN, buffer, size);
        if (got != USB_MODEL_NAK || bus->now_ms >= end)
            break;
        memory_bus_sleep(bus, STEP_MS);
    }
    *ret_got = got > 0 ? (size_t)got : 0;
    return judge(got, err);
}

static long request(struct memory_bus *bus, const uint8_t setup[8], const uint8_t *out,
                    size_t out_size, uint8_t *in, size_t in_size)
{
    return bus->model->control(bus->model->self, setup, out, out_size, in, in_size);
}

static int memory_clear_halt(void *self, enum gsn_ptp_pipe pipe, struct gsn_error *err)
{
    static const uint8_t endpoint[] = { OUT, IN, EVENT };
    struct memory_bus *const bus = ((struct memory *)self)->bus;
    const uint8_t setup[8] = { 0x02, 1, 0, 0, endpoint[pipe] };

    bus->halts_cleared++;
    return judge(request(bus, setup, NULL, 0, NULL, 0), err);
}

static int memory_cancel(void *self, uint32_t transaction, struct gsn_error *err)
{
    struct memory_bus *const bus = ((struct memory *)self)->bus;
    const uint8_t setup[8] = { 0x21, 0x64, 0, 0, 0, 0, 6 };
    const uint8_t data[6] = { 0x01,
                              0x40,
                              (uint8_t)transaction,
                              (uint8_t)(transaction >> 8),
                              (uint8_t)(transaction >> 16),
                              (uint8_t)(transaction >> 24) };

    bus->cancels++;
    if (bus->no_cancel)
        return GSN_PTP_STALLED;
    return judge(request(bus, setup, data, sizeof data, NULL, 0), err);
}

static int memory_reset(void *self, struct gsn_error *err)
{
    struct memory_bus *const bus = ((struct memory *)self)->bus;
    const uint8_t setup[8] = { 0x21, 0x66 };

    bus->resets++;
    return judge(request(bus, setup, NULL, 0, NULL, 0), err);
}

static int memory_status(void *self, uint16_t *ret_code, struct gsn_error *err)
{
    struct memory_bus *const bus = ((struct memory *)self)->bus;
    const uint8_t setup[8] = { 0xa1, 0x67, 0, 0, 0, 0, 32 };
    uint8_t in[32] = { 0 };
    const long got = request(bus, setup, NULL, 0, in, sizeof in);

    if (got >= 4)
        *ret_code = (uint16_t)(in[2] | in[3] << 8);
    return got >= 0 && got < 4 ? gsn_fail(err, GSN_E_IO, "no status") : judge(got, err);
}

static int memory_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    struct memory *const memory = self;
    struct memory_bus *const bus = memory->bus;
    const int64_t end = bus->now_ms + (timeout_ms < 0 ? 0 : timeout_ms);

    (void)stop_fd;
    for (;;) {
        const long got = memory->event_size
                             ? (long)memory->event_size
                             : bus->model->in(bus->model->self, EVENT, memory->event, EVENT_ROOM);

        if (got > 0)
            memory->event_size = (size_t)got;
        if (got == USB_MODEL_GONE)
            return gone(err);
        if (got != USB_MODEL_NAK || bus->now_ms >= end)
            return GSN_OK;
        memory_bus_sleep(bus, STEP_MS);
    }
}

static void memory_close(void *self)
{
    free(self);
}

static const struct gsn_ptp_transport_ops ops = {
    .send = memory_send,
    .receive = memory_receive,
    .clear_halt = memory_clear_halt,
    .cancel = memory_cancel,
    .reset = memory_reset,
    .status = memory_status,
    .wait = memory_wait,
    .close = memory_close,
};

int memory_transport_open(struct memory_bus *bus, struct gsn_ptp_transport **ret_transport,
                          struct gsn_error *err)
{
    const struct usb_model *const model = bus->model;
    const uint8_t setup[8] = { 0xa1, 0x67, 0, 0, 0, 0, 4 };
    uint8_t status[4];
    struct memory *memory;

    if (request(bus, setup, NULL, 0, status, sizeof status) == USB_MODEL_GONE)
        return gone(err);
    memory = calloc(1, sizeof *memory);
    if (!memory)
        abort();
    memory->bus = bus;
    memory->transport =
        (struct gsn_ptp_transport){ .ops = &ops,
                                    .self = memory,
                                    .packet_size = PACKET,
                                    .vendor = (uint16_t)(model->device[8] | model->device[9] << 8),
                                    .product =
                                        (uint16_t)(model->device[10] | model->device[11] << 8) };
    (void)snprintf(memory->transport.serial, sizeof memory->transport.serial, "%s",
                   model->strings[3] ? model->strings[3] : "");
    *ret_transport = &memory->transport;
    return GSN_OK;
}

int memory_opener(void *bus, struct gsn_ptp_transport **ret_transport, struct gsn_error *err)
{
    return memory_transport_open(bus, ret_transport, err);
}
