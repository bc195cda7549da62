/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/torn.h"

#include <stdio.h>
#include <string.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "storage/audit_log.h"
#include "storage/catalog.h"
#include "storage/queue.h"
#include "storage/scan.h"
#include "storage/sql.h"
#include "tests/check.h"
#include "tests/storage/bench.h"

enum { SIZE = 200000, CUT = 131072 + 77 };

struct stage {
    struct gsn_scratch scratch;
    struct gsn_store *store;
    uint8_t whole[SIZE];
};

static void stage_begin(struct stage *stage)
{
    stage->scratch = gsn_scratch_new();
    stage->store = bench_open(&stage->scratch, GSN_STORE_CREATE);
    for (size_t i = 0; i < SIZE; i++)
        stage->whole[i] = (uint8_t)(1 + i * 7 % 251); /* never zero */
}

static void stage_done(struct stage *stage)
{
    gsn_store_free(stage->store);
    gsn_scratch_remove(&stage->scratch);
}
#define auto_stage __attribute__((cleanup(stage_done))) struct stage

/* As the spool keeps it. */
static struct gsn_digest keep(const struct stage *stage, const uint8_t *bytes, size_t size)
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(char) folder = NULL;
    struct gsn_digest digest;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_sha256(bytes, size, &digest, &err), err);
    CHECK_OK(gsn_store_object_path(stage->store, digest.hex, &path, &err), err);
    folder = gsn_format("%.*s", (int)(strrchr(path, '/') - path), path);
    CHECK(folder != NULL);
    CHECK_OK(gsn_file_mkdir(folder, &err), err);
    CHECK_OK(gsn_file_write(path, bytes, size, &err), err);
    return digest;
}

/* The whole, as it is where only the first bytes were written: cut there, or zeros from there on.
 */
static struct gsn_digest keep_torn(const struct stage *stage, size_t written, size_t length)
{
    gsn_auto_mem(uint8_t) bytes = gsn_alloc(length);

    CHECK(bytes != NULL);
    memset(bytes, 0, length);
    memcpy(bytes, stage->whole, written < length ? written : length);
    return keep(stage, bytes, length);
}

static int is_torn(const struct stage *stage, const struct gsn_digest *a,
                   const struct gsn_digest *b)
{
    struct gsn_error err = { 0 };
    int torn = -1;

    CHECK_OK(gsn_torn_compare(stage->store, a->hex, b->hex, &torn, &err), err);
    return torn;
}

TEST(a_beginning_that_was_cut_or_ends_in_zeros_is_torn)
{
    static const struct {
        size_t written, length;
    } cuts[] = { { 1, 1 },    { CUT, CUT }, { CUT, SIZE },      { 65536, 65536 },   { 65536, SIZE },
                 { 8, SIZE }, { 0, SIZE },  { SIZE - 1, SIZE }, { CUT, SIZE + 999 } };
    auto_stage stage;
    struct gsn_digest whole;

    stage_begin(&stage);
    whole = keep(&stage, stage.whole, SIZE);
    for (size_t i = 0; i < sizeof cuts / sizeof cuts[0]; i++) {
        const struct gsn_digest torn = keep_torn(&stage, cuts[i].written, cuts[i].length);

        if (is_torn(&stage, &torn, &whole) != 1 || is_torn(&stage, &whole, &torn) != 0)
            fail_msg("%zu of %zu bytes", cuts[i].written, cuts[i].length);
    }
}

TEST(a_hole_is_torn_and_two_are_another_picture)
{
    auto_stage stage;
    struct gsn_digest whole, holed;
    uint8_t bytes[SIZE];

    stage_begin(&stage);
    whole = keep(&stage, stage.whole, SIZE);
    memcpy(bytes, stage.whole, SIZE);
    memset(bytes, 0, CUT); /* written from its end */
    holed = keep(&stage, bytes, SIZE);
    CHECK(is_torn(&stage, &holed, &whole) == 1 && is_torn(&stage, &whole, &holed) == 0);
    memcpy(bytes, stage.whole, SIZE);
    memset(bytes + 65000, 0, 70000);
    holed = keep(&stage, bytes, SIZE);
    CHECK(is_torn(&stage, &holed, &whole) == 1);
    bytes[199000] = 0; /* as a place that somebody blackened, row by row */
    holed = keep(&stage, bytes, SIZE);
    CHECK(is_torn(&stage, &holed, &whole) == 0);
}

TEST(another_scan_of_the_same_name_is_not_torn)
{
    auto_stage stage;
    struct gsn_digest whole, other;
    struct gsn_error err = { 0 };
    int torn = 7;

    stage_begin(&stage);
    whole = keep(&stage, stage.whole, SIZE);
    for (size_t at = 0; at < SIZE; at += 33333) {
        stage.whole[at] ^= 0x80;
        other = keep(&stage, stage.whole, SIZE);
        CHECK(is_torn(&stage, &other, &whole) == 0 && is_torn(&stage, &whole, &other) == 0);
        stage.whole[at] ^= 0x80;
    }
    CHECK(gsn_torn_compare(stage.store, whole.hex, bench_digest(1), &torn, &err) == GSN_E_NOTFOUND);
    CHECK(torn == 7);
    CHECK_EVERY_OOM(gsn_torn_compare(stage.store, other.hex, whole.hex, &torn, &err), err);
}

