/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/sandbox.h"

#include "pipeline/core/mem.h"
#include "tests/check.h"

#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

enum { LAST_FD = 3, SAID_YES = 42, SAID_NO = 43, NO_SANDBOX = 44 };

/* A sanitizer's build refuses a few calls that the true one kills for: see sandbox.c. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
static const int SANITIZED = 1;
#else
static const int SANITIZED = 0;
#endif

/* Does it in a sandboxed child whose descriptor 3 is fd; returns how that child ended. */
static int in_sandbox(int (*deed)(void), int fd)
{
    int status = 0;
    pid_t child;

    (void)fflush(stdout);
    child = fork();
    CHECK(child >= 0);
    if (child == 0) {
        if ((fd >= 0 && fd != LAST_FD && dup2(fd, LAST_FD) < 0) ||
            gsn_sandbox_enter(LAST_FD, 0, NULL) < 0)
            _exit(NO_SANDBOX);
        _exit(deed() ? SAID_YES : SAID_NO);
    }
    CHECK(waitpid(child, &status, 0) == child);
    return status;
}

static int ended_with(int status, int code)
{
    return WIFEXITED(status) && WEXITSTATUS(status) == code;
}

static int died_of(int status, int signal)
{
    return WIFSIGNALED(status) && WTERMSIG(status) == signal;
}

/* ---- what is left ------------------------------------------------------------------------ */

static int thinks(void)
{
    size_t sum = 0;

    for (size_t size = 1; size < (size_t)1 << 26; size *= 4) {
        gsn_auto_mem(uint8_t) bytes = gsn_alloc_array(size, 1);

        if (!bytes)
            return 0;
        memset(bytes, 3, size);
        sum += bytes[size / 2];
        bytes = gsn_realloc_array(bytes, 2 * size, 1);
        sum += bytes ? bytes[0] : 0;
    }
    return sum == (size_t)13 * 6;
}

static int reads_and_writes(void)
{
    char text[8] = "";
    const ssize_t got = read(LAST_FD, text, sizeof text);

    return got == 5 && memcmp(text, "hello", 5) == 0 && write(1, "", 0) == 0;
}

static int aborts(void)
{
    abort();
}

TEST(whoever_is_inside_may_think_read_write_and_end)
{
    int ends[2];

    CHECK(ended_with(in_sandbox(thinks, -1), SAID_YES));
    CHECK(pipe(ends) == 0 && write(ends[1], "hello", 5) == 5);
    CHECK(ended_with(in_sandbox(reads_and_writes, ends[0]), SAID_YES));
    (void)close(ends[0]);
    (void)close(ends[1]);
    CHECK(died_of(in_sandbox(aborts, -1), SIGABRT));
}

static int sees_other_descriptors(void)
{
    char byte;

    for (int fd = LAST_FD + 1; fd < 64; fd++)
        if (read(fd, &byte, 1) >= 0 || errno != EBADF)
            return 1;
    return 0;
}

TEST(descriptors_that_were_not_given_are_gone)
{
    const int fd = memfd_create("secret", 0), high = fcntl(fd, F_DUPFD_CLOEXEC, 20);

    CHECK(high >= 20);
    CHECK(ended_with(in_sandbox(sees_other_descriptors, -1), SAID_NO));
    (void)close(fd);
    (void)close(high);
}

/* ---- what is not ------------------------------------------------------------------------- */

static int opens_a_file(void)
{
    return open("/etc/passwd", O_RDONLY | O_CLOEXEC) >= 0;
}

static int makes_a_file(void)
{
    return open("/tmp/gieson.sandbox", O_WRONLY | O_CREAT | O_CLOEXEC, 0600) >= 0;
}

static int looks_at_a_file(void)
{
    struct stat status;

    return stat("/etc/passwd", &status) == 0;
}

static int removes_a_file(void)
{
    return unlink("/tmp/gieson.sandbox") == 0;
}

static int connects(void)
{
    return socket(AF_INET, SOCK_STREAM, 0) >= 0;
}

static int forks(void)
{
    return fork() >= 0;
}

