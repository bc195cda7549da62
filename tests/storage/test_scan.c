/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/scan.h"

#include <string.h>
#include <sys/stat.h>

#include "storage/audit_log.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "storage/sql.h"
#include "tests/storage/bench.h"

static struct gsn_scan_row arrival(const char *name, unsigned digest)
{
    return (struct gsn_scan_row){ .source = "flatbed",
                                  .device = "04a9:31c0 SN1",
                                  .name = name,
                                  .key = "",
                                  .subject = "panel",
                                  .sha256 = bench_digest(digest),
                                  .size = 4711,
                                  .facts = "{\"ISO\":100}" };
}

/* Takes a picture and gives its row. */
static struct gsn_scan_row *arrive(struct gsn_store *store, const char *name, unsigned digest,
                                   unsigned number)
{
    const struct gsn_scan_row row = arrival(name, digest);
    struct gsn_scan_row *got = NULL;
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = -1;

    CHECK_OK(gsn_scan_stage(store, &row, number, NOON, &id, &again, &err), err);
    CHECK(again == 0);
    CHECK_OK(gsn_scan_commit_staged(store, &err), err);
    CHECK_OK(gsn_scan_get(store, id, &got, &err), err);
    return got;
}

static int64_t ask(struct gsn_store *store, const char *sql)
{
    struct gsn_error err = { 0 };
    int64_t value = -1;

    CHECK_OK(gsn_sql_int(store, sql, SQL_NO_ARGS, &value, &err), err);
    return value;
}

/* As long as nobody began the log anew. */
static int64_t wal_frames(const struct gsn_scratch *scratch)
{
    struct stat st;

    CHECK(stat(gsn_scratch_path(scratch, "gieson.db-wal"), &st) == 0);
    return (st.st_size - 32) / (4096 + 24);
}

static int64_t number_of(struct gsn_store *store, int64_t panel)
{
    gsn_auto(gsn_panel_row) row = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_panel_get(store, panel, &row, &err), err);
    return row->number;
}

TEST(a_scan_reads_back_as_it_was_taken)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) got = arrive(store, "IMG_1.JPG", 1, 0);

    CHECK(strcmp(got->source, "flatbed") == 0 && strcmp(got->device, "04a9:31c0 SN1") == 0);
    CHECK(strcmp(got->name, "IMG_1.JPG") == 0 && strcmp(got->subject, "panel") == 0);
    CHECK(strcmp(got->sha256, bench_digest(1)) == 0 && got->size == 4711);
    CHECK(strcmp(got->facts, "{\"ISO\":100}") == 0 && got->arrived == NOON);
    CHECK(strcmp(got->specimen, "") == 0 && got->panel_id == 0);
}

TEST(the_newest_of_a_subject_is_that_of_this_source)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_scan_row rows[] = { arrival("1", 1), arrival("2", 2), arrival("3", 3),
                                   arrival("4", 4) };
    gsn_auto(gsn_scan_row) panel = NULL;
    gsn_auto(gsn_scan_row) blank = NULL;
    gsn_auto(gsn_scan_row) none = NULL;
    struct gsn_error err = { 0 };
    int64_t id;
    int again;

    rows[2].subject = "blank";
    rows[3].source = "camera";
    for (size_t i = 0; i < 4; i++)
        CHECK_OK(gsn_scan_stage(store, &rows[i], 0, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_scan_commit_staged(store, &err), err);
    CHECK_OK(gsn_scan_newest(store, "flatbed", "panel", &panel, &err), err);
    CHECK(strcmp(panel->name, "2") == 0);
    CHECK_OK(gsn_scan_newest(store, "flatbed", "blank", &blank, &err), err);
    CHECK(strcmp(blank->name, "3") == 0);
    CHECK(gsn_scan_newest(store, "flatbed", "dark", &none, &err) == GSN_E_NOTFOUND && !none);
    CHECK(strcmp(err.text, "flatbed has given no dark picture yet") == 0);
}

/* Case 35. */
TEST(a_scan_that_nobody_can_place_is_unfiled_with_the_reason)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) got = NULL;

    (void)bench_add_specimen(store, "S1", "g", "");
    got = arrive(store, "S10-P1.tif", 1, 1); /* S10 is not S1 */
    CHECK(strcmp(got->state, "unfiled") == 0 && got->panel_id == 0);
    CHECK(strstr(got->reason, "gieson file") && strstr(got->reason, "flatbed"));
    CHECK(ask(store, "SELECT count(*) FROM panel") == 0);
    CHECK(ask(store, "SELECT count(*) FROM job") == 0);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'scan'") == 1);
}

