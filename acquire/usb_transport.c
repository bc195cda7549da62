/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pipes of a USB Still Image device (class 06/01/01) through libusb-1.0; the only file that
 * names it.
 *
 * Steps.
 * 1. An address (serial number, VVVV:PPPP, both, or "any") is held against all Still Image devices;
 *    exactly one must answer.
 * 2. The interface is claimed, a kernel driver asked to let go. Where another program has it, /proc
 *    says which.
 * 3. Bulk transfers carry containers; an interrupt transfer waits for the next event all the time.
 * 4. Class requests: Cancel, Device Reset (a bus reset where the device does not know it), Status.
 *
 * How it fails: unplugging is GSN_E_NOTFOUND wherever it is met; a pipe of events that fails three
 * times in a row is given up, for events are hints. On closing, the event's memory is libusb's
 * until it has said that the transfer ended. */
#include "acquire/usb_transport.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <libusb.h>
#include <poll.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/calendar.h"
#include "pipeline/core/error.h"
#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"

/* Addresses, and who holds a device. */

/* Four hexadecimal digits and nothing else up to the end of a part. */
static int read_id(const char *text, uint16_t *ret_id)
{
    for (int i = 0; i < 4; i++)
        if (!isxdigit((unsigned char)text[i]))
            return 0;
    *ret_id = (uint16_t)strtoul(text, NULL, 16);
    return text[4] == ':' || text[4] == '\0';
}

static int fail_address(const char *rest, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "\"%.100s\" names no USB device: give its serial number, VVVV:PPPP or "
                    "VVVV:PPPP:SERIAL with the hexadecimal numbers that lsusb prints, or any",
                    rest);
}

static int read_serial(const char *serial, const char *rest, struct gsn_usb_address *address,
                       struct gsn_error *err)
{
    const size_t length = strlen(serial);

    if (length == 0 || length >= sizeof address->serial)
        return fail_address(rest, err);
    for (size_t i = 0; i < length; i++)
        if (iscntrl((unsigned char)serial[i]))
            return fail_address(rest, err);
    memcpy(address->serial, serial, length + 1);
    return GSN_OK;
}

int gsn_usb_address_read(const char *rest, struct gsn_usb_address *ret_address,
                         struct gsn_error *err)
{
    struct gsn_usb_address address = { 0 };
    int r = GSN_OK;

    if (strcmp(rest, "any") == 0) {
        *ret_address = address;
        return GSN_OK;
    }
    if (!strchr(rest, ':')) {
        r = read_serial(rest, rest, &address, err);
    } else {
        if (!read_id(rest, &address.vendor) || rest[4] != ':' ||
            !read_id(rest + 5, &address.product))
            return fail_address(rest, err);
        address.has_ids = 1;
        if (rest[9] == ':')
            r = read_serial(rest + 10, rest, &address, err);
    }
    if (r >= 0)
        *ret_address = address;
    return r;
}

int gsn_usb_address_matches(const struct gsn_usb_address *address, uint16_t vendor,
                            uint16_t product, const char *serial)
{
    return (!address->has_ids || (address->vendor == vendor && address->product == product)) &&
           (!address->serial[0] || strcmp(address->serial, serial) == 0);
}

/* The first file open in /proc/PROCESS/fd whose path ends with end; 0 when there is none. */
static int find_open(const char *process, const char *end, char *ret_path, size_t size)
{
    char path[64], link[400];
    const size_t tail = strlen(end);
    struct dirent *entry;
    DIR *dir;
    int found = 0;

    (void)snprintf(path, sizeof path, "/proc/%.20s/fd", process);
    dir = opendir(path);
    while (dir && !found && (entry = readdir(dir))) {
        const ssize_t length = readlinkat(dirfd(dir), entry->d_name, link, sizeof link);

        found = length >= (ssize_t)tail && (size_t)length < size &&
                memcmp(link + (size_t)length - tail, end, tail) == 0;
        if (found) {
            memcpy(ret_path, link, (size_t)length);
            ret_path[length] = '\0';
        }
    }
    if (dir)
        (void)closedir(dir);
    return found;
}

/* Whether the process has this very file open. */
static int has_open(const char *process, const char *node)
{
    char path[400];

    return find_open(process, node, path, sizeof path) && strcmp(path, node) == 0;
}

static void describe_process(const char *process, char *ret_text, size_t size)
{
    char path[64], name[64] = "";
    ssize_t length = 0;
    int fd;

    (void)snprintf(path, sizeof path, "/proc/%.20s/comm", process);
    if (gsn_file_open(path, &fd, NULL) >= 0) {
        length = read(fd, name, sizeof name - 1);
        (void)close(fd);
    }
    name[length > 0 ? length : 0] = '\0';
    name[strcspn(name, "\n")] = '\0';
    (void)snprintf(ret_text, size, "%s (process %.20s)", name[0] ? name : "another program",
                   process);
}

