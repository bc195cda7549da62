/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A child process with limits, the descriptors it is given, and nothing else.
 *
 * Between fork and exec only async-signal-safe calls: signals to their defaults, PR_SET_PDEATHSIG
 * (the kernel ends the child when its parent dies), a low priority where asked for, close_range()
 * over everything but what it is given, RLIMIT_AS and RLIMIT_CPU, exec. The descriptors are first
 * lifted out of each other's way, then put in place.
 *
 * How it fails: a pipe that exec closes brings back errno when it did not come to that, so the
 * failure is the caller's and has a sentence. */
#include "systemd/service/spawn.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

enum {
    MOST_FDS = 4,
    NICE = 10,
    CPU_GRACE_S = 5,
    /* linux/ioprio.h: the best-effort class at its lowest level. */
    IOPRIO_WHO_PROCESS = 1,
    IOPRIO_LOW = (2 << 13) | 7,
};

/* The kernel warns at the first and kills at the second; for memory it makes no difference. */
static void set_limit(__rlimit_resource_t what, uint64_t most, uint64_t grace)
{
    const struct rlimit value = { .rlim_cur = most, .rlim_max = most + grace };

    if (most)
        (void)setrlimit(what, &value);
}

/* First out of each other's way, then in place: no dup2() may close the next one's source. */
static int place_fds(const struct gsn_spawn *what)
{
    int lifted[MOST_FDS];

    for (size_t i = 0; i < what->fd_count; i++) {
        lifted[i] = fcntl(what->fd[i].ours, F_DUPFD_CLOEXEC, 16);
        if (lifted[i] < 0)
            return -1;
    }
    for (size_t i = 0; i < what->fd_count; i++)
        if (dup2(lifted[i], what->fd[i].its) < 0)
            return -1;
    return 0;
}

/* Between fork and exec: only async-signal-safe calls. Comes back with errno when it fails. */
static void exec_child(const struct gsn_spawn *what, pid_t parent)
{
    sigset_t none;

    (void)sigemptyset(&none);
    (void)signal(SIGPIPE, SIG_DFL);
    (void)sigprocmask(SIG_SETMASK, &none, NULL);
    (void)prctl(PR_SET_PDEATHSIG, SIGTERM, 0, 0, 0);
    if (getppid() != parent)
        _exit(127);
    if (what->in_background) {
        (void)setpriority(PRIO_PROCESS, 0, NICE);
        (void)syscall(SYS_ioprio_set, IOPRIO_WHO_PROCESS, 0, IOPRIO_LOW);
    }
    /* It gets what it is given and nothing that somebody left open before us. */
    if (close_range(3, ~0U, CLOSE_RANGE_CLOEXEC) < 0 || place_fds(what) < 0)
        return;
    set_limit(RLIMIT_AS, what->memory_bytes, 0);
    set_limit(RLIMIT_CPU, what->cpu_s, CPU_GRACE_S);
    (void)execv(what->argv[0], (char *const *)(uintptr_t)what->argv);
}

/* Nothing comes when exec worked, because it closed the pipe; else why it did not. */
static int hear_failure(int from)
{
    int why = 0;
    ssize_t got;

    do
        got = read(from, &why, sizeof why);
    while (got < 0 && errno == EINTR);
    return got == (ssize_t)sizeof why ? why : 0;
}

int gsn_spawn(const struct gsn_spawn *what, pid_t *ret_child, struct gsn_error *err)
{
    const pid_t parent = getpid();
    int ends[2], why;
    pid_t child;

    assert(what->fd_count <= MOST_FDS);
    if (pipe2(ends, O_CLOEXEC) < 0)
        return gsn_fail(err, GSN_E_PROCESS, "%s: %s", what->argv[0], strerror(errno));
    child = fork();
    if (child == 0) {
        exec_child(what, parent);
        why = errno;
        (void)!write(ends[1], &why, sizeof why);
        _exit(127);
    }
    why = child < 0 ? errno : 0;
    (void)close(ends[1]);
    if (child > 0)
        why = hear_failure(ends[0]);
    (void)close(ends[0]);
    if (why && child > 0)
        (void)waitpid(child, NULL, 0);
    if (why)
        return gsn_fail(err, GSN_E_PROCESS, "%s could not be started: %s", what->argv[0],
                        strerror(why));
    *ret_child = child;
    return GSN_OK;
}
