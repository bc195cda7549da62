/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/redir.h"

#include <errno.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#include <usbredirparser.h>

#include "tests/device/usb_standard.h"
#include "tests/device/wire.h"

enum { LARGEST = 1 << 20, CONTROL_ROOM = 4096, EVENT_ROOM = 64, ENDPOINTS = 32 };

/* A bulk request of the guest that was not answered yet. */
struct waiting {
    struct waiting *next;
    uint64_t id;
    struct usb_redir_bulk_packet_header header;
    uint8_t *out; /* what is to be sent; NULL for a read */
    size_t size;
};

struct redir {
    struct usbredirparser *parser;
    int socket;
    const struct usb_model *model;
    struct waiting *first;
    uint8_t interrupt; /* the endpoint that is listened to, or 0 */
    bool plugged, greeted;
    uint8_t buffer[LARGEST];
};

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static uint8_t status_of(long got)
{
    return got == USB_MODEL_STALL  ? usb_redir_stall
           : got == USB_MODEL_GONE ? usb_redir_ioerror
           : got < 0               ? usb_redir_babble
                                   : usb_redir_success;
}

/* Plugging */

static void describe_interface(struct usb_redir_interface_info_header *info, const uint8_t *d)
{
    const uint32_t at = info->interface_count;

    if (d[3] != 0 || at >= 32) /* another setting of one that is there */
        return;
    info->interface[at] = d[2];
    info->interface_class[at] = d[5];
    info->interface_subclass[at] = d[6];
    info->interface_protocol[at] = d[7];
    info->interface_count++;
}

static void describe_endpoint(struct usb_redir_ep_info_header *info, uint8_t interface,
                              const uint8_t *d)
{
    const unsigned at = (d[2] & 15u) | (d[2] & 0x80u) >> 3;

    info->type[at] = d[3] & 3;
    info->interval[at] = d[6];
    info->interface[at] = interface;
    info->max_packet_size[at] = wire_get16(d + 4);
}

static void send_connect(struct redir *redir)
{
    const uint8_t *const device = redir->model->device;
    struct usb_redir_device_connect_header connect = {
        .speed = usb_redir_speed_high,
        .device_class = device[4],
        .device_subclass = device[5],
        .device_protocol = device[6],
        .vendor_id = wire_get16(device + 8),
        .product_id = wire_get16(device + 10),
        .device_version_bcd = wire_get16(device + 12),
    };

    usbredirparser_send_device_connect(redir->parser, &connect);
}

void redir_plug(struct redir *redir)
{
    struct usb_redir_interface_info_header interfaces = { 0 };
    struct usb_redir_ep_info_header endpoints = { 0 };
    const struct usb_model *const model = redir->model;
    uint8_t interface = 0;

    if (redir->plugged || !redir->greeted)
        return;
    memset(endpoints.type, usb_redir_type_invalid, sizeof endpoints.type);
    endpoints.type[0] = endpoints.type[16] = usb_redir_type_control;
    endpoints.max_packet_size[0] = endpoints.max_packet_size[16] = 64;
    for (size_t at = 0; at < model->config_size; at += model->config[at]) {
        const uint8_t *const d = model->config + at;

        if (d[1] == 4) {
            interface = d[2];
            describe_interface(&interfaces, d);
        } else if (d[1] == 5) {
            describe_endpoint(&endpoints, interface, d);
        }
    }
    usbredirparser_send_interface_info(redir->parser, &interfaces);
    usbredirparser_send_ep_info(redir->parser, &endpoints);
    send_connect(redir);
    redir->plugged = true;
}

static void forget_waiting(struct redir *redir)
{
    while (redir->first) {
        struct waiting *const first = redir->first;

        redir->first = first->next;
        free(first->out);
        free(first);
    }
}

void redir_unplug(struct redir *redir)
{
    if (redir->plugged)
        usbredirparser_send_device_disconnect(redir->parser);
    redir->plugged = false;
    redir->interrupt = 0;
    forget_waiting(redir);
}

/* What the guest asks */

static void on_hello(void *self, struct usb_redir_hello_header *hello)
{
    struct redir *const redir = self;

    (void)hello;
    redir->greeted = true;
    redir_plug(redir);
}

static void on_control(void *self, uint64_t id, struct usb_redir_control_packet_header *header,
                       uint8_t *data, int size)
{
    struct redir *const redir = self;
    struct usb_redir_control_packet_header answer = *header;
    const bool reads = header->requesttype & 0x80;
    const uint8_t setup[8] = { header->requesttype, header->request, WIRE16(header->value),
                               WIRE16(header->index), WIRE16(header->length) };
    uint8_t in[CONTROL_ROOM];
    const size_t room = header->length < sizeof in ? header->length : sizeof in;
    const long got =
        usb_standard_control(redir->model, setup, data, (size_t)size, in, reads ? room : 0);

    answer.status = status_of(got);
    answer.length = got < 0 ? 0 : reads ? (uint16_t)got : header->length;
    usbredirparser_send_control_packet(redir->parser, id, &answer, reads && got > 0 ? in : NULL,
                                       reads && got > 0 ? (int)got : 0);
    usbredirparser_free_packet_data(redir->parser, data);
}

