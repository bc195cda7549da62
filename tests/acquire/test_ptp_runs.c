/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Five hundred scanners with random faults, unplugged at random bytes, under a process that is
 * killed at random: nothing that was acknowledged is lost, nothing is changed or doubled, and the
 * source comes back by itself. GIESON_SEED=n runs one of them alone. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/acquire/ptp_bench.h"
#include "tests/check.h"
#include "tests/device/dice.h"

enum { RUNS = 500, STORMY_TURNS = 60, CALM_TURNS = 400, MOST_SIZE = 1 << 19 };

static bool one_in(struct dice *dice, unsigned n)
{
    return below(dice, n) == 0;
}

static unsigned now_and_then(struct dice *dice, unsigned limit)
{
    return one_in(dice, 6) ? 1 + below(dice, limit) : 0;
}

/* What a run is like throughout. */
struct nature {
    bool dated;     /* the scanner's clock works, so that there are keys */
    bool renumbers; /* a replug gives other handles */
    bool grows;     /* scans are seen before they are finished */
    size_t scans;
};

static struct ptp_faults draw_faults(struct dice *dice, const struct nature *nature)
{
    struct ptp_faults faults = {
        .merge_response = one_in(dice, 4),
        .split_header = one_in(dice, 4),
        .leftover_zlp = one_in(dice, 4),
        .no_zlp = one_in(dice, 4),
        .short_reads = now_and_then(dice, 1024),
        .stall_at = now_and_then(dice, 200),
        .stall_every = now_and_then(dice, 50),
        .short_data_at = now_and_then(dice, 60),
        .wrong_id_at = now_and_then(dice, 60),
        .late_at = now_and_then(dice, 60),
        .late_ms = now_and_then(dice, 200),
        .silent_at = now_and_then(dice, 60),
        .lying_length_at = now_and_then(dice, 60),
        .unplug_at_byte = one_in(dice, 2) ? 1 + below(dice, 2 * MOST_SIZE) : 0,
        .info_needs_session = one_in(dice, 4),
        .no_list_of_all = one_in(dice, 4),
        .session_stays_open = one_in(dice, 4),
        .new_handles = nature->renumbers,
        .no_partial = one_in(dice, 4),
        .no_partial64 = one_in(dice, 2),
        .no_delete = one_in(dice, 4),
        .busy_count = now_and_then(dice, 50),
        .bad_object = now_and_then(dice, 4),
        .no_events = one_in(dice, 4),
        .hidden_events = one_in(dice, 4),
        .size_zero_first = nature->grows,
        .changed_flood = now_and_then(dice, 100),
        .wrong_event_handle = one_in(dice, 4),
    };

    faults.crash_above = one_in(dice, 10) ? 65536 + below(dice, 100000) : 0;
    return faults;
}

/* The model's growing objects need this size for every look to see more than the one before. */
enum { GROWING_SIZE = 100000 };

static size_t draw_size(struct dice *dice, const struct nature *nature)
{
    if (nature->grows)
        return GROWING_SIZE + below(dice, MOST_SIZE - GROWING_SIZE);
    switch (below(dice, 4)) {
    case 0:
        return 1 + below(dice, 2000);
    case 1: /* about whole packets, with and without the header */
        return 512 * (1 + below(dice, 200)) - below(dice, 14);
    default:
        return 1 + below(dice, MOST_SIZE);
    }
}

static void draw_scan(struct bench *bench, struct dice *dice, const struct nature *nature)
{
    char name[32], date[32] = "";

    (void)snprintf(name, sizeof name, "P%02zu.TIF", bench->objects + 1);
    if (nature->dated)
        (void)snprintf(date, sizeof date, "20260101T1200%02zu", bench->objects);
    (void)bench_scan(bench, name, draw_size(dice, nature), (unsigned)roll(dice), date, 1);
}

