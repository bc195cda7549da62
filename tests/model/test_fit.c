/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/fit.h"

#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

enum { GRID = 20 };

static struct gsn_spline *fitted(const struct gsn_dms *space, const struct gsn_samples *samples,
                                 const struct gsn_fit_options *options,
                                 struct gsn_fit_report *ret_report)
{
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_fit(space, samples, options, &spline, ret_report, NULL, NULL, &err), err);
    return spline;
}

static double at(const struct gsn_spline *spline, const double u[3])
{
    size_t hint = 0;
    double value = NAN;

    CHECK(gsn_spline_eval(spline, u, &hint, &value, NULL) == GSN_OK);
    return value;
}

/* The largest distance from f on points between the samples, `margin` um inside the sampled cube:
 * nearer to its surface some tetrahedra have too few samples to know more than the penalty. */
static double largest_error(const struct gsn_spline *spline, double margin,
                            double (*f)(const double u[3]))
{
    const double step = (80 - 2 * margin) / 10.03;
    double most = 0;

    for (size_t i = 0; i < 11 * 11 * 11; i++) {
        const double u[3] = { margin + step * (double)(i % 11),
                              margin + step * (double)(i / 11 % 11) + 0.01,
                              margin + step * (double)(i / 121) + 0.02 };

        most = fmax(most, fabs(at(spline, u) - f(u)));
    }
    return most;
}

static double constant(const double u[3])
{
    (void)u;
    return 137.25;
}

/* At odd multiples of 2.5 um up to 120 these three are exact as floats. */
static double linear(const double u[3])
{
    return 8 + u[0] / 4 - u[1] / 8 + u[2] / 2;
}

static double quadratic(const double u[3])
{
    return (u[0] * u[0] - 3 * u[1] * u[2] + u[2] * u[2]) / 64 + linear(u);
}

static double cubic(const double u[3])
{
    return u[0] * u[1] * u[2] / 4096 + linear(u);
}

static double wave(const double u[3])
{
    return sin(u[0] / 13) * cos(u[1] / 17) + sin(u[2] / 15);
}

TEST(a_constant_is_reproduced_even_where_nothing_was_measured)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, constant);

    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = shape_space(degree, 0.02, 20000);
        struct gsn_fit_report report;
        const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .threads = 2 };
        gsn_auto(gsn_spline) spline = fitted(space, &grid.samples, &options, &report);

        for (size_t i = 0; i < gsn_dms_controls(space); i++)
            CHECK_NEAR(gsn_spline_controls(spline)[i], 137.25, 1e-10);
        CHECK_NEAR(largest_error(spline, 0, constant), 0, 1e-10);
        CHECK_NEAR(report.worst, 0, 1e-10);
    }
    shape_samples_done(&grid);
}

TEST(polynomials_up_to_the_degree_are_reproduced)
{
    static double (*const TRUTH[])(const double u[3]) = { linear, quadratic, cubic };

    for (unsigned degree = 1; degree <= 3; degree++) {
        struct shape_samples grid = shape_grid(-40, 120, 32, TRUTH[degree - 1]);
        gsn_auto(gsn_dms) space = shape_space(degree, 0.02, 60000);
        const struct gsn_fit_options options = { .smoothing = 1e-12, .tolerance = 1e-13 };
        struct gsn_fit_report report;
        gsn_auto(gsn_spline) spline = fitted(space, &grid.samples, &options, &report);

        CHECK_NEAR(largest_error(spline, -20, TRUTH[degree - 1]), 0, 1e-8 * 100);
        CHECK_NEAR(report.rms, 0, 1e-8);
        shape_samples_done(&grid);
    }
}

TEST(the_residuals_sum_to_nothing)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 20000);
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING };
    struct gsn_fit_report report;
    gsn_auto(gsn_spline) spline = fitted(space, &grid.samples, &options, &report);
    double sum = 0;

    for (size_t i = 0; i < grid.samples.count; i++)
        sum += at(spline, grid.at[i]) - grid.value[i];
    CHECK_NEAR(sum / (double)grid.samples.count, 0, 1e-7 * 4);
    shape_samples_done(&grid);
}

