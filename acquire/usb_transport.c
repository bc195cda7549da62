/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/usb_transport.h"

#include <errno.h>
#include <libusb.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "acquire/usb_address.h"
#include "acquire/usb_find.h"
#include "pipeline/core/mem.h"

enum {
    CONTROL_MS = 5000,
    EVENT_ROOM = 1024,
    LEAST_EVENT = 24, /* bytes of the longest event that ISO 15740 knows */
    EVENT_FAILURES = 3,
    MOST_WAITED_FOR = 16,
};

/* Class requests of the Still Image definition, 5.2. */
enum { CANCEL = 0x64, DEVICE_RESET = 0x66, DEVICE_STATUS = 0x67, CANCEL_CODE = 0x4001 };

struct usb {
    struct gsn_ptp_transport transport;
    libusb_context *context;
    libusb_device_handle *handle;
    struct gsn_usb_pipes pipes;
    char name[140]; /* "04a9:31c0 SN0001", for sentences */
    int claimed;
    /* An interrupt transfer waits for the next event all the time. */
    struct libusb_transfer *event;
    int event_pending, event_came;
    unsigned event_failures; /* in a row; after EVENT_FAILURES the device's events are given up */
    uint8_t event_bytes[EVENT_ROOM];
};

static int fail(const struct usb *usb, int r, const char *doing, struct gsn_error *err)
{
    const int code = r == LIBUSB_ERROR_NO_DEVICE ? GSN_E_NOTFOUND
                     : r == LIBUSB_ERROR_NO_MEM  ? GSN_E_NOMEM
                                                 : GSN_E_IO;

    if (code == GSN_E_NOTFOUND)
        return gsn_fail(err, code, "USB device %s: it was unplugged while %s", usb->name, doing);
    return gsn_fail(err, code, "USB device %s: %s failed: %s", usb->name, doing,
                    libusb_strerror(r));
}

/* Events */

static void LIBUSB_CALL event_ended(struct libusb_transfer *transfer)
{
    struct usb *const usb = transfer->user_data;

    usb->event_pending = 0;
    usb->event_came = 1;
}

/* Keeps the interrupt transfer waiting. */
static int expect_event(struct usb *usb, struct gsn_error *err)
{
    int r;

    if (!usb->event || usb->event_pending || usb->event_came ||
        usb->event_failures >= EVENT_FAILURES)
        return GSN_OK;
    r = libusb_submit_transfer(usb->event);
    if (r == LIBUSB_ERROR_NO_DEVICE)
        return fail(usb, r, "waiting for an event", err);
    if (r == 0)
        usb->event_pending = 1;
    else
        usb->event_failures++;
    return GSN_OK;
}

/* Lets libusb see what happened, without waiting. */
static int look_around(struct usb *usb, struct gsn_error *err)
{
    struct timeval now = { 0 };
    const int r = libusb_handle_events_timeout_completed(usb->context, &now, NULL);

    return r < 0 && r != LIBUSB_ERROR_INTERRUPTED ? fail(usb, r, "waiting", err) : GSN_OK;
}

static void cancel_event(struct usb *usb)
{
    struct timeval second = { .tv_sec = 1 };

    if (usb->event_pending)
        (void)libusb_cancel_transfer(usb->event);
    /* The memory is libusb's until it has said that the transfer ended. */
    while (usb->event_pending)
        if (libusb_handle_events_timeout_completed(usb->context, &second, NULL) < 0)
            break;
    usb->event_came = 0;
}

/* What the event transfer that ended has brought. */
static int take_event(struct usb *usb, void *buffer, size_t size, size_t *ret_got,
                      struct gsn_error *err)
{
    const size_t came = (size_t)usb->event->actual_length;
    const size_t got = came < size ? came : size;

