/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-sim as qemu meets it: this test is the other end of usb-redir. */
#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>
#include <usbredirparser.h>

#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/device/wire.h"
#include "tests/storage/scratch.h"

enum { ROOM = 1 << 16, PATIENCE_MS = 20000, SIZE = 5000, WIDTH = 32, HEIGHT = 16 };

/* The guest's side, and what it heard last. */
struct guest {
    struct gsn_scratch scratch;
    int listening, socket;
    pid_t sim;
    struct usbredirparser *parser;
    unsigned connects, disconnects, answers, events;
    uint64_t id; /* of the last request */
    struct usb_redir_device_connect_header device;
    uint8_t status;
    uint8_t bytes[ROOM];
    size_t size;
    uint8_t event[64];
};

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void on_log(void *self, int level, const char *words)
{
    (void)self;
    if (level <= usbredirparser_warning)
        print_message("guest: %s\n", words);
}

static int on_read(void *self, uint8_t *data, int size)
{
    const struct guest *const guest = self;
    const ssize_t got = recv(guest->socket, data, (size_t)size, MSG_DONTWAIT);

    return got > 0 ? (int)got : got < 0 && errno == EAGAIN ? 0 : -1;
}

static int on_write(void *self, uint8_t *data, int size)
{
    const struct guest *const guest = self;

    return (int)send(guest->socket, data, (size_t)size, MSG_NOSIGNAL);
}

static void on_connect(void *self, struct usb_redir_device_connect_header *device)
{
    struct guest *const guest = self;

    guest->device = *device;
    guest->connects++;
}

static void on_disconnect(void *self)
{
    ((struct guest *)self)->disconnects++;
}

static void on_interfaces(void *self, struct usb_redir_interface_info_header *info)
{
    (void)self;
    CHECK(info->interface_count >= 1);
}

static void on_endpoints(void *self, struct usb_redir_ep_info_header *info)
{
    (void)self;
    CHECK(info->type[17] == usb_redir_type_bulk && info->max_packet_size[17] == 512);
}

static void keep(struct guest *guest, uint64_t id, uint8_t status, uint8_t *data, int size)
{
    CHECK(id == guest->id && (size_t)size <= ROOM);
    if (size > 0)
        memcpy(guest->bytes, data, (size_t)size);
    guest->size = (size_t)size;
    guest->status = status;
    guest->answers++;
    usbredirparser_free_packet_data(guest->parser, data);
}

static void on_control(void *self, uint64_t id, struct usb_redir_control_packet_header *header,
                       uint8_t *data, int size)
{
    keep(self, id, header->status, data, size);
}

static void on_bulk(void *self, uint64_t id, struct usb_redir_bulk_packet_header *header,
                    uint8_t *data, int size)
{
    keep(self, id, header->status, data, size);
}

static void on_interrupt_status(void *self, uint64_t id,
                                struct usb_redir_interrupt_receiving_status_header *header)
{
    keep(self, id, header->status, NULL, 0);
}

static void on_interrupt(void *self, uint64_t id, struct usb_redir_interrupt_packet_header *header,
                         uint8_t *data, int size)
{
    struct guest *const guest = self;

    (void)id;
    CHECK(header->endpoint == 0x83 && size > 0 && (size_t)size <= sizeof guest->event);
    memcpy(guest->event, data, (size_t)size);
    guest->events++;
    usbredirparser_free_packet_data(guest->parser, data);
}

/* Until a counter has reached so much; fails when that takes too long. */
static void wait_for(struct guest *guest, const unsigned *counter, unsigned count)
{
    const int64_t end = now_ms() + PATIENCE_MS;

    while (*counter < count && now_ms() < end) {
        struct pollfd fd = { .fd = guest->socket, .events = POLLIN };

        while (usbredirparser_has_data_to_write(guest->parser))
            CHECK(usbredirparser_do_write(guest->parser) == 0);
        (void)poll(&fd, 1, 100);
        if (fd.revents && usbredirparser_do_read(guest->parser) < 0)
            break;
    }
    CHECK(*counter >= count);
}