TEST(the_longest_name_that_a_scan_begins_with_is_its_specimen)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) longer = NULL;
    gsn_auto(gsn_scan_row) shorter = NULL;

    (void)bench_add_specimen(store, "GVP", "g", "");
    (void)bench_add_specimen(store, "GVP-D-S02", "g", "");
    longer = arrive(store, "GVP-D-S02-P03.tif", 1, 3);
    CHECK(strcmp(longer->state, "filed") == 0 && strcmp(longer->specimen, "GVP-D-S02") == 0);
    CHECK(number_of(store, longer->panel_id) == 3);
    shorter = arrive(store, "GVP-D-S03-P03.tif", 2, 3);
    CHECK(strcmp(shorter->specimen, "GVP") == 0);
    CHECK(ask(store, "SELECT count(*) FROM job WHERE kind = 'panel'") == 2);
    CHECK(ask(store, "SELECT count(*) FROM job WHERE kind = 'specimen'") == 2);
}

TEST(digits_of_the_specimen_are_no_panel_number)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) got = NULL;

    (void)bench_add_specimen(store, "S02", "g", "");
    got = arrive(store, "S02.tif", 1, 2);
    CHECK(number_of(store, got->panel_id) == 0);
}

TEST(what_is_expected_takes_its_number_or_the_next_one)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) numbered = NULL;
    gsn_auto(gsn_scan_row) next = NULL;
    gsn_auto(gsn_scan_row) after = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "A", "g", "");
    CHECK_OK(gsn_scan_expect(store, "flatbed", "A", "ann", NOON, &err), err);
    numbered = arrive(store, "scan-P4.tif", 1, 4);
    CHECK(strcmp(numbered->specimen, "A") == 0 && number_of(store, numbered->panel_id) == 4);
    next = arrive(store, "IMG.JPG", 2, 0);
    CHECK(strcmp(next->specimen, "A") == 0 && number_of(store, next->panel_id) == 5);
    CHECK_OK(gsn_scan_expect(store, "flatbed", NULL, "ann", NOON, &err), err);
    after = arrive(store, "IMG2.JPG", 3, 0);
    CHECK(strcmp(after->state, "unfiled") == 0);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'expect'") == 2);
}

/* Case 33. */
TEST(a_name_that_contradicts_what_is_expected_is_for_a_person_to_settle)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) other = NULL;
    gsn_auto(gsn_scan_row) same = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "A", "g", "");
    (void)bench_add_specimen(store, "B", "g", "");
    CHECK_OK(gsn_scan_expect(store, "flatbed", "A", "ann", NOON, &err), err);
    other = arrive(store, "B-P4.tif", 1, 4);
    CHECK(strcmp(other->state, "unfiled") == 0 && other->panel_id == 0);
    CHECK(strcmp(other->reason, "A is expected from flatbed, but its name is that of B: say whose "
                                "it is with `gieson file`") == 0);
    same = arrive(store, "A-P2.tif", 2, 2);
    CHECK(strcmp(same->specimen, "A") == 0 && number_of(store, same->panel_id) == 2);
}

TEST(a_picture_is_safe_and_known_before_it_is_settled)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_store) reader = bench_open(&scratch, GSN_STORE_READ);
    gsn_auto(gsn_scan_row) got = NULL;
    struct gsn_scan_row row = arrival("S-P7.tif", 1);
    struct gsn_error err = { 0 };
    int64_t id = 0, same = 0;
    int64_t unsettled = -1;
    int again = -1, known = 0;

    (void)bench_add_specimen(store, "S", "g", "");
    row.key = "SN1/1";
    CHECK_OK(gsn_scan_stage(store, &row, 7, NOON, &id, &again, &err), err);
    CHECK(again == 0 && ask(reader, "SELECT count(*) FROM inbox") == 1);
    CHECK(ask(reader, "SELECT count(*) FROM scan") == 0);
    CHECK_OK(gsn_scan_count_staged(reader, &unsettled, &err), err);
    CHECK(unsettled == 1);
    CHECK_OK(gsn_scan_is_known(reader, "SN1/1", &known, &err), err);
    CHECK(known == 1);
    CHECK_OK(gsn_scan_stage(store, &row, 7, NOON + 9, &same, &again, &err), err);
    CHECK(again == 1 && same == id);

    /* Killed here, and started again. */
    gsn_store_free(store);
    store = bench_open(&scratch, GSN_STORE_WRITE);
    CHECK_OK(gsn_scan_count_staged(reader, &unsettled, &err), err);
    CHECK(unsettled == 0);
    CHECK_OK(gsn_scan_get(reader, id, &got, &err), err);
    CHECK(strcmp(got->state, "filed") == 0 && number_of(reader, got->panel_id) == 7);
    CHECK(got->arrived == NOON && strcmp(got->key, "SN1/1") == 0);
    CHECK(ask(reader, "SELECT time FROM event WHERE kind = 'scan'") == NOON);
    CHECK(ask(reader, "SELECT count(*) FROM job WHERE state = 'waiting'") == 2);
}

