/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What controls handed on in the store is what a treated specimen is compared with. */
#include "systemd/worker/baseline.h"
#include "systemd/worker/job_inputs.h"
#include "systemd/worker/specimen_job.h"
#include "tests/check.h"
#include "tests/storage/bench.h"

#include <math.h>
#include <string.h>

static const char JOB[] =
    "{\"specimen\": \"a\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 1, "
    "\"baseline\": \"healthy\", \"markers_um\": [[0, 0], [600, 0], [0, 900]]}";

static const double VALUE[] = { 0.7, 0.4, 0.9 }, ERROR[] = { 0.01, 0.02, 0.03 },
                    COVARIANCE[] = { 1e-4, -2e-4, 3e-4 }; /* of 1 0, 2 0, 2 1 */

static struct gsn_store *with_treated(const struct gsn_scratch *scratch, int64_t *ret_id)
{
    struct gsn_store *store = bench_open(scratch, GSN_STORE_CREATE);
    struct gsn_specimen_row row = bench_specimen("a", "treated", "healthy");
    struct gsn_error err = { 0 };

    row.job_json = JOB;
    CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "test", NOON, ret_id, &err), err);
    return store;
}

/* A control that was reported: its first so many tissues read so many times VALUE, and its vectors
 * turned by so much on so many panels. */
struct control {
    const char *name;
    double times, variance, freedom;
    unsigned tissues;
    const char *parameters;
};

static size_t add_tissues(const struct control *c, struct gsn_measure_row *rows)
{
    size_t count = 0;

    for (unsigned t = 0; t < c->tissues; t++) {
        const double value = c->times * VALUE[t], wide = 1.96 * ERROR[t];

        rows[count++] = (struct gsn_measure_row){ .name = gsn_specimen_tissue_measure(t),
                                                  .value = value,
                                                  .lower = value - wide,
                                                  .upper = value + wide,
                                                  .unit = "density" };
        for (unsigned u = 0; u < t; u++)
            rows[count++] = (struct gsn_measure_row){ .name = gsn_specimen_tissues_measure(t, u),
                                                      .value = COVARIANCE[t + u - 1],
                                                      .lower = NAN,
                                                      .upper = NAN,
                                                      .unit = "density^2" };
    }
    return count;
}

static void add_control(struct gsn_store *store, const struct control *c)
{
    struct gsn_measure_row rows[16] = { { .name = "mean_density",
                                          .value = c->times,
                                          .lower = NAN,
                                          .upper = NAN,
                                          .unit = "density" },
                                        { .name = "vector_turns",
                                          .value = c->variance,
                                          .lower = NAN,
                                          .upper = NAN,
                                          .unit = "rad^2" },
                                        { .name = "vector_turns_freedom",
                                          .value = c->freedom,
                                          .lower = NAN,
                                          .upper = NAN,
                                          .unit = "" } };
    const struct gsn_run_row run = { .specimen_id =
                                         bench_add_specimen(store, c->name, "healthy", ""),
                                     .key = bench_digest(7),
                                     .version = "test",
                                     .inputs_json = "[]",
                                     .parameters_json = c->parameters ? c->parameters : "{}" };
    struct gsn_run_end end = { .state = "reported", .measures = rows };
    struct gsn_error err = { 0 };
    int64_t id;

    end.measure_count = 3 + add_tissues(c, rows + 3);
    CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);
    CHECK_OK(gsn_run_finish(store, id, &end, NOON, &err), err);
}

static const struct control ONE = { "c", 1, 0.002, 4, GSN_CONTROL_TISSUES, NULL },
                            OTHER = { "d", 1.2, 0.005, 2, GSN_CONTROL_TISSUES, NULL };

static struct gsn_job_inputs *loaded(struct gsn_store *store, int64_t id)
{
    struct gsn_job_inputs *inputs = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_job_inputs_load(store, id, NULL, &inputs, &err), err);
    return inputs;
}

TEST(the_tissues_of_one_control_come_back_with_their_errors_and_what_these_share)
{
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);

    add_control(store, &ONE);
    gsn_auto(gsn_job_inputs) inputs = loaded(store, id);
    const struct gsn_specimen_baseline *b = &gsn_job_inputs_specimen(inputs)->baseline;

    CHECK(b->specimens == 1);
    for (unsigned t = 0; t < GSN_CONTROL_TISSUES; t++) {
        CHECK_NEAR(b->tissues.value[t], VALUE[t], 1e-12);
        CHECK_NEAR(b->tissues.covariance[t][t], ERROR[t] * ERROR[t], 1e-12);
        for (unsigned u = 0; u < t; u++) {
            CHECK_NEAR(b->tissues.covariance[t][u], COVARIANCE[t + u - 1], 1e-12);
            CHECK_NEAR(b->tissues.covariance[u][t], COVARIANCE[t + u - 1], 1e-12);
        }
    }
    CHECK_NEAR(b->turns.variance, 0.002, 1e-12);
    CHECK_NEAR(b->turns.freedom, 4, 0);
}