TEST(the_report_agrees_with_the_spline)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 20000);
    const size_t tets = gsn_dms_mesh(space)->tet_count;
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .threads = 2 };
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto_mem(uint32_t) samples = NULL;
    gsn_auto_mem(double) rms = NULL;
    gsn_auto_mem(double) squares = gsn_alloc_array(tets, sizeof *squares);
    struct gsn_fit_report report;
    struct gsn_error err = { 0 };
    double sum = 0, worst = 0;
    size_t tet = 0, empty = 0;

    CHECK(squares);
    CHECK_OK(gsn_fit(space, &grid.samples, &options, &spline, &report, &samples, &rms, &err), err);
    for (size_t i = 0; i < grid.samples.count; i++) {
        const double off = at(spline, grid.at[i]) - grid.value[i];

        CHECK(gsn_dms_locate(space, grid.at[i], tet, &tet) == GSN_OK);
        squares[tet] += off * off;
        samples[tet]--;
        sum += off * off;
        worst = fmax(worst, fabs(off));
    }
    for (size_t t = 0; t < tets; t++)
        CHECK(samples[t] == 0);
    gsn_free(gsn_steal(&samples));
    gsn_spline_free(gsn_steal(&spline));
    gsn_free(gsn_steal(&rms));

    CHECK_OK(gsn_fit(space, &grid.samples, &options, &spline, &report, &samples, &rms, &err), err);
    for (size_t t = 0; t < tets; t++) {
        empty += samples[t] == 0;
        CHECK_NEAR(rms[t] * rms[t] * samples[t], squares[t], 1e-12);
    }
    CHECK(report.samples == grid.samples.count && report.empty_tets == empty);
    CHECK(report.unknowns == gsn_dms_controls(space));
    CHECK_NEAR(report.rms, sqrt(sum / (double)grid.samples.count), 1e-12);
    CHECK_NEAR(report.worst, worst, 1e-10);
    shape_samples_done(&grid);
}

TEST(noise_is_averaged_as_statistics_says)
{
    const double sigma = 0.5;
    struct shape_samples grid = shape_grid(0, 80, GRID, linear);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    const struct gsn_fit_options options = { .smoothing = 1e-9 };
    struct gsn_fit_report report;
    gsn_auto(gsn_spline) spline = NULL;
    uint64_t dice = 20260101;
    double squares = 0, n = (double)grid.samples.count, measured;

    for (size_t i = 0; i < grid.samples.count; i++)
        grid.value[i] += (float)(sigma * shape_normal(&dice));
    spline = fitted(space, &grid.samples, &options, &report);
    for (size_t i = 0; i < grid.samples.count; i++) {
        const double off = at(spline, grid.at[i]) - linear(grid.at[i]);

        squares += off * off;
    }
    /* Not every unknown reaches into the sampled cube; those that do are p, and
     * E sum (s - truth)^2 = p sigma^2,  E sum residual^2 = (n - p) sigma^2. */
    measured = squares / (sigma * sigma);
    CHECK(measured > 50 && measured < (double)report.unknowns);
    CHECK_NEAR(report.rms * report.rms * n / (sigma * sigma), n - measured,
               4 * sqrt(2 * n)); /* standard deviation sqrt(2 n) */
    shape_samples_done(&grid);
}

TEST(one_thread_and_three_give_the_same_bits)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.05, 5000);
    struct gsn_fit_report first;
    struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .threads = 1 };
    gsn_auto(gsn_spline) one = fitted(space, &grid.samples, &options, &first);

    for (unsigned threads = 2; threads <= 3; threads++) {
        struct gsn_fit_report again;
        gsn_auto(gsn_spline) spline = NULL;

        options.threads = threads;
        spline = fitted(space, &grid.samples, &options, &again);
        CHECK(memcmp(gsn_spline_controls(one), gsn_spline_controls(spline),
                     gsn_dms_controls(space) * sizeof(double)) == 0);
        CHECK(memcmp(&first.rms, &again.rms, sizeof first.rms) == 0);
        CHECK(first.iterations == again.iterations);
    }
    shape_samples_done(&grid);
}

/* Drops the samples for which gone() says so; the arrays stay as long. */
static void drop(struct shape_samples *grid, int (*gone)(const double u[3]))
{
    size_t kept = 0;

    for (size_t i = 0; i < grid->samples.count; i++) {
        if (gone(grid->at[i]))
            continue;
        memcpy(grid->at[kept], grid->at[i], sizeof *grid->at);
        grid->value[kept++] = grid->value[i];
    }
    grid->samples.count = kept;
}

static int in_the_gap(const double u[3])
{
    return u[2] > 28 && u[2] < 52;
}