/* Whoever writes after it came finds it filed as it was then. */
TEST(nothing_is_written_between_a_picture_and_its_filing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_store) other = bench_open(&scratch, GSN_STORE_WRITE);
    gsn_auto(gsn_scan_row) before = NULL;
    gsn_auto(gsn_scan_row) after = NULL;
    struct gsn_event_verdict diary;
    struct gsn_error err = { 0 };
    const struct gsn_scan_row first = arrival("S-P1.tif", 1), second = arrival("S-P2.tif", 2);
    int64_t id[2];
    int again;

    CHECK_OK(gsn_scan_stage(store, &first, 1, NOON, &id[0], &again, &err), err);
    (void)bench_add_specimen(other, "S", "g", "");
    CHECK_OK(gsn_scan_stage(store, &second, 2, NOON, &id[1], &again, &err), err);
    CHECK_OK(gsn_scan_expect(other, "flatbed", NULL, "ann", NOON, &err), err);
    CHECK_OK(gsn_scan_get(other, id[0], &before, &err), err);
    CHECK_OK(gsn_scan_get(other, id[1], &after, &err), err);
    CHECK(id[1] == id[0] + 1);
    CHECK(strcmp(before->state, "unfiled") == 0 && strcmp(after->state, "filed") == 0);
    CHECK(ask(store, "SELECT (SELECT min(id) FROM event WHERE kind = 'scan') = 1") == 1);
    CHECK(ask(store, "SELECT (SELECT max(id) FROM event WHERE kind = 'scan') < "
                     "(SELECT id FROM event WHERE kind = 'expect')") == 1);
    CHECK_OK(gsn_event_verify(store, NULL, &diary, &err), err);
    CHECK(diary.broken == 0 && diary.count == 3);
}

/* Digests that differ in front, as those of bytes do. */
static struct gsn_scan_row picture(unsigned number, struct gsn_digest *digest)
{
    struct gsn_scan_row row = arrival("x", 0);

    (void)snprintf(digest->hex, sizeof digest->hex, "%08x%056x", number, number);
    row.sha256 = digest->hex;
    return row;
}

/* What a handle remembers of its own must hide nobody else's, and nothing that is gone. */
TEST(two_handles_take_no_picture_twice)
{
    enum { PICTURES = 40 };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) one = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_store) other = bench_open(&scratch, GSN_STORE_WRITE);
    struct gsn_store *const store[2] = { one, other };
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = -1;

    for (unsigned i = 0; i < PICTURES; i++) {
        struct gsn_digest digest;
        const struct gsn_scan_row row = picture(i, &digest);

        CHECK_OK(gsn_scan_stage(store[i / 3 % 2], &row, 0, NOON, &id, &again, &err), err);
        CHECK(again == 0 && id == i + 1);
        if (i % 11 == 10)
            CHECK_OK(gsn_scan_commit_staged(store[i % 2], &err), err);
        /* All that came so far, to either. */
        for (unsigned k = 0; k <= i; k++) {
            struct gsn_digest old_digest;
            const struct gsn_scan_row old = picture(k, &old_digest);

            CHECK_OK(gsn_scan_stage(store[k % 2], &old, 0, NOON, &id, &again, &err), err);
            CHECK(again == 1 && id == k + 1);
        }
    }
}