/* Independent ones: the covariance of a mean of n is a mean of theirs over n. */
TEST(the_tissues_of_several_controls_are_their_mean)
{
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);

    add_control(store, &ONE);
    add_control(store, &OTHER);
    gsn_auto(gsn_job_inputs) inputs = loaded(store, id);
    const struct gsn_specimen_baseline *b = &gsn_job_inputs_specimen(inputs)->baseline;

    CHECK(b->specimens == 2);
    CHECK_NEAR(b->mean_density, 1.1, 1e-12);
    for (unsigned t = 0; t < GSN_CONTROL_TISSUES; t++) {
        CHECK_NEAR(b->tissues.value[t], 1.1 * VALUE[t], 1e-12);
        CHECK_NEAR(b->tissues.covariance[t][t], ERROR[t] * ERROR[t] / 2, 1e-12);
        for (unsigned u = 0; u < t; u++)
            CHECK_NEAR(b->tissues.covariance[t][u], COVARIANCE[t + u - 1] / 2, 1e-12);
    }
    CHECK_NEAR(b->turns.variance, (0.002 * 4 + 0.005 * 2) / 6, 1e-12);
    CHECK_NEAR(b->turns.freedom, 6, 0);
}

/* One that did not hand a tissue on leaves it unknown of all. */
TEST(a_tissue_that_one_control_lacks_is_not_known)
{
    struct control other = OTHER;
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);

    add_control(store, &ONE);
    other.tissues--;
    add_control(store, &other);
    gsn_auto(gsn_job_inputs) inputs = loaded(store, id);
    const struct gsn_control_tissues *tissues = &gsn_job_inputs_specimen(inputs)->baseline.tissues;
    const double lacked = tissues->value[other.tissues];

    for (unsigned t = 0; t < other.tissues; t++)
        CHECK_NEAR(tissues->value[t], 1.1 * VALUE[t], 1e-12);
    CHECK(lacked != lacked); /* NaN */
}

/* 1/3 takes all digits of a double. */
TEST(what_a_run_hands_on_of_its_colours_comes_back_beside_its_tissues)
{
    struct gsn_cloud_bin bin[] = { { 7, 12, 0.75 }, { 9000, 3, 1.25 } };
    struct gsn_cloud_panel panel[] = { { 1, 0, 0, NULL, 0 }, { 2, 1e-5, 1, bin, 2 } };
    struct gsn_cloud cloud = { panel, 2 };
    const struct gsn_specimen_result result = { .definition = "of \"red\"",
                                                .dyes = "set",
                                                .colours = { .region_od = { 1.0 / 3, 0.5, 0.25 },
                                                             .free_od = { 0.1, 0.2, 0.3 },
                                                             .free_panels = 2.5,
                                                             .yellow = { 0.125, (double)NAN, 0.5 },
                                                             .cloud = &cloud } };
    struct control whole = ONE, none = OTHER;
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);
    gsn_auto_mem(char) parameters = gsn_run_parameters("key", &result);

    whole.parameters = parameters;
    add_control(store, &whole);
    add_control(store, &none); /* by a version that did not hand them on */
    gsn_auto(gsn_job_inputs) inputs = loaded(store, id);
    const struct gsn_specimen_baseline *b = &gsn_job_inputs_specimen(inputs)->baseline;
    const struct gsn_specimen_control *control = b->control;

    assert_string_equal(b->definition, "of \"red\"");
    assert_string_equal(b->dyes, "set");
    CHECK(b->specimens == 2);
    CHECK(control[0].region_od[0] == 1.0 / 3 && control[0].region_od[2] == 0.25);
    CHECK(control[0].free_panels == 2.5 && control[1].free_panels == 0);
    CHECK(control[0].free_od[2] == 0.3 && isnan(control[1].free_od[0]));
    CHECK(control[0].yellow[0] == 0.125 && isnan(control[0].yellow[1]));
    CHECK(control[0].cloud && control[0].cloud->panels == 1); /* one holds nothing */
    CHECK(control[0].cloud->panel[0].panel == 2 && control[0].cloud->panel[0].bins == 2);
    CHECK_NEAR(control[0].cloud->panel[0].noise, 1e-5, 1e-18);
    CHECK(control[0].cloud->panel[0].lossy);
    CHECK(control[0].cloud->panel[0].bin[1].at == 9000);
    CHECK_NEAR(control[0].cloud->panel[0].bin[1].cells, 3, 0);
    CHECK_NEAR(control[0].cloud->panel[0].bin[1].od, 1.25, 1e-12);
    CHECK(!control[1].cloud && isnan(control[1].region_od[0]));
    for (unsigned t = 0; t < none.tissues; t++) {
        CHECK_NEAR(control[0].tissues.value[t], VALUE[t], 1e-12);
        CHECK_NEAR(control[1].tissues.covariance[t][t], ERROR[t] * ERROR[t], 1e-12);
    }
}

