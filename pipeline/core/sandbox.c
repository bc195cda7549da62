/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sandbox: what Linux lets a process give up, for good.
 *
 * Steps: (1) close all descriptors but those that are handed over (close_range); (2) a Landlock
 * rule set that takes charge of every access this kernel's version knows and allows none
 * (landlock(7)); (3) limits of 0 on core dumps, the size of files, processes and, unless it may
 * receive some, descriptors; no new privileges; (4) a seccomp filter, by libseccomp, that lets a
 * list of system calls through and kills the process for any other (seccomp(2)). The filter comes
 * last because it would forbid the steps before it.
 *
 * Failure: GSN_E_PROCESS names the call that the kernel refused; a kernel without Landlock is no
 * failure. Cost: once a process; the kernel then runs the filter at each system call. */
#include "pipeline/core/sandbox.h"

#include <errno.h>
#include <linux/landlock.h>
#include <seccomp.h>
#include <stdint.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

static int fail_refused(const char *what, int code, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_PROCESS, "the sandbox cannot be entered: %s: %s", what,
                    strerror(code));
}

/* ---- limits ------------------------------------------------------------------------------ */

static int limit_resources(rlim_t descriptors, struct gsn_error *err)
{
    static const __rlimit_resource_t none_of[] = { RLIMIT_CORE, RLIMIT_FSIZE, RLIMIT_NPROC };
    const struct rlimit none = { 0, 0 }, few = { descriptors, descriptors };

    for (size_t i = 0; i < sizeof none_of / sizeof none_of[0]; i++)
        if (setrlimit(none_of[i], &none) < 0)
            return fail_refused("setrlimit", errno, err);
    if (setrlimit(RLIMIT_NOFILE, &few) < 0)
        return fail_refused("setrlimit", errno, err);
    if (prctl(PR_SET_DUMPABLE, 0, 0, 0, 0) < 0 || prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) < 0)
        return fail_refused("prctl", errno, err);
    return GSN_OK;
}

/* ---- Landlock ---------------------------------------------------------------------------- */

/* What a rule set may take charge of, as of version 6; older kernels read the first words only. */
struct ruleset {
    uint64_t files, network, scopes;
};

int gsn_sandbox_landlock(void)
{
    const long version =
        syscall(SYS_landlock_create_ruleset, NULL, 0, LANDLOCK_CREATE_RULESET_VERSION);

    return version > 0 ? (int)version : 0;
}

/* Each version knows more kinds of access to files; the first had 13. */
static uint64_t file_accesses(int version)
{
    static const unsigned count[] = { 0, 13, 14, 15, 15, 16 };
    const size_t last = sizeof count / sizeof count[0] - 1;

    return (UINT64_C(1) << count[(size_t)version < last ? (size_t)version : last]) - 1;
}

/* Takes charge of everything and then allows nothing of it. */
int gsn_sandbox_leave_files(struct gsn_error *err)
{
    const int version = gsn_sandbox_landlock();
    const struct ruleset all = { .files = file_accesses(version),
                                 .network = version >= 4 ? 3 : 0,
                                 .scopes = version >= 6 ? 3 : 0 };
    const size_t words = version >= 6 ? 3 : version >= 4 ? 2 : 1;
    long rules;
    int r = GSN_OK;

    if (version == 0)
        return GSN_OK;
    /* No new privileges first: without that the kernel lets nobody in. */
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) < 0)
        return fail_refused("prctl", errno, err);
    rules = syscall(SYS_landlock_create_ruleset, &all, words * sizeof(uint64_t), 0);
    if (rules < 0)
        return fail_refused("landlock_create_ruleset", errno, err);
    if (syscall(SYS_landlock_restrict_self, rules, 0) < 0)
        r = fail_refused("landlock_restrict_self", errno, err);
    (void)close((int)rules);
    return r;
}

/* ---- system calls ------------------------------------------------------------------------ */

