/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/refine.h"

#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

enum { GRID = 24 };

struct result {
    struct gsn_dms *space;
    struct gsn_spline *spline;
    struct gsn_adapt_report report;
};

static void result_done(struct result *result)
{
    gsn_spline_free(result->spline);
    gsn_dms_free(result->space);
    gsn_adapt_report_done(&result->report);
}

/* A ball of 1 in 0, sharp but for two micrometres. */
static double ball(const double u[3])
{
    const double x = u[0] - 41, y = u[1] - 39, z = u[2] - 40;

    return 1 / (1 + exp(2 * (sqrt(x * x + y * y + z * z) - 24)));
}

static double linear(const double u[3])
{
    return u[0] / 4 - u[1] / 8 + u[2] / 2;
}

static double noise(const double u[3])
{
    uint64_t dice = (uint64_t)(u[0] * 7919 + u[1] * 104729 + u[2] * 1299709);

    return shape_normal(&dice);
}

static struct gsn_adapt_options options_with(double tolerance, unsigned rounds)
{
    return (struct gsn_adapt_options){ .fit = { .smoothing = GSN_FIT_SMOOTHING },
                                       .tolerance = tolerance,
                                       .rounds = rounds };
}

/* Of n^3 samples in a box of 80 um, on a mesh of such cells. */
static int adapt_on(double (*f)(const double u[3]), size_t n, double cell_um,
                    const struct gsn_adapt_options *options, struct result *ret,
                    struct gsn_error *err)
{
    gsn_auto(gsn_mask) region = shape_mask(8, 8, 8, 10, 10, 10, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, cell_um, 30000);
    struct shape_samples grid = shape_grid(0, 80, n, f);
    const int r =
        gsn_adapt(mesh, &grid.samples, options, &ret->space, &ret->spline, &ret->report, err);

    shape_samples_done(&grid);
    return r;
}

static int adapt(double (*f)(const double u[3]), const struct gsn_adapt_options *options,
                 struct result *ret, struct gsn_error *err)
{
    return adapt_on(f, GRID, 40, options, ret, err);
}

static struct result adapted(double (*f)(const double u[3]),
                             const struct gsn_adapt_options *options)
{
    struct result result = { .space = NULL };
    struct gsn_error err = { 0 };

    CHECK_OK(adapt(f, options, &result, &err), err);
    return result;
}

/* The figures of the result are those of the last round that was taken, and only lower predicted
 * errors were. */
static void check_rounds(const struct gsn_adapt_report *report)
{
    double best = INFINITY, rms = NAN;

    CHECK(report->rounds >= 1);
    for (size_t i = 0; i < report->rounds; i++) {
        const double now = report->round[i].predicted;

        CHECK(report->round[i].accepted || i + 1 == report->rounds);
        CHECK(report->round[i].accepted == (now > 0 && now < 0.999 * best));
        if (report->round[i].accepted) {
            best = now;
            rms = report->round[i].rms;
        }
    }
    CHECK(report->fit.rms == rms);
}

TEST(noise_is_not_followed)
{
    struct gsn_adapt_options options = options_with(0.001, 4);
    struct result result;

    options.samples_per_unknown = 1.5;
    options.samples_per_tet = 3;
    result = adapted(noise, &options);
    check_rounds(&result.report);
    CHECK(result.report.end == GSN_ADAPT_NO_GAIN);
    CHECK(result.report.rounds == 2);
    /* It would have been by the residual alone. */
    CHECK(result.report.round[1].rms < 0.99 * result.report.round[0].rms);
    result_done(&result);
}

/* How many iterations equations may take; each layer of samples is of the other fold. */
static int folded(unsigned iterations, struct result *ret, struct gsn_error *err)
{
    static uint8_t fold[GRID * GRID * GRID];
    struct gsn_adapt_options options = options_with(0.01, 0);

    for (size_t i = 0; i < sizeof fold; i++)
        fold[i] = i / (GRID * GRID) % 2;
    options.fit.fold = fold;
    options.fit.iterations = iterations;
    return adapt(ball, &options, ret, err);
}