static void on_bulk(void *self, uint64_t id, struct usb_redir_bulk_packet_header *header,
                    uint8_t *data, int size)
{
    struct redir *const redir = self;
    struct waiting **last = &redir->first, *const waiting = calloc(1, sizeof *waiting);

    if (!waiting)
        abort();
    waiting->id = id;
    waiting->header = *header;
    waiting->size = header->length | (size_t)header->length_high << 16;
    if (!(header->endpoint & 0x80)) {
        waiting->size = (size_t)size;
        waiting->out = malloc(waiting->size + 1);
        if (!waiting->out)
            abort();
        if (size > 0)
            memcpy(waiting->out, data, waiting->size);
    }
    while (*last)
        last = &(*last)->next;
    *last = waiting;
    usbredirparser_free_packet_data(redir->parser, data);
}

static void answer_bulk(struct redir *redir, struct waiting **at, uint8_t status, size_t size,
                        bool with_data)
{
    struct waiting *const waiting = *at;

    *at = waiting->next;
    waiting->header.status = status;
    waiting->header.length = (uint16_t)size;
    waiting->header.length_high = (uint16_t)(size >> 16);
    usbredirparser_send_bulk_packet(redir->parser, waiting->id, &waiting->header,
                                    with_data ? redir->buffer : NULL, with_data ? (int)size : 0);
    free(waiting->out);
    free(waiting);
}

static void on_cancel(void *self, uint64_t id)
{
    struct redir *const redir = self;

    for (struct waiting **at = &redir->first; *at; at = &(*at)->next)
        if ((*at)->id == id) {
            answer_bulk(redir, at, usb_redir_cancelled, 0, false);
            return;
        }
}

static void on_reset(void *self)
{
    struct redir *const redir = self;

    forget_waiting(redir);
}

static void on_set_configuration(void *self, uint64_t id,
                                 struct usb_redir_set_configuration_header *header)
{
    struct redir *const redir = self;
    struct usb_redir_configuration_status_header status = { usb_redir_success,
                                                            header->configuration };

    usbredirparser_send_configuration_status(redir->parser, id, &status);
}

static void on_get_configuration(void *self, uint64_t id)
{
    struct redir *const redir = self;
    struct usb_redir_configuration_status_header status = { usb_redir_success, 1 };

    usbredirparser_send_configuration_status(redir->parser, id, &status);
}

static void on_set_setting(void *self, uint64_t id, struct usb_redir_set_alt_setting_header *header)
{
    struct redir *const redir = self;
    struct usb_redir_alt_setting_status_header status = { usb_redir_success, header->interface,
                                                          header->alt };

    usbredirparser_send_alt_setting_status(redir->parser, id, &status);
}

static void on_get_setting(void *self, uint64_t id, struct usb_redir_get_alt_setting_header *header)
{
    struct redir *const redir = self;
    struct usb_redir_alt_setting_status_header status = { usb_redir_success, header->interface, 0 };

    usbredirparser_send_alt_setting_status(redir->parser, id, &status);
}

static void tell_interrupt(struct redir *redir, uint64_t id, uint8_t endpoint)
{
    struct usb_redir_interrupt_receiving_status_header status = { usb_redir_success, endpoint };

    usbredirparser_send_interrupt_receiving_status(redir->parser, id, &status);
}

static void on_start_interrupt(void *self, uint64_t id,
                               struct usb_redir_start_interrupt_receiving_header *header)
{
    struct redir *const redir = self;

    redir->interrupt = header->endpoint;
    tell_interrupt(redir, id, header->endpoint);
}

static void on_stop_interrupt(void *self, uint64_t id,
                              struct usb_redir_stop_interrupt_receiving_header *header)
{
    struct redir *const redir = self;

    redir->interrupt = 0;
    tell_interrupt(redir, id, header->endpoint);
}

static void on_log(void *self, int level, const char *words)
{
    (void)self;
    if (level <= usbredirparser_warning)
        (void)fprintf(stderr, "usb-redir: %s\n", words);
}

static int on_read(void *self, uint8_t *data, int size)
{
    const struct redir *const redir = self;
    const ssize_t got = read(redir->socket, data, (size_t)size);

    return got > 0 ? (int)got : got < 0 && errno == EAGAIN ? 0 : -1;
}

static int on_write(void *self, uint8_t *data, int size)
{
    const struct redir *const redir = self;
    const ssize_t sent = write(redir->socket, data, (size_t)size);

    return sent >= 0 ? (int)sent : errno == EAGAIN ? 0 : -1;
}

