/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/audit.h"

#include <fcntl.h>
#include <math.h>
#include <sqlite3.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/audit_log.h"
#include "storage/pagesum.h"
#include "storage/result.h"
#include "storage/sql.h"
#include "tests/storage/bench.h"

/* What an audit told, a line each. */
struct heard {
    unsigned count;
    char text[4000];
};

static void hear(void *context, const char *what, const char *sentence)
{
    struct heard *const heard = context;
    const size_t used = strlen(heard->text);

    heard->count++;
    (void)snprintf(heard->text + used, sizeof heard->text - used, "%s: %s\n", what, sentence);
}

static struct heard audit(struct gsn_store *store, const struct gsn_audit_head *heads, size_t count)
{
    struct heard heard = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_audit_pages(gsn_store_dir(store), hear, &heard, NULL, &err), err);
    CHECK_OK(gsn_audit_tables(store, hear, &heard, &err), err);
    CHECK_OK(gsn_audit_log(store, heads, count, hear, &heard, NULL, &err), err);
    CHECK_OK(gsn_audit_runs(store, 0, hear, &heard, &err), err);
    CHECK_OK(gsn_audit_ledger(store, hear, &heard, &err), err);
    return heard;
}

static void hears(struct gsn_store *store, const char *words)
{
    const struct heard heard = audit(store, NULL, 0);

    if (!strstr(heard.text, words))
        fail_msg("not told of \"%s\", only of:\n%s", words, heard.text);
}

/* A specimen with one panel and a run that has ended: the log has three events. */
static int64_t fill(struct gsn_store *store)
{
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t panel = bench_add_panel(store, specimen, 1);
    const struct gsn_measure_row measure = {
        .name = "mean_density", .value = 0.4, .lower = NAN, .upper = NAN, .unit = ""
    };
    const struct gsn_pose_row pose = { .panel_id = panel, .slot = 1, .serial = 1, .m00 = 1 };
    const struct gsn_stain_row stain = { .panel_id = panel, .source = "named" };
    const struct gsn_run_end end = { .state = "reported",
                                     .measures = &measure,
                                     .measure_count = 1,
                                     .poses = &pose,
                                     .pose_count = 1,
                                     .stains = &stain,
                                     .stain_count = 1 };
    const struct gsn_run_row run = { .specimen_id = specimen,
                                     .key = "k",
                                     .version = "1",
                                     .inputs_json = "",
                                     .parameters_json = "" };
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_OK(gsn_event_add(store, NOON, "Anna", "panel", "P.tif", bench_digest(1), &err), err);
    CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);
    CHECK_OK(gsn_run_finish(store, id, &end, NOON + 60, &err), err);
    CHECK_OK(gsn_event_add(store, NOON + 60, "gieson-work", "run", "S", "k", &err), err);
    return id;
}

TEST(a_page_has_the_sum_that_its_words_give)
{
    const uint8_t page[16] = { 1, 0, 0, 0, 2, 0, 0, 0, 5, 0, 0, 0, 0, 0, 0, 0x80 };
    uint8_t sum[GSN_PAGESUM_BYTES];

    /* 1; 2 + 1; 1 + 5 + 3; 3 + 0x80000000 + 9: SQLite's file format, section 4.2. */
    gsn_pagesum(page, sizeof page, sum);
    CHECK(memcmp(sum, (const uint8_t[]){ 9, 0, 0, 0, 12, 0, 0, 0x80 }, sizeof sum) == 0);
}

TEST(what_a_run_found_is_neither_changed_nor_removed_nor_replaced)
{
    static const char *const statements[] = {
        "UPDATE measure SET value = 1",
        "DELETE FROM measure",
        "INSERT INTO measure (run_id, name, value, unit) VALUES (1, 'more', 1, '')",
        "INSERT OR REPLACE INTO measure SELECT id, run_id, name, 1, lower, upper, unit FROM "
        "measure",
        "UPDATE pose SET m02 = 7",
        "DELETE FROM pose",
        "UPDATE stain_batch SET white_r = 7",
        "DELETE FROM stain_batch",
        "DELETE FROM run",
        "UPDATE run SET message = 'x'",
        "INSERT OR REPLACE INTO run (id, specimen_id, key, version, inputs_json, parameters_json, "
        "state, started) VALUES (1, 1, '', '', '', '', 'running', 1)",
        "DELETE FROM specimen",
    };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    (void)fill(store);
    for (size_t i = 0; i < sizeof statements / sizeof *statements; i++)
        if (bench_raw(&scratch, statements[i]) != SQLITE_CONSTRAINT)
            fail_msg("not refused: %s", statements[i]);
    CHECK(audit(store, NULL, 0).count == 0);
}