TEST(with_folds_equations_that_take_too_long_are_an_error)
{
    struct result free = { .space = NULL }, none = free;
    struct gsn_error err = { 0 };

    CHECK_OK(folded(2000, &free, &err), err);
    CHECK(free.report.fit.jump > 0 && free.report.fit.predicted > free.report.fit.rms);
    CHECK(free.report.round[0].predicted == free.report.fit.predicted);
    CHECK(folded(3, &none, &err) == GSN_E_FIT);
    CHECK(strstr(err.text, "iterations leave") && !none.space);
    result_done(&free);
    result_done(&none);
}

TEST(a_sharp_ball_is_followed_better_after_refinement)
{
    struct gsn_adapt_options options = options_with(0.01, 3);
    struct result result;

    options.samples_per_unknown = 3;
    options.samples_per_tet = 4;
    result = adapted(ball, &options);
    check_rounds(&result.report);
    CHECK(result.report.rounds >= 2);
    CHECK(result.report.fit.rms < 0.6 * result.report.round[0].rms);
    CHECK(result.report.round[1].tets > result.report.round[0].tets);
    CHECK((double)result.report.fit.unknowns <= GRID * GRID * GRID / 3.0);
    CHECK(gsn_dms_controls(result.space) == result.report.fit.unknowns);
    result_done(&result);
}

/* A hump, smooth to all orders. */
static double smooth(const double u[3])
{
    const double x = u[0] - 41, y = u[1] - 39, z = u[2] - 40;

    return exp(-(x * x + y * y + z * z) / (2 * 16 * 16));
}

/* Root mean square error over points between the samples. */
static double error_between(const struct result *result, double (*f)(const double u[3]))
{
    const int count = 4000;
    uint64_t dice = 7;
    size_t hint = 0;
    double squares = 0;

    for (int i = 0; i < count; i++) {
        double u[3], value;

        for (size_t k = 0; k < 3; k++)
            u[k] = 2 + 76 * shape_uniform(&dice);
        CHECK(gsn_spline_eval(result->spline, u, &hint, &value, NULL) == GSN_OK);
        squares += pow(value - f(u), 2);
    }
    return sqrt(squares / count);
}

/* Cubic, by refinement where the fit is poor; GIESON_EPSILON: a finer tolerance, too. */
TEST(every_tetrahedron_of_a_smooth_field_comes_within_the_tolerance)
{
    const char *finer = getenv("GIESON_EPSILON");
    const double tolerance[] = { 1e-2, 1e-3, finer ? atof(finer) : 1e-3 };
    double last_error = 0, last_unknowns = 0;

    for (size_t k = 0; k < (finer ? 3 : 2); k++) {
        struct gsn_adapt_options options = options_with(tolerance[k], 8);
        struct gsn_error err = { 0 };
        struct result result;
        double error;

        options.degree = 3;
        options.fit.smoothing = 1e-8;
        options.samples_per_unknown = 1.5;
        options.samples_per_tet = 4;
        CHECK_OK(adapt_on(smooth, k < 2 ? 40 : 56, 20, &options, &result, &err), err);
        error = error_between(&result, smooth);
        print_message("  %g: %zu rounds, %zu tetrahedra, %zu unknowns, rms %.2e, between samples "
                      "%.2e\n",
                      tolerance[k], result.report.rounds, gsn_dms_mesh(result.space)->tet_count,
                      result.report.fit.unknowns, result.report.fit.rms, error);
        if (k > 0)
            print_message("    order %.1f\n",
                          -3 * log(error / last_error) /
                              log((double)result.report.fit.unknowns / last_unknowns));
        CHECK(result.report.end == GSN_ADAPT_WITHIN);
        for (size_t t = 0; t < gsn_dms_mesh(result.space)->tet_count; t++)
            CHECK(result.report.tet_samples[t] == 0 || result.report.tet_rms[t] <= tolerance[k]);
        CHECK(error <= tolerance[k]);
        last_error = error;
        last_unknowns = (double)result.report.fit.unknowns;
        result_done(&result);
    }
}

