/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The cubic seam kernels, hot in the cache, as a fraction of the multiply-add peak of the same
 * instruction set measured in the same turns. */
#include "pipeline/model/face_correction.h"

#include "tests/bench/bench.h"

#include <math.h>
#include <string.h>

#define CLOUD 0.03
enum { POINTS = 512, CLASSES = 4, MOST_JOBS = GSN_ISA_COUNT * (1 + CLASSES), MOST_TRIES = 100000 };

/* The classes, by the clouds that are not clear: what the recurrence cannot leave out. */
static const struct {
    unsigned unclear;
    const char *name;
} CLASS[CLASSES] = { { 0, "face" }, { 1, "one cloud" }, { 3, "edge" }, { 7, "all" } };

/* One face and points inside its prism that are clear of all clouds, so that every class may be
 * asked about them. */
struct subject {
    struct gsn_prism prism;
    struct gsn_face_correction seam;
    double x[POINTS], y[POINTS], z[POINTS];
};

/* A point near the middle of the face, anywhere across the prism. */
static void draw_point(const struct bench_case *bench, const struct gsn_prism *prism,
                       uint64_t *seed, double ret_u[3])
{
    const double a = 0.2 + 0.2 * bench_draw(seed), b = 0.2 + 0.2 * bench_draw(seed);
    const double weight[3] = { 1 - a - b, a, b };
    double radius = 0, height;

    for (int c = 0; c < 3; c++) {
        const double edge =
            bench->mesh->vertex[prism->vertex[1]][c] - bench->mesh->vertex[prism->vertex[0]][c];

        radius += edge * edge;
    }
    height = CLOUD * sqrt(radius) * (2 * bench_draw(seed) - 1);
    for (int c = 0; c < 3; c++) {
        ret_u[c] = height * prism->turn[2][c];
        for (int k = 0; k < 3; k++)
            ret_u[c] += weight[k] * bench->mesh->vertex[prism->vertex[k]][c];
    }
}

static int draw_points(const struct bench_case *bench, struct subject *subject)
{
    uint64_t seed = 77;
    size_t count = 0;

    for (int i = 0; i < MOST_TRIES && count < POINTS; i++) {
        double u[3];

        draw_point(bench, &subject->prism, &seed, u);
        if (gsn_prism_at(&subject->prism, u) != 0)
            continue;
        subject->x[count] = u[0];
        subject->y[count] = u[1];
        subject->z[count] = u[2];
        count++;
    }
    return count == POINTS;
}

/* The first inner face that has enough room, prepared for every class. */
static int find_subject(const struct bench_case *bench, struct subject *subject)
{
    for (size_t t = 0; t < bench->mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++) {
            const double *at[3] = { subject->x, subject->y, subject->z };
            double unused = 0;

            if (bench->mesh->neighbour[t][k] < 0 ||
                !gsn_prism_init(bench->space, t, k, &subject->prism) ||
                !draw_points(bench, subject))
                continue;
            gsn_face_correction_init(&subject->seam, bench->space, &subject->prism,
                                     gsn_spline_controls(bench->spline));
            gsn_face_correction_add(&subject->seam, 7, at, 1, &unused, NULL);
            return 1;
        }
    }
    return 0;
}

struct kernel_job {
    const struct subject *subject;
    gsn_face_correction_kernel *run;
    unsigned lanes, unsure;
    size_t rounds;
    double sink;
};

static void run_kernel(void *context)
{
    struct kernel_job *job = context;
    const struct subject *s = job->subject;
    double ret[4 * GSN_MAX_SIMD_WIDTH];

    for (size_t round = 0; round < job->rounds; round++) {
        for (size_t i = 0; i < POINTS; i += job->lanes) {
            job->unsure |= job->run(&s->seam.data, &s->x[i], &s->y[i], &s->z[i], ret, NULL);
            job->sink += ret[0];
        }
    }
}