TEST(an_id_that_was_rolled_back_hides_no_picture)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_store) other = bench_open(&scratch, GSN_STORE_WRITE);
    struct gsn_digest digest[3];
    const struct gsn_scan_row undone = picture(1, &digest[0]), row = picture(2, &digest[1]),
                              next = picture(3, &digest[2]);
    struct gsn_error err = { 0 };
    int64_t id, same;
    int again = -1;

    CHECK_OK(gsn_store_begin(store, &err), err);
    CHECK_OK(gsn_scan_stage(store, &undone, 0, NOON, &id, &again, &err), err);
    gsn_store_rollback(store);
    CHECK_OK(gsn_scan_stage(other, &row, 0, NOON, &same, &again, &err), err);
    CHECK(same == id);
    CHECK_OK(gsn_scan_stage(store, &next, 0, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err), err);
    CHECK(again == 1 && id == same);
}

TEST(what_is_rolled_back_leaves_the_inbox_as_it_was)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct gsn_scan_row row = arrival("x.tif", 1);
    struct gsn_error err = { 0 };
    int64_t id;
    int again;

    CHECK_OK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_store_begin(store, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM scan") == 1);
    gsn_store_rollback(store);
    CHECK(ask(store, "SELECT count(*) FROM scan") == 0);
    CHECK(ask(store, "SELECT count(*) FROM inbox") == 1);
    CHECK_OK(gsn_scan_commit_staged(store, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM scan") == 1);
}

TEST(a_long_burst_is_settled_on_its_way)
{
    enum { BURST = 600, MOST = 256 };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = -1;

    for (unsigned i = 1; i <= BURST; i++) {
        const struct gsn_scan_row row = arrival("x", i);

        CHECK_OK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err), err);
        CHECK(again == 0 && id == i);
        CHECK(ask(store, "SELECT count(*) FROM inbox") <= MOST);
    }
    CHECK_OK(gsn_scan_commit_staged(store, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM scan") == BURST);
    CHECK(ask(store, "SELECT max(id) FROM scan") == BURST);
}

/* Every commit syncs its pages and writes them twice: once into the log, once from there. */
TEST(one_picture_dirties_one_page)
{
    enum { PICTURES = 60 };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    int64_t id = 0, frames = 0;
    int again = -1;

    for (unsigned i = 0; i <= PICTURES; i++) {
        const struct gsn_scan_row row = arrival("x", i);

        CHECK_OK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err), err);
        if (i == 0)
            frames = wal_frames(&scratch);
    }
    /* A page takes about ten; the next one costs a few. */
    CHECK(wal_frames(&scratch) - frames <= 2 * PICTURES);
}

TEST(the_same_picture_again_writes_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) first = NULL;
    const struct gsn_scan_row row = arrival("S-P1.tif", 1);
    struct gsn_error err = { 0 };
    int64_t id = 0, events;
    int again = -1;

    (void)bench_add_specimen(store, "S", "g", "");
    first = arrive(store, "S-P1.tif", 1, 1);
    events = ask(store, "SELECT count(*) FROM event");
    CHECK_OK(gsn_scan_stage(store, &row, 1, NOON + 1, &id, &again, &err), err);
    CHECK(again == 1 && id == first->id);
    CHECK(ask(store, "SELECT count(*) FROM scan") == 1);
    CHECK(ask(store, "SELECT count(*) FROM event") == events);
}

TEST(a_picture_that_nobody_could_place_is_not_placed_by_coming_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct gsn_scan_row row = arrival("IMG_7.JPG", 7);
    gsn_auto(gsn_scan_row) first = arrive(store, "IMG_7.JPG", 7, 0);
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = -1;

    (void)bench_add_specimen(store, "S", "g", "");
    CHECK_OK(gsn_scan_expect(store, "flatbed", "S", "ann", NOON, &err), err);
    CHECK_OK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err), err);
    CHECK(again == 1 && id == first->id);
    CHECK(ask(store, "SELECT count(*) FROM scan WHERE state = 'unfiled'") == 1);
    CHECK(ask(store, "SELECT (SELECT count(*) FROM panel) + (SELECT count(*) FROM job)") == 0);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'scan'") == 1);
}

/* Case 4. */
TEST(the_same_bytes_under_another_name_are_one_panel_and_two_scans)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) first = NULL;
    gsn_auto(gsn_scan_row) second = NULL;

    (void)bench_add_specimen(store, "S", "g", "");
    first = arrive(store, "S-P1.tif", 1, 1);
    second = arrive(store, "S-P1 (2).tif", 1, 1);
    CHECK(first->panel_id == second->panel_id && first->id != second->id);
    CHECK(ask(store, "SELECT count(*) FROM panel") == 1);
}