int gsn_usb_holder(unsigned bus, unsigned device, char *ret_text, size_t size)
{
    char name[40], node[400], own[24];
    struct dirent *entry;
    DIR *proc;
    int found = 0;

    (void)snprintf(name, sizeof name, "/dev/bus/usb/%03u/%03u", bus, device);
    /* Who asks has it open as well; an emulated bus keeps the file elsewhere. */
    if (!find_open("self", name, node, sizeof node))
        (void)snprintf(node, sizeof node, "%s", name);
    (void)snprintf(own, sizeof own, "%ld", (long)getpid());
    proc = opendir("/proc");
    while (proc && !found && (entry = readdir(proc))) {
        if (!isdigit((unsigned char)entry->d_name[0]) || strcmp(entry->d_name, own) == 0)
            continue;
        found = has_open(entry->d_name, node);
        if (found)
            describe_process(entry->d_name, ret_text, size);
    }
    if (proc)
        (void)closedir(proc);
    return found;
}

/* Which devices there are. */

/* Where a Still Image device has its pipes. event 0: it has none. */
struct usb_pipes {
    int interface, alternate;
    uint8_t in, out, event;
    uint16_t in_packet, event_packet;
};

static int is_bulk(const struct libusb_endpoint_descriptor *endpoint, int in)
{
    return (endpoint->bmAttributes & 3) == LIBUSB_TRANSFER_TYPE_BULK &&
           !in == !(endpoint->bEndpointAddress & LIBUSB_ENDPOINT_IN);
}

static int find_pipes_of(const struct libusb_interface_descriptor *setting,
                         struct usb_pipes *ret_pipes)
{
    struct usb_pipes pipes = { .interface = setting->bInterfaceNumber,
                               .alternate = setting->bAlternateSetting };

    if (setting->bInterfaceClass != LIBUSB_CLASS_IMAGE || setting->bInterfaceSubClass != 1 ||
        setting->bInterfaceProtocol != 1)
        return 0;
    for (int i = 0; i < setting->bNumEndpoints; i++) {
        const struct libusb_endpoint_descriptor *const endpoint = &setting->endpoint[i];
        const uint16_t packet = endpoint->wMaxPacketSize & 0x7ff;

        if (is_bulk(endpoint, 1)) {
            pipes.in = endpoint->bEndpointAddress;
            pipes.in_packet = packet;
        } else if (is_bulk(endpoint, 0)) {
            pipes.out = endpoint->bEndpointAddress;
        } else if ((endpoint->bmAttributes & 3) == LIBUSB_TRANSFER_TYPE_INTERRUPT) {
            pipes.event = endpoint->bEndpointAddress;
            pipes.event_packet = packet;
        }
    }
    *ret_pipes = pipes;
    return pipes.in && pipes.out && pipes.in_packet >= 8;
}

/* 0: the device is none of the Still Image class, or lacks a pipe; then *ret_pipes may be changed.
 */
static int find_pipes(libusb_device *device, struct usb_pipes *ret_pipes)
{
    struct libusb_config_descriptor *config;
    int found = 0;

    if (libusb_get_active_config_descriptor(device, &config) < 0)
        return 0;
    for (int i = 0; i < config->bNumInterfaces && !found; i++)
        for (int k = 0; k < config->interface[i].num_altsetting && !found; k++)
            found = find_pipes_of(&config->interface[i].altsetting[k], ret_pipes);
    libusb_free_config_descriptor(config);
    return found;
}

/* Descriptors' texts end in sentences and rows: no control characters. */
static void read_text(libusb_device_handle *handle, uint8_t index, char *ret_text, size_t size)
{
    int length = 0;

    if (index)
        length = libusb_get_string_descriptor_ascii(handle, index, (unsigned char *)ret_text,
                                                    (int)size - 1);
    ret_text[length > 0 ? length : 0] = '\0';
    for (char *at = ret_text; *at; at++)
        if (*at < ' ' || *at > '~')
            *at = '?';
}

static void describe_device(libusb_device *device, struct gsn_ptp_usb_device *ret_described)
{
    struct gsn_ptp_usb_device described = { .bus = libusb_get_bus_number(device),
                                            .number = libusb_get_device_address(device) };
    struct libusb_device_descriptor descriptor = { 0 };
    libusb_device_handle *handle = NULL;
    char maker[60], product[60];

    (void)libusb_get_device_descriptor(device, &descriptor);
    described.vendor = descriptor.idVendor;
    described.product = descriptor.idProduct;
    described.refused = libusb_open(device, &handle) < 0;
    if (!described.refused) {
        read_text(handle, descriptor.iSerialNumber, described.serial, sizeof described.serial);
        read_text(handle, descriptor.iManufacturer, maker, sizeof maker);
        read_text(handle, descriptor.iProduct, product, sizeof product);
        (void)snprintf(described.name, sizeof described.name, "%s%s%s", maker,
                       maker[0] && product[0] ? " " : "", product);
        libusb_close(handle);
    }
    *ret_described = described;
}

