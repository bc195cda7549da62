/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/bench.h"

#include <string.h>

#include "storage/audit_log.h"
#include "storage/scan.h"
#include "storage/sql.h"
#include "tests/storage/bench.h"

static const struct gsn_bench_source flatbed = { .name = "flatbed",
                                                 .address = "ptp:any",
                                                 .device = "04a9:31c0 SN1",
                                                 .state = "receiving",
                                                 .message = "",
                                                 .item = "IMG_1.JPG",
                                                 .done = 10,
                                                 .total = 20 };

static int64_t ask(struct gsn_store *store, const char *sql)
{
    struct gsn_error err = { 0 };
    int64_t value = -1;

    CHECK_OK(gsn_sql_int(store, sql, SQL_NO_ARGS, &value, &err), err);
    return value;
}

TEST(a_source_reads_back_as_it_was_put_and_says_what_is_expected_of_it)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_bench_sources) all = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    CHECK_OK(gsn_scan_expect(store, "flatbed", "S", "ann", NOON, &err), err);
    CHECK_OK(gsn_bench_put(store, &flatbed, NOON, &err), err);
    CHECK_OK(gsn_bench_list(store, &all, &err), err);
    CHECK(all->count == 1 && strcmp(all->at[0].name, "flatbed") == 0);
    CHECK(strcmp(all->at[0].address, "ptp:any") == 0);
    CHECK(strcmp(all->at[0].device, "04a9:31c0 SN1") == 0);
    CHECK(strcmp(all->at[0].state, "receiving") == 0 && strcmp(all->at[0].message, "") == 0);
    CHECK(strcmp(all->at[0].item, "IMG_1.JPG") == 0);
    CHECK(all->at[0].done == 10 && all->at[0].total == 20 && all->at[0].changed == NOON);
    CHECK(strcmp(all->at[0].expects, "S") == 0);
}

TEST(a_source_that_says_the_same_is_not_written_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_bench_source other = flatbed;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_bench_put(store, &flatbed, NOON, &err), err);
    CHECK_OK(gsn_bench_put(store, &flatbed, NOON + 5, &err), err);
    CHECK(ask(store, "SELECT changed FROM source") == NOON);
    other.done = 11;
    CHECK_OK(gsn_bench_put(store, &other, NOON + 6, &err), err);
    CHECK(ask(store, "SELECT changed FROM source") == NOON + 6);
    CHECK(ask(store, "SELECT done FROM source") == 11);
}

TEST(sources_that_are_no_longer_named_are_off)
{
    static const char *const names[] = { "camera" };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_bench_source camera = flatbed;
    struct gsn_error err = { 0 };

    camera.name = "camera";
    CHECK_OK(gsn_bench_put(store, &flatbed, NOON, &err), err);
    CHECK_OK(gsn_bench_put(store, &camera, NOON, &err), err);
    CHECK_OK(gsn_bench_keep(store, names, 1, NOON + 1, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM source WHERE state = 'off' AND name = 'flatbed' AND "
                     "item = '' AND total = 0") == 1);
    CHECK(ask(store, "SELECT count(*) FROM source WHERE state = 'receiving'") == 1);
    CHECK_OK(gsn_bench_keep(store, NULL, 0, NOON + 2, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM source WHERE state = 'off'") == 2);
    CHECK(ask(store, "SELECT changed FROM source WHERE name = 'flatbed'") == NOON + 1);
}

TEST(a_state_that_is_none_is_refused)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_bench_source wrong = flatbed;
    struct gsn_error err = { 0 };

    wrong.state = "sleepy";
    CHECK(gsn_bench_put(store, &wrong, NOON, &err) == GSN_E_INPUT);
    CHECK(ask(store, "SELECT count(*) FROM source") == 0);
}

TEST(trouble_counts_its_tries_and_is_told_once_when_it_comes_and_once_when_it_goes)
{
    struct gsn_trouble_row trouble = { .source = "flatbed",
                                       .name = "IMG_2.JPG",
                                       .reason = "the device answers nonsense",
                                       .action = "look at it on the device" };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_trouble_rows) all = NULL;
    gsn_auto(gsn_trouble_rows) none = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_trouble_put(store, &trouble, NOON, &err), err);
    trouble.reason = "still nonsense";
    CHECK_OK(gsn_trouble_put(store, &trouble, NOON + 9, &err), err);
    CHECK_OK(gsn_trouble_list(store, &all, &err), err);
    CHECK(all->count == 1 && all->at[0].tries == 2);
    CHECK(all->at[0].since == NOON && all->at[0].last == NOON + 9);
    CHECK(strcmp(all->at[0].reason, "still nonsense") == 0);
    CHECK(strcmp(all->at[0].action, "look at it on the device") == 0);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'trouble'") == 1);
    CHECK_OK(gsn_trouble_clear(store, "flatbed", "IMG_2.JPG", "ann", NOON, &err), err);
    CHECK_OK(gsn_trouble_clear(store, "flatbed", "IMG_2.JPG", "ann", NOON, &err), err);
    CHECK_OK(gsn_trouble_list(store, &none, &err), err);
    CHECK(none->count == 0);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'cleared' AND actor = 'ann'") == 1);
}

