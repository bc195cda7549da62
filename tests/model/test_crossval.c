/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/fit.h"

#include "pipeline/model/refine.h"
#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

#include <string.h>

enum { GRID = 24 };

static double linear(const double u[3])
{
    return 3 + u[0] / 4 - u[1] / 8 + u[2] / 2;
}

static double wave(const double u[3])
{
    return sin(u[0] / 13) * cos(u[1] / 17) + sin(u[2] / 15);
}

static double angle(double plane, unsigned which)
{
    uint64_t dice = (uint64_t)(plane * 1000) * 2654435761u + which;

    return 6.28 * shape_normal(&dice);
}

/* Smooth in x and y, with phases of its own in every plane of z. */
static double texture(const double u[3])
{
    return cos(u[0] / 4 + angle(u[2], 1)) * cos(u[1] / 4 + angle(u[2], 2));
}

/* Alternate planes of z. gives. */
static uint8_t *folds(const struct gsn_samples *samples)
{
    uint8_t *fold = gsn_alloc_array(samples->count, 1);
    const double step = 80.0 / GRID;

    for (size_t i = 0; fold && i < samples->count; i++)
        fold[i] = (uint8_t)((unsigned)floor(samples->at[i][2] / step) % 2);
    return fold;
}

static struct gsn_adapt_options options_with(unsigned rounds)
{
    return (struct gsn_adapt_options){ .fit = { .smoothing = GSN_FIT_SMOOTHING },
                                       .tolerance = 0.01,
                                       .samples_per_unknown = 3,
                                       .samples_per_tet = 8,
                                       .rounds = rounds };
}

static int adapt(double (*f)(const double u[3]), int with_folds, struct gsn_adapt_report *ret,
                 struct gsn_error *err)
{
    gsn_auto(gsn_mask) region = shape_mask(8, 8, 8, 10, 10, 10, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 40, 30000);
    struct shape_samples grid = shape_grid(0, 80, GRID, f);
    gsn_auto_mem(uint8_t) fold = folds(&grid.samples);
    struct gsn_adapt_options options = options_with(2);
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    int r;

    options.fit.fold = with_folds ? fold : NULL;
    r = fold ? gsn_adapt(mesh, &grid.samples, &options, &space, &spline, ret, err)
             : gsn_fail(err, GSN_E_NOMEM, "out of memory");
    shape_samples_done(&grid);
    return r;
}

TEST(texture_of_one_fold_is_not_followed)
{
    struct gsn_adapt_report alone = { .rounds = 0 }, folded = { .rounds = 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(adapt(texture, 0, &alone, &err), err);
    CHECK_OK(adapt(texture, 1, &folded, &err), err);
    /* Taken for independent noise it is followed: within a plane it is smooth. */
    CHECK(alone.round[1].accepted);
    CHECK(!folded.round[1].accepted && folded.end == GSN_ADAPT_NO_GAIN);
    CHECK(alone.fit.jump == 0 && folded.fit.jump > 0);
    gsn_adapt_report_done(&alone);
    gsn_adapt_report_done(&folded);
}

TEST(what_both_folds_share_is_predicted)
{
    struct gsn_adapt_report report = { .rounds = 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(adapt(linear, 1, &report, &err), err);
    /* The range is 70; what is left is the penalty, which pulls at the planes beyond the other
     * fold.  */
    CHECK_NEAR(report.round[0].predicted, 0, 0.06);
    gsn_adapt_report_done(&report);
}

TEST(independent_noise_is_priced_by_its_unknowns)
{
    const struct gsn_fit_report fit = { .unknowns = 250, .samples = 1000, .rms = 0.3 };
    const struct gsn_fit_report half_empty = {
        .unknowns = 500, .samples = 1000, .rms = 0.3, .empty_tets = 5
    };
    const struct gsn_fit_report overfull = { .unknowns = 1000, .samples = 1000, .rms = 0.3 };

    CHECK_NEAR(gsn_generalised_cross_validation(&fit, 10), 0.4, 1e-15);
    CHECK_NEAR(gsn_generalised_cross_validation(&half_empty, 10), 0.4, 1e-15);
    CHECK(gsn_generalised_cross_validation(&overfull, 10) > 1e300);
}

/* Square of the errors at the samples of one fold, one after the other. */
static double errors_of_fold(const struct gsn_dms *space, const struct gsn_samples *samples,
                             const uint8_t *fold, uint8_t seen, double jump, struct gsn_error *err)
{
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING,
                                             .jump = jump,
                                             .threads = 1 };
    struct shape_samples half = { .at = gsn_alloc_array(samples->count, sizeof *half.at),
                                  .value = gsn_alloc_array(samples->count, sizeof *half.value) };
    gsn_auto(gsn_spline) spline = NULL;
    struct gsn_fit_report report;
    size_t hint = 0;
    double sum = 0;

    CHECK(half.at && half.value);
    for (size_t i = 0; i < samples->count; i++) {
        if (fold[i] != seen)
            continue;
        memcpy(half.at[half.samples.count], samples->at[i], sizeof *half.at);
        half.value[half.samples.count++] = samples->value[i];
    }
    half.samples.at = (const double(*)[3])half.at;
    half.samples.value = half.value;
    CHECK_OK(gsn_fit(space, &half.samples, &options, &spline, &report, NULL, NULL, err), *err);
    for (size_t i = 0; i < samples->count; i++) {
        double value;

        if (fold[i] == seen)
            continue;
        CHECK(gsn_spline_eval(spline, samples->at[i], &hint, &value, NULL) == GSN_OK);
        sum += (value - (double)samples->value[i]) * (value - (double)samples->value[i]);
    }
    shape_samples_done(&half);
    return sum;
}

TEST(the_error_predicted_is_that_of_two_fits_at_single_points)
{
    gsn_auto(gsn_dms) space = shape_space(2, 0.05, 100000);
    struct shape_samples grid = shape_grid(0, 80, 52, texture);
    gsn_auto_mem(uint8_t) fold = folds(&grid.samples);
    struct gsn_fit_report report[2];
    struct gsn_error err = { 0 };
    double sum;

    for (unsigned k = 0; k < 2; k++) {
        const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING,
                                                 .fold = fold,
                                                 .threads = k + 1 };
        gsn_auto(gsn_spline) spline = NULL;

        CHECK_OK(gsn_fit(space, &grid.samples, &options, &spline, &report[k], NULL, NULL, &err),
                 err);
    }
    CHECK(memcmp(&report[0], &report[1], sizeof report[0]) == 0);
    CHECK(report[0].jump > 0);
    sum = errors_of_fold(space, &grid.samples, fold, 0, report[0].jump, &err) +
          errors_of_fold(space, &grid.samples, fold, 1, report[0].jump, &err);
    CHECK_NEAR(report[0].predicted / sqrt(sum / (double)grid.samples.count), 1, 1e-4);
    shape_samples_done(&grid);
}

