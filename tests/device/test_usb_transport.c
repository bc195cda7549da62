/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The libusb transport against models of devices behind usbfs. */
#include "acquire/usb_transport.h"

#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "acquire/ptp_transport.h"
#include "tests/check.h"
#include "tests/device/ptp_model.h"
#include "tests/device/umock.h"
#include "tests/device/wire.h"

enum { NUMBER = 7, MIB = 1 << 20, SOON_MS = 5000 };

/* One scanner on the bus, and what the tests ask of it. */
struct bench {
    struct umock *umock;
    struct ptp_model *model;
    struct gsn_ptp_transport *usb;
    uint32_t transaction;
};

static struct bench set_up(const struct ptp_faults *faults)
{
    struct bench bench = { .umock = umock_new(), .model = ptp_model_new("SN0001", faults) };

    umock_plug(bench.umock, ptp_model_usb(bench.model), NUMBER);
    return bench;
}

static void close_usb(struct bench *bench)
{
    if (bench->usb)
        bench->usb->ops->close(bench->usb->self);
    bench->usb = NULL;
}

static void tear_down(struct bench *bench)
{
    close_usb(bench);
    umock_free(bench->umock);
    ptp_model_free(bench->model);
}

static void open_usb(struct bench *bench)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_ptp_usb_open("SN0001", &bench->usb, &err), err);
}

static int ask(struct bench *bench, uint16_t operation, uint32_t a, struct gsn_error *err)
{
    uint8_t command[16];

    wire_put32(command, sizeof command);
    wire_put16(command + 4, 1);
    wire_put16(command + 6, operation);
    wire_put32(command + 8, ++bench->transaction);
    wire_put32(command + 12, a);
    return bench->usb->ops->send(bench->usb->self, command, sizeof command, SOON_MS, err);
}

static int receive(struct bench *bench, void *buffer, size_t size, size_t *ret_got,
                   struct gsn_error *err)
{
    return bench->usb->ops->receive(bench->usb->self, GSN_PTP_IN, buffer, size, SOON_MS, ret_got,
                                    err);
}

static void expect(struct bench *bench, uint16_t code)
{
    struct gsn_error err = { 0 };
    uint8_t buffer[512];
    size_t got = 0;

    CHECK_OK(receive(bench, buffer, sizeof buffer, &got, &err), err);
    CHECK(got >= 12 && wire_get16(buffer + 4) == 3 && wire_get16(buffer + 6) == code);
}

static void open_session(struct bench *bench)
{
    struct gsn_error err = { 0 };

    CHECK_OK(ask(bench, 0x1002, 1, &err), err);
    expect(bench, 0x2001);
}

static uint8_t *picture(size_t size)
{
    uint8_t *const bytes = malloc(size);

    for (size_t i = 0; i < size; i++)
        bytes[i] = (uint8_t)(i * 7 + i / 251);
    return bytes;
}

static uint32_t add(struct bench *bench, const uint8_t *bytes, size_t size, int announce)
{
    const struct ptp_object object = {
        .name = "a.tif", .format = PTP_TIFF, .size = size, .bytes = bytes
    };
    uint32_t handle;

    umock_lock(bench->umock);
    handle = ptp_model_add(bench->model, &object, announce);
    umock_unlock(bench->umock);
    return handle;
}

TEST(an_address_is_a_serial_or_ids_or_both_or_any)
{
    struct gsn_usb_address a;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_usb_address_read("04a9:31c0:X:1", &a, &err), err);
    CHECK(gsn_usb_address_matches(&a, 0x04a9, 0x31c0, "X:1"));
    CHECK(!gsn_usb_address_matches(&a, 0x04a9, 0x31c0, "X"));
    CHECK_OK(gsn_usb_address_read("04A9:31c0", &a, &err), err);
    CHECK(gsn_usb_address_matches(&a, 0x04a9, 0x31c0, "") &&
          !gsn_usb_address_matches(&a, 0x04a9, 0x31c1, ""));
    CHECK_OK(gsn_usb_address_read("SN 1", &a, &err), err);
    CHECK(gsn_usb_address_matches(&a, 1, 2, "SN 1") && !gsn_usb_address_matches(&a, 1, 2, ""));
    CHECK_OK(gsn_usb_address_read("any", &a, &err), err);
    CHECK(gsn_usb_address_matches(&a, 1, 2, "") && gsn_usb_address_matches(&a, 1, 2, "any"));
}