static const char TWO[] =
    "{\"specimen\": \"a\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 1, "
    "\"baseline\": \"healthy\", \"markers_um\": [[0, 0], [600, 0], [0, 900]], \"region\": "
    "{\"shape\": \"sphere\", \"centre\": [1, 2, 3], \"radius\": 400}, \"regions\": {\"left\": "
    "{\"shape\": \"sphere\", \"centre\": [1, 2, 3], \"radius\": 90}, \"right\": "
    "{\"shape\": \"sphere\", \"centre\": [9, 2, 3], \"radius\": 90}}}";

/* What a run hands on of its named regions comes back beside the regions of that name. */
TEST(a_named_region_is_compared_with_the_baselines_of_its_name)
{
    static struct gsn_specimen_result left = {
        .name = "left", .definition = "of left", .dyes = "set", .region = "a sphere"
    };
    const struct gsn_specimen_result result = { .definition = "of all",
                                                .dyes = "set",
                                                .region = "a ball",
                                                .part = { &left },
                                                .part_count = 1 };
    struct gsn_measure_row rows[] = {
        { .name = "mean_density", .value = 0.75, .lower = NAN, .upper = NAN, .unit = "density" },
        { .name = "left/mean_density",
          .value = 0.5,
          .lower = NAN,
          .upper = NAN,
          .unit = "density" },
        { .name = "left/region_volume", .value = 0.25, .lower = NAN, .upper = NAN, .unit = "mm3" },
    };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto_mem(char) parameters = gsn_run_parameters("key", &result);
    struct gsn_specimen_row row = bench_specimen("a", "treated", "healthy");
    const struct gsn_run_end end = { .state = "reported", .measures = rows, .measure_count = 3 };
    struct gsn_run_row run = { .key = bench_digest(7),
                               .version = "test",
                               .inputs_json = "[]",
                               .parameters_json = parameters };
    struct gsn_error err = { 0 };
    int64_t id, run_id;

    row.job_json = TWO;
    CHECK_OK(gsn_specimen_put(store, &row, GSN_SPECIMEN_REFUSE, "test", NOON, &id, &err), err);
    run.specimen_id = bench_add_specimen(store, "c", "healthy", "");
    CHECK_OK(gsn_run_begin(store, &run, NOON, &run_id, &err), err);
    CHECK_OK(gsn_run_finish(store, run_id, &end, NOON, &err), err);
    gsn_auto(gsn_job_inputs) inputs = loaded(store, id);
    const struct gsn_specimen *s = gsn_job_inputs_specimen(inputs);

    CHECK(s->baseline.specimens == 1 && s->baseline.lacking == 0);
    CHECK_NEAR(s->baseline.mean_density, 0.75, 0);
    assert_string_equal(s->baseline.region, "a ball");
    CHECK(s->named[0].baseline.specimens == 1);
    CHECK_NEAR(s->named[0].baseline.mean_density, 0.5, 0);
    CHECK_NEAR(s->named[0].baseline.volume_mm3, 0.25, 0);
    assert_string_equal(s->named[0].baseline.definition, "of left");
    assert_string_equal(s->named[0].baseline.region, "a sphere");
    CHECK(s->named[1].baseline.specimens == 0 && s->named[1].baseline.lacking == 1);
    gsn_auto(gsn_job_inputs) again = NULL;
    CHECK_EVERY_OOM(gsn_job_inputs_load(store, id, NULL, &again, &err), err);
}

TEST(colours_that_no_run_wrote_do_no_harm)
{
    struct control strange = ONE;
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);

    strange.parameters = "{\"colours\": {\"region_od\": [\"a\"], \"panels\": [{\"bins\": "
                         "[-5, 2, 900, 99999999, 1]}, 7]}}";
    add_control(store, &strange);
    gsn_auto(gsn_job_inputs) inputs = loaded(store, id);
    const struct gsn_cloud *cloud = gsn_job_inputs_specimen(inputs)->baseline.control[0].cloud;

    CHECK(cloud && cloud->panels == 2 && cloud->panel[0].bins == 1 && cloud->panel[1].bins == 0);
    CHECK(cloud->panel[0].bin[0].at < GSN_CLOUD_GREENS * GSN_CLOUD_BLUES);
}

TEST(running_out_of_memory_for_a_baseline_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);
    gsn_auto(gsn_job_inputs) inputs = NULL;
    struct gsn_error err = { 0 };

    add_control(store, &ONE);
    CHECK_EVERY_OOM(gsn_job_inputs_load(store, id, NULL, &inputs, &err), err);
    CHECK(gsn_job_inputs_specimen(inputs)->baseline.specimens == 1);
}