/* Lists the Still Image devices; of the one that answers to address (NULL: none) ret_device is a
 * reference, NULL when several or none do. ret_matches and ret_device may be NULL. */
static int list_devices(libusb_context *context, const struct gsn_usb_address *address,
                        struct gsn_ptp_usb_devices *ret_devices, size_t *ret_matches,
                        libusb_device **ret_device, struct gsn_error *err)
{
    libusb_device **list, *match = NULL;
    const ssize_t count = libusb_get_device_list(context, &list);
    size_t matches = 0;
    struct usb_pipes pipes;

    if (count < 0)
        return gsn_fail(err, count == LIBUSB_ERROR_NO_MEM ? GSN_E_NOMEM : GSN_E_IO,
                        "the USB devices cannot be listed: %s", libusb_strerror((int)count));
    ret_devices->count = 0;
    for (ssize_t i = 0; i < count && ret_devices->count < GSN_PTP_USB_MOST; i++) {
        struct gsn_ptp_usb_device *const at = &ret_devices->at[ret_devices->count];

        if (!find_pipes(list[i], &pipes))
            continue;
        describe_device(list[i], at);
        ret_devices->count++;
        if (address && gsn_usb_address_matches(address, at->vendor, at->product, at->serial) &&
            matches++ == 0)
            match = list[i];
    }
    if (ret_device)
        *ret_device = matches == 1 ? libusb_ref_device(match) : NULL;
    if (ret_matches)
        *ret_matches = matches;
    libusb_free_device_list(list, 1);
    return GSN_OK;
}

/* "04a9:31c0 SN0001, 1209:0001 (may not be opened)" of those that answer to address; NULL: all. */
static void say_devices(const struct gsn_ptp_usb_devices *devices,
                        const struct gsn_usb_address *address, char *ret_text, size_t size)
{
    size_t used = 0;

    ret_text[0] = '\0';
    for (size_t i = 0; i < devices->count && used < size; i++) {
        const struct gsn_ptp_usb_device *const at = &devices->at[i];

        if (address && !gsn_usb_address_matches(address, at->vendor, at->product, at->serial))
            continue;
        used +=
            (size_t)snprintf(ret_text + used, size - used, "%s%04x:%04x%s%s%s", used ? ", " : "",
                             at->vendor, at->product, at->serial[0] ? ":" : "", at->serial,
                             at->refused ? " (may not be opened)" : "");
    }
}

static int any_refused(const struct gsn_ptp_usb_devices *devices)
{
    for (size_t i = 0; i < devices->count; i++)
        if (devices->at[i].refused)
            return 1;
    return 0;
}

/* Fails always: says why not exactly one of the devices answers to an address (rest, as given). */
static int explain_mismatch(const char *rest, const struct gsn_usb_address *address, size_t matches,
                            const struct gsn_ptp_usb_devices *devices, struct gsn_error *err)
{
    char text[240];

    say_devices(devices, matches > 1 ? address : NULL, text, sizeof text);
    if (matches > 1)
        return gsn_fail(err, GSN_E_INPUT,
                        "%zu scanners or cameras answer to \"%.60s\": %s; name one of them",
                        matches, rest, text);
    if (any_refused(devices))
        return gsn_fail(err, GSN_E_IO,
                        "no scanner or camera answers to \"%.60s\", but there is %s: see that the "
                        "udev rules are installed and this account is in the device's group",
                        rest, text);
    return gsn_fail(err, GSN_E_NOTFOUND,
                    "no scanner or camera (USB Still Image class) answers to \"%.60s\"%s%s; is it "
                    "switched on and set to PTP?",
                    rest, text[0] ? "; there is " : "", text);
}

/* Fails with GSN_E_IO where there is no USB; GSN_E_NOMEM. gives: ret_context, for libusb_exit(). */
static int start_libusb(libusb_context **ret_context, struct gsn_error *err)
{
    const int r = libusb_init(ret_context);

    if (r < 0)
        return gsn_fail(err, r == LIBUSB_ERROR_NO_MEM ? GSN_E_NOMEM : GSN_E_IO,
                        "USB is not available here: %s", libusb_strerror(r));
    return GSN_OK;
}

