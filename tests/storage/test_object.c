/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/catalog.h"

#include <string.h>

#include "storage/scan.h"
#include "tests/storage/bench.h"

/* Panels 1 and 2, panel 1 of a second specimen as well, attachment 3, a blank frame 4. */
static void fill(struct gsn_store *store)
{
    const int64_t one = bench_add_specimen(store, "S01", "control", "");
    const int64_t two = bench_add_specimen(store, "S02", "control", "");
    struct gsn_attachment_row mask = { .name = "mask.mhd", .size = 33 };
    struct gsn_scan_row blank = { .source = "camera",
                                  .device = "",
                                  .name = "blank.pam",
                                  .key = "",
                                  .subject = "blank",
                                  .size = 44,
                                  .facts = "" };
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = 0;

    (void)bench_add_panel(store, one, 1);
    (void)bench_add_panel(store, one, 2);
    (void)bench_add_panel(store, two, 1);
    mask.sha256 = bench_digest(3);
    CHECK_OK(gsn_attachment_put(store, two, &mask, &again, &err), err);
    blank.sha256 = bench_digest(4);
    CHECK_OK(gsn_scan_stage(store, &blank, 0, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_scan_commit_staged(store, &err), err);
}

TEST(each_object_is_listed_once_by_digest_and_in_pieces)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_object_rows) first = NULL;
    gsn_auto(gsn_object_rows) rest = NULL;
    gsn_auto(gsn_object_rows) none = NULL;
    struct gsn_error err = { 0 };

    fill(store);
    CHECK_OK(gsn_object_list(store, "", 3, &first, &err), err);
    CHECK(first->count == 3);
    for (unsigned i = 0; i < 3; i++)
        CHECK(strcmp(first->at[i].sha256, bench_digest(i + 1)) == 0);
    CHECK(first->at[2].size == 33);
    CHECK_OK(gsn_object_list(store, first->at[2].sha256, 3, &rest, &err), err);
    CHECK(rest->count == 1 && rest->at[0].size == 44);
    CHECK_OK(gsn_object_list(store, rest->at[0].sha256, 3, &none, &err), err);
    CHECK(none->count == 0);
}

TEST(all_that_rests_on_an_object_is_named)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_object_use_rows) panels = NULL;
    gsn_auto(gsn_object_use_rows) blank = NULL;
    struct gsn_error err = { 0 };

    fill(store);
    CHECK_OK(gsn_object_uses(store, bench_digest(1), &panels, &err), err);
    CHECK(panels->count == 2 && strcmp(panels->at[1].specimen, "S02") == 0);
    CHECK(strcmp(panels->at[0].name, "P.tif") == 0);
    CHECK_OK(gsn_object_uses(store, bench_digest(4), &blank, &err), err);
    CHECK(blank->count == 1 && !blank->at[0].specimen[0]);
    CHECK(strcmp(blank->at[0].name, "blank.pam") == 0);
}

static int ask_once(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_object_rows) rows = NULL;
    gsn_auto(gsn_object_use_rows) uses = NULL;
    const int r = gsn_object_list(store, "", 10, &rows, err);

    return r < 0 ? r : gsn_object_uses(store, rows->at[0].sha256, &uses, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    fill(store);
    CHECK_EVERY_OOM(ask_once(store, &err), err);
}

TEST(a_table_that_is_gone_is_refused_and_the_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_object_rows *rows = NULL;
    struct gsn_error err = { 0 };

    CHECK(bench_raw(&scratch, "DROP TABLE attachment") == 0);
    CHECK(gsn_object_list(store, "", 1, &rows, &err) == GSN_E_STORE);
    CHECK(rows == NULL && err.text[0]);
}
