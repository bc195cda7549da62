/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* faults [STEP]: an intake whose N-th call of the system fails, for every STEP-th N, once and for
 * ever; that may not write any more; whose disk is full at each of 100 sizes, by account and on a
 * small disk of its own; whose store is mounted read-only. Whatever happened: no crash, a sentence,
 * nothing acknowledged is lost, and the next intake without faults finishes. */
#include <errno.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/power/bench.h"
#include "tests/power/fault.h"
#include "tests/power/ingest.h"
#include "tests/power/judge.h"

enum { PICTURES = 5, SIZES = 100, NAME = 100, SENTENCE = 600, SKIPPED = 77 };

/* Told by the process that meets the faults; it lies in memory both see. */
struct told {
    size_t safe;
    char name[PICTURES][NAME]; /* "SHA256 NAME" of what was acknowledged */
    long calls;
    int code;
    char sentence[SENTENCE];
};

struct tally {
    size_t runs, failed, crashed, mute, bad;
};

static struct told *told;

static void acknowledged(void *context, const char *name, const char *sha256)
{
    (void)context;
    (void)snprintf(told->name[told->safe++], NAME, "%s %s", sha256, name);
}

void __lsan_do_leak_check(void) __attribute__((weak));

static void ingest(const struct power_bench *bench, const struct fault *fault)
{
    const struct power_ingest all = { .store = bench->store,
                                      .address = bench->address,
                                      .checkpoint_every = 2,
                                      .acknowledged = acknowledged };
    struct gsn_error err = { 0 };
    unsigned taken = 0;

    (void)alarm(120);
    fault_arm(fault);
    told->code = power_ingest(&all, &taken, &err);
    told->calls = fault_disarm();
    (void)snprintf(told->sentence, SENTENCE, "%s", err.text);
    if (__lsan_do_leak_check && fault->at % 16 == 1)
        __lsan_do_leak_check();
    _exit(0);
}