int gsn_ptp_usb_list(struct gsn_ptp_usb_devices *ret_devices, struct gsn_error *err)
{
    struct gsn_ptp_usb_devices devices;
    libusb_context *context;
    int r = start_libusb(&context, err);

    if (r < 0)
        return r;
    r = list_devices(context, NULL, &devices, NULL, NULL, err);
    libusb_exit(context);
    if (r >= 0)
        *ret_devices = devices;
    return r;
}

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
    struct usb_pipes pipes;
    char name[140]; /* "04a9:31c0 SN0001", for sentences */
    int claimed;
    /* An interrupt transfer waits for the next event all the time. */
    struct libusb_transfer *event;
    int event_pending, event_came;
    unsigned event_failures; /* in a row; after EVENT_FAILURES the device's events are given up */
    uint8_t event_bytes[EVENT_ROOM];
};

static int fail_usb(const struct usb *usb, int r, const char *doing, struct gsn_error *err)
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
        return fail_usb(usb, r, "waiting for an event", err);
    if (r == 0)
        usb->event_pending = 1;
    else
        usb->event_failures++;
    return GSN_OK;
}

/* Lets libusb see what happened, without waiting. */
static int handle_events(struct usb *usb, struct gsn_error *err)
{
    struct timeval now = { 0 };
    const int r = libusb_handle_events_timeout_completed(usb->context, &now, NULL);

    return r < 0 && r != LIBUSB_ERROR_INTERRUPTED ? fail_usb(usb, r, "waiting", err) : GSN_OK;
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
        return fail_usb(usb, LIBUSB_ERROR_NO_DEVICE, "waiting for an event", err);
    default:
        usb->event_failures++;
        return fail_usb(usb, LIBUSB_ERROR_IO, "waiting for an event", err);
    }
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
    const int64_t end = gsn_now_ms() + timeout_ms;

    for (int stopped = 0;;) {
        const int64_t left = timeout_ms < 0 ? -1 : end - gsn_now_ms();
        int r;

        r = expect_event(usb, err);
        if (r >= 0)
            r = handle_events(usb, err);
        if (r < 0)
            return r;
        if (usb->event_came && usb->event->status == LIBUSB_TRANSFER_NO_DEVICE)
            return fail_usb(usb, LIBUSB_ERROR_NO_DEVICE, "waiting for an event", err);
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
    return r < 0 ? fail_usb(usb, r, "sending a request", err) : GSN_PTP_DONE;
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
        return fail_usb(usb, r, "reading", err);
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
    return r < 0 ? fail_usb(usb, r, "clearing a stalled endpoint", err) : GSN_OK;
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

    return r < 0 ? fail_usb(usb, r, "the request to cancel", err) : GSN_OK;
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
    return r < 0 ? fail_usb(usb, r, "the request to reset", err) : GSN_OK;
}

static int usb_status(void *self, uint16_t *ret_code, struct gsn_error *err)
{
    struct usb *const usb = self;
    uint8_t bytes[64];
    const int r = class_request(usb, DEVICE_STATUS, bytes, sizeof bytes);

    if (r < 0)
        return fail_usb(usb, r, "asking for the status", err);
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

static int claim_interface(struct usb *usb, libusb_device *device, struct gsn_error *err)
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
    return r < 0 ? fail_usb(usb, r, "claiming it", err) : GSN_OK;
}

static int prepare_events(struct usb *usb, struct gsn_error *err)
{
    const struct usb_pipes *const pipes = &usb->pipes;
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

    describe_device(device, &described);
    usb->transport.vendor = described.vendor;
    usb->transport.product = described.product;
    memcpy(usb->transport.serial, described.serial, sizeof usb->transport.serial);
    (void)snprintf(usb->name, sizeof usb->name, "%04x:%04x%s%s", described.vendor,
                   described.product, described.serial[0] ? " " : "", described.serial);
    if (!find_pipes(device, &usb->pipes))
        return fail_usb(usb, LIBUSB_ERROR_NO_DEVICE, "it was opened", err);
    usb->transport.packet_size = usb->pipes.in_packet;
    r = libusb_open(device, &usb->handle);
    if (r < 0)
        return fail_usb(usb, r, "opening it", err);
    r = claim_interface(usb, device, err);
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
    r = start_libusb(&usb->context, err);
    if (r >= 0)
        r = list_devices(usb->context, &address, &devices, &matches, &device, err);
    if (r < 0)
        return r;
    if (!device)
        return explain_mismatch(rest, &address, matches, &devices, err);
    r = open_device(usb, device, err);
    libusb_unref_device(device);
    if (r < 0)
        return r;
    usb->transport.ops = &usb_ops;
    usb->transport.self = usb;
    *ret_transport = &gsn_steal(&usb)->transport;
    return GSN_OK;
}