TEST(blank_glass_and_dark_frames_are_kept_and_are_no_panels)
{
    static const char *const subjects[] = { "blank", "dark" };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    for (unsigned i = 0; i < 2; i++) {
        struct gsn_scan_row row = arrival("S-P1.pam", i);
        gsn_auto(gsn_scan_row) got = NULL;
        int64_t id = 0;
        int again = -1;

        row.subject = subjects[i];
        CHECK_OK(gsn_scan_stage(store, &row, 1, NOON, &id, &again, &err), err);
        CHECK_OK(gsn_scan_commit_staged(store, &err), err);
        CHECK_OK(gsn_scan_get(store, id, &got, &err), err);
        CHECK(strcmp(got->state, "kept") == 0 && got->panel_id == 0);
        CHECK(gsn_scan_file(store, id, "S", 1, "ann", NOON, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "is no picture of a panel"));
    }
}

TEST(a_person_files_a_scan_once)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) scan = arrive(store, "x.tif", 1, 0);
    gsn_auto(gsn_scan_row) filed = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    CHECK(gsn_scan_file(store, scan->id, "S", 0, "ann", NOON, &err) == GSN_E_INPUT);
    CHECK(gsn_scan_file(store, scan->id, "T", 1, "ann", NOON, &err) == GSN_E_NOTFOUND);
    CHECK(gsn_scan_file(store, 99, "S", 1, "ann", NOON, &err) == GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "there is no scan 99"));
    CHECK_OK(gsn_scan_file(store, scan->id, "S", 7, "ann", NOON, &err), err);
    CHECK_OK(gsn_scan_get(store, scan->id, &filed, &err), err);
    CHECK(strcmp(filed->state, "filed") == 0 && strcmp(filed->specimen, "S") == 0);
    CHECK(strstr(filed->reason, "ann") && number_of(store, filed->panel_id) == 7);
    CHECK(gsn_scan_file(store, scan->id, "S", 8, "ann", NOON, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "is filed already, as a panel of S"));
    CHECK(number_of(store, filed->panel_id) == 7);
}

TEST(a_held_panel_takes_the_number_that_a_person_gives_and_is_looked_at_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) scan = NULL;
    gsn_auto(gsn_panel_row) panel = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    scan = arrive(store, "S.tif", 1, 0);
    CHECK_OK(gsn_panel_set_state(store, scan->panel_id, "held", "input", "no number", &err), err);
    CHECK(bench_raw(&scratch, "UPDATE job SET state = 'done'") == 0);
    CHECK_OK(gsn_scan_file(store, scan->id, "S", 2, "ann", NOON, &err), err);
    CHECK_OK(gsn_panel_get(store, scan->panel_id, &panel, &err), err);
    CHECK(panel->number == 2 && strcmp(panel->state, "waiting") == 0);
    CHECK(ask(store, "SELECT count(*) FROM job WHERE state = 'waiting'") == 2);
}

TEST(a_clock_that_jumps_changes_neither_order_nor_history)
{
    static const int64_t times[] = { NOON, NOON - 31536000, 0, NOON + 31536000, NOON };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_rows) rows = NULL;
    gsn_auto(gsn_panel_rows) panels = NULL;
    struct gsn_event_verdict verdict;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    for (unsigned i = 0; i < sizeof times / sizeof times[0]; i++) {
        gsn_auto_mem(char) name = gsn_format("S-P%u.tif", i + 1);
        const struct gsn_scan_row row = arrival(name, i + 1);
        int64_t id = 0;
        int again = -1;

        CHECK_OK(gsn_scan_stage(store, &row, i + 1, times[i], &id, &again, &err), err);
        CHECK(id == i + 1 && again == 0);
        if (i % 2)
            CHECK_OK(gsn_scan_commit_staged(store, &err), err);
    }
    CHECK_OK(gsn_scan_commit_staged(store, &err), err);
    CHECK_OK(gsn_scan_list(store, NULL, 0, &rows, &err), err);
    CHECK_OK(gsn_panel_list(store, 1, &panels, &err), err);
    CHECK(rows->count == 5 && rows->at[0].id == 5 && panels->count == 5);
    for (size_t i = 0; i < 5; i++)
        CHECK(rows->at[i].arrived == times[4 - i] && panels->at[i].number == (int64_t)i + 1);
    CHECK_OK(gsn_event_verify(store, NULL, &verdict, &err), err);
    CHECK(verdict.broken == 0 && verdict.count >= 5);
}

