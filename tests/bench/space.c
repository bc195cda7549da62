/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a space and a spline cost before they are asked anything, and exact means of tetrahedra. */
#include "tests/bench/bench.h"

#include <malloc.h>
#include <math.h>

#define CLOUD 0.03

struct space_job {
    const struct bench_case *bench;
    struct gsn_dms *space;
    struct gsn_spline *spline;
};

static void run_space(void *context)
{
    struct space_job *job = context;
    struct gsn_error err = { 0 };

    gsn_dms_free(job->space);
    job->space = NULL;
    bench_need(gsn_dms_new(job->bench->mesh, gsn_dms_degree(job->bench->space),
                           gsn_dms_knots(job->bench->space), GSN_DMS_SHARED, &job->space, &err),
               &err, "space");
}

static void run_spline(void *context)
{
    struct space_job *job = context;
    struct gsn_error err = { 0 };

    gsn_spline_free(job->spline);
    job->spline = NULL;
    bench_need(gsn_spline_new(job->bench->space, gsn_spline_controls(job->bench->spline),
                              &job->spline, &err),
               &err, "spline");
}

/* What the heap has given out. */
static double heap(void)
{
    const struct mallinfo2 info = mallinfo2();

    return (double)(info.uordblks + info.hblkhd);
}

static json_t *describe(const struct bench_case *bench)
{
    return json_pack("{s:i, s:I}", "degree", (int)gsn_dms_degree(bench->space), "tets",
                     (json_int_t)bench->mesh->tet_count);
}

/* As the heap sees it, so nothing is forgotten; the space's copy of the mesh included. */
static void measure_memory(const struct bench_case *bench)
{
    const double tets = (double)bench->mesh->tet_count, before = heap();
    struct space_job job = { .bench = bench };
    double after_space, after_spline, control;
    json_t *details = describe(bench);

    run_space(&job);
    after_space = heap();
    run_spline(&job);
    after_spline = heap();
    control = (double)gsn_dms_controls(bench->space) * sizeof(double);
    (void)json_object_set_new(details, "space_bytes", json_real((after_space - before) / tets));
    (void)json_object_set_new(details, "spline_bytes",
                              json_real((after_spline - after_space) / tets));
    (void)json_object_set_new(details, "control_bytes", json_real(control / tets));
    bench_say("memory", (after_spline - before - control) / tets,
              "bytes a tetrahedron beside the control points", NULL, NAN, details);
    gsn_spline_free(job.spline);
    gsn_dms_free(job.space);
}

static void measure_making(const struct bench_case *bench)
{
    const unsigned repeats = bench_quick ? 1 : 5;
    const double tets = (double)bench->mesh->tet_count;
    struct space_job what = { .bench = bench };
    struct bench_job job[2] = { { .run = run_space, .context = &what },
                                { .run = run_spline, .context = &what } };

    bench_race(job, 2, repeats);
    bench_say("make_space", job[0].cpu_s * 1e9 / tets, "ns/tetrahedron", NULL, NAN,
              describe(bench));
    bench_say("make_spline", job[1].cpu_s * 1e9 / tets, "ns/tetrahedron", NULL, NAN,
              describe(bench));
    gsn_spline_free(what.spline);
    gsn_dms_free(what.space);
}

void bench_space(void)
{
    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        struct bench_case bench = bench_case_new(BENCH_27K, degree, CLOUD);

        measure_memory(&bench);
        measure_making(&bench);
        bench_case_done(&bench);
    }
}

/* Every so-many-th tetrahedron. */
struct mean_job {
    const struct bench_case *bench;
    size_t count;
    double sink;
};

static void run_mean(void *context)
{
    struct mean_job *job = context;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < job->count; i++) {
        double mean = 0;

        bench_need(gsn_spline_tet_mean(job->bench->spline,
                                       i * job->bench->mesh->tet_count / job->count, &mean, &err),
                   &err, "mean");
        job->sink += mean;
    }
}

void bench_mean(void)
{
    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        struct bench_case bench = bench_case_new(BENCH_27K, degree, CLOUD);
        struct mean_job what = { .bench = &bench, .count = bench_quick ? 3 : 500 };
        struct bench_job job = { .run = run_mean, .context = &what };
        json_t *details = describe(&bench);

        bench_race(&job, 1, bench_quick ? 1 : 3);
        (void)json_object_set_new(details, "cells", json_integer((json_int_t)what.count));
        bench_say("mean", job.cpu_s * 1e6 / (double)what.count, "us/cell", NULL, NAN, details);
        bench_case_done(&bench);
    }
}
