/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* states RECORDER PROGRAM COUNT [caught] [FIRST]
 *
 * Records the program while it takes pictures in, then looks at COUNT disks that a power cut may
 * have left, the seeds from FIRST on. With "caught" the program is one that breaks the promise on
 * purpose, and one of the disks must show it. Works in /dev/shm, or in TMPDIR. */
#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/mem.h"
#include "tests/power/bench.h"
#include "tests/power/disk.h"
#include "tests/power/judge.h"

enum { PICTURES = 24, SESSIONS = 3, ROOM = 600 };

/* ---- the recording ---- */

static void record(const struct power_bench *bench, const char *recorder, const char *program)
{
    char trace[240], sessions[12], pictures[12];
    int status = 0;
    const pid_t child = fork();

    if (child == 0) {
        (void)snprintf(trace, sizeof trace, "%s/trace", bench->dir);
        (void)snprintf(sessions, sizeof sessions, "%d", SESSIONS);
        (void)snprintf(pictures, sizeof pictures, "%d", PICTURES);
        if (setenv("GSN_POWER_ROOT", bench->root, 1) == 0 &&
            setenv("GSN_POWER_TRACE", trace, 1) == 0 && setenv("LD_PRELOAD", recorder, 1) == 0 &&
            setenv("ASAN_OPTIONS", "verify_asan_link_order=0:detect_leaks=0", 1) == 0)
            (void)execl(program, program, bench->store, bench->folder, sessions, pictures, NULL);
        power_give_up(program);
    }
    if (child < 0 || waitpid(child, &status, 0) < 0)
        power_give_up(program);
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
        fprintf(stderr, "%s failed under the recorder\n", program);
        exit(70);
    }
}

/* What the trace leads to must be what the program left, but for files written through memory. */
static void check_recording(const struct power_bench *bench, const struct power_disk *disk)
{
    gsn_auto_mem(char) copy = gsn_format("%s/copy", bench->dir);
    gsn_auto_mem(char) command = gsn_format(
        "diff -r --no-dereference --exclude='*-shm' '%s' '%s/copy'", bench->root, bench->dir);

    if (!copy || !command || mkdir(copy, 0755) < 0)
        power_give_up("a copy of the disk");
    power_disk_make_all(disk, copy);
    if (system(command) != 0) {
        fprintf(stderr, "the recorder missed something\n");
        exit(70);
    }
    power_remove_tree(copy);
}

/* ---- the states ---- */

struct tally {
    size_t verdict[POWER_VERDICTS];
    size_t states, safe; /* acknowledged slices over all states */
    char first[ROOM + 100];
};

struct plan {
    const struct power_bench *bench;
    const struct power_trace *trace;
    const struct power_disk *disk;
};

static size_t collect_safe(const struct power_trace *trace, size_t cut, const char **safe)
{
    size_t count = 0;

    for (size_t i = 0; i < cut; i++) {
        size_t j = 0;

        if (trace->at[i].op != POWER_MARK)
            continue;
        while (j < count && strcmp(safe[j], trace->at[i].name) != 0)
            j++;
        if (j == count)
            safe[count++] = trace->at[i].name;
    }
    return count;
}

/* In a process of its own, which may die of what it finds. */
static enum power_verdict look(const struct plan *plan, size_t cut, uint64_t seed,
                               const char *const *safe, size_t count, char text[static ROOM])
{
    gsn_auto_mem(char) dir = gsn_format("%s/state", plan->bench->dir);
    gsn_auto_mem(char) store = gsn_format("%s/state/store", plan->bench->dir);
    int status = 0, pipes[2];
    ssize_t got;
    pid_t child;

    if (!dir || !store || mkdir(dir, 0755) < 0 || pipe(pipes) < 0)
        power_give_up("a state");
    child = fork();
    if (child == 0) {
        enum power_verdict verdict;

        text[0] = '\0';
        power_disk_make(plan->disk, cut, seed, dir);
        verdict = power_judge(store, plan->bench->address, safe, count, PICTURES, text);
        (void)!write(pipes[1], text, strlen(text));
        _exit((int)verdict);
    }
    (void)close(pipes[1]);
    got = read(pipes[0], text, ROOM - 1);
    text[got > 0 ? got : 0] = '\0';
    (void)close(pipes[0]);
    if (child < 0 || waitpid(child, &status, 0) < 0)
        power_give_up("a state");
    power_remove_tree(dir);
    if (WIFEXITED(status) && WEXITSTATUS(status) < POWER_VERDICTS)
        return (enum power_verdict)WEXITSTATUS(status);
    return POWER_DIED;
}

static void look_at_one(const struct plan *plan, uint64_t seed, struct tally *tally)
{
    const char *safe[PICTURES];
    char text[ROOM];
    const size_t cut = (size_t)((seed * 0x9e3779b97f4a7c15u >> 11) % plan->trace->count);
    const size_t count = collect_safe(plan->trace, cut, safe);
    const enum power_verdict verdict = look(plan, cut, seed, safe, count, text);

    tally->verdict[verdict]++;
    tally->states++;
    tally->safe += count;
    if (verdict != POWER_FINE && tally->first[0] == '\0') {
        (void)snprintf(tally->first, sizeof tally->first, "seed %llu, cut at step %zu: %s",
                       (unsigned long long)seed, cut, text);
        printf("%s\n", tally->first);
    }
}

static int say(const struct tally *tally, size_t steps, bool caught, double seconds)
{
    const size_t bad = tally->states - tally->verdict[POWER_FINE];

    printf("%zu states of a trace of %zu steps, %.1f acknowledged slices in each, %.1f s\n",
           tally->states, steps, (double)tally->safe / (double)tally->states, seconds);
    for (int i = 1; i < POWER_VERDICTS; i++)
        printf("%8zu %s\n", tally->verdict[i], power_verdict_name((enum power_verdict)i));
    if (caught)
        printf(bad ? "caught after %zu states\n" : "not caught in %zu states\n", tally->states);
    return caught ? bad == 0 : bad != 0;
}

int main(int argc, char **argv)
{
    const bool caught = argc > 4 && strcmp(argv[4], "caught") == 0;
    const size_t most = argc > 3 ? strtoull(argv[3], NULL, 10) : 0;
    const uint64_t first = argc > 5 ? strtoull(argv[5], NULL, 10) : 1;
    struct power_bench bench;
    struct power_trace trace;
    struct tally tally = { .states = 0 };
    struct timespec start, end;
    struct plan plan;
    char path[240];
    int result;

    if (most == 0)
        return 64;
    bench = power_bench_new(PICTURES);
    record(&bench, argv[1], argv[2]);
    (void)snprintf(path, sizeof path, "%s/trace", bench.dir);
    trace = power_trace_read(path);
    plan = (struct plan){ &bench, &trace, power_disk_new(&trace) };
    check_recording(&bench, plan.disk);
    (void)clock_gettime(CLOCK_MONOTONIC, &start);
    for (uint64_t seed = first; tally.states < most; seed++) {
        look_at_one(&plan, seed, &tally);
        if (caught && tally.verdict[POWER_FINE] != tally.states)
            break;
    }
    (void)clock_gettime(CLOCK_MONOTONIC, &end);
    result =
        say(&tally, trace.count, caught,
            (double)(end.tv_sec - start.tv_sec) + 1e-9 * (double)(end.tv_nsec - start.tv_nsec));
    power_disk_free((struct power_disk *)plan.disk);
    power_trace_done(&trace);
    power_bench_done(&bench);
    return result;
}
