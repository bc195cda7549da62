/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/process.h"

#include "pipeline/core/parallel.h"
#include "tests/check.h"

#include <dirent.h>
#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { MEGABYTE = 1000000 };

static const struct gsn_process_limits NO_LIMITS = { .answer_bytes = (size_t)1 << 30 };

static double seconds(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Bytes of every value, zeros among them. */
static uint8_t *question(size_t size)
{
    uint8_t *bytes = gsn_alloc(size);
    uint32_t x = 1;

    CHECK(bytes != NULL);
    for (size_t i = 0; i < size; i++) {
        x = x * 1664525u + 1013904223u;
        bytes[i] = (uint8_t)(x >> 24);
    }
    return bytes;
}

/* Asks a shell that runs the script; the answer is dropped. */
static int ask_shell(const char *script, const struct gsn_process_limits *limits,
                     struct gsn_error *err)
{
    const char *const argv[] = { "/bin/sh", "-c", script, NULL };
    uint8_t mark = 1, *answer = &mark;
    size_t size = 77;
    const int r = gsn_process_ask(argv, limits, NULL, 0, &answer, &size, err);

    if (r >= 0)
        gsn_free(answer);
    else
        CHECK(answer == &mark && size == 77);
    return r;
}

static size_t descriptors(void)
{
    DIR *directory = opendir("/proc/self/fd");
    size_t count = 0;

    CHECK(directory != NULL);
    while (readdir(directory))
        count++;
    (void)closedir(directory);
    return count;
}

static int has_no_children(void)
{
    return waitpid(-1, NULL, WNOHANG) == -1 && errno == ECHILD;
}

TEST(a_megabyte_comes_back_unchanged)
{
    static const char *const argv[] = { "/bin/cat", NULL };
    static const size_t sizes[] = { 1, 65535, 65536, MEGABYTE, 3 * MEGABYTE + 1 };

    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        gsn_auto_mem(uint8_t) bytes = question(sizes[i]);
        gsn_auto_mem(uint8_t) answer = NULL;
        size_t size = 0;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_process_ask(argv, &NO_LIMITS, bytes, sizes[i], &answer, &size, &err), err);
        CHECK(size == sizes[i]);
        assert_memory_equal(answer, bytes, size);
        CHECK(answer[size] == 0);
    }
}

TEST(a_child_that_speaks_before_it_listens_does_not_lock_up)
{
    static const char *const argv[] = { "/bin/sh", "-c", "head -c 1000000 /dev/zero; cat", NULL };
    const struct gsn_process_limits limits = { .wall_s = 30, .answer_bytes = 3 * MEGABYTE };
    gsn_auto_mem(uint8_t) bytes = question(MEGABYTE);
    gsn_auto_mem(uint8_t) answer = NULL;
    size_t size = 0;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_process_ask(argv, &limits, bytes, MEGABYTE, &answer, &size, &err), err);
    CHECK(size == 2 * MEGABYTE && answer[0] == 0 && answer[MEGABYTE - 1] == 0);
    assert_memory_equal(answer + MEGABYTE, bytes, MEGABYTE);
}

TEST(a_child_may_be_asked_nothing_and_answer_nothing)
{
    static const char *const argv[] = { "/bin/cat", NULL };
    gsn_auto_mem(uint8_t) answer = NULL;
    size_t size = 1;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_process_ask(argv, &NO_LIMITS, NULL, 0, &answer, &size, &err), err);
    CHECK(size == 0 && answer != NULL && answer[0] == 0);
}

TEST(a_question_that_is_not_read_is_no_failure_and_no_death)
{
    static const char *const argv[] = { "/bin/sh", "-c", "exec 0<&-; echo enough", NULL };
    gsn_auto_mem(uint8_t) bytes = question(MEGABYTE);
    gsn_auto_mem(uint8_t) answer = NULL;
    size_t size = 0;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_process_ask(argv, &NO_LIMITS, bytes, MEGABYTE, &answer, &size, &err), err);
    assert_string_equal((const char *)answer, "enough\n");
}

static int ask_deaf_child(size_t index, void *context, struct gsn_error *err)
{
    static const char *const argv[] = { "/bin/sh", "-c", "exec 0<&-; echo enough", NULL };
    gsn_auto_mem(uint8_t) answer = NULL;
    size_t size = 0;

    (void)index;
    return gsn_process_ask(argv, &NO_LIMITS, context, MEGABYTE, &answer, &size, err);
}

