/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the pages of many specimens cost, on a store whose reports are as large as those of 36
 * sections. Times are of the processor, so that what else the machine does is in none of them. */
#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "storage/result.h"
#include "systemd/worker/store_index.h"
#include "systemd/worker/study.h"
#include "tests/storage/bench.h"

#include <math.h>
#include <string.h>
#include <time.h>

enum { SECTIONS = 36, GROUPS = 4 };

static double seconds_used(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

/* gives. */
static char *make_report(double density, double loss)
{
    char *text = gsn_format(
        "{\"schema\": \"gieson-report-1\", \"kind\": \"specimen\", \"loss_percent\": %.6f, "
        "\"loss_interval\": {\"lower\": %.6f, \"upper\": %.6f}, \"region\": {\"volume_mm3\": "
        "0.98}, "
        "\"mean\": %.6f, \"volumes\": [{\"threshold\": 0.3, \"estimate_mm3\": %.6f}, "
        "{\"threshold\": 0.5, \"estimate_mm3\": %.6f}, {\"threshold\": 0.7, \"estimate_mm3\": "
        "%.6f}]",
        loss, loss - 0.4, loss + 0.4, density, density, 0.8 * density, 0.6 * density);

    for (int i = 0; i < SECTIONS; i++) {
        char *const more =
            gsn_format("%s%s{\"serial\": %d, \"filler\": \"%01200d\"}%s", text,
                       i ? "," : ", \"sections\": [", i, 0, i == SECTIONS - 1 ? "]}" : "");

        gsn_free(text);
        text = more;
    }
    CHECK(text);
    return text;
}

static void add_run(const struct gsn_scratch *scratch, struct gsn_store *store, int64_t specimen,
                    const char *name, double density, double loss)
{
    const struct gsn_run_row run = { .specimen_id = specimen,
                                     .key = bench_digest((unsigned)specimen),
                                     .version = "1",
                                     .inputs_json = "[]",
                                     .parameters_json = "{}" };
    const struct gsn_measure_row measure[] = {
        { .name = "mean_density", .value = density, .lower = NAN, .upper = NAN, .unit = "density" }
    };
    gsn_auto_mem(char) folder = gsn_format("%s/reports/%s/k", scratch->dir, name);
    gsn_auto_mem(char) path = gsn_format("reports/%s/k/report.json", name);
    gsn_auto_mem(char) page = gsn_format("reports/%s/k/report.html", name);
    gsn_auto_mem(char) whole = gsn_format("%s/%s", scratch->dir, path);
    gsn_auto_mem(char) text = make_report(density, loss);
    struct gsn_digest digest;
    struct gsn_error err = { 0 };
    int64_t id = 0;

    CHECK_OK(gsn_file_mkdir(folder, &err), err);
    CHECK_OK(gsn_file_write(whole, text, strlen(text), &err), err);
    CHECK_OK(gsn_sha256(text, strlen(text), &digest, &err), err);
    CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);

    const struct gsn_run_end end = { .state = "reported",
                                     .report_path = page,
                                     .report_sha256 = digest.hex,
                                     .json_path = path,
                                     .json_sha256 = digest.hex,
                                     .measures = measure,
                                     .measure_count = 1 };

    CHECK_OK(gsn_run_finish(store, id, &end, NOON + 60, &err), err);
}

/* Studies of so many animals: four groups, the first of which is the control, at two weeks. */
static void add_study(const struct gsn_scratch *scratch, struct gsn_store *store, int study,
                      int animals)
{
    static const char *const group[GROUPS] = { "placebo", "A", "B", "C" };
    gsn_auto_mem(char) named = gsn_format("study %d", study);
    struct gsn_error err = { 0 };

    for (int i = 0; i < animals; i++) {
        gsn_auto_mem(char) name = gsn_format("S%d-%03d", study, i);
        const int g = i % GROUPS;
        const double loss = 10 * g + 3 * sin(i);
        const struct gsn_specimen_row row = { .name = name,
                                              .study = named,
                                              .group = group[g],
                                              .animal = name,
                                              .week = i / GROUPS % 2 ? 4 : 8,
                                              .kind = "sections",
                                              .baseline = g ? "placebo" : "",
                                              .job_json = "{}",
                                              .job_sha256 = "" };
        int64_t id = 0;

        CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "test", NOON, &id, &err), err);
        add_run(scratch, store, id, name, 0.6 * (1 - loss / 100), loss);
    }
}

static double time_index(struct gsn_store *store)
{
    struct gsn_error err = { 0 };
    const double began = seconds_used();

    CHECK_OK(gsn_store_index_write(store, &err), err);
    return seconds_used() - began;
}

static double time_study(struct gsn_store *store, const char *name, size_t animals)
{
    gsn_auto(gsn_study_files) files = NULL;
    gsn_auto(gsn_study) study = NULL;
    gsn_auto_mem(char) folder = NULL;
    struct gsn_error err = { 0 };
    const double began = seconds_used();

    CHECK_OK(gsn_study_gather(store, name, &files, &err), err);
    CHECK_OK(gsn_study_analyse(gsn_study_files_input(files), &study, &err), err);
    CHECK_OK(gsn_study_write(store, study, &folder, &err), err);
    CHECK(study->animal_count == animals);
    return seconds_used() - began;
}

TEST(three_hundred_specimens_have_their_front_page_in_five_seconds)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    double few, many;

    add_study(&scratch, store, 1, 100);
    few = time_index(store);
    add_study(&scratch, store, 2, 100);
    add_study(&scratch, store, 3, 100);
    many = time_index(store);
    printf("front page: 100 specimens %.2f s, 300 %.2f s, slope %.2f\n", few, many,
           log(many / few) / log(3));
    CHECK(many <= 5);
}

TEST(a_study_of_a_hundred_animals_is_made_in_ten_seconds)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    double few, many;

    add_study(&scratch, store, 1, 100);
    add_study(&scratch, store, 2, 300);
    few = time_study(store, "study 1", 100);
    many = time_study(store, "study 2", 300);
    printf("study: 100 animals %.2f s, 300 %.2f s, slope %.2f\n", few, many,
           log(many / few) / log(3));
    CHECK(few <= 10);
}
