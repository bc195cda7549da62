/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What controls handed on in the store is what a treated specimen is compared with. */
#include "storage/result.h"
#include "systemd/specimen_job.h"
#include "tests/check.h"
#include "tests/storage/bench.h"

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
                                     .parameters_json = "{}" };
    struct gsn_run_end end = { .state = "reported", .measures = rows };
    struct gsn_error err = { 0 };
    int64_t id;

    end.measure_count = 3 + add_tissues(c, rows + 3);
    CHECK_OK(gsn_run_begin(store, &run, NOON, &id, &err), err);
    CHECK_OK(gsn_run_finish(store, id, &end, NOON, &err), err);
}

static const struct control ONE = { "c", 1, 0.002, 4, GSN_LEVEL_TISSUES },
                            OTHER = { "d", 1.2, 0.005, 2, GSN_LEVEL_TISSUES };

static struct gsn_material *loaded(struct gsn_store *store, int64_t id)
{
    struct gsn_material *material = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_material_load(store, id, &material, &err), err);
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

TEST(running_out_of_memory_for_a_baseline_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    int64_t id;
    gsn_auto(gsn_store) store = with_treated(&scratch, &id);
    gsn_auto(gsn_material) material = NULL;
    struct gsn_error err = { 0 };

    add_control(store, &ONE);
    CHECK_EVERY_OOM(gsn_material_load(store, id, &material, &err), err);
    CHECK(gsn_material_specimen(material)->baseline.specimens == 1);
}