TEST(several_threads_may_ask_at_once_and_sigpipe_stays_what_it_was)
{
    gsn_auto_mem(uint8_t) bytes = question(MEGABYTE);
    struct sigaction action;
    sigset_t mask, pending;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_parallel_for(60, 6, ask_deaf_child, bytes, &err), err);
    CHECK(sigaction(SIGPIPE, NULL, &action) == 0 && action.sa_handler == SIG_DFL);
    CHECK(sigprocmask(SIG_BLOCK, NULL, &mask) == 0 && !sigismember(&mask, SIGPIPE));
    CHECK(sigpending(&pending) == 0 && !sigismember(&pending, SIGPIPE));
    CHECK(has_no_children());
}

TEST(a_child_meets_its_signals_as_if_started_by_hand)
{
    struct gsn_error err = { 0 };

    CHECK(ask_shell("kill -PIPE $$; echo survived", &NO_LIMITS, &err) == GSN_E_PROCESS);
    CHECK(strstr(err.text, "/bin/sh: died of signal 13 (") == err.text);
}

TEST(the_exit_code_and_the_first_complaint_are_in_the_sentence)
{
    struct gsn_error err = { 0 };

    CHECK(ask_shell("echo half; echo facets cross >&2; echo more >&2; exit 3", &NO_LIMITS, &err) ==
          GSN_E_PROCESS);
    CHECK(err.code == GSN_E_PROCESS);
    assert_string_equal(err.text, "/bin/sh: ended with code 3: facets cross");
    CHECK(ask_shell("exit 7", &NO_LIMITS, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text, "/bin/sh: ended with code 7");
    CHECK(ask_shell("echo oh >&2; kill -ABRT $$", &NO_LIMITS, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text, "/bin/sh: died of signal 6 (Aborted): oh");
}

TEST(complaints_of_a_child_that_succeeds_are_dropped_however_many)
{
    struct gsn_error err = { 0 };

    CHECK_OK(ask_shell("head -c 1000000 /dev/zero >&2", &NO_LIMITS, &err), err);
}

TEST(a_complaint_without_end_is_cut)
{
    struct gsn_error err = { 0 };

    CHECK(ask_shell("printf %1000d 7 >&2; exit 1", &NO_LIMITS, &err) == GSN_E_PROCESS);
    CHECK(strncmp(err.text, "/bin/sh: ended with code 1:    ", 31) == 0);
    CHECK(strlen(err.text) > 200 && strlen(err.text) < 300);
}

TEST(the_code_is_the_same_when_nobody_wants_the_sentence)
{
    const struct gsn_process_limits narrow = { .answer_bytes = 3 };

    CHECK(ask_shell("exit 7", &NO_LIMITS, NULL) == GSN_E_PROCESS);
    CHECK(ask_shell("echo long", &narrow, NULL) == GSN_E_LIMIT);
}

/* Refused because of the clock, within a few seconds of its limit of 1. */
static void check_stopped_by_the_clock(const char *script)
{
    const struct gsn_process_limits limits = { .wall_s = 1, .answer_bytes = 100 };
    const double began = seconds();
    struct gsn_error err = { 0 };

    CHECK(ask_shell(script, &limits, &err) == GSN_E_PROCESS);
    CHECK(seconds() - began >= 1 && seconds() - began < 6);
    assert_string_equal(err.text, "/bin/sh: gave no answer within 1 s");
    CHECK(has_no_children());
}

TEST(a_child_that_hangs_is_killed_when_its_time_is_over)
{
    check_stopped_by_the_clock("exec sleep 20");
    check_stopped_by_the_clock("trap '' TERM INT HUP; echo begun; exec sleep 20");
}

TEST(a_child_that_hangs_after_closing_its_ends_is_killed_too)
{
    check_stopped_by_the_clock("exec 0<&- 1>&- 2>&- sleep 20");
}

TEST(a_child_that_is_slow_but_in_time_is_waited_for)
{
    const struct gsn_process_limits limits = { .wall_s = 20, .answer_bytes = 100 };
    struct gsn_error err = { 0 };

    CHECK_OK(ask_shell("sleep 0.3; echo done", &limits, &err), err);
    CHECK_OK(ask_shell("exec 1>&- 2>&- sleep 0.3", &limits, &err), err);
    CHECK_OK(ask_shell("exec 1>&- 2>&- sleep 0.3", &NO_LIMITS, &err), err);
}

TEST(a_child_that_takes_too_much_memory_dies_with_a_sentence)
{
    static const char hungry[] = "exec dd if=/dev/zero of=/dev/null bs=300M count=1";
    struct gsn_process_limits limits = { .memory_bytes = (uint64_t)100 << 20,
                                         .answer_bytes = 1000 };
    struct gsn_error err = { 0 };

    CHECK(ask_shell(hungry, &limits, &err) == GSN_E_PROCESS);
    CHECK(strstr(err.text, "/bin/sh: ended with code 1: dd: memory exhausted") == err.text);
    limits.memory_bytes = (uint64_t)1 << 30;
    CHECK_OK(ask_shell(hungry, &limits, &err), err);
}

TEST(a_child_that_takes_too_much_processor_dies_with_a_sentence)
{
    const struct gsn_process_limits limits = { .cpu_s = 1, .wall_s = 60, .answer_bytes = 1000 };
    struct gsn_error err = { 0 };

    CHECK(ask_shell("while :; do :; done", &limits, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text, "/bin/sh: died of signal 24 (CPU time limit exceeded)");
}

TEST(an_answer_may_reach_its_limit_and_not_pass_it)
{
    const struct gsn_process_limits limits = { .wall_s = 20, .answer_bytes = 1000 };
    struct gsn_error err = { 0 };

    CHECK_OK(ask_shell("printf %1000d 7", &limits, &err), err);
    CHECK(ask_shell("printf %1001d 7", &limits, &err) == GSN_E_LIMIT);
    assert_string_equal(err.text, "/bin/sh: a child's answer is longer than 1000 bytes");
    CHECK(ask_shell("exec cat /dev/zero", &limits, &err) == GSN_E_LIMIT);
    CHECK(has_no_children());
}

TEST(a_missing_program_is_named_with_the_reason)
{
    static const char *const missing[] = { "/no/such/gieson-mesh", NULL };
    static const char *const folder[] = { "/tmp", NULL };
    uint8_t *answer = NULL;
    size_t size;
    struct gsn_error err = { 0 };

    CHECK(gsn_process_ask(missing, &NO_LIMITS, NULL, 0, &answer, &size, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text,
                        "/no/such/gieson-mesh: ended with code 127: No such file or directory");
    CHECK(gsn_process_ask(folder, &NO_LIMITS, NULL, 0, &answer, &size, &err) == GSN_E_PROCESS);
    assert_string_equal(err.text, "/tmp: ended with code 127: Permission denied");
}

TEST(no_zombie_and_no_descriptor_is_left)
{
    const struct gsn_process_limits narrow = { .wall_s = 1, .answer_bytes = 10 };
    const size_t before = descriptors();
    static const char *const scripts[] = {
        "echo fine",    "exit 1", "kill -9 $$", "exec sleep 20", "echo far too long an answer",
        "exec /no/such"
    };

    for (size_t i = 0; i < sizeof scripts / sizeof scripts[0]; i++) {
        struct gsn_error err = { 0 };

        (void)ask_shell(scripts[i], &narrow, &err);
        CHECK(descriptors() == before);
        CHECK(has_no_children());
    }
}

/* For a process of its own: the answer of cat when the streams 0, 1 and 2 are closed. */
static int ask_without_streams(void)
{
    static const char *const argv[] = { "/bin/cat", NULL };
    uint8_t *answer = NULL;
    size_t size = 0;

    for (int fd = 0; fd < 3; fd++)
        (void)close(fd);
    if (gsn_process_ask(argv, &NO_LIMITS, "question", 8, &answer, &size, NULL) < 0)
        return 1;
    return size == 8 && memcmp(answer, "question", 8) == 0 ? 0 : 2;
}

TEST(a_program_without_streams_of_its_own_can_ask)
{
    const pid_t child = fork();
    int status = 0;

    CHECK(child >= 0);
    if (child == 0) {
        (void)alarm(20);
        _exit(ask_without_streams());
    }
    CHECK(waitpid(child, &status, 0) == child);
    CHECK(WIFEXITED(status) && WEXITSTATUS(status) == 0);
}

static int ask_cat(struct gsn_error *err)
{
    static const char *const argv[] = { "/bin/cat", NULL };
    gsn_auto_mem(uint8_t) answer = NULL;
    size_t size;

    return gsn_process_ask(argv, &NO_LIMITS, "question", 8, &answer, &size, err);
}

TEST(running_out_of_memory_leaves_no_child)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(ask_cat(&err), err);
    CHECK(has_no_children());
    gsn_check_fail_allocation(1);
    CHECK(ask_cat(&err) == GSN_E_NOMEM);
    gsn_check_fail_allocation(0);
    assert_string_equal(err.text, "/bin/cat: out of memory for a child's answer");
}

/* ---- start and wait ---------------------------------------------------------------------- */

static pid_t start_shell(const char *script)
{
    const char *const argv[] = { "/bin/sh", "-c", script, NULL };
    struct gsn_error err = { 0 };
    pid_t child = -1;

    CHECK_OK(gsn_process_start(argv, &child, &err), err);
    CHECK(child > 0);
    return child;
}

TEST(waiting_tells_the_exit_status_or_the_signal)
{
    CHECK(gsn_process_wait(start_shell("exit 0"), 1) == 0);
    CHECK(gsn_process_wait(start_shell("exit 66"), 1) == 66);
    CHECK(gsn_process_wait(start_shell("kill -TERM $$"), 1) == 128 + SIGTERM);
    CHECK(gsn_process_wait(start_shell("kill -KILL $$"), 1) == 128 + SIGKILL);
    CHECK(has_no_children());
}

TEST(a_running_child_can_be_looked_at_without_waiting)
{
    const pid_t child = start_shell("exec sleep 60");

    CHECK(gsn_process_wait(child, 0) == -1);
    CHECK(gsn_process_wait(child, 0) == -1);
    CHECK(kill(child, SIGKILL) == 0);
    CHECK(gsn_process_wait(child, 1) == 128 + SIGKILL);
    CHECK(gsn_process_wait(child, 1) == 127); /* it was waited for already */
}

TEST(a_started_child_has_no_signal_blocked)
{
    sigset_t term, before;
    pid_t child;

    (void)sigemptyset(&term);
    (void)sigaddset(&term, SIGTERM);
    CHECK(sigprocmask(SIG_BLOCK, &term, &before) == 0);
    child = start_shell("kill -TERM $$; exit 0");
    CHECK(sigprocmask(SIG_SETMASK, &before, NULL) == 0);
    CHECK(gsn_process_wait(child, 1) == 128 + SIGTERM);
}

TEST(a_program_that_cannot_be_started_is_named)
{
    static const char *const argv[] = { "/no/such/gieson-work", NULL };
    struct gsn_error err = { 0 };
    pid_t child = 7;

    CHECK(gsn_process_start(argv, &child, &err) == GSN_E_PROCESS);
    CHECK(child == 7);
    assert_string_equal(err.text,
                        "/no/such/gieson-work could not be started: No such file or directory");
    CHECK(has_no_children());
}

/* As a job of the service, which may not raise what it was given: 0 when all is well. */
static int allow_as_a_job(void)
{
    static const char *const argv[] = { "/bin/sh", "-c", "read line", NULL };
    const rlim_t all = (rlim_t)1 << 46, part = (rlim_t)1 << 33;
    const struct rlimit given = { .rlim_cur = all, .rlim_max = all };
    struct gsn_process *process = NULL;
    struct gsn_process_end end;
    int way[2], status = 0;

    if (setrlimit(RLIMIT_AS, &given) < 0 ||
        (geteuid() == 0 && setresuid(65534, 65534, 65534) < 0) || pipe(way) < 0 ||
        gsn_process_open(argv, way[0], &process, NULL) < 0)
        return 1;
    if (gsn_process_allow(process, part, NULL) < 0)
        status = 2;
    /* More than the job has: that much and no more. */
    if (gsn_process_allow(process, 2 * all, NULL) < 0)
        status = 3;
    (void)close(way[0]);
    (void)close(way[1]);
    gsn_process_close(process, 1, &end);
    return status;
}

TEST(a_job_with_a_limit_of_its_own_lends_part_of_it)
{
    const pid_t job = fork();

    CHECK(job >= 0);
    if (job == 0)
        _exit(allow_as_a_job());
    CHECK(gsn_process_wait(job, 1) == 0);
}

/* ---- siblings ---------------------------------------------------------------------------- */

static int find_sibling(struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;

    return gsn_process_sibling("test_core_process", &path, err);
}

TEST(a_program_beside_the_running_one_is_found)
{
    gsn_auto_mem(char) path = NULL;
    char self[4096] = "";
    struct gsn_error err = { 0 };

    CHECK(readlink("/proc/self/exe", self, sizeof self - 1) > 0);
    CHECK_OK(gsn_process_sibling("test_core_process", &path, &err), err);
    assert_string_equal(path, self);
    CHECK_EVERY_OOM(find_sibling(&err), err);
}

TEST(a_program_that_is_nowhere_is_not_found)
{
    char mark = 1, *path = &mark;
    struct gsn_error err = { 0 };

    CHECK(gsn_process_sibling("gieson-nowhere", &path, &err) == GSN_E_NOTFOUND);
    CHECK(path == &mark);
    CHECK(strstr(err.text, "the program gieson-nowhere is not installed: there is neither /") ==
          err.text);
    CHECK(strstr(err.text, "/gieson/gieson-nowhere") != NULL); /* in libexec */
}
