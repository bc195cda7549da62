/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Points that are no grid: where they lie, and value and gradient there, in random order and in the
 * order of space. */
#include "pipeline/model/batch.h"

#include "tests/bench/bench.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define CLOUD 0.03
enum { CHECKED = 2000 };

struct points {
    size_t count;
    double (*u)[3];
};

static uint64_t morton(const double u[3])
{
    uint64_t code = 0;

    for (int c = 0; c < 3; c++) {
        const uint32_t cell = (uint32_t)(u[c] * (1 << 20));

        for (int bit = 0; bit < 20; bit++)
            code |= (uint64_t)(cell >> bit & 1) << (3 * bit + c);
    }
    return code;
}

static int by_morton(const void *a, const void *b)
{
    const uint64_t x = morton(a), y = morton(b);

    return (x > y) - (x < y);
}

static struct points draw_points(size_t count)
{
    struct points points = { .count = count, .u = bench_alloc(count, sizeof *points.u) };
    uint64_t seed = 4711;

    for (size_t i = 0; i < count; i++) {
        for (int c = 0; c < 3; c++)
            points.u[i][c] = bench_draw(&seed);
    }
    return points;
}

static struct points sorted(const struct points *points)
{
    struct points order = { .count = points->count,
                            .u = bench_alloc(points->count, sizeof *order.u) };

    memcpy(order.u, points->u, points->count * sizeof *points->u);
    qsort(order.u, order.count, sizeof *order.u, by_morton);
    return order;
}

struct points_job {
    const struct bench_case *bench;
    const struct points *points;
    size_t found;
    double sink;
    double *value, (*gradient)[3]; /* of a batch */
};

static void run_locate(void *context)
{
    struct points_job *job = context;
    size_t tet = 0;

    for (size_t i = 0; i < job->points->count; i++)
        job->found += gsn_dms_locate(job->bench->space, job->points->u[i], tet, &tet) == GSN_OK;
}

static void run_eval(void *context)
{
    struct points_job *job = context;
    double value = 0, gradient[3];
    size_t hint = 0;

    for (size_t i = 0; i < job->points->count; i++) {
        job->found += gsn_spline_eval(job->bench->spline, job->points->u[i], &hint, &value,
                                      gradient) == GSN_OK;
        job->sink += value;
    }
}

static void run_many(void *context)
{
    struct points_job *job = context;
    struct gsn_error err = { 0 };

    bench_need(gsn_spline_eval_many(job->bench->spline, (const double(*)[3])job->points->u,
                                    job->points->count, 1, job->value, job->gradient, &err),
               &err, "points");
}

static double ns(const struct bench_job *job, const struct points *points)
{
    return job->cpu_s * 1e9 / (double)points->count;
}

static json_t *describe(const struct points_job *job, const char *order, unsigned repeats)
{
    return json_pack(
        "{s:i, s:I, s:I, s:s, s:s, s:i}", "degree", (int)gsn_dms_degree(job->bench->space), "tets",
        (json_int_t)job->bench->mesh->tet_count, "points", (json_int_t)job->points->count, "order",
        order, "of", "least of repeats", "repeats", (int)repeats);
}

void bench_locate(void)
{
    const unsigned repeats = bench_quick ? 1 : 3;
    struct bench_case bench = bench_case_new(BENCH_27K, 1, CLOUD);
    struct points random = draw_points(bench_quick ? 100 : 1000000), order = sorted(&random);
    struct points_job what[2] = { { .bench = &bench, .points = &random },
                                  { .bench = &bench, .points = &order } };
    struct bench_job job[2] = { { .run = run_locate, .context = &what[0] },
                                { .run = run_locate, .context = &what[1] } };

    bench_race(job, 2, repeats);
    bench_say("locate", ns(&job[0], &random), "ns/point", NULL, NAN,
              describe(&what[0], "random", repeats));
    bench_say("locate", ns(&job[1], &order), "ns/point", "random order",
              job[0].cpu_s / job[1].cpu_s, describe(&what[1], "morton", repeats));
    gsn_free(random.u);
    gsn_free(order.u);
    bench_case_done(&bench);
}

/* The largest difference of the batch's values and gradients from those of one at a time. */
static void compare(const struct points_job *job, double *ret_value, double *ret_gradient)
{
    size_t hint = 0;

    *ret_value = *ret_gradient = 0;
    for (size_t i = 0; i < job->points->count && i < CHECKED; i++) {
        double value = NAN, gradient[3] = { NAN, NAN, NAN };

        (void)gsn_spline_eval(job->bench->spline, job->points->u[i], &hint, &value, gradient);
        /* A NaN of either side alone must not pass for agreement. */
        if (isnan(value) != isnan(job->value[i]))
            *ret_value = DBL_MAX;
        *ret_value = fmax(*ret_value, fabs(value - job->value[i]));
        for (int c = 0; c < 3; c++)
            *ret_gradient = fmax(*ret_gradient, fabs(gradient[c] - job->gradient[i][c]));
    }
}

static void say_many(const struct points_job *what, const struct bench_job *many,
                     const struct bench_job *one, const struct points *few, const char *order,
                     unsigned repeats)
{
    json_t *details = describe(what, order, repeats);
    double value, gradient;

    compare(what, &value, &gradient);
    (void)json_object_set_new(details, "against_ns", json_real(ns(one, few)));
    (void)json_object_set_new(details, "largest_value_difference", json_real(value));
    (void)json_object_set_new(details, "largest_gradient_difference", json_real(gradient));
    bench_say("eval_many", ns(many, what->points), "ns/point", "one at a time in the same order",
              ns(one, few) / ns(many, what->points), details);
}

/* Value and gradient: all points at once, and a part of them one at a time, in both orders. */
static void points_degree(unsigned degree, const struct points order[2], const struct points few[2])
{
    static const char *const ORDER[2] = { "random", "morton" };
    const unsigned repeats = bench_quick ? 1 : 3;
    struct bench_case bench = bench_case_new(BENCH_27K, degree, CLOUD);
    struct points_job what[4];
    struct bench_job job[4];

    for (int o = 0; o < 2; o++) {
        what[o] =
            (struct points_job){ .bench = &bench,
                                 .points = &order[o],
                                 .value = bench_alloc(order[o].count, sizeof(double)),
                                 .gradient = bench_alloc(order[o].count, 3 * sizeof(double)) };
        what[2 + o] = (struct points_job){ .bench = &bench, .points = &few[o] };
        job[o] = (struct bench_job){ .run = run_many, .context = &what[o] };
        job[2 + o] = (struct bench_job){ .run = run_eval, .context = &what[2 + o] };
    }
    bench_race(job, 4, repeats);
    for (int o = 0; o < 2; o++) {
        bench_say("eval_one_by_one", ns(&job[2 + o], &few[o]), "ns/point", NULL, NAN,
                  describe(&what[2 + o], ORDER[o], repeats));
        say_many(&what[o], &job[o], &job[2 + o], &few[o], ORDER[o], repeats);
        gsn_free(what[o].value);
        gsn_free(what[o].gradient);
    }
    bench_case_done(&bench);
}

void bench_points(void)
{
    struct points order[2], few[2];

    order[0] = draw_points(bench_quick ? 1000 : 1000000);
    order[1] = sorted(&order[0]);
    few[0] = draw_points(bench_quick ? 100 : 100000);
    few[1] = sorted(&few[0]);
    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++)
        points_degree(degree, order, few);
    for (int o = 0; o < 2; o++) {
        gsn_free(order[o].u);
        gsn_free(few[o].u);
    }
}