/* What the model answers */

/* Whether this request could be answered. */
static bool try_bulk(struct redir *redir, struct waiting **at)
{
    const struct usb_model *const model = redir->model;
    struct waiting *const waiting = *at;
    const uint8_t endpoint = waiting->header.endpoint;
    long got;

    if (waiting->out)
        got = model->out(model->self, endpoint, waiting->out, waiting->size);
    else
        got = model->in(model->self, endpoint, redir->buffer,
                        waiting->size < LARGEST ? waiting->size : LARGEST);
    if (got == USB_MODEL_NAK)
        return false;
    if (got == USB_MODEL_GONE)
        redir_unplug(redir); /* and nothing waits any more */
    else
        answer_bulk(redir, at, status_of(got), got < 0 ? 0 : (size_t)got, !waiting->out && got > 0);
    return true;
}

static bool is_first_of_its_endpoint(const struct redir *redir, const struct waiting *waiting)
{
    const struct waiting *at = redir->first;

    while (at != waiting && at->header.endpoint != waiting->header.endpoint)
        at = at->next;
    return at == waiting;
}

static void answer_all(struct redir *redir)
{
    struct waiting **at = &redir->first;

    while (*at) {
        if (is_first_of_its_endpoint(redir, *at) && try_bulk(redir, at))
            at = &redir->first;
        else
            at = &(*at)->next;
    }
}

static void send_events(struct redir *redir)
{
    const struct usb_model *const model = redir->model;
    uint8_t event[EVENT_ROOM];

    while (redir->interrupt) {
        struct usb_redir_interrupt_packet_header header = { .endpoint = redir->interrupt };
        const long got = model->in(model->self, redir->interrupt, event, sizeof event);

        if (got < 0)
            return;
        header.length = (uint16_t)got;
        usbredirparser_send_interrupt_packet(redir->parser, 0, &header, event, (int)got);
    }
}

int redir_turn(struct redir *redir, int timeout_ms)
{
    struct usbredirparser *const parser = redir->parser;
    struct pollfd fd = { .fd = redir->socket, .events = POLLIN };

    if (usbredirparser_has_data_to_write(parser))
        fd.events |= POLLOUT;
    if (poll(&fd, 1, timeout_ms) < 0 && errno != EINTR)
        return -1;
    if ((fd.revents & (POLLIN | POLLHUP)) && usbredirparser_do_read(parser) < 0)
        return -1;
    if (redir->model->tick)
        redir->model->tick(redir->model->self, now_ms());
    if (redir->plugged) {
        answer_all(redir);
        send_events(redir);
    }
    return usbredirparser_has_data_to_write(parser) && usbredirparser_do_write(parser) < 0 ? -1 : 0;
}

static void set_functions(struct usbredirparser *parser)
{
    parser->log_func = on_log;
    parser->read_func = on_read;
    parser->write_func = on_write;
    parser->hello_func = on_hello;
    parser->reset_func = on_reset;
    parser->control_packet_func = on_control;
    parser->bulk_packet_func = on_bulk;
    parser->cancel_data_packet_func = on_cancel;
    parser->set_configuration_func = on_set_configuration;
    parser->get_configuration_func = on_get_configuration;
    parser->set_alt_setting_func = on_set_setting;
    parser->get_alt_setting_func = on_get_setting;
    parser->start_interrupt_receiving_func = on_start_interrupt;
    parser->stop_interrupt_receiving_func = on_stop_interrupt;
}

struct redir *redir_new(int socket, const struct usb_model *model)
{
    uint32_t can[USB_REDIR_CAPS_SIZE] = { 0 };
    struct redir *const redir = calloc(1, sizeof *redir);

    if (!redir)
        return NULL;
    redir->parser = usbredirparser_create();
    if (!redir->parser) {
        free(redir);
        return NULL;
    }
    redir->socket = socket;
    redir->model = model;
    redir->parser->priv = redir;
    set_functions(redir->parser);
    usbredirparser_caps_set_cap(can, usb_redir_cap_connect_device_version);
    usbredirparser_caps_set_cap(can, usb_redir_cap_ep_info_max_packet_size);
    usbredirparser_caps_set_cap(can, usb_redir_cap_64bits_ids);
    usbredirparser_caps_set_cap(can, usb_redir_cap_32bits_bulk_length);
    usbredirparser_init(redir->parser, "gieson-sim", can, USB_REDIR_CAPS_SIZE,
                        usbredirparser_fl_usb_host);
    return redir;
}

void redir_free(struct redir *redir)
{
    if (!redir)
        return;
    forget_waiting(redir);
    usbredirparser_destroy(redir->parser);
    (void)close(redir->socket);
    free(redir);
}