/* More noise, more smoothing. */
TEST(the_weight_follows_the_noise)
{
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 20000);
    double before = 0;

    for (unsigned k = 0; k < 3; k++) {
        static const double SIGMA[3] = { 0.001, 0.2, 1 };
        struct shape_samples grid = shape_grid(0, 80, GRID, wave);
        gsn_auto_mem(uint8_t) fold = folds(&grid.samples);
        const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING,
                                                 .fold = fold,
                                                 .threads = 2 };
        gsn_auto(gsn_spline) spline = NULL;
        struct gsn_fit_report report;
        struct gsn_error err = { 0 };
        uint64_t dice = 20260101 + k;

        for (size_t i = 0; i < grid.samples.count; i++)
            grid.value[i] += (float)(SIGMA[k] * shape_normal(&dice));
        CHECK_OK(gsn_fit(space, &grid.samples, &options, &spline, &report, NULL, NULL, &err), err);
        CHECK(report.jump > before);
        CHECK(report.predicted > SIGMA[k]);
        before = report.jump;
        shape_samples_done(&grid);
    }
}

static int validate_once(const struct gsn_dms *space, const struct gsn_samples *samples,
                         const uint8_t *fold, struct gsn_error *err)
{
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING,
                                             .fold = fold,
                                             .threads = 1 };
    gsn_auto(gsn_spline) spline = NULL;
    struct gsn_fit_report report;

    return gsn_fit(space, samples, &options, &spline, &report, NULL, NULL, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = shape_mask(4, 4, 4, 20, 20, 20, shape_everywhere);
    const struct gsn_domain_options domain = shape_options(80, 300000);
    struct shape_samples grid = shape_grid(0, 80, 6, linear);
    gsn_auto_mem(uint8_t) fold = folds(&grid.samples);
    gsn_auto(gsn_tets) mesh = NULL;
    gsn_auto(gsn_dms) space = NULL;
    double(*knots)[3] = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < grid.samples.count; i++)
        fold[i] = (uint8_t)(i % 2);
    CHECK_OK(gsn_domain_build(region, &domain, &mesh, &err), err);
    CHECK_OK(gsn_dms_clouds(mesh, 2, 0.01, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, 2, (const double(*)[3])knots, GSN_DMS_SHARED, &space, &err), err);
    CHECK_EVERY_OOM(validate_once(space, &grid.samples, fold, &err), err);
    gsn_free(knots);
    shape_samples_done(&grid);
}
