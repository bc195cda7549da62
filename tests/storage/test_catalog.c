/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/storage/bench.h"

#include <math.h>
#include <string.h>

#include "storage/audit_log.h"

TEST(a_specimen_reads_back_as_it_was_written)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_row) got = NULL;
    struct gsn_error err = { 0 };
    const int64_t id = bench_add_specimen(store, "S02", "particles", "S00");

    CHECK_OK(gsn_specimen_get(store, "S02", &got, &err), err);
    CHECK(got->id == id);
    CHECK(strcmp(got->name, "S02") == 0 && strcmp(got->study, "debris") == 0);
    CHECK(strcmp(got->group, "particles") == 0 && strcmp(got->animal, "rat 1") == 0);
    CHECK(strcmp(got->kind, "sections") == 0 && strcmp(got->baseline, "S00") == 0);
    CHECK(strcmp(got->job_json, "{}") == 0);
    CHECK_NEAR(got->week, 4, 0);
    /* printf {} | sha256sum */
    CHECK(strcmp(got->job_sha256,
                 "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a") == 0);
}

TEST(a_week_not_told_stays_not_told)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_row) got = NULL;
    struct gsn_specimen_row row = bench_specimen("S", "", "");
    struct gsn_error err = { 0 };
    int64_t id = 0;

    row.week = NAN;
    CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "test", NOON, &id, &err), err);
    CHECK_OK(gsn_specimen_get_by_id(store, id, &got, &err), err);
    CHECK(got->week != got->week);
}

/* Case 63. */
TEST(any_name_is_data)
{
    static char endless[100001];
    const char *const names[] = { "a/b",
                                  "..",
                                  "'; DROP TABLE specimen; --",
                                  "M\xc3\xbcller \xe5\x8c\x97",
                                  "\xff\xfe not UTF-8",
                                  " ",
                                  "%s%n",
                                  endless };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_rows) all = NULL;
    struct gsn_error err = { 0 };

    memset(endless, 'n', sizeof endless - 1);
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        gsn_auto(gsn_specimen_row) got = NULL;
        const int64_t id = bench_add_specimen(store, names[i], names[i], names[i]);

        CHECK_OK(gsn_specimen_get(store, names[i], &got, &err), err);
        CHECK(got->id == id);
        CHECK(strcmp(got->name, names[i]) == 0 && strcmp(got->group, names[i]) == 0);
    }
    CHECK_OK(gsn_specimen_list(store, &all, &err), err);
    CHECK(all->count == sizeof names / sizeof names[0]);
}

TEST(the_same_settings_twice_are_the_same_specimen)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_rows) all = NULL;
    struct gsn_error err = { 0 };
    const int64_t first = bench_add_specimen(store, "S", "g", "");

    CHECK(bench_add_specimen(store, "S", "g", "") == first);
    CHECK_OK(gsn_specimen_list(store, &all, &err), err);
    CHECK(all->count == 1);
}

TEST(other_settings_under_a_known_name_are_refused)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_row) got = NULL;
    struct gsn_specimen_row row = bench_specimen("S", "other", "");
    struct gsn_error err = { 0 };
    int64_t id = -7;

    (void)bench_add_specimen(store, "S", "g", "");
    row.job_json = "{ }";
    CHECK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "t", NOON, &id, &err) == GSN_E_INPUT);
    CHECK(id == -7);
    CHECK(strstr(err.text, "specimen S exists with other settings (44136fa3, now ") != NULL);
    CHECK(strstr(err.text, "use another name or `gieson import --replace`") != NULL);
    CHECK_OK(gsn_specimen_get(store, "S", &got, &err), err);
    CHECK(strcmp(got->job_json, "{}") == 0 && strcmp(got->group, "g") == 0);
}