TEST(what_names_no_device_is_refused)
{
    static const char *const wrong[] = { "",           "04a9:",    "04a9:31c",
                                         "04a9:31c00", "4a9:31c0", "04a9:31c0:",
                                         "04a9;31c0:", "SN\n1",    "04a9:31g0" };
    struct gsn_usb_address a = { .vendor = 77 };
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        err.text[0] = '\0';
        CHECK(gsn_usb_address_read(wrong[i], &a, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "VVVV:PPPP") && a.vendor == 77);
        CHECK(gsn_ptp_usb_check(wrong[i], &err) == GSN_E_INPUT);
    }
}

TEST(a_device_is_found_by_serial_by_ids_and_by_any)
{
    static const char *const names[] = { "SN0001", "1209:0001", "1209:0001:SN0001", "any" };
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < 4; i++) {
        CHECK_OK(gsn_ptp_usb_open(names[i], &bench.usb, &err), err);
        CHECK(bench.usb->vendor == 0x1209 && bench.usb->product == 1);
        CHECK(strcmp(bench.usb->serial, "SN0001") == 0 && bench.usb->packet_size == 512);
        close_usb(&bench);
    }
    CHECK(gsn_ptp_usb_open("SN0002", &bench.usb, &err) == GSN_E_NOTFOUND && !bench.usb);
    CHECK(strstr(err.text, "SN0002") && strstr(err.text, "1209:0001:SN0001"));
    tear_down(&bench);
}

TEST(a_device_without_a_serial_number_is_found_by_its_ids)
{
    struct umock *const umock = umock_new();
    struct ptp_model *const model = ptp_model_new("", NULL);
    struct gsn_ptp_transport *usb = NULL;
    struct gsn_error err = { 0 };

    umock_plug(umock, ptp_model_usb(model), NUMBER);
    CHECK_OK(gsn_ptp_usb_open("1209:0001", &usb, &err), err);
    CHECK(usb->serial[0] == '\0');
    umock_unplug(umock, NUMBER);
    CHECK(usb->ops->wait(usb->self, SOON_MS, -1, &err) == GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "1209:0001: it was unplugged"));
    usb->ops->close(usb->self);
    umock_free(umock);
    ptp_model_free(model);
}

TEST(of_two_any_is_refused_and_both_are_listed)
{
    struct bench bench = set_up(NULL);
    struct ptp_model *const second = ptp_model_new("SN0002", NULL);
    struct gsn_ptp_usb_devices devices = { 0 };
    struct gsn_error err = { 0 };

    umock_plug(bench.umock, ptp_model_usb(second), 8);
    CHECK(gsn_ptp_usb_open("any", &bench.usb, &err) == GSN_E_INPUT && !bench.usb);
    CHECK(strstr(err.text, "1209:0001:SN0001") && strstr(err.text, "1209:0001:SN0002"));
    CHECK_OK(gsn_ptp_usb_list(&devices, &err), err);
    CHECK(devices.count == 2 && devices.at[0].bus == 1 && !devices.at[0].refused);
    CHECK(strcmp(devices.at[0].name, "gieson Slide Scanner") == 0);
    CHECK_OK(gsn_ptp_usb_open("SN0002", &bench.usb, &err), err);
    CHECK(strcmp(bench.usb->serial, "SN0002") == 0);
    tear_down(&bench);
    ptp_model_free(second);
}

TEST(eight_mebibytes_come_byte_equal)
{
    const size_t size = 8 * MIB;
    struct bench bench = set_up(NULL);
    uint8_t *const bytes = picture(size), *const copy = malloc(size + 12);
    const uint32_t handle = add(&bench, bytes, size, 0);
    struct gsn_error err = { 0 };
    size_t done = 0;

    open_usb(&bench);
    open_session(&bench);
    CHECK_OK(ask(&bench, 0x1009, handle, &err), err);
    for (size_t got = 1; done < size + 12 && got > 0; done += got) {
        uint8_t *const at = malloc(MIB);

        CHECK_OK(receive(&bench, at, MIB, &got, &err), err);
        CHECK(done + got <= size + 12);
        memcpy(copy + done, at, got);
        free(at);
    }
    CHECK(done == size + 12 && memcmp(copy + 12, bytes, size) == 0);
    expect(&bench, 0x2001);
    free(bytes);
    free(copy);
    tear_down(&bench);
}