static void start_parser(struct guest *guest)
{
    uint32_t can[USB_REDIR_CAPS_SIZE] = { 0 };
    struct usbredirparser *const parser = usbredirparser_create();

    guest->parser = parser;
    parser->priv = guest;
    parser->log_func = on_log;
    parser->read_func = on_read;
    parser->write_func = on_write;
    parser->device_connect_func = on_connect;
    parser->device_disconnect_func = on_disconnect;
    parser->interface_info_func = on_interfaces;
    parser->ep_info_func = on_endpoints;
    parser->control_packet_func = on_control;
    parser->bulk_packet_func = on_bulk;
    parser->interrupt_receiving_status_func = on_interrupt_status;
    parser->interrupt_packet_func = on_interrupt;
    usbredirparser_caps_set_cap(can, usb_redir_cap_connect_device_version);
    usbredirparser_caps_set_cap(can, usb_redir_cap_ep_info_max_packet_size);
    usbredirparser_caps_set_cap(can, usb_redir_cap_64bits_ids);
    usbredirparser_caps_set_cap(can, usb_redir_cap_32bits_bulk_length);
    usbredirparser_init(parser, "test", can, USB_REDIR_CAPS_SIZE, 0);
}

static pid_t spawn(const char *const *arguments)
{
    const pid_t child = fork();

    if (child == 0) {
        (void)execv(GSN_SIM, (char *const *)arguments);
        _exit(127);
    }
    return child;
}

/* Listens as qemu does, starts the program (its first argument is set here), and is greeted. */
static void start(struct guest *guest, const char **arguments)
{
    struct sockaddr_un address = { .sun_family = AF_UNIX };

    (void)snprintf(address.sun_path, sizeof address.sun_path, "%.90s/usb", guest->scratch.dir);
    guest->listening = socket(AF_UNIX, SOCK_STREAM, 0);
    CHECK(bind(guest->listening, (struct sockaddr *)&address, sizeof address) == 0);
    CHECK(listen(guest->listening, 1) == 0);
    arguments[0] = GSN_SIM;
    arguments[1] = address.sun_path;
    guest->sim = spawn(arguments);
    guest->socket = accept(guest->listening, NULL, NULL);
    CHECK(guest->socket >= 0);
    start_parser(guest);
    wait_for(guest, &guest->connects, 1);
}

static void finish(struct guest *guest)
{
    int status = -1;

    CHECK(kill(guest->sim, SIGTERM) == 0);
    wait_for(guest, &guest->disconnects, guest->connects);
    CHECK(waitpid(guest->sim, &status, 0) == guest->sim);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    usbredirparser_destroy(guest->parser);
    (void)close(guest->socket);
    (void)close(guest->listening);
    gsn_scratch_remove(&guest->scratch);
}

static void control(struct guest *guest, uint8_t type, uint8_t request, uint16_t value,
                    uint16_t index, const uint8_t *bytes, uint16_t size)
{
    struct usb_redir_control_packet_header header = { .endpoint = type & 0x80,
                                                      .request = request,
                                                      .requesttype = type,
                                                      .value = value,
                                                      .index = index,
                                                      .length = size };

    usbredirparser_send_control_packet(guest->parser, ++guest->id, &header, (uint8_t *)bytes,
                                       bytes ? size : 0);
    wait_for(guest, &guest->answers, guest->answers + 1);
}

static void send_bulk(struct guest *guest, uint8_t *bytes, uint16_t size)
{
    struct usb_redir_bulk_packet_header header = { .endpoint = 0x02, .length = size };

    usbredirparser_send_bulk_packet(guest->parser, ++guest->id, &header, bytes, size);
    wait_for(guest, &guest->answers, guest->answers + 1);
    CHECK(guest->status == usb_redir_success);
}

static void receive_bulk(struct guest *guest, uint16_t size)
{
    struct usb_redir_bulk_packet_header header = { .endpoint = 0x81, .length = size };

    usbredirparser_send_bulk_packet(guest->parser, ++guest->id, &header, NULL, 0);
    wait_for(guest, &guest->answers, guest->answers + 1);
    CHECK(guest->status == usb_redir_success);
}

static void ask(struct guest *guest, uint16_t operation, uint32_t parameter)
{
    uint8_t command[16] = { 16, 0, 0, 0, 1, 0, WIRE16(operation), 1, 0, 0, 0, WIRE32(parameter) };

    send_bulk(guest, command, sizeof command);
}

static const char *write_scan(struct guest *guest, const char *name, uint8_t *bytes, size_t size)
{
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < size; i++)
        bytes[i] = (uint8_t)(i * 7 + (uint8_t)name[0]);
    CHECK_OK(gsn_file_write(gsn_scratch_path(&guest->scratch, name), bytes, size, &err), err);
    return gsn_scratch_path(&guest->scratch, name);
}

