/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

void bench_need(int code, const struct gsn_error *err, const char *what)
{
    if (code >= 0)
        return;
    fprintf(stderr, "gieson-bench: %s: %s\n", what, err->text);
    exit(gsn_code_exit(code));
}

void *bench_alloc(size_t count, size_t size)
{
    void *memory = gsn_alloc_array(count, size);

    if (!memory) {
        fprintf(stderr, "gieson-bench: out of memory for %zu x %zu bytes\n", count, size);
        exit(gsn_code_exit(GSN_E_NOMEM));
    }
    return memory;
}

static double seconds(clockid_t clock)
{
    struct timespec now;

    if (clock_gettime(clock, &now) < 0)
        abort();
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void bench_race(struct bench_job *job, size_t count, unsigned repeats)
{
    for (size_t j = 0; j < count; j++)
        job[j].cpu_s = job[j].wall_s = INFINITY;
    for (unsigned turn = 0; turn < repeats; turn++) {
        for (size_t j = 0; j < count; j++) {
            const double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID);
            const double wall = seconds(CLOCK_MONOTONIC);

            job[j].run(job[j].context);
            job[j].cpu_s = fmin(job[j].cpu_s, seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu);
            job[j].wall_s = fmin(job[j].wall_s, seconds(CLOCK_MONOTONIC) - wall);
        }
    }
}

/* JSON knows no NaN. */
static json_t *number(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

static void print_line(json_t *line)
{
    if (!line || json_dumpf(line, stdout, JSON_REAL_PRECISION(6) | JSON_COMPACT) < 0 ||
        printf("\n") < 0 || fflush(stdout) < 0) {
        fprintf(stderr, "gieson-bench: a line could not be printed\n");
        exit(gsn_code_exit(GSN_E_IO));
    }
    json_decref(line);
}

static json_t *start_line(const char *measure, double value, const char *unit, const char *against,
                          double ratio)
{
    return json_pack("{s:s, s:o, s:s, s:s?, s:o}", "measure", measure, "value", number(value),
                     "unit", unit, "against", against, "ratio", number(ratio));
}

void bench_say(const char *measure, double value, const char *unit, const char *against,
               double ratio, json_t *details)
{
    json_t *line = start_line(measure, value, unit, against, ratio);

    if (details)
        (void)json_object_update(line, details);
    json_decref(details);
    print_line(line);
}

void bench_skip(const char *measure, const char *unit, const char *against, const char *why)
{
    fprintf(stderr, "gieson-bench: SKIPPED %s: %s\n", measure, why);
    bench_say(measure, NAN, unit, against, NAN, json_pack("{s:s}", "skipped", why));
}

double bench_draw(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (double)(*seed >> 11) * 0x1p-53;
}
