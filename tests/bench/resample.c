/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A whole grid of values, and the recurrences it is measured against: the textbook's, and the
 * product's own, which shares everything that one tetrahedron has to share at a point. */
#include "pipeline/model/resample.h"

#include "tests/bench/bench.h"
#include "tests/bench/plain.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CLOUD 0.03
enum { CHECKED = 2000, MOST_TERMS = 4096 };

static size_t grid_edge(void)
{
    return bench_quick ? 16 : 256;
}

struct grid_job {
    const struct gsn_spline *spline;
    struct gsn_lattice at;
    unsigned threads;
    double *value;
};

static void run_grid(void *context)
{
    const struct grid_job *job = context;
    struct gsn_error err = { 0 };

    bench_need(gsn_spline_resample(job->spline, &job->at, job->threads, job->value, &err), &err,
               "resample");
}

/* Random voxels of a lattice in the order of the lattice, so that nobody pays for jumping about. */
struct samples {
    size_t count;
    size_t *voxel;
    double (*u)[3];
};

static int ascending(const void *a, const void *b)
{
    const size_t x = *(const size_t *)a, y = *(const size_t *)b;

    return (x > y) - (x < y);
}

static struct samples draw_samples(const struct gsn_lattice *at, size_t count)
{
    struct samples samples = { .count = count };
    uint64_t seed = 31;

    samples.voxel = bench_alloc(count, sizeof *samples.voxel);
    samples.u = bench_alloc(count, sizeof *samples.u);
    for (size_t i = 0; i < count; i++)
        samples.voxel[i] = (size_t)(bench_draw(&seed) * (double)gsn_lattice_count(at));
    qsort(samples.voxel, count, sizeof *samples.voxel, ascending);
    for (size_t i = 0; i < count; i++) {
        const size_t v = samples.voxel[i];
        const struct gsn_vec3 centre =
            gsn_lattice_centre(at, v % at->nx, v / at->nx % at->ny, v / at->nx / at->ny);

        samples.u[i][0] = centre.x;
        samples.u[i][1] = centre.y;
        samples.u[i][2] = centre.z;
    }
    return samples;
}

static void free_samples(struct samples *samples)
{
    gsn_free(samples->voxel);
    gsn_free(samples->u);
}

struct plain_job {
    const struct plain *plain;
    enum plain_choice choice;
    const struct samples *samples;
    size_t count; /* of the samples, spread evenly */
    double sink;
};

static void run_plain(void *context)
{
    struct plain_job *job = context;

    for (size_t i = 0; i < job->count; i++)
        job->sink += plain_eval(job->plain, job->choice,
                                job->samples->u[i * job->samples->count / job->count]);
}

/* The product's recurrence as fast as it goes point by point, without its polynomials' shortcut. */
struct memo_job {
    const struct gsn_spline *spline;
    const struct samples *samples;
    size_t count;
    double sink;
};

static void run_memo(void *context)
{
    static struct gsn_dms_term term[MOST_TERMS];
    struct memo_job *job = context;
    const double *control = gsn_spline_controls(job->spline);
    size_t hint = 0;

    for (size_t i = 0; i < job->count; i++) {
        size_t count = 0;

        (void)gsn_dms_basis(gsn_spline_space(job->spline),
                            job->samples->u[i * job->samples->count / job->count], 0, &hint, term,
                            MOST_TERMS, &count);
        for (size_t j = 0; j < count && j < MOST_TERMS; j++)
            job->sink += control[term[j].control] * term[j].value;
    }
}

/* The largest difference of a recurrence from the product's evaluation at some of the samples. */
static double plain_error(const struct plain *plain, enum plain_choice choice,
                          const struct gsn_spline *spline, const struct samples *samples)
{
    const size_t count = samples->count < 200 ? samples->count : 200;
    double worst = 0;
    size_t hint = 0;

    for (size_t i = 0; i < count; i++) {
        const double *u = samples->u[i * samples->count / count];
        double value = 0;

        if (gsn_spline_eval(spline, u, &hint, &value, NULL) != GSN_OK)
            continue;
        worst = fmax(worst, fabs(value - plain_eval(plain, choice, u)));
    }
    return worst;
}

/* A recurrence that computes something else is no peer. */
static void demand_same(double error)
{
    if (error <= 1e-9)
        return;
    fprintf(stderr, "gieson-bench: the plain recurrence is off by %g\n", error);
    exit(70);
}

/* Enough points for about a third of a second. */
static size_t plain_points(unsigned degree)
{
    static const size_t POINTS[GSN_DMS_MAX_DEGREE + 1] = { 0, 100000, 20000, 4000 };

    return bench_quick ? 50 : POINTS[degree];
}

static const char *const PLAIN_NAME[PLAIN_CHOICES] = {
    "plain recurrence, W of largest |det| looked up",
    "plain recurrence, W the first independent four",
    "plain recurrence, W of largest |det| looked up, every tetrahedron whose knots' box holds u",
};

/* Everything one degree has. */
struct contest {
    struct bench_case bench;
    struct samples samples;
    struct plain *plain;
    struct plain_job textbook[PLAIN_CHOICES];
    struct memo_job memo;
    double error[PLAIN_CHOICES];
};