/* No call here names a file, a peer or another process. (qsort() asks how much memory there is.) */
static const int calls[] = {
    SCMP_SYS(read),   SCMP_SYS(write),          SCMP_SYS(writev),       SCMP_SYS(close),
    SCMP_SYS(brk),    SCMP_SYS(munmap),         SCMP_SYS(mremap),       SCMP_SYS(madvise),
    SCMP_SYS(futex),  SCMP_SYS(clock_gettime),  SCMP_SYS(getrandom),    SCMP_SYS(getpid),
    SCMP_SYS(gettid), SCMP_SYS(rt_sigprocmask), SCMP_SYS(rt_sigreturn), SCMP_SYS(restart_syscall),
    SCMP_SYS(exit),   SCMP_SYS(exit_group),     SCMP_SYS(sysinfo),
};

/* A sanitizer's own needs, in builds that are made for tests: it yields, asks for its stack and its
 * own name. A report of it reads files; it does without. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
static const int sanitizer_calls[] = { SCMP_SYS(sched_yield), SCMP_SYS(sigaltstack),
                                       SCMP_SYS(rt_sigaction), SCMP_SYS(getrlimit),
                                       SCMP_SYS(prlimit64) };
static const int sanitizer_refusals[] = { SCMP_SYS(openat), SCMP_SYS(readlink) };

static int allow_sanitizer(scmp_filter_ctx list)
{
    int r = 0;

    for (size_t i = 0; r == 0 && i < sizeof sanitizer_calls / sizeof sanitizer_calls[0]; i++)
        r = seccomp_rule_add(list, SCMP_ACT_ALLOW, sanitizer_calls[i], 0);
    for (size_t i = 0; r == 0 && i < sizeof sanitizer_refusals / sizeof sanitizer_refusals[0]; i++)
        r = seccomp_rule_add(list, SCMP_ACT_ERRNO(EACCES), sanitizer_refusals[i], 0);
    return r;
}
#else
static int allow_sanitizer(scmp_filter_ctx list)
{
    (void)list;
    return 0;
}
#endif

/* Memory that is not code, and the signal by which abort() ends its own process. */
static int allow_some(scmp_filter_ctx list, int may_receive)
{
    const uint64_t own = (uint64_t)getpid();
    int r = seccomp_rule_add(list, SCMP_ACT_ALLOW, SCMP_SYS(mmap), 1,
                             SCMP_A2(SCMP_CMP_MASKED_EQ, PROT_EXEC, 0));

    if (r == 0)
        r = seccomp_rule_add(list, SCMP_ACT_ALLOW, SCMP_SYS(mprotect), 1,
                             SCMP_A2(SCMP_CMP_MASKED_EQ, PROT_EXEC, 0));
    if (r == 0)
        r = seccomp_rule_add(list, SCMP_ACT_ALLOW, SCMP_SYS(tgkill), 1, SCMP_A0(SCMP_CMP_EQ, own));
    if (r == 0 && may_receive)
        r = seccomp_rule_add(list, SCMP_ACT_ALLOW, SCMP_SYS(recvmsg), 1, SCMP_A0(SCMP_CMP_EQ, 0));
    return r;
}

static int keep_few_calls(int may_receive, struct gsn_error *err)
{
    scmp_filter_ctx list = seccomp_init(SCMP_ACT_KILL_PROCESS);
    int r = list ? 0 : -ENOMEM;

    for (size_t i = 0; r == 0 && i < sizeof calls / sizeof calls[0]; i++)
        r = seccomp_rule_add(list, SCMP_ACT_ALLOW, calls[i], 0);
    if (r == 0)
        r = allow_some(list, may_receive);
    if (r == 0)
        r = allow_sanitizer(list);
    if (r == 0)
        r = seccomp_load(list);
    if (list)
        seccomp_release(list);
    return r < 0 ? fail_refused("seccomp", -r, err) : GSN_OK;
}

int gsn_sandbox_enter(int last_fd, int may_receive, struct gsn_error *err)
{
    int r;

    if (close_range((unsigned)last_fd + 1, ~0U, 0) < 0)
        return fail_refused("close_range", errno, err);
    r = gsn_sandbox_leave_files(err);
    if (r >= 0)
        r = limit_resources(may_receive ? (rlim_t)last_fd + 2 : 0, err);
    if (r >= 0)
        r = keep_few_calls(may_receive, err);
    return r;
}