TEST(requests_are_answered_in_order_and_once)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_request_row) first = NULL;
    gsn_auto(gsn_request_row) second = NULL;
    gsn_auto(gsn_request_row) none = NULL;
    struct gsn_error err = { 0 };
    int64_t a = 0, b = 0;

    CHECK_OK(gsn_bench_put(store, &flatbed, NOON, &err), err);
    CHECK_OK(gsn_request_add(store, "flatbed", "capture-blank", "ann", NOON, &a, &err), err);
    CHECK_OK(gsn_request_add(store, "flatbed", "capture-panel", "ann", NOON, &b, &err), err);
    CHECK_OK(gsn_request_next(store, "flatbed", &first, &err), err);
    CHECK(first->id == a && strcmp(first->kind, "capture-blank") == 0 && first->time == NOON);
    CHECK(strcmp(first->actor, "ann") == 0 && strcmp(first->state, "waiting") == 0);
    CHECK_OK(gsn_request_answer(store, a, NULL, NOON, &err), err);
    CHECK(gsn_request_answer(store, a, "late", NOON, &err) == GSN_E_NOTFOUND);
    CHECK_OK(gsn_request_next(store, "flatbed", &second, &err), err);
    CHECK(second->id == b);
    CHECK_OK(gsn_request_answer(store, b, "pictures come by themselves here", NOON, &err), err);
    CHECK(gsn_request_next(store, "flatbed", &none, &err) == GSN_E_NOTFOUND && none == NULL);
    CHECK(ask(store, "SELECT count(*) FROM request WHERE state = 'refused' AND message <> ''") ==
          1);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'request'") == 2);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'answer'") == 2);
}

TEST(nothing_is_asked_of_a_source_that_is_not_there)
{
    static const char *const names[] = { "" };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    int64_t id = 77;

    CHECK(gsn_request_add(store, "flatbed", "capture-panel", "ann", NOON, &id, &err) ==
          GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "there is no source \"flatbed\""));
    CHECK_OK(gsn_bench_put(store, &flatbed, NOON, &err), err);
    CHECK_OK(gsn_bench_keep(store, names, 0, NOON, &err), err);
    CHECK(gsn_request_add(store, "flatbed", "capture-panel", "ann", NOON, &id, &err) ==
          GSN_E_NOTFOUND);
    CHECK_OK(gsn_bench_put(store, &flatbed, NOON, &err), err);
    CHECK(gsn_request_add(store, "flatbed", "dance", "ann", NOON, &id, &err) == GSN_E_INPUT);
    CHECK(id == 77 && ask(store, "SELECT count(*) FROM request") == 0);
}

static int list_once(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_bench_sources) sources = NULL;
    gsn_auto(gsn_trouble_rows) troubles = NULL;
    gsn_auto(gsn_request_row) request = NULL;
    int r = gsn_bench_list(store, &sources, err);

    if (r >= 0)
        r = gsn_trouble_list(store, &troubles, err);
    return r < 0 ? r : gsn_request_next(store, "flatbed", &request, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    static const struct gsn_trouble_row trouble = {
        .source = "flatbed", .name = "a", .reason = "r", .action = "look"
    };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_EVERY_OOM(gsn_bench_put(store, &flatbed, NOON, &err), err);
    CHECK_EVERY_OOM(gsn_trouble_put(store, &trouble, NOON, &err), err);
    CHECK_EVERY_OOM(gsn_request_add(store, "flatbed", "capture-dark", "ann", NOON, &id, &err), err);
    CHECK_EVERY_OOM(list_once(store, &err), err);
    CHECK_EVERY_OOM(gsn_request_answer(store, id, "no", NOON, &err), err);
    CHECK_EVERY_OOM(gsn_trouble_clear(store, "flatbed", "a", "ann", NOON, &err), err);
    CHECK_EVERY_OOM(gsn_bench_keep(store, NULL, 0, NOON, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM trouble") == 0);
}
