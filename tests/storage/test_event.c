/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/audit_log.h"

#include <sqlite3.h>
#include <stdio.h>
#include <string.h>

#include "tests/storage/bench.h"

static void add(struct gsn_store *store, const char *text)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_event_add(store, NOON, "Anna", "note", "S00", text, &err), err);
}

static struct gsn_event_verdict verify(struct gsn_store *store, const char *head)
{
    struct gsn_event_verdict verdict = { -1, -1, -1 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_event_verify(store, head, &verdict, &err), err);
    return verdict;
}

TEST(the_chain_is_the_documented_hash)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_digest head, expected;
    struct gsn_error err = { 0 };
    char text[400];

    CHECK_OK(gsn_event_head(store, &head, &err), err);
    CHECK(strspn(head.hex, "0") == 64);
    add(store, "first");
    (void)snprintf(text, sizeof text, "64:%s12:1 18000000004:Anna4:note3:S005:first", head.hex);
    CHECK_OK(gsn_sha256(text, strlen(text), &expected, &err), err);
    CHECK_OK(gsn_event_head(store, &head, &err), err);
    CHECK(strcmp(head.hex, expected.hex) == 0);
}

TEST(events_are_listed_oldest_first_and_from_the_end)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_event_rows) two = NULL;
    gsn_auto(gsn_event_rows) all = NULL;
    struct gsn_error err = { 0 };

    add(store, "a");
    add(store, "b");
    add(store, "c");
    CHECK_OK(gsn_event_list(store, 2, &two, &err), err);
    CHECK(two->count == 2 && two->at[0].id == 2 && strcmp(two->at[1].text, "c") == 0);
    CHECK_OK(gsn_event_list(store, 0, &all, &err), err);
    CHECK(all->count == 3 && all->at[0].id == 1);
}

TEST(rows_can_be_neither_changed_nor_removed_nor_replaced)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    add(store, "a");
    add(store, "b");
    CHECK(bench_raw(&scratch, "UPDATE event SET text = 'x' WHERE id = 1") == SQLITE_CONSTRAINT);
    CHECK(bench_raw(&scratch, "DELETE FROM event WHERE id = 2") == SQLITE_CONSTRAINT);
    CHECK(bench_raw(&scratch, "INSERT OR REPLACE INTO event SELECT 1, time, actor, kind, subject, "
                              "'x', hash FROM event WHERE id = 1") == SQLITE_CONSTRAINT);
    CHECK(bench_raw(&scratch, "INSERT INTO event SELECT 9, time, actor, kind, subject, text, hash "
                              "FROM event WHERE id = 1") == SQLITE_CONSTRAINT);
    CHECK(verify(store, NULL).broken == 0 && verify(store, NULL).count == 2);
}

/* Each edit is made on a fresh chain of five with the triggers dropped. */
static void finds(const char *edit, int64_t broken)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    for (char text[] = "a"; text[0] <= 'e'; text[0]++)
        add(store, text);
    CHECK(verify(store, NULL).broken == 0);
    CHECK(bench_raw(&scratch, "DROP TRIGGER event_stays; DROP TRIGGER event_is_kept; "
                              "DROP TRIGGER event_is_appended") == SQLITE_OK);
    CHECK(bench_raw(&scratch, edit) == SQLITE_OK);
    if (verify(store, NULL).broken != broken)
        fail_msg("after \"%s\" row %lld was found, not %lld", edit,
                 (long long)verify(store, NULL).broken, (long long)broken);
}

TEST(a_change_behind_the_triggers_is_found_at_its_row)
{
    finds("UPDATE event SET text = 'x' WHERE id = 3", 3);
    finds("UPDATE event SET time = time + 1 WHERE id = 1", 1);
    finds("UPDATE event SET actor = 'Anni' WHERE id = 2", 2);
    finds("UPDATE event SET kind = 'Note' WHERE id = 5", 5);
    finds("UPDATE event SET actor = 'Ann', kind = 'anote' WHERE id = 4", 4);
    finds("UPDATE event SET hash = replace(hash, substr(hash, 1, 1), 'g') WHERE id = 2", 2);
    finds("DELETE FROM event WHERE id = 1", 2);
    finds("DELETE FROM event WHERE id = 3", 4);
    finds("UPDATE event SET id = 6 WHERE id = 5", 6);
    finds("CREATE TEMP TABLE t AS SELECT text FROM event WHERE id = 2; UPDATE event SET text = "
          "(SELECT text FROM event WHERE id = 3) WHERE id = 2",
          2);
}

TEST(a_printed_head_shows_that_the_end_was_cut_off)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_digest early, late;
    struct gsn_error err = { 0 };

    add(store, "a");
    CHECK_OK(gsn_event_head(store, &early, &err), err);
    add(store, "b");
    CHECK_OK(gsn_event_head(store, &late, &err), err);
    CHECK(verify(store, early.hex).head_is_there == 1);
    CHECK(verify(store, late.hex).head_is_there == 1);
    CHECK(bench_raw(&scratch, "DROP TRIGGER event_is_kept; DELETE FROM event WHERE id = 2") ==
          SQLITE_OK);
    CHECK(verify(store, NULL).broken == 0);
    CHECK(verify(store, early.hex).head_is_there == 1);
    CHECK(verify(store, late.hex).head_is_there == 0);
}

TEST(an_event_without_a_kind_is_refused)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    CHECK(gsn_event_add(store, NOON, "a", "", "c", "d", &err) == GSN_E_INPUT);
    CHECK(verify(store, NULL).count == 0);
}

static int add_once(struct gsn_store *store, struct gsn_error *err)
{
    return gsn_event_add(store, NOON, "a", "b", "c", "d", err);
}

static int verify_once(struct gsn_store *store, struct gsn_error *err)
{
    struct gsn_event_verdict verdict;

    return gsn_event_verify(store, NULL, &verdict, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(add_once(store, &err), err);
    CHECK_EVERY_OOM(add_once(store, &err), err);
    CHECK_EVERY_OOM(verify_once(store, &err), err);
    CHECK(verify(store, NULL).count == 2);
}