/* "scan 1 is filed already" was all that one typo at the bench left. */
TEST(a_filing_is_taken_back_as_if_it_had_never_been)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) scan = arrive(store, "IMG_1.JPG", 1, 0);
    gsn_auto(gsn_scan_row) now = NULL;
    gsn_auto(gsn_panel_rows) panels = NULL;
    const struct gsn_section_row found = { .slot = 1, .state = "found", .flags = "" };
    struct gsn_event_verdict verdict;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    (void)bench_add_specimen(store, "T", "g", "");
    CHECK(gsn_scan_unfile(store, scan->id, "ann", NOON, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "is not filed"));
    CHECK(gsn_scan_unfile(store, 99, "ann", NOON, &err) == GSN_E_NOTFOUND);
    CHECK_OK(gsn_scan_file(store, scan->id, "S", 7, "ann", NOON, &err), err);
    CHECK_OK(gsn_section_replace(store, 1, &found, 1, &err), err);
    CHECK(gsn_scan_file(store, scan->id, "T", 7, "ann", NOON, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "`gieson file 1 undo` takes that back"));
    CHECK_OK(gsn_scan_unfile(store, scan->id, "bob", NOON, &err), err);
    CHECK_OK(gsn_scan_get(store, scan->id, &now, &err), err);
    CHECK(strcmp(now->state, "unfiled") == 0 && now->panel_id == 0);
    CHECK(strcmp(now->reason, "taken back by bob: say whose it is with `gieson file`") == 0);
    CHECK(ask(store, "SELECT count(*) FROM panel") == 0);
    CHECK(ask(store, "SELECT count(*) FROM job WHERE panel_id IS NOT NULL") == 0);
    CHECK(ask(store, "SELECT count(*) FROM event WHERE kind = 'unfile' AND actor = 'bob'") == 1);
    CHECK_OK(gsn_scan_file(store, scan->id, "T", 7, "ann", NOON, &err), err);
    CHECK_OK(gsn_panel_list(store, 2, &panels, &err), err);
    CHECK(panels->count == 1 && panels->at[0].number == 7);
    CHECK_OK(gsn_event_verify(store, NULL, &verdict, &err), err);
    CHECK(verdict.broken == 0);
}

TEST(what_a_report_rests_on_is_kept_and_not_used_until_it_is_filed_again)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) scan = arrive(store, "IMG_1.JPG", 1, 0);
    gsn_auto(gsn_scan_row) other = arrive(store, "IMG_2.JPG", 2, 0);
    gsn_auto(gsn_panel_row) panel = NULL;
    gsn_auto(gsn_panel_row) again = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    CHECK_OK(gsn_scan_file(store, scan->id, "S", 7, "ann", NOON, &err), err);
    CHECK_OK(gsn_scan_file(store, other->id, "S", 7, "ann", NOON, &err), err);
    CHECK_OK(gsn_panel_set_state(store, 2, "held", "input", "two of one number", &err), err);
    CHECK_OK(gsn_sql_run(store,
                         "INSERT INTO run (specimen_id, key, version, inputs_json, "
                         "parameters_json, state, started) VALUES (1, 'k', 'v', '', '', 'running', "
                         "0)",
                         SQL_NO_ARGS, NULL, &err),
             err);
    CHECK_OK(gsn_sql_run(store,
                         "INSERT INTO pose (run_id, panel_id, slot, serial, m00, m01, m02, m10, "
                         "m11, m12, flipped, rotated180) VALUES (1, 1, 1, 1, 1, 0, 0, 0, 1, 0, 0, "
                         "0)",
                         SQL_NO_ARGS, NULL, &err),
             err);
    CHECK_OK(gsn_scan_unfile(store, scan->id, "bob", NOON, &err), err);
    CHECK_OK(gsn_panel_get(store, 1, &panel, &err), err);
    CHECK(strcmp(panel->state, "refused") == 0 && strstr(panel->message, "taken back by bob"));
    CHECK(ask(store, "SELECT count(*) FROM panel WHERE id = 2 AND state = 'waiting'") == 1);
    CHECK_OK(gsn_scan_file(store, scan->id, "S", 8, "ann", NOON, &err), err);
    CHECK_OK(gsn_panel_get(store, 1, &again, &err), err);
    CHECK(strcmp(again->state, "waiting") == 0 && again->number == 8);
}