static int starts_a_program(void)
{
    char *const argv[] = { (char *)(uintptr_t) "/bin/true", NULL };

    return execv(argv[0], argv) == 0;
}

static void *nothing(void *context)
{
    return context;
}

static int starts_a_thread(void)
{
    pthread_t thread;

    return pthread_create(&thread, NULL, nothing, NULL) == 0;
}

static int signals_its_parent(void)
{
    return kill(getppid(), 0) == 0;
}

static int signals_by_thread(void)
{
    return syscall(SYS_tgkill, 1, 1, 0) == 0;
}

static int traces(void)
{
    return ptrace(PTRACE_TRACEME, 0, NULL, NULL) == 0;
}

static int makes_code(void)
{
    return mmap(NULL, 4096, PROT_READ | PROT_WRITE | PROT_EXEC, MAP_PRIVATE | MAP_ANONYMOUS, -1,
                0) != MAP_FAILED;
}

static int turns_data_into_code(void)
{
    void *page = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

    return page != MAP_FAILED && mprotect(page, 4096, PROT_READ | PROT_EXEC) == 0;
}

static int raises_a_limit(void)
{
    const struct rlimit all = { RLIM_INFINITY, RLIM_INFINITY };

    return setrlimit(RLIMIT_FSIZE, &all) == 0;
}

static int leaves(void)
{
    return chroot("/") == 0;
}

TEST(whatever_else_is_tried_ends_in_death)
{
    static const struct {
        const char *what;
        int (*deed)(void);
        int sanitizer_refuses; /* there it fails instead of dying */
    } deeds[] = {
        { "open a file", opens_a_file, 1 },
        { "make a file", makes_a_file, 1 },
        { "look at a file", looks_at_a_file, 0 },
        { "remove a file", removes_a_file, 0 },
        { "connect", connects, 0 },
        { "fork", forks, 0 },
        { "start a program", starts_a_program, 0 },
        { "start a thread", starts_a_thread, 0 },
        { "signal another process", signals_its_parent, 0 },
        { "signal another's thread", signals_by_thread, 0 },
        { "trace", traces, 0 },
        { "make code", makes_code, 0 },
        { "turn data into code", turns_data_into_code, 0 },
        { "raise a limit", raises_a_limit, 1 },
        { "leave", leaves, 0 },
    };
    size_t wrong = 0;

    for (size_t i = 0; i < sizeof deeds / sizeof deeds[0]; i++) {
        const int status = in_sandbox(deeds[i].deed, -1);

        if (died_of(status, SIGSYS) ||
            (SANITIZED && deeds[i].sanitizer_refuses && ended_with(status, SAID_NO)))
            continue;
        print_error("%s: status %#x\n", deeds[i].what, (unsigned)status);
        wrong++;
    }
    CHECK(wrong == 0);
}

static int writes_a_file(void)
{
    return write(LAST_FD, "more", 4) == 4;
}

TEST(a_file_that_was_given_grows_no_longer)
{
    char path[] = "/tmp/gieson.sandbox.XXXXXX";
    struct stat status;
    const int fd = mkstemp(path);

    CHECK(fd >= 0);
    CHECK(died_of(in_sandbox(writes_a_file, fd), SIGXFSZ));
    CHECK(fstat(fd, &status) == 0 && status.st_size == 0);
    (void)close(fd);
    (void)unlink(path);
}

/* ---- the second wall alone --------------------------------------------------------------- */

TEST(landlock_takes_the_file_system_away_by_itself)
{
    int status = 0;
    pid_t child;

    if (gsn_sandbox_landlock() == 0) {
        gsn_check_skip("this kernel has no Landlock");
    }
    (void)fflush(stdout);
    child = fork();
    CHECK(child >= 0);
    if (child == 0) {
        if (gsn_sandbox_leave_files(NULL) < 0)
            _exit(NO_SANDBOX);
        _exit(opens_a_file() || errno != EACCES || makes_a_file() || errno != EACCES ||
                      !looks_at_a_file()
                  ? SAID_NO
                  : SAID_YES);
    }
    CHECK(waitpid(child, &status, 0) == child);
    CHECK(ended_with(status, SAID_YES));
}