TEST(a_missing_section_is_bridged_smoothly)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, linear);
    struct shape_samples waves = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 5000);
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING };
    struct gsn_fit_report report;
    gsn_auto(gsn_spline) spline = NULL;

    drop(&grid, in_the_gap);
    drop(&waves, in_the_gap);
    spline = fitted(space, &grid.samples, &options, &report);
    CHECK(report.empty_tets > 0);
    CHECK_NEAR(largest_error(spline, 20, linear), 0, 0.05); /* of a range of 70 */
    gsn_spline_free(spline);
    spline = fitted(space, &waves.samples, &options, &report);
    /* sin(z / 15) has its top in the gap: a straight bridge over 24 um misses it by up to 0.28. */
    CHECK_NEAR(largest_error(spline, 20, wave), 0, 0.35);
    shape_samples_done(&grid);
    shape_samples_done(&waves);
}

static int far_half(const double u[3])
{
    return u[0] > 30;
}

TEST(where_nothing_was_measured_the_field_stays_in_range)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, linear);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 20000);
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING };
    struct gsn_fit_report report;
    gsn_auto(gsn_spline) spline = NULL;
    double low = INFINITY, high = -INFINITY;

    drop(&grid, far_half);
    for (size_t i = 0; i < grid.samples.count; i++) {
        low = fmin(low, grid.value[i]);
        high = fmax(high, grid.value[i]);
    }
    spline = fitted(space, &grid.samples, &options, &report);
    CHECK(report.empty_tets > gsn_dms_mesh(space)->tet_count / 4);
    for (size_t i = 0; i < gsn_dms_controls(space); i++) {
        const double value = gsn_spline_controls(spline)[i];

        CHECK(value > low - 0.2 * (high - low) && value < high + 0.2 * (high - low));
    }
    shape_samples_done(&grid);
}

static int beyond(const double u[3])
{
    return u[0] > 40;
}

/* What noise bends by at the samples' edge is not what 80 um beyond it are made of. */
TEST(beyond_the_samples_a_slope_goes_on_straight)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, linear);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 20000);
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .jump = 0.5 };
    struct gsn_fit_report report;
    gsn_auto(gsn_spline) spline = NULL;
    uint64_t dice = 3;
    double most = 0;

    drop(&grid, beyond);
    for (size_t i = 0; i < grid.samples.count; i++)
        grid.value[i] += (float)(2 * shape_normal(&dice));
    spline = fitted(space, &grid.samples, &options, &report);
    for (double x = 45; x < 120; x += 5)
        for (double y = 5; y < 80; y += 15)
            for (double z = 5; z < 80; z += 15) {
                const double u[3] = { x, y, z };

                most = fmax(most, fabs(at(spline, u) - linear(u)));
            }
    print_message("  %.2f off beyond, %u iterations\n", most, report.iterations);
    CHECK(most < 0.5);
    shape_samples_done(&grid);
}

static int two_blocks(size_t x, size_t y, size_t z)
{
    (void)y;
    (void)z;
    return x < 3 || x > 8;
}

TEST(a_part_without_any_sample_gets_the_mean)
{
    gsn_auto(gsn_mask) region = shape_mask(12, 3, 3, 10, 10, 10, two_blocks);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 10, 1000);
    gsn_auto(gsn_dms) space = NULL;
    double(*knots)[3] = NULL;
    const double sampled[4][3] = { { 5, 5, 5 }, { 25, 5, 5 }, { 5, 25, 5 }, { 5, 5, 25 } };
    const float value[4] = { 1, 2, 4, 5 };
    const struct gsn_samples samples = { .count = 4, .at = sampled, .value = value };
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING };
    struct gsn_fit_report report;
    gsn_auto(gsn_spline) spline = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_dms_clouds(mesh, 2, 0.02, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, 2, knots, GSN_DMS_SHARED, &space, &err), err);
    gsn_free(knots);
    spline = fitted(space, &samples, &options, &report);
    CHECK_NEAR(at(spline, (const double[3]){ 105, 15, 15 }), 3, 1e-12);
    CHECK_NEAR(at(spline, sampled[3]), 5, 1e-2);
}

