/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/worker/scrub.h"

#include "acquire/spool.h"
#include "storage/bench.h"
#include "storage/audit_log.h"
#include "tests/storage/bench.h"

#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* A store of three panels whose objects are there. */
struct originals {
    struct gsn_store *store;
    struct gsn_digest digest[3];
};

static struct originals fill(const struct gsn_scratch *scratch)
{
    struct originals o = { .store = bench_open(scratch, GSN_STORE_CREATE) };
    struct gsn_specimen_row row = bench_specimen("S01", "control", "");
    gsn_auto(gsn_spool) spool = NULL;
    struct gsn_error err = { 0 };
    int64_t specimen = 0;

    row.job_json = "{\"specimen\": \"S01\", \"study\": \"debris\", \"group\": \"control\", "
                   "\"animal\": \"rat 1\", \"week\": 4}";
    CHECK_OK(gsn_specimen_put(o.store, &row, GSN_SPECIMEN_REFUSE, "test", NOON, &specimen, &err),
             err);

    CHECK_OK(gsn_spool_open(scratch->dir, 0, &spool, &err), err);
    for (unsigned i = 0; i < 3; i++) {
        struct gsn_panel_row panel = bench_panel(specimen, i + 1);
        const char bytes[] = { 'p', (char)('0' + i) };
        struct gsn_spooled spooled;
        int64_t id = 0;
        int again = 0;

        CHECK_OK(gsn_spool_take(spool, bytes, sizeof bytes, "P.tif", &spooled, &err), err);
        o.digest[i] = spooled.digest;
        panel.sha256 = spooled.digest.hex;
        panel.size = (int64_t)spooled.size;
        CHECK_OK(gsn_panel_put(o.store, &panel, &id, &again, &err), err);
        CHECK_OK(gsn_event_add(o.store, NOON, "test", "panel", panel.file_name, panel.sha256, &err),
                 err);
    }
    return o;
}

static char *path_of(const struct originals *o, unsigned i)
{
    struct gsn_error err = { 0 };
    char *path = NULL;

    CHECK_OK(gsn_store_object_path(o->store, o->digest[i].hex, &path, &err), err);
    return path;
}

static void damage(const struct originals *o, unsigned i)
{
    gsn_auto_mem(char) path = path_of(o, i);

    CHECK(chmod(path, 0644) == 0);
    gsn_scratch_overwrite(path, 0, "q", 1);
}

static void mend(const struct originals *o, unsigned i)
{
    gsn_auto_mem(char) path = path_of(o, i);

    gsn_scratch_overwrite(path, 0, "p", 1);
}

static struct gsn_scrub_counts scrub(struct gsn_store *store)
{
    const struct gsn_scrub how = { .store = store, .actor = "test" };
    struct gsn_scrub_counts counts = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_scrub_run(&how, &counts, &err), err);
    return counts;
}

static size_t troubles(struct gsn_store *store)
{
    gsn_auto(gsn_trouble_rows) rows = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_trouble_list(store, &rows, &err), err);
    return rows->count;
}

TEST(every_object_is_read_to_its_last_byte)
{
    scratch_auto scratch = gsn_scratch_new();
    struct originals o = fill(&scratch);
    const struct gsn_scrub_counts counts = scrub(o.store);

    CHECK(counts.checked == 3 && counts.bytes == 6);
    CHECK(counts.damaged == 0 && counts.complete);
    gsn_store_free(o.store);
}

TEST(a_store_without_objects_is_whole)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct gsn_scrub_counts counts = scrub(store);

    CHECK(counts.checked == 0 && counts.complete);
}

/* Case 62. */
TEST(a_damaged_object_is_a_trouble_until_it_is_whole_again)
{
    scratch_auto scratch = gsn_scratch_new();
    struct originals o = fill(&scratch);

    damage(&o, 1);
    CHECK(scrub(o.store).damaged == 1 && troubles(o.store) == 1);
    CHECK(scrub(o.store).damaged == 1 && troubles(o.store) == 1);
    {
        gsn_auto(gsn_trouble_rows) rows = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_trouble_list(o.store, &rows, &err), err);
        CHECK(strstr(rows->at[0].reason, " of S01 rests on it: ") != NULL);
        CHECK(strstr(rows->at[0].reason, "its bytes are no longer those that came in") != NULL);
    }
    mend(&o, 1);
    CHECK(scrub(o.store).damaged == 0 && troubles(o.store) == 0);
    gsn_store_free(o.store);
}

TEST(a_round_begins_behind_the_object_that_is_written_down)
{
    scratch_auto scratch = gsn_scratch_new();
    struct originals o = fill(&scratch);
    const char *first = o.digest[0].hex;
    gsn_auto_mem(char) kept = NULL;

    for (unsigned i = 1; i < 3; i++)
        first = strcmp(o.digest[i].hex, first) < 0 ? o.digest[i].hex : first;
    kept = gsn_format("{\"after\": \"%s\", \"checked\": 1, \"damaged\": 1}", first);
    gsn_scratch_append(gsn_scratch_path(&scratch, "scrub.json"), kept, strlen(kept));

    const struct gsn_scrub_counts counts = scrub(o.store);

    CHECK(counts.checked == 2 && counts.round_checked == 3 && counts.round_damaged == 1);
    CHECK(access(gsn_scratch_path(&scratch, "scrub.json"), F_OK) < 0);
    gsn_store_free(o.store);
}

TEST(a_store_that_cannot_be_asked_is_refused_and_the_output_stays_untouched)
{
    scratch_auto scratch = gsn_scratch_new();
    struct originals o = fill(&scratch);
    const struct gsn_scrub how = { .store = o.store, .actor = "test" };
    struct gsn_scrub_counts counts = { .checked = -7 };
    struct gsn_error err = { 0 };

    CHECK(bench_raw(&scratch, "DROP TABLE attachment") == 0);
    CHECK(gsn_scrub_run(&how, &counts, &err) == GSN_E_STORE);
    CHECK(counts.checked == -7 && err.text[0]);
    gsn_store_free(o.store);
}

/* So that looking into all 256 is not what the sweep does. */
static void remove_empty_shelves(const struct gsn_scratch *scratch)
{
    char name[32];

    for (unsigned i = 0; i < 256; i++) {
        (void)snprintf(name, sizeof name, "objects/%02x", i);
        (void)rmdir(gsn_scratch_path(scratch, name));
    }
}

static int scrub_once(struct gsn_store *store, struct gsn_error *err)
{
    const struct gsn_scrub how = { .store = store, .actor = "test" };
    struct gsn_scrub_counts counts;

    return gsn_scrub_run(&how, &counts, err);
}

TEST(running_out_of_memory_leaks_nothing_and_condemns_no_object)
{
    scratch_auto scratch = gsn_scratch_new();
    struct originals o = fill(&scratch);
    struct gsn_error err = { 0 };

    damage(&o, 0);
    remove_empty_shelves(&scratch);
    CHECK_EVERY_OOM(scrub_once(o.store, &err), err);
    CHECK(troubles(o.store) == 1);
    gsn_store_free(o.store);
}