TEST(an_object_of_exactly_one_packet_ends_with_an_empty_transfer)
{
    struct bench bench = set_up(NULL);
    uint8_t *const bytes = picture(500), buffer[512];
    const uint32_t handle = add(&bench, bytes, 500, 0);
    struct gsn_error err = { 0 };
    size_t got = 0;

    open_usb(&bench);
    open_session(&bench);
    CHECK_OK(ask(&bench, 0x1009, handle, &err), err);
    CHECK_OK(receive(&bench, buffer, sizeof buffer, &got, &err), err);
    CHECK(got == 512 && memcmp(buffer + 12, bytes, 500) == 0);
    CHECK(receive(&bench, buffer, sizeof buffer, &got, &err) == GSN_PTP_DONE && got == 0);
    expect(&bench, 0x2001);
    free(bytes);
    tear_down(&bench);
}

TEST(silence_is_a_timeout_and_a_stall_is_cleared)
{
    struct bench bench = set_up(&(struct ptp_faults){ .silent_at = 2, .stall_at = 2 });
    struct gsn_error err = { 0 };
    uint8_t buffer[512];
    uint16_t code = 0;
    size_t got = 1;

    open_usb(&bench);
    open_session(&bench);
    CHECK_OK(ask(&bench, 0x1004, 0, &err), err);
    CHECK(bench.usb->ops->receive(bench.usb->self, GSN_PTP_IN, buffer, 512, 30, &got, &err) ==
          GSN_PTP_TIMEOUT);
    CHECK(got == 0);
    CHECK_OK(bench.usb->ops->cancel(bench.usb->self, 2, &err), err);
    CHECK_OK(bench.usb->ops->status(bench.usb->self, &code, &err), err);
    CHECK(code == 0x2019);
    CHECK_OK(ask(&bench, 0x1003, 0, &err), err);
    CHECK(receive(&bench, buffer, 512, &got, &err) == GSN_PTP_STALLED);
    CHECK_OK(bench.usb->ops->clear_halt(bench.usb->self, GSN_PTP_IN, &err), err);
    expect(&bench, 0x2001);
    CHECK_OK(bench.usb->ops->reset(bench.usb->self, &err), err);
    tear_down(&bench);
}

static void *add_later(void *context)
{
    struct bench *const bench = context;

    (void)usleep(50000);
    (void)add(bench, (const uint8_t *)"x", 1, 1);
    return NULL;
}

TEST(an_event_wakes_who_waits)
{
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };
    uint8_t event[64];
    pthread_t thread;
    size_t got = 0;

    open_usb(&bench);
    open_session(&bench);
    CHECK(bench.usb->ops->receive(bench.usb->self, GSN_PTP_EVENT, event, 64, 0, &got, &err) ==
          GSN_PTP_TIMEOUT);
    CHECK(pthread_create(&thread, NULL, add_later, &bench) == 0);
    CHECK_OK(bench.usb->ops->wait(bench.usb->self, 60000, -1, &err), err);
    CHECK(bench.usb->ops->receive(bench.usb->self, GSN_PTP_EVENT, event, 64, 0, &got, &err) ==
          GSN_PTP_DONE);
    CHECK(got == 16 && wire_get16(event + 6) == 0x4002 && wire_get32(event + 12) == 1);
    (void)pthread_join(thread, NULL);
    tear_down(&bench);
}

TEST(who_waits_stops_when_told_to)
{
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };
    int pipes[2];

    open_usb(&bench);
    CHECK(pipe(pipes) == 0 && write(pipes[1], "x", 1) == 1);
    CHECK_OK(bench.usb->ops->wait(bench.usb->self, 600000, pipes[0], &err), err);
    CHECK_OK(bench.usb->ops->wait(bench.usb->self, 20, -1, &err), err);
    (void)close(pipes[0]);
    (void)close(pipes[1]);
    tear_down(&bench);
}