TEST(a_scanner_is_there_finishes_scans_and_is_plugged_again)
{
    static struct guest guest;
    struct usb_redir_start_interrupt_receiving_header listen_to = { .endpoint = 0x83 };
    uint8_t first[SIZE], second[SIZE];

    guest = (struct guest){ .scratch = gsn_scratch_new() };
    const char *arguments[] = { NULL,
                                NULL,
                                "ptp",
                                "--fault",
                                "split_header=1",
                                write_scan(&guest, "a.tif", first, SIZE),
                                write_scan(&guest, "b.tif", second, SIZE),
                                NULL };

    start(&guest, arguments);
    CHECK(guest.device.vendor_id == 0x1209 && guest.device.product_id == 1);
    control(&guest, 0x80, 6, 0x0100, 0, NULL, 18);
    CHECK(guest.size == 18 && guest.bytes[0] == 18);
    control(&guest, 0x80, 6, 0x0303, 0, NULL, 255);
    CHECK(guest.size == 14 && guest.bytes[2] == 'S' && guest.bytes[12] == '1');
    ask(&guest, 0x1002, 1);
    receive_bulk(&guest, 512);
    CHECK(wire_get16(guest.bytes + 6) == 0x2001);
    ask(&guest, 0x1009, 1);
    receive_bulk(&guest, 512);
    CHECK(guest.size == 12); /* the header by itself: the fault was taken */
    receive_bulk(&guest, 16384);
    CHECK(guest.size == SIZE && memcmp(guest.bytes, first, SIZE) == 0);
    receive_bulk(&guest, 512);

    usbredirparser_send_start_interrupt_receiving(guest.parser, ++guest.id, &listen_to);
    wait_for(&guest, &guest.answers, guest.answers + 1);
    CHECK(kill(guest.sim, SIGUSR1) == 0);
    wait_for(&guest, &guest.events, 1);
    CHECK(wire_get16(guest.event + 6) == 0x4002 && wire_get32(guest.event + 12) == 2);

    CHECK(kill(guest.sim, SIGUSR2) == 0);
    wait_for(&guest, &guest.disconnects, 1);
    wait_for(&guest, &guest.connects, 2);
    ask(&guest, 0x1002, 1);
    receive_bulk(&guest, 512);
    CHECK(wire_get16(guest.bytes + 6) == 0x2001);
    finish(&guest);
}

TEST(a_camera_plays_its_frames)
{
    static struct guest guest;
    static const uint8_t commit[34] = { 0, 0, 1, 1 };
    uint8_t frame[2 * WIDTH * HEIGHT];

    guest = (struct guest){ .scratch = gsn_scratch_new() };
    const char *arguments[] = { NULL, NULL, "uvc",
                                "32", "16", write_scan(&guest, "frames", frame, sizeof frame),
                                NULL };

    start(&guest, arguments);
    CHECK(guest.device.product_id == 2 && guest.device.device_class == 0xef);
    control(&guest, 0x21, 1, 0x0200, 1, commit, sizeof commit);
    CHECK(guest.status == usb_redir_success);
    receive_bulk(&guest, 16384);
    CHECK(guest.size == sizeof frame + 2 && memcmp(guest.bytes + 2, frame, sizeof frame) == 0);
    finish(&guest);
}

static int exit_code_of(const char *const *arguments)
{
    const pid_t child = spawn(arguments);
    int status = -1;

    CHECK(waitpid(child, &status, 0) == child && WIFEXITED(status));
    return WEXITSTATUS(status);
}

TEST(what_it_cannot_play_is_refused)
{
    const char *const nothing[] = { GSN_SIM, "/nowhere", "ptp", NULL };
    const char *const other[] = { GSN_SIM, "/nowhere", "scsi", "file", NULL };
    const char *const fault[] = { GSN_SIM, "/nowhere", "ptp", "--fault", "fire=1", GSN_SIM, NULL };
    const char *const size[] = { GSN_SIM, "/nowhere", "uvc", "0", "1", GSN_SIM, NULL };
    const char *const missing[] = { GSN_SIM, "/nowhere", "ptp", "/nowhere/a.tif", NULL };
    const char *const socket_[] = { GSN_SIM, "/nowhere", "ptp", GSN_SIM, NULL };

    CHECK(exit_code_of(nothing) == 64 && exit_code_of(other) == 64);
    CHECK(exit_code_of(fault) == 64 && exit_code_of(size) == 64);
    CHECK(exit_code_of(missing) == 66);
    CHECK(exit_code_of(socket_) == 69);
}