/* The newest event is gone, which left "the diary of 1 events is whole" before. */
TEST(a_log_that_was_cut_is_found_by_what_is_remembered_outside)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_audit_head head = { 0 };
    struct gsn_error err = { 0 };

    (void)fill(store);
    CHECK_OK(gsn_audit_tail(store, &head, &err), err);
    (void)snprintf(head.where, sizeof head.where, "the journal");
    CHECK(head.events == 3 && audit(store, &head, 1).count == 0);
    CHECK(bench_raw(&scratch, "DROP TRIGGER event_is_kept; DELETE FROM event WHERE id = 3") == 0);
    hears(store, "audit log: its newest events are gone: by audit.head there were 3\n");

    /* audit.head is the evidence, and stays as it is however the log grows; it can be removed. */
    for (int i = 0; i < 3; i++)
        CHECK_OK(gsn_event_add(store, NOON, "Anna", "note", "", "", &err), err);
    hears(store, "audit log: it was written anew: by audit.head its event 3 was another one\n");
    CHECK(unlink(gsn_scratch_path(&scratch, "audit.head")) == 0);
    hears(store, "audit.head: the file that says where the audit log ends is missing or damaged");
    CHECK_OK(gsn_event_add(store, NOON, "Anna", "note", "", "", &err), err);
    CHECK(audit(store, NULL, 0).count == 0);
    CHECK(strstr(audit(store, &head, 1).text,
                 "audit log: it was written anew: by the journal its event 3 was another one\n"));
}

TEST(rows_of_a_run_that_are_not_those_it_ended_with_are_found)
{
    static const char *const edits[][2] = {
        { "DROP TRIGGER measure_stays; UPDATE measure SET value = 0.4000000000000001",
          "run 1: its" },
        { "DROP TRIGGER pose_is_kept; DELETE FROM pose", "run 1: its" },
        { "DROP TRIGGER run_stays; UPDATE run SET state = 'withheld'", "run 1: its" },
        { "DROP TRIGGER event_is_kept; DELETE FROM event WHERE kind = 'seal'",
          "run 1: it has ended and the audit log has no seal of it" },
        { "DROP TRIGGER measure_is_kept; DROP TRIGGER pose_is_kept; DROP TRIGGER run_is_kept; DROP "
          "TRIGGER stain_batch_is_kept; DELETE FROM measure; DELETE FROM pose; DELETE FROM "
          "stain_batch; DELETE FROM run",
          "run 1: the audit log has its seal, and the run is gone" },
        { "DROP TRIGGER pose_is_kept; DROP TRIGGER "
          "stain_batch_is_kept; "
          "DELETE FROM pose; DELETE FROM stain_batch; DELETE FROM panel",
          "audit log: event 1 says that panel P.tif came in, and it is not there" },
    };

    for (size_t i = 0; i < sizeof edits / sizeof *edits; i++) {
        scratch_auto scratch = gsn_scratch_new();
        gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

        (void)fill(store);
        CHECK(bench_raw(&scratch, edits[i][0]) == SQLITE_OK);
        hears(store, edits[i][1]);
    }
}

TEST(a_run_whose_worker_died_is_sealed_too)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const struct gsn_run_row run = { .specimen_id = specimen,
                                     .key = "k",
                                     .version = "1",
                                     .inputs_json = "",
                                     .parameters_json = "" };
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);
    CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);
    CHECK(audit(store, NULL, 0).count == 0);
}

/* Each bit of one byte of every page, the unused ones among them. */
TEST(a_flipped_bit_is_found_on_its_page)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_pagesum_verdict verdict = { 0 };
    struct gsn_error err = { 0 };
    struct stat st;
    gsn_auto_fd fd = -1;

    {
        gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

        (void)fill(store);
    }
    CHECK_OK(gsn_audit_pages(scratch.dir, hear, &(struct heard){ 0 }, &verdict.without, &err), err);
    CHECK(verdict.without == 0);
    CHECK(gsn_file_reopen(gsn_scratch_path(&scratch, "gieson.db"), &fd, &err) == GSN_OK);
    CHECK(fstat(fd, &st) == 0 && st.st_size >= 40 * 4096);
    for (off_t page = 0; page < st.st_size / 4096; page++) {
        const off_t at = page * 4096 + 200 + (page * 97) % 3800;
        struct heard heard = { 0 };
        char what[40];
        uint8_t byte, flipped;

        CHECK(pread(fd, &byte, 1, at) == 1);
        flipped = (uint8_t)(byte ^ 1 << page % 8);
        CHECK(pwrite(fd, &flipped, 1, at) == 1);
        CHECK_OK(gsn_audit_pages(scratch.dir, hear, &heard, NULL, &err), err);
        (void)snprintf(what, sizeof what, "gieson.db, page %lld: ", (long long)page + 1);
        CHECK(heard.count == 1 && strstr(heard.text, what) == heard.text);
        CHECK(pwrite(fd, &byte, 1, at) == 1);
    }
}