static int64_t ask(const struct stage *stage, const char *sql)
{
    struct gsn_error err = { 0 };
    int64_t value = -1;

    CHECK_OK(gsn_sql_int(stage->store, sql, SQL_NO_ARGS, &value, &err), err);
    return value;
}

static void deliver(const struct stage *stage, const char *name, const struct gsn_digest *digest,
                    int64_t size)
{
    const struct gsn_scan_row row = { .source = "flatbed",
                                      .device = "",
                                      .name = name,
                                      .key = "",
                                      .subject = "panel",
                                      .sha256 = digest->hex,
                                      .size = size,
                                      .facts = "" };
    struct gsn_error err = { 0 };
    int64_t id;
    int again;

    CHECK_OK(gsn_scan_stage(stage->store, &row, 3, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_scan_commit_staged(stage->store, &err), err);
}

static int lists_object(const struct stage *stage, const struct gsn_digest *digest)
{
    gsn_auto(gsn_object_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_object_list(stage->store, "", 100, &rows, &err), err);
    for (size_t i = 0; i < rows->count; i++)
        if (strcmp(rows->at[i].sha256, digest->hex) == 0)
            return 1;
    return 0;
}

/* Both used to be held, as two panels of one number. */
TEST(the_whole_picture_takes_the_torn_ones_place_and_both_are_kept)
{
    auto_stage stage;
    struct gsn_digest torn, whole;
    gsn_auto(gsn_panel_row) panel = NULL;
    gsn_auto(gsn_scan_row) scan = NULL;
    gsn_auto(gsn_event_rows) events = NULL;
    struct gsn_event_verdict verdict;
    struct gsn_error err = { 0 };

    stage_begin(&stage);
    (void)bench_add_specimen(stage.store, "S02", "g", "");
    torn = keep_torn(&stage, CUT, SIZE);
    whole = keep(&stage, stage.whole, SIZE);
    deliver(&stage, "S02-P03.tif", &torn, SIZE);
    CHECK_OK(gsn_panel_set_state(stage.store, 1, "refused", "input", "it ends early", &err), err);
    deliver(&stage, "S02-P03.tif", &whole, SIZE);
    CHECK(ask(&stage, "SELECT count(*) FROM panel") == 1);
    CHECK_OK(gsn_panel_get(stage.store, 1, &panel, &err), err);
    CHECK(strcmp(panel->sha256, whole.hex) == 0 && strcmp(panel->state, "waiting") == 0);
    CHECK(!panel->message[0] && panel->number == 3);
    CHECK_OK(gsn_scan_get(stage.store, 1, &scan, &err), err);
    CHECK(strcmp(scan->state, "kept") == 0 && strstr(scan->reason, "a torn beginning of"));
    CHECK(ask(&stage, "SELECT panel_id FROM scan WHERE id = 2 AND state = 'filed' AND "
                      "reason LIKE '%torn beginning of it'") == 1);
    CHECK(lists_object(&stage, &torn) && lists_object(&stage, &whole));
    CHECK(ask(&stage, "SELECT count(*) FROM event WHERE kind = 'torn'") == 1);
    CHECK_OK(gsn_event_verify(stage.store, NULL, &verdict, &err), err);
    CHECK(verdict.broken == 0);
    /* The torn one again, as another process may meet it. */
    deliver(&stage, "S02-P03.tif", &torn, SIZE);
    CHECK(ask(&stage, "SELECT count(*) FROM panel") == 1);
}

TEST(a_rescan_of_the_same_name_is_a_panel_of_its_own)
{
    auto_stage stage;
    struct gsn_digest first, second;

    stage_begin(&stage);
    (void)bench_add_specimen(stage.store, "S02", "g", "");
    first = keep(&stage, stage.whole, SIZE);
    stage.whole[SIZE / 2] ^= 0x80;
    second = keep(&stage, stage.whole, SIZE);
    deliver(&stage, "S02-P03.tif", &first, SIZE);
    deliver(&stage, "S02-P03.tif", &second, SIZE);
    CHECK(ask(&stage, "SELECT count(*) FROM panel") == 2);
}

TEST(an_unfiled_torn_picture_waits_for_nobody_when_the_whole_one_is_there)
{
    auto_stage stage;
    struct gsn_digest torn, whole;

    stage_begin(&stage);
    torn = keep_torn(&stage, CUT, CUT);
    whole = keep(&stage, stage.whole, SIZE);
    deliver(&stage, "x.tif", &torn, CUT);
    deliver(&stage, "y.tif", &torn, CUT);
    deliver(&stage, "x.tif", &whole, SIZE);
    CHECK(ask(&stage, "SELECT group_concat(id, '') FROM scan WHERE state = 'unfiled'") == 23);
    CHECK(lists_object(&stage, &torn));
}