TEST(unplugged_in_mid_object_is_not_found_and_replugged_it_goes_on)
{
    struct bench bench =
        set_up(&(struct ptp_faults){ .unplug_at_byte = 3 * MIB, .session_stays_open = true });
    uint8_t *const bytes = picture(8 * MIB), *const copy = malloc(MIB);
    const uint32_t handle = add(&bench, bytes, 8 * MIB, 0);
    struct gsn_error err = { 0 };
    size_t got = 0;
    int r = 0;

    open_usb(&bench);
    open_session(&bench);
    CHECK_OK(ask(&bench, 0x1009, handle, &err), err);
    for (int i = 0; i < 8 && r >= 0; i++)
        r = receive(&bench, copy, MIB, &got, &err);
    CHECK(r == GSN_E_NOTFOUND && strstr(err.text, "unplugged"));
    umock_unplug(bench.umock, NUMBER);
    CHECK(ask(&bench, 0x1004, 0, &err) < 0);
    close_usb(&bench);
    CHECK(gsn_ptp_usb_open("SN0001", &bench.usb, &err) == GSN_E_NOTFOUND);
    ptp_model_replug(bench.model);
    umock_plug(bench.umock, ptp_model_usb(bench.model), NUMBER + 1);
    open_usb(&bench);
    CHECK_OK(ask(&bench, 0x1002, 1, &err), err);
    expect(&bench, 0x201e); /* and its session is still open */
    free(bytes);
    free(copy);
    tear_down(&bench);
}

static void *unplug_later(void *context)
{
    (void)usleep(50000);
    umock_unplug(((struct bench *)context)->umock, NUMBER);
    return NULL;
}

TEST(unplugged_while_waiting_is_not_found)
{
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };
    pthread_t thread;

    open_usb(&bench);
    open_session(&bench);
    CHECK(pthread_create(&thread, NULL, unplug_later, &bench) == 0);
    CHECK(bench.usb->ops->wait(bench.usb->self, 60000, -1, &err) == GSN_E_NOTFOUND);
    (void)pthread_join(thread, NULL);
    CHECK(bench.usb->ops->wait(bench.usb->self, 60000, -1, &err) == GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "1209:0001 SN0001") && strstr(err.text, "unplugged"));
    tear_down(&bench);
}

/* However late it is asked. */
TEST(unplugged_before_waiting_is_not_found)
{
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };

    open_usb(&bench);
    open_session(&bench);
    CHECK_OK(bench.usb->ops->wait(bench.usb->self, 20, -1, &err), err);
    umock_unplug(bench.umock, NUMBER);
    CHECK(bench.usb->ops->wait(bench.usb->self, SOON_MS, -1, &err) == GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "unplugged"));
    tear_down(&bench);
}

/* Another process has the node open while ours tries to claim it. */
TEST(who_holds_the_device_is_said)
{
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };
    char node[200], expected[40];
    int ready[2], done[2];
    char byte;
    pid_t child;

    (void)snprintf(node, sizeof node, "%s/dev/bus/usb/001/%03d", umock_root(bench.umock), NUMBER);
    CHECK(pipe(ready) == 0 && pipe(done) == 0);
    child = fork();
    if (child == 0) {
        (void)close(done[1]);
        if (open(node, O_RDWR) >= 0 && write(ready[1], "x", 1) == 1)
            (void)!read(done[0], &byte, 1); /* until the parent has gone */
        _exit(0);
    }
    CHECK(read(ready[0], &byte, 1) == 1);
    umock_claim(bench.umock, NUMBER, 1);
    CHECK(gsn_ptp_usb_open("SN0001", &bench.usb, &err) == GSN_E_BUSY && !bench.usb);
    (void)snprintf(expected, sizeof expected, "(process %d)", (int)child);
    CHECK(strstr(err.text, "test_device_usb") && strstr(err.text, expected));
    (void)close(done[1]);
    CHECK(waitpid(child, NULL, 0) == child);
    CHECK(gsn_ptp_usb_open("SN0001", &bench.usb, &err) == GSN_E_BUSY);
    CHECK(strstr(err.text, "another program"));
    umock_claim(bench.umock, NUMBER, 0);
    open_usb(&bench);
    tear_down(&bench);
}

static int open_recorded_once(struct gsn_error *err)
{
    struct gsn_ptp_transport *usb = NULL;
    int r = gsn_ptp_usb_open("SN0001", &usb, err);

    if (r >= 0)
        r = gsn_ptp_record(usb, "/dev/null", &usb, err);
    if (r >= 0)
        usb->ops->close(usb->self);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(open_recorded_once(&err), err);
    tear_down(&bench);
}