/* Case 61. */
TEST(replacing_keeps_the_old_settings_in_the_diary)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_row) got = NULL;
    gsn_auto(gsn_event_rows) events = NULL;
    struct gsn_specimen_row row = bench_specimen("S", "other", "S00");
    struct gsn_error err = { 0 };
    const int64_t id = bench_add_specimen(store, "S", "g", "");
    int64_t same = 0;

    row.job_json = "{ }";
    CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REPLACE, "Anna", NOON + 5, &same, &err),
             err);
    CHECK(same == id);
    CHECK_OK(gsn_specimen_get(store, "S", &got, &err), err);
    CHECK(strcmp(got->job_json, "{ }") == 0 && strcmp(got->group, "other") == 0);
    CHECK(strcmp(got->baseline, "S00") == 0);
    CHECK_OK(gsn_event_list(store, 0, &events, &err), err);
    CHECK(events->count == 1);
    CHECK(strcmp(events->at[0].kind, "replace") == 0 && strcmp(events->at[0].actor, "Anna") == 0);
    CHECK(strcmp(events->at[0].subject, "S") == 0 && strcmp(events->at[0].text, "{}") == 0);
    CHECK(events->at[0].time == NOON + 5);
}

TEST(what_is_no_specimen_is_refused_and_leaves_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_rows) all = NULL;
    struct gsn_specimen_row row = bench_specimen("", "g", "");
    struct gsn_error err = { 0 };
    int64_t id = -7;

    CHECK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "t", NOON, &id, &err) == GSN_E_INPUT);
    row = bench_specimen("S", "g", "");
    row.kind = "cake";
    CHECK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "t", NOON, &id, &err) == GSN_E_INPUT);
    CHECK(id == -7);
    CHECK_OK(gsn_specimen_list(store, &all, &err), err);
    CHECK(all->count == 0 && all->at != NULL);
}

TEST(an_unknown_specimen_is_named)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_specimen_row *got = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_specimen_get(store, "S99", &got, &err) == GSN_E_NOTFOUND);
    CHECK(strcmp(err.text, "there is no specimen S99: `gieson status` lists them") == 0);
    CHECK(got == NULL);
}

static size_t count_baseline(struct gsn_store *store, const char *study, const char *text)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_baseline(store, study, text, &rows, &err), err);
    return rows->count;
}

static size_t count_dependents(struct gsn_store *store, int64_t id)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_dependents(store, id, &rows, &err), err);
    return rows->count;
}

TEST(a_baseline_is_a_specimen_else_a_group_of_the_same_study)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_specimen_row stranger = bench_specimen("X1", "control", "control");
    struct gsn_error err = { 0 };
    const int64_t c1 = bench_add_specimen(store, "C1", "control", "");
    const int64_t c2 = bench_add_specimen(store, "C2", "control", "control");
    int64_t x1 = 0;

    stranger.study = "another";
    CHECK_OK(gsn_specimen_put(store, &stranger, GSN_SPECIMEN_REFUSE, "t", NOON, &x1, &err), err);
    (void)bench_add_specimen(store, "T1", "treated", "control");
    (void)bench_add_specimen(store, "T2", "treated", "C1");
    CHECK(count_baseline(store, "debris", "control") == 2);
    CHECK(count_baseline(store, "another", "control") == 1);
    CHECK(count_baseline(store, "debris", "C1") == 1);
    CHECK(count_baseline(store, "debris", "") == 0);
    CHECK(count_baseline(store, "debris", "nobody") == 0);
    CHECK(count_dependents(store, c1) == 3); /* C2 and T1 by the group, T2 by the name */
    CHECK(count_dependents(store, c2) == 1); /* T1; never itself */
    CHECK(count_dependents(store, x1) == 0);

    /* A specimen that is called like the group takes its place. */
    const int64_t named = bench_add_specimen(store, "control", "treated", "");

    CHECK(count_baseline(store, "debris", "control") == 1);
    CHECK(count_dependents(store, c1) == 1);
    CHECK(count_dependents(store, named) == 3); /* names know no study: C2, T1 and X1 */
}

static int put_once(struct gsn_store *store, struct gsn_error *err)
{
    const struct gsn_specimen_row row = bench_specimen("S", "g", "");
    int64_t id = 0;

    return gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "t", NOON, &id, err);
}

static int replace_once(struct gsn_store *store, struct gsn_error *err)
{
    struct gsn_specimen_row row = bench_specimen("S", "h", "");
    int64_t id = 0;

    row.job_json = "{ }";
    return gsn_specimen_put(store, &row, GSN_SPECIMEN_REPLACE, "t", NOON, &id, err);
}

static int list_once(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;

    return gsn_specimen_list(store, &rows, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(put_once(store, &err), err);
    CHECK_EVERY_OOM(replace_once(store, &err), err);
    CHECK_EVERY_OOM(list_once(store, &err), err);
}