TEST(bad_samples_are_refused_by_their_number)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .threads = 2 },
                                 silly = { .smoothing = -1 };
    struct gsn_samples none = { 0 };
    struct gsn_fit_report report = { .unknowns = 77 };
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    grid.value[4321] = NAN;
    grid.at[7000][1] = 1e6;
    CHECK(gsn_fit(space, &grid.samples, &options, &spline, &report, NULL, NULL, &err) ==
          GSN_E_INPUT);
    CHECK(strstr(err.text, "sample 4321 is not finite"));
    grid.value[4321] = 1;
    CHECK(gsn_fit(space, &grid.samples, &options, &spline, &report, NULL, NULL, &err) ==
          GSN_E_INPUT);
    CHECK(strstr(err.text, "sample 7000") && strstr(err.text, "outside"));
    CHECK(gsn_fit(space, &none, &options, &spline, &report, NULL, NULL, &err) == GSN_E_INPUT);
    grid.at[7000][1] = 40;
    CHECK(gsn_fit(space, &grid.samples, &silly, &spline, &report, NULL, NULL, &err) == GSN_E_INPUT);
    CHECK(spline == NULL && report.unknowns == 77);
    shape_samples_done(&grid);
}

TEST(too_few_iterations_are_an_error)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .iterations = 3 };
    struct gsn_fit_report report;
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_fit(space, &grid.samples, &options, &spline, &report, NULL, NULL, &err) == GSN_E_FIT);
    CHECK(strstr(err.text, "3 iterations"));
    shape_samples_done(&grid);
}

TEST(a_forgiving_fit_gives_its_best_and_says_so)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .forgiving = 1 };
    struct gsn_fit_report whole, cut;
    gsn_auto(gsn_spline) best = fitted(space, &grid.samples, &options, &whole);
    gsn_auto(gsn_spline) early = NULL;

    CHECK(!whole.unconverged && whole.outside == 0);
    options.iterations = 3;
    early = fitted(space, &grid.samples, &options, &cut);
    CHECK(cut.unconverged && cut.iterations == 3);
    CHECK(cut.rms > whole.rms && cut.rms < 10 * whole.rms + 0.1);
    shape_samples_done(&grid);
}

TEST(a_forgiving_fit_leaves_out_what_is_outside_and_counts_it)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .forgiving = 1 };
    const size_t all = grid.samples.count;
    struct gsn_fit_report few, some;
    gsn_auto(gsn_spline) short_of = NULL;
    gsn_auto(gsn_spline) with = NULL;

    grid.at[all - 1][2] = grid.at[all - 3][0] = 1e5;
    grid.samples.count = all - 3;
    short_of = fitted(space, &grid.samples, &options, &few);
    grid.samples.count = all;
    grid.at[all - 2][1] = -1e5;
    with = fitted(space, &grid.samples, &options, &some);
    CHECK(some.outside == 3 && some.first_outside == all - 3 && some.samples == all - 3);
    CHECK(memcmp(gsn_spline_controls(short_of), gsn_spline_controls(with),
                 gsn_dms_controls(space) * sizeof(double)) == 0);
    shape_samples_done(&grid);
}

/* With 2 for a sample there twice, and 0 for one that is not there. */
TEST(a_weight_is_how_often_a_sample_counts)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    const struct gsn_fit_options options = { .smoothing = 1e-4, .jump = 1e-3, .tolerance = 1e-13 };
    const size_t count = grid.samples.count;
    gsn_auto_mem(double) weight = gsn_alloc_array(count, sizeof *weight);
    gsn_auto_mem(float) value = gsn_alloc_array(2 * count, sizeof *value);
    double(*at)[3] = gsn_alloc_array(2 * count, sizeof *at);
    struct gsn_samples repeated = { .at = (const double(*)[3])at, .value = value };
    struct gsn_fit_report one, two;
    gsn_auto(gsn_spline) weighted = NULL;
    gsn_auto(gsn_spline) plain = NULL;

    for (size_t i = 0; i < count; i++) {
        weight[i] = (double)(i % 3);
        for (size_t k = 0; k < i % 3; k++) {
            memcpy(at[repeated.count], grid.at[i], sizeof *at);
            value[repeated.count++] = grid.value[i];
        }
    }
    grid.samples.weight = weight;
    weighted = fitted(space, &grid.samples, &options, &one);
    plain = fitted(space, &repeated, &options, &two);
    CHECK_NEAR(one.rms, two.rms, 1e-9);
    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        CHECK_NEAR(gsn_spline_controls(weighted)[i], gsn_spline_controls(plain)[i], 1e-6);
    weight[5] = -1;
    {
        gsn_auto_mem(uint8_t) fold = gsn_alloc_array(count, 1);
        struct gsn_fit_options folded = options;
        struct gsn_spline *none = NULL;
        struct gsn_error err = { 0 };

        CHECK(gsn_fit(space, &grid.samples, &options, &none, &one, NULL, NULL, &err) ==
              GSN_E_INPUT);
        CHECK(strstr(err.text, "sample 5 has the weight -1"));
        memset(weight, 0, count * sizeof *weight);
        CHECK(gsn_fit(space, &grid.samples, &options, &none, &one, NULL, NULL, &err) ==
              GSN_E_INPUT);
        CHECK(strstr(err.text, "no sample in the mesh has a weight above 0"));
        for (size_t i = 0; i < count; i++)
            weight[i] = 1;
        folded.fold = fold;
        CHECK(gsn_fit(space, &grid.samples, &folded, &none, &one, NULL, NULL, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "no sample in the mesh and in fold 1 has a weight above 0"));
    }
    gsn_free(at);
    shape_samples_done(&grid);
}

