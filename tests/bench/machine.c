/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the machine can do at best: multiply-adds that never touch memory, and memory that hardly
 * meets arithmetic. Everything else is a fraction of these. */
#include "tests/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#ifdef __x86_64__
#include <immintrin.h>
#endif

/* Independent sums, enough of them to hide the latency of an instruction on two ports. They tend
 * to 1, so that no operand is ever slow, and start apart: equal ones would be computed once. */
enum { SUMS = 12 };
#define FACTOR (1 - 0x1p-20)
#define TERM 0x1p-20

#define PEAK(name, attributes, vector, set, multiply_add, add, first)                              \
    __attribute__(attributes) static double name(size_t rounds)                                    \
    {                                                                                              \
        const vector factor = set(FACTOR), term = set(TERM);                                       \
        vector sum[SUMS];                                                                          \
                                                                                                   \
        for (int s = 0; s < SUMS; s++)                                                             \
            sum[s] = set(0.5 + s / 64.0);                                                          \
        for (size_t i = 0; i < rounds; i++) {                                                      \
            _Pragma("GCC unroll 12") for (int s = 0; s < SUMS; s++) sum[s] =                       \
                multiply_add(sum[s], factor, term);                                                \
        }                                                                                          \
        for (int s = 1; s < SUMS; s++)                                                             \
            sum[0] = add(sum[0], sum[s]);                                                          \
        return first(sum[0]);                                                                      \
    }

#ifdef __x86_64__
PEAK(peak_avx512, (noinline, target("avx512f")), __m512d, _mm512_set1_pd, _mm512_fmadd_pd,
     _mm512_add_pd, _mm512_reduce_add_pd)
PEAK(peak_avx2, (noinline, target("avx2,fma")), __m256d, _mm256_set1_pd, _mm256_fmadd_pd,
     _mm256_add_pd, _mm256_cvtsd_f64)
/* One lane, but fused where the processor has it: no build with scalar arithmetic can do more. */
PEAK(peak_scalar_fused, (noinline, target("fma")), __m128d, _mm_set_sd, _mm_fmadd_sd, _mm_add_sd,
     _mm_cvtsd_f64)
#endif

#define ITSELF(a) (a)
#define TWO_STEPS(a, b, c) ((a) * (b) + (c))
#define PLUS(a, b) ((a) + (b))
/* Kept from becoming vectors. */
PEAK(peak_scalar_apart, (noinline, optimize("no-tree-slp-vectorize")), double, ITSELF, TWO_STEPS,
     PLUS, ITSELF)

int bench_peak_exists(enum gsn_isa isa)
{
#ifdef __x86_64__
    if (isa == GSN_ISA_AVX512)
        return __builtin_cpu_supports("avx512f");
    if (isa == GSN_ISA_AVX2)
        return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#endif
    return isa == GSN_ISA_SCALAR;
}

const char *bench_isa_name(enum gsn_isa isa)
{
    static const char *const NAME[GSN_ISA_COUNT] = { "scalar", "avx2", "avx512" };

    return NAME[isa];
}

void bench_peak_run(void *context)
{
    struct bench_peak *peak = context;

#ifdef __x86_64__
    if (peak->isa == GSN_ISA_AVX512)
        peak->sink += peak_avx512(peak->rounds);
    else if (peak->isa == GSN_ISA_AVX2)
        peak->sink += peak_avx2(peak->rounds);
    else if (__builtin_cpu_supports("fma"))
        peak->sink += peak_scalar_fused(peak->rounds);
    else
        peak->sink += peak_scalar_apart(peak->rounds);
#else
    peak->sink += peak_scalar_apart(peak->rounds);
#endif
}

double bench_peak_flops(const struct bench_peak *peak)
{
    static const double LANES[GSN_ISA_COUNT] = { 1, 4, 8 };

    return (double)peak->rounds * SUMS * 2 * LANES[peak->isa];
}

/* The first "model name" of the processors. */
static void cpu_name(char *ret, size_t room)
{
    FILE *info = fopen("/proc/cpuinfo", "r");
    char line[512];

    snprintf(ret, room, "unknown");
    while (info && fgets(line, sizeof line, info)) {
        const char *colon = strchr(line, ':');

        if (strncmp(line, "model name", 10) != 0 || !colon)
            continue;
        snprintf(ret, room, "%.*s", (int)strcspn(colon + 2, "\n"), colon + 2);
        break;
    }
    if (info)
        (void)fclose(info);
}

struct triad {
    size_t count;
    double *a, *b, *c, factor;
};

static void run_triad(void *context)
{
    const struct triad *triad = context;
    double *restrict a = triad->a;
    const double *restrict b = triad->b, *restrict c = triad->c;

    for (size_t i = 0; i < triad->count; i++)
        a[i] = b[i] + triad->factor * c[i];
}

/* Three arrays, together at least twice the largest cache. */
static size_t triad_items(void)
{
    const long cache = sysconf(_SC_LEVEL3_CACHE_SIZE);
    const size_t floor = (size_t)3 << 26;
    const size_t bytes = cache > 0 && 2 * (size_t)cache > floor ? 2 * (size_t)cache : floor;

    return bench_quick ? 1000 : bytes / 3 / sizeof(double);
}

static void measure_triad(const char *cpu)
{
    struct triad triad = { .count = triad_items(), .factor = 0.5 };
    struct bench_job job = { .run = run_triad, .context = &triad };
    const double mib = (double)triad.count * 3 * sizeof(double) / (1 << 20);

    triad.a = bench_alloc(triad.count, sizeof *triad.a);
    triad.b = bench_alloc(triad.count, sizeof *triad.b);
    triad.c = bench_alloc(triad.count, sizeof *triad.c);
    for (size_t i = 0; i < triad.count; i++)
        triad.b[i] = triad.c[i] = (double)i;
    bench_race(&job, 1, bench_quick ? 1 : 7);
    bench_say("machine_triad", (double)triad.count * 3 * sizeof(double) / job.cpu_s * 1e-9, "GB/s",
              NULL, NAN,
              json_pack("{s:s, s:f, s:s}", "cpu", cpu, "arrays_mib", mib, "counted",
                        "two reads and one write an item"));
    gsn_free(triad.a);
    gsn_free(triad.b);
    gsn_free(triad.c);
}

void bench_machine(void)
{
    struct bench_peak peak[GSN_ISA_COUNT];
    struct bench_job job[GSN_ISA_COUNT];
    size_t count = 0;
    char cpu[256];

    cpu_name(cpu, sizeof cpu);
    for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
        if (!bench_peak_exists((enum gsn_isa)isa))
            continue;
        peak[count] = (struct bench_peak){ .isa = (enum gsn_isa)isa,
                                           .rounds = bench_quick ? 1000 : 20000000 };
        job[count] = (struct bench_job){ .run = bench_peak_run, .context = &peak[count] };
        count++;
    }
    bench_race(job, count, bench_quick ? 1 : 7);
    for (size_t j = 0; j < count; j++)
        bench_say(
            "machine_peak", bench_peak_flops(&peak[j]) / job[j].cpu_s * 1e-9, "GFLOP/s", "scalar",
            job[0].cpu_s / job[j].cpu_s * bench_peak_flops(&peak[j]) / bench_peak_flops(&peak[0]),
            json_pack("{s:s, s:s}", "isa", bench_isa_name(peak[j].isa), "cpu", cpu));
    measure_triad(cpu);
}
