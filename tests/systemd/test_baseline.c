/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What controls handed on in the store is what a treated specimen is compared with. */
#include "systemd/run_parameters.h"
#include "systemd/specimen_job.h"
#include "tests/check.h"
#include "tests/storage/bench.h"

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

static const struct control ONE = { "c", 1, 0.002, 4, GSN_LEVEL_TISSUES, NULL },
                            OTHER = { "d", 1.2, 0.005, 2, GSN_LEVEL_TISSUES, NULL };

static struct gsn_material *loaded(struct gsn_store *store, int64_t id)
{
    struct gsn_material *material = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_material_load(store, id, NULL, &material, &err), err);
    return material;
}

TEST(the_tissues_of_one_control_come_back_with_their_errors_and_what_these_share)
{
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);

    add_control(store, &ONE);
    gsn_auto(gsn_material) material = loaded(store, id);
    const struct gsn_specimen_baseline *b = &gsn_material_specimen(material)->baseline;

    CHECK(b->specimens == 1);
    for (unsigned t = 0; t < GSN_LEVEL_TISSUES; t++) {
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
    gsn_auto(gsn_material) material = loaded(store, id);
    const struct gsn_specimen_baseline *b = &gsn_material_specimen(material)->baseline;

    CHECK(b->specimens == 2);
    CHECK_NEAR(b->mean_density, 1.1, 1e-12);
    for (unsigned t = 0; t < GSN_LEVEL_TISSUES; t++) {
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
    gsn_auto(gsn_material) material = loaded(store, id);
    const struct gsn_level_tissues *tissues = &gsn_material_specimen(material)->baseline.tissues;
    const double lacked = tissues->value[other.tissues];

    for (unsigned t = 0; t < other.tissues; t++)
        CHECK_NEAR(tissues->value[t], 1.1 * VALUE[t], 1e-12);
    CHECK(lacked != lacked); /* NaN */
}

/* Each control's panels are read on its own scale, so its tissues stay beside them. */
TEST(where_the_panels_of_each_control_put_density_0_comes_back_beside_its_own_tissues)
{
    struct control zeros = ONE, none = OTHER;
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);

    zeros.parameters = "{\"panel_zeros\": [0.0625, -0.5, 0]}";
    none.tissues--;
    add_control(store, &zeros);
    add_control(store, &none); /* by a version that did not hand them on */
    gsn_auto(gsn_material) material = loaded(store, id);
    const struct gsn_specimen_baseline *b = &gsn_material_specimen(material)->baseline;
    const double lacked = b->control[1].tissues.value[none.tissues];

    CHECK(b->specimens == 2);
    CHECK(b->control[0].panels == 3 && b->control[1].panels == 0);
    CHECK_NEAR(b->control[0].zero[0], 0.0625, 0);
    CHECK_NEAR(b->control[0].zero[1], -0.5, 0);
    CHECK_NEAR(b->control[0].zero[2], 0, 0);
    for (unsigned t = 0; t < none.tissues; t++) {
        CHECK_NEAR(b->control[0].tissues.value[t], VALUE[t], 1e-12);
        CHECK_NEAR(b->control[1].tissues.value[t], 1.2 * VALUE[t], 1e-12);
        CHECK_NEAR(b->control[1].tissues.covariance[t][t], ERROR[t] * ERROR[t], 1e-12);
    }
    CHECK(lacked != lacked); /* NaN */
}

/* 1/3 takes all digits of a double. */
TEST(what_a_run_hands_on_comes_back_to_the_last_bit)
{
    const struct gsn_specimen_result result = {
        .definition = "of \"red\"", .dyes = "set", .zero = { 1.0 / 3, -0.25 }, .zero_count = 2
    };
    struct control whole = ONE;
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);
    gsn_auto_mem(char) parameters = gsn_run_parameters("key", &result);

    whole.parameters = parameters;
    add_control(store, &whole);
    gsn_auto(gsn_material) material = loaded(store, id);
    const struct gsn_specimen_baseline *b = &gsn_material_specimen(material)->baseline;

    assert_string_equal(b->definition, "of \"red\"");
    assert_string_equal(b->dyes, "set");
    CHECK(b->control[0].panels == 2);
    CHECK(b->control[0].zero[0] == 1.0 / 3 && b->control[0].zero[1] == -0.25);
}

TEST(more_panels_than_a_block_can_have_are_not_read)
{
    char many[2 * GSN_LEVEL_PANELS + 40] = "{\"panel_zeros\": [1";
    struct control strange = ONE;
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);

    for (int i = 0; i < GSN_LEVEL_PANELS; i++)
        strcat(many, ",2");
    strange.parameters = strcat(many, "]}");
    add_control(store, &strange);
    gsn_auto(gsn_material) material = loaded(store, id);

    CHECK(gsn_material_specimen(material)->baseline.control[0].panels == GSN_LEVEL_PANELS);
}

TEST(running_out_of_memory_for_a_baseline_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);
    gsn_auto(gsn_material) material = NULL;
    struct gsn_error err = { 0 };

    add_control(store, &ONE);
    CHECK_EVERY_OOM(gsn_material_load(store, id, NULL, &material, &err), err);
    CHECK(gsn_material_specimen(material)->baseline.specimens == 1);
}
