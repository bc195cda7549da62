/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Points that are no grid: where they lie, and value and gradient there, in random order and in the
 * order of space. */
#include "tests/bench/bench.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define CLOUD 0.03

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

static json_t *describe(const struct points_job *job, const char *order, unsigned repeats)
{
    return json_pack(
        "{s:i, s:I, s:I, s:s, s:s, s:i}", "degree", (int)gsn_dms_degree(job->bench->space), "tets",
        (json_int_t)job->bench->mesh->tet_count, "points", (json_int_t)job->points->count, "order",
        order, "of", "least of repeats", "repeats", (int)repeats);
}

/* The same points in both orders, in turns. */
static void race_orders(const char *measure, const struct bench_case *bench, size_t count,
                        void (*run)(void *context))
{
    const unsigned repeats = bench_quick ? 1 : 3;
    struct points random = draw_points(count), order = sorted(&random);
    struct points_job what[2] = { { .bench = bench, .points = &random },
                                  { .bench = bench, .points = &order } };
    struct bench_job job[2] = { { .run = run, .context = &what[0] },
                                { .run = run, .context = &what[1] } };

    bench_race(job, 2, repeats);
    bench_say(measure, job[0].cpu_s * 1e9 / (double)count, "ns/point", NULL, NAN,
              describe(&what[0], "random", repeats));
    bench_say(measure, job[1].cpu_s * 1e9 / (double)count, "ns/point", "random order",
              job[0].cpu_s / job[1].cpu_s, describe(&what[1], "morton", repeats));
    gsn_free(random.u);
    gsn_free(order.u);
}

void bench_points(void)
{
    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        struct bench_case bench = bench_case_new(BENCH_27K, degree, CLOUD);

        race_orders("eval_one_by_one", &bench, bench_quick ? 100 : 100000, run_eval);
        bench_case_done(&bench);
    }
}

void bench_locate(void)
{
    struct bench_case bench = bench_case_new(BENCH_27K, 1, CLOUD);

    race_orders("locate", &bench, bench_quick ? 100 : 1000000, run_locate);
    bench_case_done(&bench);
}
