/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/acquire/ptp_bench.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "acquire/ptp_source.h"
#include "pipeline/core/file.h"
#include "tests/check.h"

enum { WAIT_MS = 500, AWAY_MS = 2000, MIB = 1 << 20 };

static int is_known(void *context, const char *key)
{
    const struct bench *const bench = context;

    for (size_t i = 0; i < bench->keys; i++) {
        if (strcmp(bench->key[i], key) == 0)
            return 1;
    }
    return 0;
}

static void open_spool(struct bench *bench)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spool_open(bench->scratch.dir, 0, &bench->spool, &err), err);
}

void bench_init(struct bench *bench, const struct ptp_faults *faults)
{
    *bench = (struct bench){ .model = ptp_model_new("SN0001", faults) };
    /* What a disk costs is not the question here. */
    if (access("/dev/shm", W_OK) == 0)
        (void)setenv("TMPDIR", "/dev/shm", 0);
    bench->scratch = gsn_scratch_new();
    bench->bus.model = ptp_model_usb(bench->model);
    bench->options = (struct gsn_source_options){
        .settle_ms = 1000, .patience_ms = 600000, .is_known = is_known, .context = bench
    };
    open_spool(bench);
}

void bench_open(struct bench *bench)
{
    const struct gsn_ptp_opener opener = { memory_opener, &bench->bus };
    struct gsn_error err = { 0 };
    void *self = NULL;

    CHECK_OK(gsn_ptp_source_new(&opener, &bench->options, &self, &err), err);
    CHECK_OK(gsn_source_make(&gsn_ptp_source_ops, self, "ptp:SN0001", &bench->options,
                             &bench->source, &err),
             err);
}

void bench_restart(struct bench *bench)
{
    gsn_source_free(bench->source);
    gsn_spool_free(bench->spool);
    bench->source = NULL;
    bench->spool = NULL;
    bench->dies = false;
    open_spool(bench);
    bench_open(bench);
}

void bench_done(struct bench *bench)
{
    gsn_source_free(bench->source);
    gsn_spool_free(bench->spool);
    ptp_model_free(bench->model);
    for (size_t i = 0; i < bench->objects; i++)
        free(bench->object[i].bytes);
    gsn_scratch_remove(&bench->scratch);
}

struct bench_object *bench_scan(struct bench *bench, const char *name, size_t size, unsigned seed,
                                const char *date, int announce)
{
    struct bench_object *const object = &bench->object[bench->objects++];
    uint64_t state = seed + 0x9E3779B97F4A7C15u;

    *object = (struct bench_object){ .bytes = malloc(size + 1), .size = size };
    (void)snprintf(object->name, sizeof object->name, "%s", name);
    for (size_t i = 0; i < size; i++) {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        object->bytes[i] = (uint8_t)(state >> 32);
    }
    object->handle = ptp_model_add(bench->model,
                                   &(struct ptp_object){ .name = object->name,
                                                         .date = date ? date : "20260101T120000",
                                                         .format = PTP_TIFF,
                                                         .size = size,
                                                         .bytes = object->bytes },
                                   announce);
    return object;
}

/* The bytes that lie in the spool under this digest are those of the object. */
static bool is_stored(const struct bench *bench, const struct gsn_spooled *spooled,
                      const struct bench_object *object)
{
    gsn_auto_mem(char) path = gsn_format("%s/objects/%.2s/%s", bench->scratch.dir,
                                         spooled->digest.hex, spooled->digest.hex + 2);
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;

    return gsn_file_read(path, 64 << 20, &bytes, &size, NULL) >= 0 && size == object->size &&
           memcmp(bytes, object->bytes, size) == 0;
}

static void write_down(struct bench *bench, const struct gsn_source_event *event,
                       const struct gsn_spooled *spooled)
{
    struct bench_object *object = NULL;

    for (size_t i = 0; i < bench->objects && !object; i++) {
        if (strcmp(bench->object[i].name, event->name) == 0 &&
            is_stored(bench, spooled, &bench->object[i]))
            object = &bench->object[i];
    }
    if (!object) {
        bench->foreign++;
        return;
    }
    /* The store knows a picture by its bytes: a second copy of it makes no second row. */
    if (object->taken > 0)
        bench->again++;
    else
        object->taken++;
    if (event->key[0] && !is_known(bench, event->key) && bench->keys < BENCH_OBJECTS)
        (void)snprintf(bench->key[bench->keys++], sizeof bench->key[0], "%s", event->key);
}

static void take(struct bench *bench, const struct gsn_source_event *event)
{
    struct gsn_spooled spooled;
    struct gsn_error err = { 0 };

    if (gsn_spool_take_item(bench->spool, bench->source, event, &spooled, &err) < 0) {
        bench->failed_copies++;
        return;
    }
    write_down(bench, event, &spooled);
    if (bench->dies)
        return;
    (void)gsn_source_acknowledge(bench->source, event->item, &err);
}

static void note(struct bench *bench, const struct gsn_source_event *event)
{
    struct bench_line *const line = &bench->line[bench->lines++ % BENCH_LINES];

    line->what = event->what;
    (void)snprintf(line->name, sizeof line->name, "%s", event->name);
    (void)snprintf(line->reason, sizeof line->reason, "%s", event->reason);
}

void bench_turn(struct bench *bench)
{
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error err = { 0 };
    int ended = 0;
    const int r = gsn_source_poll(bench->source, bench->bus.now_ms, &events, &ended, &err);

    bench->away += r == GSN_E_NOTFOUND;
    for (size_t i = 0; r >= 0 && i < events->count; i++) {
        if (events->at[i].what == GSN_SOURCE_READY)
            take(bench, &events->at[i]);
        else
            note(bench, &events->at[i]);
    }
    if (r >= 0)
        (void)gsn_source_wait(bench->source, WAIT_MS, -1, &err);
    memory_bus_sleep(&bench->bus, r < 0 ? AWAY_MS : 1);
}

bool bench_is_complete(const struct bench *bench)
{
    for (size_t i = 0; i < bench->objects; i++) {
        if (bench->object[i].taken != 1)
            return false;
    }
    return bench->foreign == 0;
}

bool bench_work(struct bench *bench, unsigned turns)
{
    for (unsigned i = 0; i < turns && !bench_is_complete(bench); i++)
        bench_turn(bench);
    return bench_is_complete(bench);
}

const struct bench_line *bench_told(const struct bench *bench, const char *name, const char *part)
{
    const size_t count = bench->lines < BENCH_LINES ? bench->lines : BENCH_LINES;

    for (size_t i = count; i-- > 0;) {
        const struct bench_line *const line = &bench->line[i];

        if ((!name || strcmp(line->name, name) == 0) && strstr(line->reason, part))
            return line;
    }
    return NULL;
}

void bench_take_three(const struct ptp_faults *faults, struct bench *bench)
{
    bench_init(bench, faults);
    (void)bench_scan(bench, "P01.TIF", 1000, 1, NULL, 0);
    (void)bench_scan(bench, "P02.TIF", 512 * 8 - 12, 2, NULL, 0);
    (void)bench_scan(bench, "P10.TIF", 2 * MIB + 12345, 3, NULL, 0);
    bench_open(bench);
    CHECK(bench_work(bench, BENCH_TURNS));
    CHECK(bench->again == 0);
    CHECK(ptp_model_count(bench->model) == 3);
}