/* What is not in the ledger is still on the device. */
static bool nothing_is_lost(const struct bench *bench)
{
    size_t missing = 0;

    for (size_t i = 0; i < bench->objects; i++)
        missing += bench->object[i].taken == 0;
    return ptp_model_count(bench->model) >= missing && bench->foreign == 0;
}

static void finish_scans(struct bench *bench)
{
    for (size_t i = 0; i < bench->objects; i++)
        ptp_model_complete(bench->model, bench->object[i].handle);
}

/* The process died; it is started when there is a device to start with. */
static void start_again(struct bench *bench)
{
    ptp_model_replug(bench->model);
    bench_restart(bench);
}

static void storm(struct bench *bench, struct dice *dice, const struct nature *nature)
{
    for (int turn = 0; turn < STORMY_TURNS; turn++) {
        const unsigned away = bench->away;

        if (bench->objects < nature->scans && one_in(dice, 3))
            draw_scan(bench, dice, nature);
        bench->dies = one_in(dice, 10);
        bench_turn(bench);
        if (bench->dies)
            start_again(bench);
        if (one_in(dice, 20))
            ptp_model_unplug(bench->model);
        if (one_in(dice, 10)) {
            const struct ptp_faults faults = draw_faults(dice, nature);

            ptp_model_set_faults(bench->model, &faults);
        }
        if (bench->away > away && one_in(dice, 2)) {
            const struct ptp_faults faults = draw_faults(dice, nature);

            ptp_model_set_faults(bench->model, &faults);
            ptp_model_replug(bench->model);
        }
        if (!nothing_is_lost(bench))
            return;
    }
}

/* What the runs went through, together. */
struct hardship {
    unsigned unplugged, broken_off, cancelled, reset;
};

/* Whether this run kept all promises. */
static bool run(uint64_t seed, struct hardship *total)
{
    struct dice dice = { seed };
    const struct nature nature = { !one_in(&dice, 4), seed % 3 == 0, seed % 3 == 1,
                                   1 + below(&dice, 5) };
    const struct ptp_faults faults = draw_faults(&dice, &nature);
    bench_auto bench;
    bool kept;

    bench_init(&bench, &faults);
    bench.options.delete_there = one_in(&dice, 4);
    bench_open(&bench);
    storm(&bench, &dice, &nature);
    kept = nothing_is_lost(&bench);
    ptp_model_set_faults(bench.model, &(struct ptp_faults){ .new_handles = nature.renumbers });
    ptp_model_replug(bench.model);
    finish_scans(&bench);
    while (bench.objects < nature.scans)
        draw_scan(&bench, &dice, &nature);
    for (int turn = 0; turn < CALM_TURNS && !bench_is_complete(&bench); turn++) {
        bench_turn(&bench);
        memory_bus_sleep(&bench.bus, 60000);
    }
    total->unplugged += bench.away;
    total->broken_off += bench.failed_copies;
    total->cancelled += bench.bus.cancels;
    total->reset += bench.bus.resets;
    return kept && bench_is_complete(&bench) && (!nature.dated || bench.again == 0);
}

TEST(five_hundred_stormy_scanners_lose_and_double_nothing)
{
    const char *const alone = getenv("GIESON_SEED");
    const uint64_t first = alone ? strtoull(alone, NULL, 10) : 1;
    const uint64_t last = alone ? first : RUNS;
    struct hardship total = { 0 };
    unsigned broken = 0;

    for (uint64_t seed = first; seed <= last; seed++) {
        if (run(seed, &total))
            continue;
        print_error("run %llu broke a promise; GIESON_SEED=%llu runs it alone\n",
                    (unsigned long long)seed, (unsigned long long)seed);
        broken++;
    }
    CHECK(broken == 0);
    print_message("%u unplugged, %u copies broken off, %u cancels, %u resets\n", total.unplugged,
                  total.broken_off, total.cancelled, total.reset);
    /* The weather was bad enough to mean something. */
    CHECK(alone || (total.unplugged > RUNS && total.broken_off > RUNS / 2 &&
                    total.cancelled > RUNS && total.reset > RUNS / 5));
}