/* Other programs may read a store, and SQLite then copies pages out of its log for them. */
TEST(another_program_that_reads_does_no_damage_and_one_that_writes_is_found)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };
    struct heard heard = { 0 };
    int64_t without = 0;

    {
        gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

        (void)fill(store);
        CHECK(bench_raw(&scratch, "PRAGMA wal_checkpoint") == SQLITE_OK);
    }
    CHECK_OK(gsn_audit_pages(scratch.dir, hear, &heard, &without, &err), err);
    CHECK(heard.count == 0 && without > 0);
    {
        gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_WRITE);

        (void)bench_add_specimen(store, "T", "g", "");
    }
    for (const char *const *name = (const char *const[]){ "gieson.db-wal", "gieson.db-shm", NULL };
         *name; name++)
        CHECK(unlink(gsn_scratch_path(&scratch, *name)) == 0);
    CHECK(bench_raw(&scratch, "UPDATE specimen SET week = 5 WHERE name = 'T'") == SQLITE_OK);
    CHECK_OK(gsn_audit_pages(scratch.dir, hear, &heard, &without, &err), err);
    CHECK(heard.count >= 1 && strstr(heard.text, "gieson.db, page "));
}

/* As a gieson of the eighth schema left it, with a run that has ended. */
TEST(an_older_store_gets_sums_in_its_pages_and_seals_for_its_runs)
{
    static const char *const schemas[] = { gsn_schema_001, gsn_schema_002, gsn_schema_003,
                                           gsn_schema_004, gsn_schema_005, gsn_schema_006,
                                           gsn_schema_007, gsn_schema_008 };
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof schemas / sizeof *schemas; i++)
        CHECK(bench_raw(&scratch, schemas[i]) == SQLITE_OK);
    CHECK(
        bench_raw(&scratch,
                  "PRAGMA application_id = 0x67736e31; PRAGMA user_version = 8; "
                  "PRAGMA journal_mode = WAL; INSERT INTO study VALUES (1, 'st'); "
                  "INSERT INTO study_group VALUES (1, 1, 'g'); INSERT INTO animal VALUES (1, 1, "
                  "'rat'); INSERT INTO specimen VALUES (1, 'S', 1, 1, 1, 4, 'sections', '', '{}', "
                  "printf('%064d', 0)); INSERT INTO run (specimen_id, key, version, inputs_json, "
                  "parameters_json, state, started) VALUES (1, 'k', '', '', '', 'reported', 1); "
                  "INSERT INTO measure (run_id, name, value, unit) VALUES (1, 'loss', 7, '%')") ==
        SQLITE_OK);
    {
        struct gsn_store *store = NULL;

        CHECK(gsn_store_open(scratch.dir, GSN_STORE_READ, &store, &err) == GSN_E_UNSUPPORTED);
    }
    gsn_store_free(bench_open(&scratch, GSN_STORE_WRITE));
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_WRITE);
    gsn_auto(gsn_measure_rows) measures = NULL;
    struct gsn_digest seal;
    int late = 0;

    CHECK(audit(store, NULL, 0).count == 0);
    CHECK_OK(gsn_audit_sealed(store, 1, &seal, &late, &err), err);
    CHECK(late == 1);
    CHECK_OK(gsn_measure_list(store, 1, &measures, &err), err);
    CHECK(measures->count == 1 && fabs(measures->at[0].value - 7) <= 0);
}

TEST(a_file_that_is_no_database_of_ours_is_refused_and_the_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };
    int64_t without = -7;

    CHECK(gsn_audit_pages(scratch.dir, hear, NULL, &without, &err) == GSN_E_NOTFOUND);
    CHECK(bench_raw(&scratch, "CREATE TABLE bookmark (url)") == SQLITE_OK);
    CHECK(gsn_audit_pages(scratch.dir, hear, NULL, &without, &err) == GSN_E_STORE);
    CHECK(strstr(err.text, "its first page is damaged") && without == -7);
}

TEST(a_copy_of_the_database_is_the_same_and_has_its_sums)
{
    scratch_auto scratch = gsn_scratch_new();
    scratch_auto other = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    struct heard heard = { 0 };
    int64_t without = -1;

    (void)fill(store);
    CHECK_OK(gsn_store_copy(store, gsn_scratch_path(&other, "gieson.db"), &err), err);
    CHECK_OK(gsn_audit_pages(other.dir, hear, &heard, &without, &err), err);
    CHECK(heard.count == 0 && without == 0);
    gsn_auto(gsn_store) copy = bench_open(&other, GSN_STORE_WRITE);
    struct gsn_digest a, b;

    CHECK_OK(gsn_event_head(store, &a, &err), err);
    CHECK_OK(gsn_event_head(copy, &b, &err), err);
    CHECK(strcmp(a.hex, b.hex) == 0);
    CHECK(gsn_store_copy(store, "/nowhere/at/all.db", &err) < 0);
}

static int audit_once(struct gsn_store *store, struct gsn_error *err)
{
    struct heard heard = { 0 };
    int r = gsn_audit_pages(gsn_store_dir(store), hear, &heard, NULL, err);

    if (r >= 0)
        r = gsn_audit_tables(store, hear, &heard, err);
    if (r >= 0)
        r = gsn_audit_log(store, NULL, 0, hear, &heard, NULL, err);
    if (r >= 0)
        r = gsn_audit_runs(store, 0, hear, &heard, err);
    return r < 0 ? r : gsn_audit_ledger(store, hear, &heard, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    (void)fill(store);
    CHECK_EVERY_OOM(audit_once(store, &err), err);
}