TEST(a_filing_is_not_taken_back_while_its_panel_is_looked_at)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_row) scan = arrive(store, "IMG_1.JPG", 1, 0);
    gsn_auto(gsn_job_row) job = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    CHECK_OK(gsn_scan_file(store, scan->id, "S", 7, "ann", NOON, &err), err);
    CHECK_OK(gsn_queue_claim(store, "t", NOON, 60, 0, &job, &err), err);
    CHECK(gsn_scan_unfile(store, scan->id, "bob", NOON, &err) == GSN_E_BUSY);
    CHECK(ask(store, "SELECT count(*) FROM panel") == 1);
}

TEST(what_has_no_panels_is_not_expected)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_specimen_row tile = bench_specimen("T", "g", "");
    struct gsn_error err = { 0 };
    int64_t id = 0;

    tile.kind = "tile";
    CHECK_OK(gsn_specimen_put(store, &tile, GSN_SPECIMEN_REFUSE, "test", NOON, &id, &err), err);
    CHECK(gsn_scan_expect(store, "flatbed", "T", "ann", NOON, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "T is a tile and has no panels"));
    CHECK(gsn_scan_expect(store, "flatbed", "U", "ann", NOON, &err) == GSN_E_NOTFOUND);
    CHECK(ask(store, "SELECT count(*) FROM expectation") == 0);
}

TEST(a_key_is_known_once_its_scan_is_there_and_an_empty_one_never)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_scan_row row = arrival("a", 1);
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = -1, known = -1;

    CHECK_OK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_scan_is_known(store, "", &known, &err), err);
    CHECK(known == 0);
    row = arrival("b", 2);
    row.key = "SN1/1/b/4711/20260101T120000";
    CHECK_OK(gsn_scan_is_known(store, row.key, &known, &err), err);
    CHECK(known == 0);
    CHECK_OK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err), err);
    CHECK_OK(gsn_scan_is_known(store, row.key, &known, &err), err);
    CHECK(known == 1);
}

TEST(the_list_is_newest_first_by_state_and_no_longer_than_asked)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_scan_rows) all = NULL;
    gsn_auto(gsn_scan_rows) unfiled = NULL;
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    gsn_scan_row_free(arrive(store, "x.tif", 1, 0));
    gsn_scan_row_free(arrive(store, "S-P1.tif", 2, 1));
    gsn_scan_row_free(arrive(store, "y.tif", 3, 0));
    CHECK_OK(gsn_scan_list(store, NULL, 2, &all, &err), err);
    CHECK(all->count == 2 && strcmp(all->at[0].name, "y.tif") == 0);
    CHECK(strcmp(all->at[1].name, "S-P1.tif") == 0);
    CHECK_OK(gsn_scan_list(store, "unfiled", 0, &unfiled, &err), err);
    CHECK(unfiled->count == 2 && strcmp(unfiled->at[1].name, "x.tif") == 0);
}

TEST(what_is_no_scan_is_refused_and_the_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_scan_row row = arrival("a", 1);
    struct gsn_error err = { 0 };
    int64_t id = 55;
    int again = 56;

    row.sha256 = "no digest";
    CHECK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "scan a"));
    row = arrival("a", 1);
    row.size = 0;
    CHECK(gsn_scan_stage(store, &row, 0, NOON, &id, &again, &err) == GSN_E_INPUT);
    CHECK(id == 55 && again == 56);
    CHECK(ask(store, "SELECT count(*) FROM event") == 0);
}

static int take_once(struct gsn_store *store, const struct gsn_scan_row *row, struct gsn_error *err)
{
    int64_t id;
    int again;

    return gsn_scan_stage(store, row, 1, NOON, &id, &again, err);
}