    usb->event_came = 0;
    switch (usb->event->status) {
    case LIBUSB_TRANSFER_COMPLETED:
        usb->event_failures = 0;
        memcpy(buffer, usb->event_bytes, got);
        *ret_got = got;
        return GSN_PTP_DONE;
    case LIBUSB_TRANSFER_STALL:
        /* A pipe that stalls again and again is given up like one that fails: events are hints. */
        usb->event_failures++;
        *ret_got = 0;
        return GSN_PTP_STALLED;
    case LIBUSB_TRANSFER_NO_DEVICE:
        return fail(usb, LIBUSB_ERROR_NO_DEVICE, "waiting for an event", err);
    default:
        usb->event_failures++;
        return fail(usb, LIBUSB_ERROR_IO, "waiting for an event", err);
    }
}

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Sleeps until libusb has something to do; ret_stopped: stop_fd can be read. */
static int sleep_until(struct usb *usb, int timeout_ms, int stop_fd, int *ret_stopped,
                       struct gsn_error *err)
{
    const struct libusb_pollfd **const list = libusb_get_pollfds(usb->context);
    struct pollfd fd[MOST_WAITED_FOR] = { { .fd = stop_fd, .events = POLLIN } };
    nfds_t count = 1;
    int r;

    for (size_t i = 0; list && list[i] && count < MOST_WAITED_FOR; i++)
        fd[count++] = (struct pollfd){ .fd = list[i]->fd, .events = list[i]->events };
    libusb_free_pollfds(list);
    r = poll(fd, count, timeout_ms);
    if (r < 0 && errno != EINTR)
        return gsn_fail(err, GSN_E_IO, "waiting for an event: %s", strerror(errno));
    *ret_stopped = r > 0 && fd[0].revents != 0;
    return GSN_OK;
}

static int usb_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    struct usb *const usb = self;
    const int64_t end = now_ms() + timeout_ms;

    for (int stopped = 0;;) {
        const int64_t left = timeout_ms < 0 ? -1 : end - now_ms();
        int r;

        r = expect_event(usb, err);
        if (r >= 0)
            r = look_around(usb, err);
        if (r < 0)
            return r;
        if (usb->event_came && usb->event->status == LIBUSB_TRANSFER_NO_DEVICE)
            return fail(usb, LIBUSB_ERROR_NO_DEVICE, "waiting for an event", err);
        if (usb->event_came || stopped || (timeout_ms >= 0 && left <= 0))
            return GSN_OK;
        r = sleep_until(usb, (int)left, stop_fd, &stopped, err);
        if (r < 0)
            return r;
    }
}

static int receive_event(struct usb *usb, void *buffer, size_t size, unsigned timeout_ms,
                         size_t *ret_got, struct gsn_error *err)
{
    const int r = usb_wait(usb, (int)timeout_ms, -1, err);

    if (r < 0)
        return r;
    if (usb->event_came)
        return take_event(usb, buffer, size, ret_got, err);
    *ret_got = 0;
    return GSN_PTP_TIMEOUT;
}

/* Bulk */

static int usb_send(void *self, const void *bytes, size_t size, unsigned timeout_ms,
                    struct gsn_error *err)
{
    struct usb *const usb = self;
    int sent = 0;
    int r = libusb_bulk_transfer(usb->handle, usb->pipes.out, (unsigned char *)bytes, (int)size,
                                 &sent, timeout_ms);

    if (r == 0 && size > 0 && size % usb->transport.packet_size == 0)
        r = libusb_bulk_transfer(usb->handle, usb->pipes.out, (unsigned char *)bytes, 0, &sent,
                                 timeout_ms);
    if (r == LIBUSB_ERROR_PIPE)
        return GSN_PTP_STALLED;
    if (r == LIBUSB_ERROR_TIMEOUT)
        return GSN_PTP_TIMEOUT;
    return r < 0 ? fail(usb, r, "sending a request", err) : GSN_PTP_DONE;
}

static int usb_receive(void *self, enum gsn_ptp_pipe pipe, void *buffer, size_t size,
                       unsigned timeout_ms, size_t *ret_got, struct gsn_error *err)
{
    struct usb *const usb = self;
    int got = 0, r;

    if (pipe == GSN_PTP_EVENT)
        return receive_event(usb, buffer, size, timeout_ms, ret_got, err);
    /* To libusb 0 is for ever. */
    r = libusb_bulk_transfer(usb->handle, usb->pipes.in, buffer, (int)size, &got,
                             timeout_ms ? timeout_ms : 1);
    if (r < 0 && r != LIBUSB_ERROR_PIPE && r != LIBUSB_ERROR_TIMEOUT)
        return fail(usb, r, "reading", err);
    *ret_got = (size_t)got;
    return r == LIBUSB_ERROR_PIPE      ? GSN_PTP_STALLED
           : r == LIBUSB_ERROR_TIMEOUT ? GSN_PTP_TIMEOUT
                                       : GSN_PTP_DONE;
}