TEST(many_channels_are_as_many_fits)
{
    struct shape_samples grid = shape_grid(0, 80, GRID, wave);
    gsn_auto(gsn_dms) space = shape_space(3, 0.02, 60000);
    const size_t count = grid.samples.count;
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .jump = 1e-3 };
    gsn_auto_mem(double) first = gsn_alloc_array(count, sizeof *first);
    gsn_auto_mem(double) second = gsn_alloc_array(count, sizeof *second);
    gsn_auto_mem(double) weight = gsn_alloc_array(count, sizeof *weight);
    const double *const value[3] = { first, second, first };
    struct gsn_spline *spline[3] = { NULL };
    struct gsn_fit_report report[3], alone;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < count; i++) {
        first[i] = wave(grid.at[i]) / 3; /* no float */
        second[i] = linear(grid.at[i]);
        weight[i] = 1 + (double)(i % 5);
    }
    grid.samples.weight = weight;
    CHECK_OK(gsn_fit_channels(space, &grid.samples, value, 3, &options, spline, report, &err), err);
    for (size_t c = 0; c < 3; c++) {
        gsn_auto(gsn_spline) by_itself = NULL;

        grid.samples.exact = value[c];
        by_itself = fitted(space, &grid.samples, &options, &alone);
        CHECK(memcmp(gsn_spline_controls(by_itself), gsn_spline_controls(spline[c]),
                     gsn_dms_controls(space) * sizeof(double)) == 0);
        CHECK(alone.rms == report[c].rms && alone.iterations == report[c].iterations);
        gsn_spline_free(spline[c]);
        spline[c] = NULL;
    }
    second[17] = INFINITY;
    CHECK(gsn_fit_channels(space, &grid.samples, value, 3, &options, spline, report, &err) ==
          GSN_E_INPUT);
    CHECK(strcmp(err.text, "channel 1: sample 17 is not finite") == 0);
    CHECK(!spline[0] && !spline[1] && !spline[2]);
    shape_samples_done(&grid);
}

/* The penalty pulls a steep field flat by a part; without one nothing does. */
TEST(no_smoothing_is_none)
{
    struct shape_samples grid = shape_grid(-40, 120, 32, linear);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    const struct gsn_fit_options none = { .tolerance = 1e-13, .forgiving = 1 };
    struct gsn_fit_report report;
    gsn_auto(gsn_spline) spline = fitted(space, &grid.samples, &none, &report);

    CHECK(report.rms < 1e-9);
    CHECK(largest_error(spline, 5, linear) < 1e-9);
    grid.samples.count = 3; /* in the middle */
    grid.samples.at += 16 * (32 * 32 + 32 + 1);
    grid.samples.value += 16 * (32 * 32 + 32 + 1);
    {
        struct gsn_spline *lost = NULL;
        struct gsn_error err = { 0 };

        CHECK(gsn_fit(space, &grid.samples, &none, &lost, &report, NULL, NULL, &err) == GSN_E_FIT);
        CHECK(strstr(err.text, "is not determined by anything"));
    }
    shape_samples_done(&grid);
}

static int fit_once(const struct gsn_dms *space, const struct gsn_samples *samples,
                    struct gsn_error *err)
{
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .threads = 2 };
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto_mem(uint32_t) count = NULL;
    gsn_auto_mem(double) rms = NULL;
    struct gsn_fit_report report;
    const int r = gsn_fit(space, samples, &options, &spline, &report, &count, &rms, err);

    CHECK(r >= 0 || (!spline && !count && !rms));
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct shape_samples grid = shape_grid(0, 80, 8, wave);
    gsn_auto(gsn_dms) space = shape_space(2, 0.02, 60000);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(fit_once(space, &grid.samples, &err), err);
    shape_samples_done(&grid);
}
