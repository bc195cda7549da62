/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A ptp: source as the intake meets it, through libusb: the device comes, sends its scans, goes in
 * the middle of one, and comes again. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "acquire/source.h"
#include "tests/check.h"
#include "tests/device/ptp_model.h"
#include "tests/device/pull.h"
#include "tests/device/umock.h"

enum { NUMBER = 7, MIB = 1 << 20, LONG = 8 * MIB, EVENT_MS = 30000 };

struct bench {
    struct umock *umock;
    struct ptp_model *model;
    struct gsn_source *source;
    uint8_t *bytes;
    struct pull pull;
};

static struct bench set_up(const struct ptp_faults *faults)
{
    struct bench bench = { .umock = umock_new(), .model = ptp_model_new("SN0001", faults) };

    bench.bytes = malloc(LONG);
    for (size_t i = 0; i < LONG; i++)
        bench.bytes[i] = (uint8_t)(i * 17 + i / 509);
    umock_plug(bench.umock, ptp_model_usb(bench.model), NUMBER);
    return bench;
}

static void open_source(struct bench *bench)
{
    static const struct gsn_source_options options = { .settle_ms = 500 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_source_open("ptp:SN0001", &options, &bench->source, &err), err);
}

static void tear_down(struct bench *bench)
{
    gsn_source_free(bench->source);
    umock_free(bench->umock);
    ptp_model_free(bench->model);
    pull_free(&bench->pull);
    free(bench->bytes);
}

static void scan(struct bench *bench, const char *name, size_t size, int announce)
{
    const struct ptp_object object = { .name = name,
                                       .date = "20260101T120000",
                                       .format = PTP_TIFF,
                                       .size = size,
                                       .bytes = bench->bytes };

    umock_lock(bench->umock);
    (void)ptp_model_add(bench->model, &object, announce);
    umock_unlock(bench->umock);
}

static void has_taken(const struct bench *bench, const char *name, size_t size)
{
    const struct pulled *const got = pull_find(&bench->pull, name);

    CHECK(got && got->size == size && memcmp(got->bytes, bench->bytes, size) == 0);
}

TEST(scans_are_taken_byte_equal_those_that_fill_their_packets_too)
{
    static const size_t sizes[] = { 1, 499, 500, 501, 1012, 65536, 65524, LONG };
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };
    char names[8][16];

    for (size_t i = 0; i < 8; i++) {
        (void)snprintf(names[i], sizeof names[i], "%zu.tif", sizes[i]);
        scan(&bench, names[i], sizes[i], 0);
    }
    open_source(&bench);
    CHECK(strstr(gsn_source_device(bench.source), "1209:0001 SN0001"));
    CHECK_OK(pull_until(&bench.pull, bench.source, 8, &err), err);
    for (size_t i = 0; i < 8; i++)
        has_taken(&bench, names[i], sizes[i]);
    CHECK(ptp_model_count(bench.model) == 8); /* nothing was deleted there */
    tear_down(&bench);
}

TEST(a_stalling_device_is_read_all_the_same)
{
    struct bench bench = set_up(&(struct ptp_faults){ .stall_every = 7, .no_zlp = true });
    struct gsn_error err = { 0 };

    scan(&bench, "a.tif", 3 * MIB, 0);
    open_source(&bench);
    CHECK_OK(pull_until(&bench.pull, bench.source, 1, &err), err);
    has_taken(&bench, "a.tif", 3 * MIB);
    tear_down(&bench);
}

static void *scan_later(void *context)
{
    (void)usleep(50000);
    scan(context, "new.tif", 5000, 1);
    return NULL;
}

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

TEST(a_new_scan_wakes_who_waits)
{
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };
    pthread_t thread;
    int64_t start;

    open_source(&bench);
    CHECK_OK(pull_look(&bench.pull, bench.source, &err), err);
    start = now_ms();
    CHECK(pthread_create(&thread, NULL, scan_later, &bench) == 0);
    CHECK_OK(gsn_source_wait(bench.source, EVENT_MS, -1, &err), err);
    CHECK(now_ms() - start < EVENT_MS);
    (void)pthread_join(thread, NULL);
    CHECK_OK(pull_until(&bench.pull, bench.source, 1, &err), err);
    has_taken(&bench, "new.tif", 5000);
    tear_down(&bench);
}

/* Takes until the device has gone; the code of the failure. */
static int take_until_gone(struct bench *bench, struct gsn_error *err)
{
    int r = GSN_OK;

    for (int look = 0; look < 5 && r >= 0; look++)
        r = pull_look(&bench->pull, bench->source, err);
    return r;
}

static void goes_and_comes(const struct ptp_faults *habits)
{
    struct ptp_faults faults = *habits;
    struct bench bench;
    struct gsn_error err = { 0 };
    int r;

    faults.unplug_at_byte = 3 * MIB;
    bench = set_up(&faults);
    scan(&bench, "small.tif", 1000, 0);
    scan(&bench, "long.tif", LONG, 0);
    open_source(&bench);
    r = take_until_gone(&bench, &err);
    CHECK(r == GSN_E_NOTFOUND || r == GSN_E_IO);
    umock_unplug(bench.umock, NUMBER);
    CHECK(pull_look(&bench.pull, bench.source, &err) == GSN_E_NOTFOUND);
    ptp_model_set_faults(bench.model, habits);
    ptp_model_replug(bench.model);
    umock_plug(bench.umock, ptp_model_usb(bench.model), NUMBER + 1);
    CHECK_OK(pull_until(&bench.pull, bench.source, 2, &err), err);
    has_taken(&bench, "small.tif", 1000);
    has_taken(&bench, "long.tif", LONG);
    CHECK(bench.pull.count == 2);
    tear_down(&bench);
}

TEST(unplugged_in_mid_object_and_replugged_it_goes_on)
{
    goes_and_comes(&(struct ptp_faults){ 0 });
}

TEST(replugged_with_its_session_still_open_it_goes_on)
{
    goes_and_comes(&(struct ptp_faults){ .session_stays_open = true });
}

TEST(replugged_with_other_handles_it_goes_on)
{
    goes_and_comes(&(struct ptp_faults){ .new_handles = true, .no_partial = true });
}

TEST(a_device_held_by_another_is_said_to_be_and_taken_when_free)
{
    static const struct gsn_source_options options = { .settle_ms = 500 };
    struct bench bench = set_up(NULL);
    struct gsn_error err = { 0 };

    scan(&bench, "a.tif", 1000, 0);
    umock_claim(bench.umock, NUMBER, 1);
    CHECK(gsn_source_open("ptp:any", &options, &bench.source, &err) == GSN_E_BUSY);
    CHECK(strstr(err.text, "held by") && !bench.source);
    umock_claim(bench.umock, NUMBER, 0);
    open_source(&bench);
    CHECK_OK(pull_until(&bench.pull, bench.source, 1, &err), err);
    tear_down(&bench);
}
