/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The whole way in, without a bus: a scanner is plugged in, udev tells giesond, which starts the
 * intake of its source; libusb finds the scanner, and the picture becomes a row and an object. */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "storage/bench.h"
#include "storage/scan.h"
#include "tests/check.h"
#include "tests/device/aside.h"
#include "tests/device/ptp_model.h"
#include "tests/device/umock.h"
#include "tests/storage/scratch.h"

enum { NUMBER = 7, MIB = 1 << 20, LONG = 24 * MIB, GENEROUS_MS = 60000 };

struct bench {
    struct gsn_scratch scratch;
    struct umock *umock;
    struct ptp_model *model;
    struct gsn_store *store;
    pid_t giesond;
    uint8_t *bytes;
};

static int64_t now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Writes down the configuration and starts the service. */
static void start(struct bench *bench)
{
    static const char text[] = "[store]\nReserveMiB=1\n[work]\nMemoryMiB=0\n"
                               "[source scanner]\nAddress=ptp:SN0001\nSettleMs=100\nSweepS=1\n";
    const char *const config = gsn_scratch_path(&bench->scratch, "gieson.conf");
    const char *const store = gsn_scratch_path(&bench->scratch, "store");
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_file_write(config, text, sizeof text - 1, &err), err);
    CHECK_OK(gsn_store_open(store, GSN_STORE_CREATE, &bench->store, &err), err);
    bench->giesond = fork();
    if (bench->giesond == 0) {
        umock_open_aside();
        (void)unsetenv("NOTIFY_SOCKET");
        (void)execl(GSN_GIESOND, GSN_GIESOND, "--store", store, "--config", config, "--only",
                    "intake", (char *)NULL);
        _exit(127);
    }
}

static struct bench set_up(const struct ptp_faults *faults)
{
    struct bench bench = { .scratch = gsn_scratch_new(),
                           .umock = umock_new(),
                           .model = ptp_model_new("SN0001", faults),
                           .bytes = malloc(LONG) };

    for (size_t i = 0; i < LONG; i++)
        bench.bytes[i] = (uint8_t)(i * 23 + i / 509);
    return bench;
}

static void tear_down(struct bench *bench)
{
    int status = -1;

    CHECK(kill(bench->giesond, SIGTERM) == 0);
    CHECK(waitpid(bench->giesond, &status, 0) == bench->giesond);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    gsn_store_free(bench->store);
    umock_free(bench->umock);
    ptp_model_free(bench->model);
    gsn_scratch_remove(&bench->scratch);
    free(bench->bytes);
}

static bool source_is(struct bench *bench, const char *state)
{
    gsn_auto(gsn_bench_sources) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_bench_list(bench->store, &rows, &err), err);
    return rows->count == 1 && strcmp(rows->at[0].state, state) == 0;
}

static size_t scans(struct bench *bench)
{
    gsn_auto(gsn_scan_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_scan_list(bench->store, NULL, 0, &rows, &err), err);
    return rows->count;
}

static void wait_for_source(struct bench *bench, const char *state)
{
    const int64_t end = now_ms() + GENEROUS_MS;

    while (!source_is(bench, state) && now_ms() < end)
        (void)usleep(20000);
    if (!source_is(bench, state))
        fail_msg("the source did not become %s", state);
}

static void wait_for_scans(struct bench *bench, size_t count)
{
    const int64_t end = now_ms() + GENEROUS_MS;

    while (scans(bench) < count && now_ms() < end)
        (void)usleep(20000);
    if (scans(bench) != count)
        fail_msg("%zu scans came, not %zu", scans(bench), count);
}

static uint32_t scan(struct bench *bench, const char *name, size_t size)
{
    const struct ptp_object object = { .name = name,
                                       .date = "20260101T120000",
                                       .format = PTP_TIFF,
                                       .size = size,
                                       .bytes = bench->bytes };
    uint32_t handle;

    umock_lock(bench->umock);
    handle = ptp_model_add(bench->model, &object, 1);
    umock_unlock(bench->umock);
    return handle;
}

/* The ledger has it with these bytes, and the object that the row names has them. */
static void has(struct bench *bench, const char *name, size_t size)
{
    gsn_auto(gsn_scan_rows) rows = NULL;
    gsn_auto_mem(uint8_t) object = NULL;
    struct gsn_error err = { 0 };
    char path[120];
    size_t at = 0, got;

    CHECK_OK(gsn_scan_list(bench->store, NULL, 0, &rows, &err), err);
    while (at < rows->count && strcmp(rows->at[at].name, name) != 0)
        at++;
    CHECK(at < rows->count && rows->at[at].size == (int64_t)size);
    CHECK(strstr(rows->at[at].device, "SN0001"));
    (void)snprintf(path, sizeof path, "store/objects/%.2s/%.62s", rows->at[at].sha256,
                   rows->at[at].sha256 + 2);
    CHECK_OK(gsn_file_read(gsn_scratch_path(&bench->scratch, path), LONG, &object, &got, &err),
             err);
    CHECK(got == size && memcmp(object, bench->bytes, size) == 0);
}

TEST(a_scanner_that_is_plugged_in_delivers_and_one_that_scans_too)
{
    struct bench bench = set_up(NULL);
    uint32_t first;

    start(&bench);
    wait_for_source(&bench, "away");
    first = scan(&bench, "first.tif", 100000);
    umock_plug(bench.umock, ptp_model_usb(bench.model), NUMBER);
    wait_for_scans(&bench, 1);
    has(&bench, "first.tif", 100000);
    (void)scan(&bench, "second.tif", 512 - 12);
    wait_for_scans(&bench, 2);
    has(&bench, "second.tif", 512 - 12);
    CHECK(ptp_model_has(bench.model, first)); /* and nothing was deleted there */
    tear_down(&bench);
}

TEST(a_scanner_unplugged_in_mid_object_goes_on_where_it_was)
{
    struct bench bench = set_up(&(struct ptp_faults){ .unplug_at_byte = 20 * MIB });
    uint64_t before;

    (void)scan(&bench, "long.tif", LONG);
    umock_plug(bench.umock, ptp_model_usb(bench.model), NUMBER);
    start(&bench);
    wait_for_source(&bench, "away");
    umock_unplug(bench.umock, NUMBER);
    CHECK(scans(&bench) == 0);
    before = ptp_model_given(bench.model);
    CHECK(before >= 20 * MIB - 2 * MIB && before <= 20 * MIB + 2 * MIB);
    ptp_model_set_faults(bench.model, NULL);
    ptp_model_replug(bench.model);
    umock_plug(bench.umock, ptp_model_usb(bench.model), NUMBER + 1);
    wait_for_scans(&bench, 1);
    has(&bench, "long.tif", LONG);
    umock_lock(bench.umock);
    CHECK(ptp_model_given(bench.model) - before < LONG / 2); /* not from the start */
    umock_unlock(bench.umock);
    tear_down(&bench);
}