static void enter(struct contest *contest, unsigned degree, const struct gsn_lattice *at)
{
    contest->bench = bench_case_new(BENCH_27K, degree, CLOUD);
    contest->samples = draw_samples(at, plain_points(1));
    contest->plain = plain_new(contest->bench.spline);
    for (int c = 0; c < PLAIN_CHOICES; c++) {
        contest->textbook[c] = (struct plain_job){ .plain = contest->plain,
                                                   .choice = (enum plain_choice)c,
                                                   .samples = &contest->samples,
                                                   .count = plain_points(degree) };
        contest->error[c] = plain_error(contest->plain, (enum plain_choice)c, contest->bench.spline,
                                        &contest->samples);
    }
    demand_same(contest->error[PLAIN_LARGEST]);
    contest->memo = (struct memo_job){ .spline = contest->bench.spline,
                                       .samples = &contest->samples,
                                       .count = bench_quick ? 50 : 50000 };
}

static void leave(struct contest *contest)
{
    plain_free(contest->plain);
    free_samples(&contest->samples);
    bench_case_done(&contest->bench);
}

static json_t *describe(const struct contest *contest, unsigned degree, unsigned repeats)
{
    return json_pack("{s:i, s:I, s:f, s:I, s:s, s:i}", "degree", (int)degree, "tets",
                     (json_int_t)contest->bench.mesh->tet_count, "cloud", CLOUD, "clouds_shrunk",
                     (json_int_t)contest->bench.shrunk, "of", "least of repeats", "repeats",
                     (int)repeats);
}

/* The textbook alone. */
void bench_plain(void)
{
    const struct gsn_lattice at = bench_lattice(grid_edge());
    const unsigned repeats = bench_quick ? 1 : 5;

    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        struct contest contest;
        struct bench_job job[PLAIN_CHOICES + 1];
        double ns[PLAIN_CHOICES + 1];

        enter(&contest, degree, &at);
        for (int c = 0; c < PLAIN_CHOICES; c++)
            job[c] = (struct bench_job){ .run = run_plain, .context = &contest.textbook[c] };
        job[PLAIN_CHOICES] = (struct bench_job){ .run = run_memo, .context = &contest.memo };
        bench_race(job, PLAIN_CHOICES + 1, repeats);
        ns[PLAIN_CHOICES] = job[PLAIN_CHOICES].cpu_s * 1e9 / (double)contest.memo.count;
        for (int c = 0; c < PLAIN_CHOICES; c++) {
            json_t *details = describe(&contest, degree, repeats);

            (void)json_object_set_new(details, "what", json_string(PLAIN_NAME[c]));
            (void)json_object_set_new(details, "largest_error", json_real(contest.error[c]));
            ns[c] = job[c].cpu_s * 1e9 / (double)contest.textbook[c].count;
            bench_say("plain", ns[c], "ns/point", NULL, NAN, details);
        }
        bench_say("memoised", ns[PLAIN_CHOICES], "ns/point", PLAIN_NAME[PLAIN_LARGEST],
                  ns[PLAIN_LARGEST] / ns[PLAIN_CHOICES], describe(&contest, degree, repeats));
        leave(&contest);
    }
}

/* The largest difference from one-by-one evaluation at random voxels, "no data" included. */
static double grid_error(const struct grid_job *job)
{
    struct samples samples = draw_samples(&job->at, CHECKED);
    double worst = 0;
    size_t hint = 0;

    for (size_t i = 0; i < samples.count; i++) {
        const double value = job->value[samples.voxel[i]];
        double truth = NAN;

        (void)gsn_spline_eval(job->spline, samples.u[i], &hint, &truth, NULL);
        if (isnan(truth) != isnan(value))
            worst = INFINITY;
        else if (!isnan(truth))
            worst = fmax(worst, fabs(value - truth));
    }
    free_samples(&samples);
    return worst;
}

static void resample_degree(unsigned degree, struct grid_job *grid)
{
    const unsigned repeats = bench_quick ? 1 : 5;
    const size_t voxels = gsn_lattice_count(&grid->at);
    struct contest contest;
    struct bench_job job[PLAIN_CHOICES + 2];
    double ours;

    enter(&contest, degree, &grid->at);
    grid->spline = contest.bench.spline;
    job[0] = (struct bench_job){ .run = run_grid, .context = grid };
    for (int c = 0; c < PLAIN_CHOICES; c++)
        job[1 + c] = (struct bench_job){ .run = run_plain, .context = &contest.textbook[c] };
    job[1 + PLAIN_CHOICES] = (struct bench_job){ .run = run_memo, .context = &contest.memo };
    bench_race(job, PLAIN_CHOICES + 2, repeats);
    ours = job[0].cpu_s * 1e9 / (double)voxels;
    for (int c = 0; c <= PLAIN_CHOICES; c++) {
        const size_t points = c < PLAIN_CHOICES ? contest.textbook[c].count : contest.memo.count;
        const double theirs = job[1 + c].cpu_s * 1e9 / (double)points;
        json_t *details = describe(&contest, degree, repeats);

        (void)json_object_set_new(details, "grid", json_integer((json_int_t)grid->at.nx));
        (void)json_object_set_new(details, "seconds", json_real(job[0].cpu_s));
        (void)json_object_set_new(details, "against_ns", json_real(theirs));
        bench_say("resample", ours, "ns/voxel",
                  c < PLAIN_CHOICES ? PLAIN_NAME[c] : "memoised recurrence", theirs / ours,
                  details);
    }
    bench_say("resample_agreement", grid_error(grid), "largest absolute difference",
              "gsn_spline_eval", NAN,
              json_pack("{s:i, s:i}", "degree", (int)degree, "voxels", (int)CHECKED));
    leave(&contest);
}