static int usb_clear_halt(void *self, enum gsn_ptp_pipe pipe, struct gsn_error *err)
{
    struct usb *const usb = self;
    const uint8_t endpoint = pipe == GSN_PTP_OUT  ? usb->pipes.out
                             : pipe == GSN_PTP_IN ? usb->pipes.in
                                                  : usb->pipes.event;
    int r;

    if (pipe == GSN_PTP_EVENT)
        cancel_event(usb);
    r = endpoint ? libusb_clear_halt(usb->handle, endpoint) : 0;
    return r < 0 ? fail(usb, r, "clearing a stalled endpoint", err) : GSN_OK;
}

/* Class requests */

static int class_request(struct usb *usb, uint8_t request, uint8_t *bytes, uint16_t size)
{
    const uint8_t direction = request == DEVICE_STATUS ? LIBUSB_ENDPOINT_IN : LIBUSB_ENDPOINT_OUT;

    return libusb_control_transfer(
        usb->handle, LIBUSB_REQUEST_TYPE_CLASS | LIBUSB_RECIPIENT_INTERFACE | direction, request, 0,
        (uint16_t)usb->pipes.interface, bytes, size, CONTROL_MS);
}

static int usb_cancel(void *self, uint32_t transaction, struct gsn_error *err)
{
    struct usb *const usb = self;
    uint8_t bytes[6] = { CANCEL_CODE & 0xff,           CANCEL_CODE >> 8,
                         (uint8_t)transaction,         (uint8_t)(transaction >> 8),
                         (uint8_t)(transaction >> 16), (uint8_t)(transaction >> 24) };
    const int r = class_request(usb, CANCEL, bytes, sizeof bytes);

    return r < 0 ? fail(usb, r, "the request to cancel", err) : GSN_OK;
}

/* A device that does not even know the class request is reset on the bus. */
static int usb_reset(void *self, struct gsn_error *err)
{
    struct usb *const usb = self;
    int r = class_request(usb, DEVICE_RESET, NULL, 0);

    if (r < 0 && r != LIBUSB_ERROR_NO_DEVICE) {
        cancel_event(usb);
        r = libusb_reset_device(usb->handle);
        if (r == LIBUSB_ERROR_NOT_FOUND)
            r = LIBUSB_ERROR_NO_DEVICE;
    }
    usb->event_failures = 0;
    return r < 0 ? fail(usb, r, "the request to reset", err) : GSN_OK;
}

static int usb_status(void *self, uint16_t *ret_code, struct gsn_error *err)
{
    struct usb *const usb = self;
    uint8_t bytes[64];
    const int r = class_request(usb, DEVICE_STATUS, bytes, sizeof bytes);

    if (r < 0)
        return fail(usb, r, "asking for the status", err);
    if (r < 4)
        return gsn_fail(err, GSN_E_IO, "USB device %s: a status of %d bytes", usb->name, r);
    *ret_code = (uint16_t)(bytes[2] | bytes[3] << 8);
    return GSN_OK;
}

/* Opening and closing */

static void usb_close(void *self)
{
    struct usb *const usb = self;

    if (!usb)
        return;
    cancel_event(usb);
    libusb_free_transfer(usb->event);
    if (usb->claimed)
        (void)libusb_release_interface(usb->handle, usb->pipes.interface);
    if (usb->handle)
        libusb_close(usb->handle);
    if (usb->context)
        libusb_exit(usb->context);
    gsn_free(usb);
}

static const struct gsn_ptp_transport_ops usb_ops = {
    .send = usb_send,
    .receive = usb_receive,
    .clear_halt = usb_clear_halt,
    .cancel = usb_cancel,
    .reset = usb_reset,
    .status = usb_status,
    .wait = usb_wait,
    .close = usb_close,
};

/* Owned for as long as it is being made. */
static void close_half_made(struct usb **usb)
{
    usb_close(*usb);
}

