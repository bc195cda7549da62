/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A fit to a grid of voxels: what its equations cost against one resampling of that grid, how many
 * iterations they take, how its time grows with the number of tetrahedra, and its memory. */
#include "pipeline/model/fit.h"

#include "pipeline/model/fit_system.h"
#include "pipeline/model/resample.h"

#include "tests/bench/bench.h"

#include <malloc.h>
#include <math.h>

#define CLOUD 0.003

static size_t grid_edge(void)
{
    return bench_quick ? 24 : 128;
}

struct fit_job {
    const struct bench_case *bench;
    struct gsn_lattice at;
    struct gsn_samples samples;
    double *grid; /* room for the resampled voxels */
    double bytes; /* of the equations */
    struct gsn_fit_report report;
};

static double heap(void)
{
    const struct mallinfo2 info = mallinfo2();

    return (double)(info.uordblks + info.hblkhd);
}

static void run_resample(void *context)
{
    struct fit_job *job = context;
    struct gsn_error err = { 0 };

    bench_need(gsn_spline_resample(job->bench->spline, &job->at, 1, job->grid, &err), &err,
               "resample");
}

static void run_assembly(void *context)
{
    struct fit_job *job = context;
    const struct gsn_fit_options options = { .threads = 1 };
    const double before = heap();
    struct gsn_fit_rows rows;
    struct gsn_fit_system system;
    struct gsn_error err = { 0 };

    bench_need(gsn_fit_rows_sort(&rows, job->bench->space, &job->samples, &options, &err), &err,
               "samples");
    bench_need(gsn_fit_rows_evaluate(&rows, 1, &err), &err, "basis");
    bench_need(gsn_fit_system_assemble(&system, &rows, NULL, 1, &err), &err, "equations");
    job->bytes = heap() - before;
    gsn_fit_system_done(&system);
    gsn_fit_rows_done(&rows);
}

static void run_fit(void *context)
{
    struct fit_job *job = context;
    const struct gsn_fit_options options = { .smoothing = GSN_FIT_SMOOTHING, .threads = 1 };
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_fit(job->bench->space, &job->samples, &options, &spline, &job->report, NULL,
                       NULL, &err),
               &err, "fit");
    gsn_spline_free(spline);
}

/* Voxels of the field that all benchmarks share. */
static void job_init(struct fit_job *job, const struct bench_case *bench)
{
    const size_t edge = grid_edge(), count = edge * edge * edge;
    double(*at)[3] = bench_alloc(count, sizeof *at);
    float *value = bench_alloc(count, sizeof *value);

    *job = (struct fit_job){ .bench = bench,
                             .at = bench_lattice(edge),
                             .grid = bench_alloc(count, sizeof *job->grid) };
    for (size_t i = 0; i < count; i++) {
        const struct gsn_vec3 c =
            gsn_lattice_centre(&job->at, i % edge, i / edge % edge, i / edge / edge);

        at[i][0] = c.x;
        at[i][1] = c.y;
        at[i][2] = c.z;
        value[i] = (float)bench_field(at[i]);
    }
    job->samples =
        (struct gsn_samples){ .count = count, .at = (const double(*)[3])at, .value = value };
}

static void job_done(struct fit_job *job)
{
    gsn_free((void *)job->samples.at);
    gsn_free((void *)job->samples.value);
    gsn_free(job->grid);
}

/* Returns the seconds of the fit. */
static double measure_fit(enum bench_size size, unsigned degree, size_t *ret_tets)
{
    struct bench_case bench = bench_case_new(size, degree, CLOUD);
    struct fit_job what;
    struct bench_job job[3] = { { .run = run_resample, .context = &what },
                                { .run = run_assembly, .context = &what },
                                { .run = run_fit, .context = &what } };

    job_init(&what, &bench);
    bench_race(job, 3, bench_quick ? 1 : 3);
    *ret_tets = bench.mesh->tet_count;
    bench_say("fit_assembly", job[1].cpu_s, "s", "one resampling of the grid",
              job[0].cpu_s / job[1].cpu_s,
              json_pack("{s:i, s:I, s:I, s:f}", "degree", (int)degree, "tets",
                        (json_int_t)bench.mesh->tet_count, "samples",
                        (json_int_t)what.samples.count, "bytes", what.bytes));
    bench_say("fit", job[2].cpu_s, "s", NULL, NAN,
              json_pack("{s:i, s:I, s:I, s:i, s:f}", "degree", (int)degree, "tets",
                        (json_int_t)bench.mesh->tet_count, "unknowns",
                        (json_int_t)what.report.unknowns, "iterations", (int)what.report.iterations,
                        "rms", what.report.rms));
    job_done(&what);
    bench_case_done(&bench);
    return job[2].cpu_s;
}

void bench_fit(void)
{
    for (unsigned degree = 2; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        size_t few, many;
        const double quick = measure_fit(BENCH_4K, degree, &few);
        double slow;

        (void)measure_fit(BENCH_27K, degree, &many);
        slow = measure_fit(BENCH_240K, degree, &many);
        bench_say("fit_slope", log(slow / quick) / log((double)many / (double)few),
                  "exponent of the tetrahedra", NULL, NAN,
                  json_pack("{s:i}", "degree", (int)degree));
    }
}