static struct grid_job grid_job(size_t edge, unsigned threads)
{
    struct grid_job job = { .at = bench_lattice(edge), .threads = threads };

    job.value = bench_alloc(gsn_lattice_count(&job.at), sizeof *job.value);
    return job;
}

void bench_resample(void)
{
    struct grid_job grid = grid_job(grid_edge(), 1);

    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++)
        resample_degree(degree, &grid);
    gsn_free(grid.value);
}

void bench_threads(void)
{
    const unsigned repeats = bench_quick ? 1 : 15;
    struct grid_job one = grid_job(grid_edge(), 1), two = grid_job(grid_edge(), 2);

    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        struct bench_case bench = bench_case_new(BENCH_27K, degree, CLOUD);
        struct bench_job job[2] = { { .run = run_grid, .context = &one },
                                    { .run = run_grid, .context = &two } };
        const size_t bytes = gsn_lattice_count(&one.at) * sizeof *one.value;
        double load = 0;

        one.spline = two.spline = bench.spline;
        bench_race(job, 2, repeats);
        /* Where others want the processors too, the clock tells of them: what two threads could
         * gain at most by their CPU time, and the load, say so. */
        (void)getloadavg(&load, 1);
        bench_say("resample_threads", job[1].wall_s, "s of the clock", "one thread",
                  job[0].wall_s / job[1].wall_s,
                  json_pack("{s:i, s:i, s:f, s:f, s:f, s:b, s:s, s:i}", "degree", (int)degree,
                            "threads", 2, "one_thread_s", job[0].wall_s, "most_by_cpu_time",
                            2 * job[0].cpu_s / job[1].cpu_s, "load", load, "same_bits",
                            memcmp(one.value, two.value, bytes) == 0, "of", "least of repeats",
                            "repeats", (int)repeats));
        bench_case_done(&bench);
    }
    gsn_free(one.value);
    gsn_free(two.value);
}

/* Of the line through (log tets, log seconds) in least squares. */
static double slope_of(const double *tets, const double *seconds, size_t count)
{
    double x = 0, y = 0, xx = 0, xy = 0;

    for (size_t i = 0; i < count; i++) {
        x += log(tets[i]) / (double)count;
        y += log(seconds[i]) / (double)count;
    }
    for (size_t i = 0; i < count; i++) {
        xx += (log(tets[i]) - x) * (log(tets[i]) - x);
        xy += (log(tets[i]) - x) * (log(seconds[i]) - y);
    }
    return xy / xx;
}

void bench_slope(void)
{
    const unsigned repeats = bench_quick ? 1 : 5;
    struct grid_job grid[BENCH_SIZES];

    for (int s = 0; s < BENCH_SIZES; s++)
        grid[s] = grid_job(grid_edge(), 1);
    for (unsigned degree = 1; degree <= GSN_DMS_MAX_DEGREE; degree++) {
        struct bench_case bench[BENCH_SIZES];
        struct bench_job job[BENCH_SIZES];
        double tets[BENCH_SIZES], seconds[BENCH_SIZES];

        for (int s = 0; s < BENCH_SIZES; s++) {
            bench[s] = bench_case_new((enum bench_size)s, degree, CLOUD);
            grid[s].spline = bench[s].spline;
            job[s] = (struct bench_job){ .run = run_grid, .context = &grid[s] };
        }
        bench_race(job, BENCH_SIZES, repeats);
        for (int s = 0; s < BENCH_SIZES; s++) {
            tets[s] = (double)bench[s].mesh->tet_count;
            seconds[s] = job[s].cpu_s;
            bench_case_done(&bench[s]);
        }
        bench_say("resample_slope", slope_of(tets, seconds, BENCH_SIZES),
                  "log seconds / log tetrahedra", NULL, NAN,
                  json_pack("{s:i, s:[f,f,f], s:[f,f,f], s:[f,f], s:s, s:i}", "degree", (int)degree,
                            "tets", tets[0], tets[1], tets[2], "seconds", seconds[0], seconds[1],
                            seconds[2], "between", slope_of(tets, seconds, 2),
                            slope_of(&tets[1], &seconds[1], 2), "of", "least of repeats", "repeats",
                            (int)repeats));
    }
    for (int s = 0; s < BENCH_SIZES; s++)
        gsn_free(grid[s].value);
}