static int claim(struct usb *usb, libusb_device *device, struct gsn_error *err)
{
    char holder[120];
    int r;

    (void)libusb_set_auto_detach_kernel_driver(usb->handle, 1);
    r = libusb_claim_interface(usb->handle, usb->pipes.interface);
    if (r == LIBUSB_ERROR_OTHER) { /* an emulated bus knows no drivers to detach */
        (void)libusb_set_auto_detach_kernel_driver(usb->handle, 0);
        r = libusb_claim_interface(usb->handle, usb->pipes.interface);
    }
    if (r == LIBUSB_ERROR_BUSY) {
        const int seen = gsn_usb_holder(libusb_get_bus_number(device),
                                        libusb_get_device_address(device), holder, sizeof holder);

        return gsn_fail(err, GSN_E_BUSY, "USB device %s is held by %s: end that first", usb->name,
                        seen
                            ? holder
                            : "another program (on a desktop often gvfsd-gphoto2; which one cannot "
                              "be seen from here)");
    }
    usb->claimed = r == 0;
    if (r == 0 && usb->pipes.alternate)
        r = libusb_set_interface_alt_setting(usb->handle, usb->pipes.interface,
                                             usb->pipes.alternate);
    return r < 0 ? fail(usb, r, "claiming it", err) : GSN_OK;
}

static int prepare_events(struct usb *usb, struct gsn_error *err)
{
    const struct gsn_usb_pipes *const pipes = &usb->pipes;
    int room = pipes->event_packet;

    if (!pipes->event || pipes->event_packet == 0)
        return GSN_OK;
    while (room < LEAST_EVENT) /* whole packets, or the last one would not fit */
        room += pipes->event_packet;
    if (room > EVENT_ROOM)
        return GSN_OK;
    usb->event = libusb_alloc_transfer(0);
    if (!usb->event)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a USB transfer");
    libusb_fill_interrupt_transfer(usb->event, usb->handle, pipes->event, usb->event_bytes, room,
                                   event_ended, usb, 0);
    return GSN_OK;
}

static int open_device(struct usb *usb, libusb_device *device, struct gsn_error *err)
{
    struct gsn_ptp_usb_device described;
    int r;

    gsn_usb_describe(device, &described);
    usb->transport.vendor = described.vendor;
    usb->transport.product = described.product;
    memcpy(usb->transport.serial, described.serial, sizeof usb->transport.serial);
    (void)snprintf(usb->name, sizeof usb->name, "%04x:%04x%s%s", described.vendor,
                   described.product, described.serial[0] ? " " : "", described.serial);
    if (!gsn_usb_find_pipes(device, &usb->pipes))
        return fail(usb, LIBUSB_ERROR_NO_DEVICE, "it was opened", err);
    usb->transport.packet_size = usb->pipes.in_packet;
    r = libusb_open(device, &usb->handle);
    if (r < 0)
        return fail(usb, r, "opening it", err);
    r = claim(usb, device, err);
    return r < 0 ? r : prepare_events(usb, err);
}

int gsn_ptp_usb_check(const char *rest, struct gsn_error *err)
{
    struct gsn_usb_address address;

    return gsn_usb_address_read(rest, &address, err);
}

int gsn_ptp_usb_open(const char *rest, struct gsn_ptp_transport **ret_transport,
                     struct gsn_error *err)
{
    __attribute__((cleanup(close_half_made))) struct usb *usb = NULL;
    struct gsn_ptp_usb_devices devices;
    struct gsn_usb_address address;
    libusb_device *device;
    size_t matches;
    int r = gsn_usb_address_read(rest, &address, err);

    if (r < 0)
        return r;
    usb = gsn_alloc_array(1, sizeof *usb);
    if (!usb)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a USB device");
    r = gsn_usb_start(&usb->context, err);
    if (r >= 0)
        r = gsn_usb_look(usb->context, &address, &devices, &matches, &device, err);
    if (r < 0)
        return r;
    if (!device)
        return gsn_usb_explain(rest, &address, matches, &devices, err);
    r = open_device(usb, device, err);
    libusb_unref_device(device);
    if (r < 0)
        return r;
    usb->transport.ops = &usb_ops;
    usb->transport.self = usb;
    *ret_transport = &gsn_steal(&usb)->transport;
    return GSN_OK;
}