static int list_once(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_scan_rows) rows = NULL;

    return gsn_scan_list(store, NULL, 0, &rows, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_scan_row filed = arrival("S-P1.tif", 1), unfiled = arrival("x", 2);
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "S", "g", "");
    CHECK_EVERY_OOM(take_once(store, &filed, &err), err);
    CHECK_EVERY_OOM(take_once(store, &unfiled, &err), err);
    CHECK_EVERY_OOM(gsn_scan_commit_staged(store, &err), err);
    CHECK_EVERY_OOM(gsn_scan_file(store, 2, "S", 2, "ann", NOON, &err), err);
    CHECK_EVERY_OOM(gsn_scan_expect(store, "flatbed", "S", "ann", NOON, &err), err);
    CHECK_EVERY_OOM(list_once(store, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM scan") == 2);
    CHECK(ask(store, "SELECT count(*) FROM panel") == 2);
}

TEST(a_store_of_the_first_schema_is_brought_up_with_its_data_kept)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_scan_row) scan = NULL;
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    int64_t id = 0, panel;

    CHECK(bench_raw(&scratch, gsn_schema_001) == 0);
    CHECK(bench_raw(&scratch, "PRAGMA application_id = 0x67736e31; PRAGMA user_version = 1; "
                              "PRAGMA journal_mode = WAL") == 0);
    CHECK(
        bench_raw(&scratch,
                  "INSERT INTO study VALUES (1, 'st'); INSERT INTO study_group VALUES (1, 1, 'g'); "
                  "INSERT INTO animal VALUES (1, 1, 'rat'); INSERT INTO specimen VALUES "
                  "(1, 'S', 1, 1, 1, 4, 'sections', '', '{}', printf('%064d', 0)); "
                  "INSERT INTO panel VALUES (1, 1, 3, 'P3.tif', printf('%064d', 3), 9, 'waiting', "
                  "'', '', 0, 0, NULL); INSERT INTO job (kind, specimen_id, panel_id) VALUES "
                  "('panel', 1, 1)") == 0);
    CHECK(gsn_store_open(scratch.dir, GSN_STORE_READ, &store, &err) == GSN_E_UNSUPPORTED);
    CHECK(strstr(err.text, "older gieson") && store == NULL);
    store = bench_open(&scratch, GSN_STORE_WRITE);
    CHECK(ask(store, "PRAGMA user_version") == 9);
    CHECK(ask(store, "SELECT integrity_check = 'ok' FROM pragma_integrity_check") == 1);
    CHECK(ask(store, "SELECT count(*) FROM job WHERE state = 'waiting' AND panel_id = 1") == 1);
    CHECK(number_of(store, 1) == 3);
    scan = arrive(store, "S-P4.tif", 4, 4);
    CHECK(strcmp(scan->specimen, "S") == 0 && number_of(store, scan->panel_id) == 4);
    panel = bench_add_panel(store, 1, 5);
    CHECK_OK(gsn_queue_add(store, 1, panel, &id, &err), err);
}

TEST(a_store_of_the_third_schema_is_brought_up_with_its_ledger_kept)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_scan_row) old = NULL;
    gsn_auto(gsn_scan_row) fresh = NULL;
    gsn_auto(gsn_store) store = NULL;
    struct gsn_scan_row row = arrival("S-P4.tif", 3);
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = 0;

    CHECK(bench_raw(&scratch, gsn_schema_001) == 0);
    CHECK(bench_raw(&scratch, gsn_schema_002) == 0);
    CHECK(bench_raw(&scratch, gsn_schema_003) == 0);
    CHECK(bench_raw(&scratch,
                    "PRAGMA application_id = 0x67736e31; PRAGMA user_version = 3; "
                    "PRAGMA journal_mode = WAL; "
                    "INSERT INTO scan (id, source, device, name, key, subject, sha256, size, "
                    "facts, state, reason, arrived) VALUES (41, 'flatbed', '', 'S-P4.tif', '', "
                    "'panel', printf('%064x', 3), 9, '', 'unfiled', 'why', 5)") == 0);
    store = bench_open(&scratch, GSN_STORE_WRITE);
    CHECK(ask(store, "PRAGMA user_version") == 9);
    CHECK(ask(store, "SELECT integrity_check = 'ok' FROM pragma_integrity_check") == 1);
    CHECK_OK(gsn_scan_get(store, 41, &old, &err), err);
    CHECK(strcmp(old->reason, "why") == 0 && old->arrived == 5);
    CHECK_OK(gsn_scan_stage(store, &row, 4, NOON, &id, &again, &err), err);
    CHECK(again == 1 && id == 41);
    fresh = arrive(store, "S-P5.tif", 4, 5);
    CHECK(fresh->id == 42);
}