/* All jobs of one kind of kernel: per instruction set its peak, then its classes. */
struct lineup {
    struct bench_peak peak[GSN_ISA_COUNT];
    struct kernel_job kernel[GSN_ISA_COUNT][CLASSES];
    const struct gsn_face_correction_choice *choice[GSN_ISA_COUNT][CLASSES];
    struct bench_job job[MOST_JOBS];
    int first[GSN_ISA_COUNT]; /* job of the peak, or -1 */
};

static size_t line_up(struct lineup *lineup, const struct subject *subject,
                      enum gsn_face_correction_kind kind)
{
    size_t count = 0;

    for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
        const struct gsn_kernels *kernels = gsn_kernels_for((enum gsn_isa)isa);

        lineup->first[isa] = -1;
        if (!kernels || !bench_peak_exists((enum gsn_isa)isa))
            continue;
        lineup->first[isa] = (int)count;
        lineup->peak[isa] =
            (struct bench_peak){ .isa = (enum gsn_isa)isa, .rounds = bench_quick ? 1000 : 4000000 };
        lineup->job[count++] =
            (struct bench_job){ .run = bench_peak_run, .context = &lineup->peak[isa] };
        for (int c = 0; c < CLASSES; c++) {
            const struct gsn_face_correction_choice *choice =
                &kernels->seam[kind][3][subject->prism.top][CLASS[c].unclear];

            lineup->choice[isa][c] = choice;
            lineup->kernel[isa][c] = (struct kernel_job){ .subject = subject,
                                                          .run = choice->run,
                                                          .lanes = kernels->lanes,
                                                          .rounds = bench_quick ? 2 : 2000 };
            lineup->job[count++] =
                (struct bench_job){ .run = run_kernel, .context = &lineup->kernel[isa][c] };
        }
    }
    return count;
}

static void say_kernel(const struct lineup *lineup, int isa, int c, const struct subject *subject,
                       const char *kind, unsigned repeats)
{
    const struct bench_job *peak = &lineup->job[lineup->first[isa]], *kernel = peak + 1 + c;
    const struct bench_job *scalar = &lineup->job[lineup->first[GSN_ISA_SCALAR]] + 1 + c;
    const double points = (double)(lineup->kernel[isa][c].rounds * POINTS);
    const double ns = kernel->cpu_s * 1e9 / points;
    const double best = bench_peak_flops(&lineup->peak[isa]) / peak->cpu_s * 1e-9;
    const unsigned flops = lineup->choice[isa][c]->flops;

    bench_say(
        "kernel", ns, "ns/point", "peak of this instruction set, as a fraction", flops / ns / best,
        json_pack("{s:s, s:s, s:s, s:i, s:i, s:i, s:f, s:f, s:f, s:i, s:s, s:i}", "isa",
                  bench_isa_name((enum gsn_isa)isa), "kind", kind, "class", CLASS[c].name, "degree",
                  3, "top", (int)subject->prism.top, "flops_per_point", (int)flops, "gflops",
                  flops / ns, "peak_gflops", best, "times_scalar", scalar->cpu_s / kernel->cpu_s,
                  "undecided_lanes", __builtin_popcount(lineup->kernel[isa][c].unsure), "of",
                  "least of repeats", "repeats", (int)repeats));
}

void bench_kernel(void)
{
    static const char *const KIND[2] = { "value", "value and gradient" };
    static struct subject subject;
    static struct lineup lineup;
    const unsigned repeats = bench_quick ? 1 : 15;
    struct bench_case bench = bench_case_new(BENCH_4K, 3, CLOUD);

    if (!find_subject(&bench, &subject)) {
        bench_skip("kernel", "ns/point", "peak of this instruction set, as a fraction",
                   "no face of the mesh has room between its clouds");
        bench_case_done(&bench);
        return;
    }
    for (int kind = GSN_FACE_CORRECTION_VALUE; kind <= GSN_FACE_CORRECTION_SLOPE; kind++) {
        bench_race(lineup.job, line_up(&lineup, &subject, (enum gsn_face_correction_kind)kind),
                   repeats);
        for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
            for (int c = 0; lineup.first[isa] >= 0 && c < CLASSES; c++)
                say_kernel(&lineup, isa, c, &subject, KIND[kind], repeats);
        }
    }
    bench_case_done(&bench);
}