TEST(what_is_within_tolerance_is_left_alone)
{
    const struct gsn_adapt_options options = options_with(0.1, 3);
    struct result result = adapted(linear, &options);

    CHECK(result.report.end == GSN_ADAPT_WITHIN);
    CHECK(result.report.rounds == 1 && result.report.round[0].over_tolerance == 0);
    result_done(&result);
}

TEST(the_samples_and_the_caller_bound_the_unknowns)
{
    struct gsn_adapt_options options = options_with(0.001, 6);
    struct result result;

    options.samples_per_tet = 1;
    options.samples_per_unknown = 10;
    result = adapted(ball, &options);
    check_rounds(&result.report);
    CHECK(result.report.end == GSN_ADAPT_SAMPLES);
    CHECK(result.report.fit.unknowns <= GRID * GRID * GRID / 10);
    result_done(&result);

    options.most_unknowns = 1350;
    options.samples_per_unknown = 3;
    result = adapted(ball, &options);
    check_rounds(&result.report);
    CHECK(result.report.end == GSN_ADAPT_UNKNOWNS);
    CHECK(result.report.fit.unknowns <= 1350);
    result_done(&result);
}

TEST(without_rounds_there_is_one_fit)
{
    const struct gsn_adapt_options options = options_with(0.001, 0);
    struct result result = adapted(ball, &options);

    CHECK(result.report.end == GSN_ADAPT_ROUNDS);
    CHECK(result.report.rounds == 1);
    CHECK(result.report.tet_samples && result.report.tet_rms);
    result_done(&result);
}

/* Noise has nothing to follow, and a heavy penalty makes finer fits no better. */
TEST(a_fit_that_is_no_better_is_not_taken)
{
    struct gsn_adapt_options options = options_with(0.001, 4);
    struct result result;

    options.fit.smoothing = 1e9;
    options.samples_per_unknown = 1;
    options.samples_per_tet = 2;
    result = adapted(noise, &options);
    check_rounds(&result.report);
    CHECK(result.report.end == GSN_ADAPT_NO_GAIN);
    CHECK(result.report.rounds == 2 && !result.report.round[1].accepted);
    CHECK(gsn_dms_mesh(result.space)->tet_count == result.report.round[0].tets);
    result_done(&result);
}

TEST(bad_options_and_samples_are_refused)
{
    struct gsn_adapt_options options = options_with(0.01, GSN_ADAPT_MOST_ROUNDS + 1);
    struct result result = { .space = NULL };
    struct gsn_error err = { 0 };

    CHECK(adapt(ball, &options, &result, &err) == GSN_E_INPUT);
    options = options_with(NAN, 1);
    CHECK(adapt(ball, &options, &result, &err) == GSN_E_INPUT);
    CHECK(!result.space && !result.spline && !result.report.tet_rms);
}

static int adapt_once(const struct gsn_tets *mesh, const struct gsn_samples *samples,
                      struct gsn_error *err)
{
    struct gsn_adapt_options options = options_with(1e-6, 1);
    struct result result = { .space = NULL };
    int r;

    options.samples_per_tet = 1;
    options.samples_per_unknown = 0.01;
    r = gsn_adapt(mesh, samples, &options, &result.space, &result.spline, &result.report, err);
    if (r >= 0)
        result_done(&result);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_mask) region = shape_mask(1, 1, 1, 10, 10, 10, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 40, 30000);
    struct shape_samples grid = shape_grid(0, 80, 24, ball);
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < grid.samples.count; i++)
        for (size_t k = 0; k < 3; k++)
            grid.at[i][k] /= 8;
    grid.samples.count = 2000;
    CHECK_EVERY_OOM(adapt_once(mesh, &grid.samples, &err), err);
    shape_samples_done(&grid);
}
