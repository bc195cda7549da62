/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a space and a spline cost before they are asked anything, and exact means of tetrahedra. */
#include "tests/bench/bench.h"

#include <malloc.h>
#include <math.h>
#include <string.h>

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

enum { QUICK_CELLS = 3, CELLS = 500 };

/* Every so-many-th tetrahedron. */
struct mean_job {
    const struct bench_case *bench;
    size_t count;
    double mean[CELLS];
};

static size_t cell_of(const struct mean_job *job, size_t i)
{
    return i * job->bench->mesh->tet_count / job->count;
}

static void run_seams(void *context)
{
    struct mean_job *job = context;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < job->count; i++)
        bench_need(gsn_spline_tet_mean(job->bench->spline, cell_of(job, i), &job->mean[i], &err),
                   &err, "mean");
}

static void run_recurrence(void *context)
{
    struct mean_job *job = context;
    const struct gsn_tets *mesh = job->bench->mesh;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < job->count; i++) {
        double corner[4][3];

        for (int k = 0; k < 4; k++)
            memcpy(corner[k], mesh->vertex[mesh->tet[cell_of(job, i)][k]], sizeof corner[k]);
        bench_need(gsn_spline_cell_mean(job->bench->spline, (const double(*)[3])corner,
                                        &job->mean[i], &err),
                   &err, "mean");
    }
}

/* Means over tetrahedra of the mesh: the mean recurrence, and the seams. */
void bench_mean(void)
{
    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        struct bench_case bench = bench_case_new(BENCH_27K, degree, CLOUD);
        const size_t count = bench_quick ? QUICK_CELLS : CELLS;
        struct mean_job what[2] = { { .bench = &bench, .count = count },
                                    { .bench = &bench, .count = count } };
        struct bench_job job[2] = { { .run = run_recurrence, .context = &what[0] },
                                    { .run = run_seams, .context = &what[1] } };
        double worst = 0;
        json_t *details[2] = { describe(&bench), describe(&bench) };

        bench_race(job, 2, bench_quick ? 1 : 3);
        for (size_t i = 0; i < count; i++)
            worst = fmax(worst, fabs(what[0].mean[i] - what[1].mean[i]));
        for (int i = 0; i < 2; i++) {
            (void)json_object_set_new(details[i], "cells", json_integer((json_int_t)count));
            (void)json_object_set_new(details[i], "by",
                                      json_string(i == 0 ? "mean recurrence" : "seams"));
        }
        (void)json_object_set_new(details[1], "largest_difference", json_real(worst));
        bench_say("mean", job[0].cpu_s * 1e6 / (double)count, "us/cell", NULL, NAN, details[0]);
        bench_say("mean", job[1].cpu_s * 1e6 / (double)count, "us/cell", "mean recurrence",
                  job[0].cpu_s / job[1].cpu_s, details[1]);
        bench_case_done(&bench);
    }
}