static bool ended_well(pid_t child)
{
    int status = 0;

    if (child < 0 || waitpid(child, &status, 0) < 0)
        power_give_up("a child");
    return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

static bool meets(const struct power_bench *bench, const struct fault *fault)
{
    pid_t child;

    memset(told, 0, sizeof *told);
    child = fork();
    if (child == 0)
        ingest(bench, fault);
    return ended_well(child);
}

/* In a process of its own too: what it opens is closed with it. */
static bool is_fine_afterwards(const struct power_bench *bench, char text[static SENTENCE])
{
    const pid_t child = fork();

    if (child == 0) {
        const char *safe[PICTURES];

        for (size_t i = 0; i < told->safe; i++)
            safe[i] = told->name[i];
        text = told->sentence;
        text[0] = '\0';
        _exit((int)power_judge(bench->store, bench->address, safe, told->safe, PICTURES, text));
    }
    if (ended_well(child))
        return true;
    (void)snprintf(text, SENTENCE, "%s", told->sentence);
    return false;
}

/* Tells of the first few. */
static void complain(struct tally *tally, size_t *count, const char *what, long at,
                     const char *text)
{
    if ((*count)++ < 3)
        printf("%s %ld: %s\n", what, at, text);
    (void)tally;
}

static void judge(const struct power_bench *bench, const char *what, long at, bool alive,
                  struct tally *tally)
{
    char text[SENTENCE] = "";

    tally->runs++;
    tally->failed += told->code < 0;
    if (!alive)
        complain(tally, &tally->crashed, what, at, "the process died");
    else if (told->code < 0 && told->sentence[0] == '\0')
        complain(tally, &tally->mute, what, at, "failed without a sentence");
    if (!is_fine_afterwards(bench, text))
        complain(tally, &tally->bad, what, at, text);
}

static int say(const char *what, const struct tally *tally)
{
    printf("%-28s %6zu runs, %6zu of them failed with a sentence; %zu crashes, %zu without a "
           "sentence, %zu with wrong data or not to be finished\n",
           what, tally->runs, tally->failed - tally->mute, tally->crashed, tally->mute, tally->bad);
    (void)fflush(stdout);
    return tally->crashed || tally->mute || tally->bad || tally->runs == 0;
}

static int sweep(const struct power_bench *bench, const char *what, struct fault fault, long step)
{
    struct tally tally = { 0 };
    bool reached = true;

    for (fault.at = 1; reached; fault.at += step) {
        const bool alive = meets(bench, &fault);

        reached = !alive || told->calls >= fault.at;
        if (reached)
            judge(bench, what, fault.at, alive, &tally);
        power_remove_tree(bench->store);
    }
    return say(what, &tally);
}

static int fill_by_account(const struct power_bench *bench)
{
    enum { ENOUGH = 1400000 };
    struct tally tally = { 0 };

    for (long i = 1; i <= SIZES; i++) {
        const struct fault fault = { .room = (uint64_t)(ENOUGH / SIZES * i) };

        judge(bench, "a disk that fills up", i, meets(bench, &fault), &tally);
        power_remove_tree(bench->store);
    }
    return say("a disk that fills up", &tally);
}

/* ---- disks of their own, seen by this process alone ---- */

static bool mount_disk(const struct power_bench *bench, unsigned long flags, unsigned kib)
{
    char options[64];

    (void)snprintf(options, sizeof options, "size=%uk,mode=755", kib);
    return mount("gieson", bench->root, "tmpfs", flags, options) == 0;
}

static bool may_mount(const struct power_bench *bench)
{
    return unshare(CLONE_NEWNS) == 0 && mount("none", "/", NULL, MS_REC | MS_PRIVATE, NULL) == 0 &&
           mount_disk(bench, 0, 64) && umount(bench->root) == 0;
}

static int fill_small_disks(const struct power_bench *bench)
{
    enum { ROOM_KIB = 1 << 16, ENOUGH_KIB = 2000 };
    const struct fault none = { 0 };
    struct tally tally = { 0 };

    for (unsigned i = 1; i <= SIZES; i++) {
        bool alive;

        if (!mount_disk(bench, 0, ENOUGH_KIB / SIZES * i))
            power_give_up("mount");
        alive = meets(bench, &none);
        if (!mount_disk(bench, MS_REMOUNT, ROOM_KIB))
            power_give_up("remount");
        judge(bench, "a small disk", i, alive, &tally);
        if (umount(bench->root) < 0)
            power_give_up("umount");
    }
    return say("a small disk", &tally);
}

/* A store with the first pictures, then read-only, then writable again. */
static int mount_read_only(const struct power_bench *bench)
{
    const struct power_ingest some = { .store = bench->store,
                                       .address = bench->address,
                                       .most = 2 };
    const struct fault none = { 0 };
    struct tally tally = { 0 };
    struct gsn_error err = { 0 };
    unsigned taken = 0;
    bool alive;

    if (!mount_disk(bench, 0, 1 << 16))
        power_give_up("mount");
    if (power_ingest(&some, &taken, &err) < 0)
        power_give_up(err.text);
    if (!mount_disk(bench, MS_REMOUNT | MS_RDONLY, 1 << 16))
        power_give_up("remount");
    alive = meets(bench, &none);
    if (told->code >= 0 || told->safe)
        complain(&tally, &tally.bad, "read-only", 0, "something was taken");
    printf("read-only: %s\n", told->sentence);
    if (!mount_disk(bench, MS_REMOUNT, 1 << 16))
        power_give_up("remount");
    judge(bench, "read-only", 0, alive, &tally);
    if (umount(bench->root) < 0)
        power_give_up("umount");
    return say("mounted read-only", &tally);
}

int main(int argc, char **argv)
{
    static const struct {
        const char *what;
        struct fault fault;
    } faults[] = {
        { "EIO once", { .error = EIO } },
        { "EIO for ever", { .error = EIO, .for_ever = true } },
        { "ENOSPC once", { .error = ENOSPC, .only_changes = true } },
        { "ENOSPC for ever", { .error = ENOSPC, .only_changes = true, .for_ever = true } },
        { "EROFS for ever", { .error = EROFS, .only_changes = true, .for_ever = true } },
        { "EINTR once", { .error = EINTR } },
        { "a short write", { .only_changes = true, .shortened = true } },
    };
    const struct power_bench bench = power_bench_new(PICTURES);
    const long step = argc > 1 ? atol(argv[1]) : 1;
    int bad = 0;

    told = mmap(NULL, sizeof *told, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (told == MAP_FAILED || step < 1)
        power_give_up("memory");
    for (size_t i = 0; i < sizeof faults / sizeof *faults; i++)
        bad |= sweep(&bench, faults[i].what, faults[i].fault, step);
    bad |= fill_by_account(&bench);
    if (may_mount(&bench)) {
        bad |= fill_small_disks(&bench);
        bad |= mount_read_only(&bench);
    } else {
        printf("SKIPPED: no disk may be mounted here, so a full and a read-only one were only "
               "acted\n");
    }
    power_bench_done(&bench);
    return bad;
}
