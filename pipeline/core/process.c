/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Child processes by fork() and exec(), with pipes watched by poll().
 *
 * A question: (1) SIGPIPE is held back in this thread alone; (2) the child takes its ends of the
 * pipes, dies with the thread that started it (PR_SET_PDEATHSIG), limits its own address space and
 * processor time (setrlimit) and becomes the program; (3) question, answer and complaints cross,
 * whichever is ready, until the child closes its ends or its time is over; (4) its end is awaited
 * through a pidfd as long as there is time, then it is killed; (5) how it ended becomes the
 * sentence. A child that stays is the same without question and answer: it has a socket of the
 * caller's. A child that shares our streams is posix_spawn()'s.
 *
 * Failure: GSN_E_PROCESS with the exit status or signal and the child's first complaint;
 * GSN_E_LIMIT for too long an answer. Cost: a fork; the clock is looked at every 200 ms. */
#include "pipeline/core/process.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdbool.h>
#include <string.h>
#include <sys/pidfd.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { CHUNK = 1 << 16, CLOSING_S = 10 };

/* One conversation: the ends we hold and what has crossed so far. */
struct talk {
    pid_t child;
    int in, out, complaints; /* -1 once closed */
    const uint8_t *question;
    size_t question_size, sent;
    uint8_t *answer;
    size_t answer_size, answer_room;
    struct gsn_process_end how;
    size_t complaint_size;
    double end; /* read_clock() at which the child's time is over; 0: never */
};

static void close_end(int *fd)
{
    if (*fd >= 0)
        (void)close(*fd);
    *fd = -1;
}

/* A second of grace for processor time: at the hard limit the kernel kills without saying why. */
static void set_limit(int what, uint64_t most)
{
    const struct rlimit value = { .rlim_cur = most, .rlim_max = most + (what == RLIMIT_CPU) };

    if (most)
        (void)setrlimit((__rlimit_resource_t)what, &value);
}

/* Between fork and exec: only async-signal-safe calls. */
static void become_program(const char *const argv[], const struct gsn_process_limits *limits,
                           int in, int out, int complaints)
{
    sigset_t none;
    const char *why;

    /* Where the caller's own streams are closed our pipes took their numbers; lift them first, so
     * that no dup2() closes the next one's source or leaves close-on-exec as it is. */
    in = fcntl(in, F_DUPFD_CLOEXEC, 3);
    out = fcntl(out, F_DUPFD_CLOEXEC, 3);
    complaints = fcntl(complaints, F_DUPFD_CLOEXEC, 3);
    if (dup2(in, 0) < 0 || dup2(out, 1) < 0 || dup2(complaints, 2) < 0)
        _exit(127);
    (void)prctl(PR_SET_PDEATHSIG, SIGKILL, 0, 0, 0);
    (void)sigemptyset(&none);
    (void)sigprocmask(SIG_SETMASK, &none, NULL);
    set_limit(RLIMIT_AS, limits->memory_bytes);
    set_limit(RLIMIT_CPU, limits->cpu_s);
    (void)execv(argv[0], (char *const *)(uintptr_t)argv);
    why = strerrordesc_np(errno);
    if (why)
        (void)!write(2, why, strlen(why));
    _exit(127);
}

/* lent: the child's stdin, or -1 for a pipe from us. */
static int start_child(struct talk *talk, const char *const argv[],
                       const struct gsn_process_limits *limits, int lent, struct gsn_error *err)
{
    int in[2] = { -1, -1 }, out[2] = { -1, -1 }, complaints[2] = { -1, -1 };

    if ((lent >= 0 || pipe2(in, O_CLOEXEC) == 0) && pipe2(out, O_CLOEXEC) == 0 &&
        pipe2(complaints, O_CLOEXEC) == 0)
        talk->child = fork();
    if (talk->child == 0)
        become_program(argv, limits, lent >= 0 ? lent : in[0], out[1], complaints[1]);
    close_end(&in[0]);
    close_end(&out[1]);
    close_end(&complaints[1]);
    talk->in = in[1];
    talk->out = out[0];
    talk->complaints = complaints[0];
    if (talk->child < 0)
        return gsn_fail(err, GSN_E_PROCESS, "%s could not be started: %s", argv[0],
                        strerror(errno));
    if (talk->in >= 0)
        (void)fcntl(talk->in, F_SETFL, O_NONBLOCK);
    return GSN_OK;
}

static void feed_child(struct talk *talk)
{
    const ssize_t put =
        write(talk->in, talk->question + talk->sent, talk->question_size - talk->sent);

    if (put > 0)
        talk->sent += (size_t)put;
    if ((put < 0 && errno != EAGAIN && errno != EINTR) || talk->sent == talk->question_size)
        close_end(&talk->in);
}

static int read_child(struct talk *talk, size_t most, struct gsn_error *err)
{
    ssize_t got;

    if (talk->answer_room - talk->answer_size < CHUNK) {
        const size_t room = 2 * talk->answer_room + CHUNK + 1;
        uint8_t *larger = gsn_realloc_array(talk->answer, room, 1);

        if (!larger)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for a child's answer");
        talk->answer = larger;
        talk->answer_room = room;
    }
    got = read(talk->out, talk->answer + talk->answer_size, CHUNK - 1);
    if (got == 0 || (got < 0 && errno != EINTR))
        close_end(&talk->out);
    if (got > 0)
        talk->answer_size += (size_t)got;
    if (talk->answer_size > most)
        return gsn_fail(err, GSN_E_LIMIT, "a child's answer is longer than %zu bytes", most);
    return GSN_OK;
}

static void listen_to_complaint(struct talk *talk)
{
    char rest[512];
    const ssize_t got = read(talk->complaints, rest, sizeof rest);

    if (got == 0 || (got < 0 && errno != EINTR))
        close_end(&talk->complaints);
    for (ssize_t i = 0; i < got && talk->complaint_size + 1 < sizeof talk->how.complaint; i++)
        talk->how.complaint[talk->complaint_size++] = rest[i];
}

static double read_clock(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Moves bytes both ways until the child closes its ends or its time is over. */
static int talk_to_child(struct talk *talk, const struct gsn_process_limits *limits,
                         struct gsn_error *err)
{
    while (talk->out >= 0 || talk->complaints >= 0) {
        struct pollfd ends[3] = { { .fd = talk->in, .events = POLLOUT },
                                  { .fd = talk->out, .events = POLLIN },
                                  { .fd = talk->complaints, .events = POLLIN } };
        int r;

        if (talk->end > 0 && read_clock() > talk->end) {
            talk->how.late = 1;
            return GSN_OK;
        }
        r = poll(ends, 3, 200);
        if (r < 0 && errno != EINTR)
            return gsn_fail(err, GSN_E_PROCESS, "poll: %s", strerror(errno));
        if (r <= 0)
            continue;
        if (talk->in >= 0 && ends[0].revents)
            feed_child(talk);
        if (talk->out >= 0 && ends[1].revents) {
            r = read_child(talk, limits->answer_bytes, err);
            if (r < 0)
                return r;
        }
        if (talk->complaints >= 0 && ends[2].revents)
            listen_to_complaint(talk);
    }
    return GSN_OK;
}

/* Whether the child ends while it has time; one that closed its ends may still go on. */
static bool ends_in_time(const struct talk *talk)
{
    struct pollfd child = { .fd = talk->end > 0 ? pidfd_open(talk->child, 0) : -1,
                            .events = POLLIN };
    int r = 1;

    if (child.fd < 0)
        return true;
    do {
        const double left = talk->end - read_clock();

        r = left > 0 ? poll(&child, 1, (int)(1000 * left) + 1) : 0;
    } while (r < 0 && errno == EINTR);
    (void)close(child.fd);
    return r != 0;
}

static void finish_complaint(struct talk *talk)
{
    talk->how.complaint[talk->complaint_size] = '\0';
    talk->how.complaint[strcspn(talk->how.complaint, "\n")] = '\0';
}

/* Waits for the end of the child, with quick not for its own, and keeps how it was. */
static int reap_child(struct talk *talk, bool quick, struct gsn_error *err)
{
    struct gsn_process_end *how = &talk->how;
    pid_t ended;
    int status = 0;

    if (!quick && !how->late)
        how->late = !ends_in_time(talk);
    if (quick || how->late)
        (void)kill(talk->child, SIGKILL);
    do
        ended = waitpid(talk->child, &status, 0);
    while (ended < 0 && errno == EINTR);
    if (ended < 0)
        return gsn_fail(err, GSN_E_PROCESS, "its end cannot be learnt: %s", strerror(errno));
    how->code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    how->signal = WIFSIGNALED(status) ? WTERMSIG(status) : 0;
    finish_complaint(talk);
    return GSN_OK;
}

/* Its end as a sentence. */
static int judge_end(const struct gsn_process_end *how, const struct gsn_process_limits *limits,
                     struct gsn_error *err)
{
    const char *colon = how->complaint[0] ? ": " : "";

    if (how->late)
        return gsn_fail(err, GSN_E_PROCESS, "gave no answer within %u s", limits->wall_s);
    if (how->code == 0)
        return GSN_OK;
    if (how->signal)
        return gsn_fail(err, GSN_E_PROCESS, "died of signal %d (%s)%s%s", how->signal,
                        strsignal(how->signal), colon, how->complaint);
    return gsn_fail(err, GSN_E_PROCESS, "ended with code %d%s%s", how->code, colon, how->complaint);
}

/* A child that dies early closes our pipe: that must be an error, not our own death. The signal is
 * held back in this thread alone, for other threads may be asking too. */
struct hush {
    sigset_t before;
    bool was_pending;
};

static void hold_sigpipe(struct hush *hush)
{
    sigset_t held, pending;

    (void)sigemptyset(&held);
    (void)sigaddset(&held, SIGPIPE);
    (void)sigemptyset(&pending);
    (void)sigpending(&pending);
    hush->was_pending = sigismember(&pending, SIGPIPE) == 1;
    (void)pthread_sigmask(SIG_BLOCK, &held, &hush->before);
}

static void release_sigpipe(const struct hush *hush)
{
    const struct timespec at_once = { 0 };
    sigset_t held;

    (void)sigemptyset(&held);
    (void)sigaddset(&held, SIGPIPE);
    while (!hush->was_pending && sigtimedwait(&held, NULL, &at_once) < 0 && errno == EINTR)
        ;
    (void)pthread_sigmask(SIG_SETMASK, &hush->before, NULL);
}

/* From the start of the child to its end; a failure here is one of ours, not of the child's. */
static int hold_talk(struct talk *talk, const char *const argv[],
                     const struct gsn_process_limits *limits, int lent, struct gsn_error *err)
{
    struct hush hush;
    int r;

    talk->end = limits->wall_s ? read_clock() + limits->wall_s : 0;
    hold_sigpipe(&hush);
    r = start_child(talk, argv, limits, lent, err);
    if (r >= 0) {
        const int talked = talk_to_child(talk, limits, err);

        close_end(&talk->in);
        r = reap_child(talk, talked < 0, talked < 0 ? NULL : err);
        r = talked < 0 ? talked : r;
    }
    close_end(&talk->in);
    close_end(&talk->out);
    close_end(&talk->complaints);
    release_sigpipe(&hush);
    return r;
}

int gsn_process_ask(const char *const argv[], const struct gsn_process_limits *limits,
                    const void *question, size_t question_size, uint8_t **ret_answer,
                    size_t *ret_answer_size, struct gsn_error *err)
{
    struct talk talk = { .child = -1,
                         .in = -1,
                         .out = -1,
                         .complaints = -1,
                         .question = question,
                         .question_size = question_size };
    int r = hold_talk(&talk, argv, limits, -1, err);

    if (r >= 0)
        r = judge_end(&talk.how, limits, err);
    if (r < 0) {
        gsn_free(talk.answer);
        (void)gsn_fail_at(err, "%s", argv[0]);
        return r;
    }
    talk.answer[talk.answer_size] = 0;
    *ret_answer = talk.answer;
    *ret_answer_size = talk.answer_size;
    return GSN_OK;
}

/* ---- a child that stays ------------------------------------------------------------------ */

struct gsn_process {
    struct talk talk;
};

int gsn_process_open(const char *const argv[], int fd, struct gsn_process **ret_process,
                     struct gsn_error *err)
{
    const struct gsn_process_limits none = { 0 };
    struct gsn_process *process = gsn_alloc_array(1, sizeof *process);
    int r;

    if (!process)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a child");
    process->talk = (struct talk){ .child = -1, .in = -1, .out = -1, .complaints = -1 };
    r = start_child(&process->talk, argv, &none, fd, err);
    if (r < 0) {
        close_end(&process->talk.out);
        close_end(&process->talk.complaints);
        gsn_free(process);
        return r;
    }
    /* What it prints is dropped where it is not its complaint: it has another way to answer. */
    close_end(&process->talk.out);
    (void)fcntl(process->talk.complaints, F_SETFL, O_NONBLOCK);
    *ret_process = process;
    return GSN_OK;
}

int gsn_process_allow(const struct gsn_process *process, uint64_t memory_bytes,
                      struct gsn_error *err)
{
    struct rlimit most;
    int r = prlimit(process->talk.child, RLIMIT_AS, NULL, &most);

    /* What the job as a whole may have only root could raise. */
    most.rlim_cur = memory_bytes < most.rlim_max ? memory_bytes : most.rlim_max;
    if (r >= 0)
        r = prlimit(process->talk.child, RLIMIT_AS, &most, NULL);
    if (r < 0)
        return gsn_fail(err, GSN_E_PROCESS, "a child's memory cannot be limited: %s",
                        strerror(errno));
    return GSN_OK;
}

int gsn_process_await(struct gsn_process *process, int fd, unsigned wall_s)
{
    const double end = wall_s ? read_clock() + wall_s : 0;

    for (;;) {
        struct pollfd ends[2] = { { .fd = fd, .events = POLLIN },
                                  { .fd = process->talk.complaints, .events = POLLIN } };

        if (end > 0 && read_clock() > end) {
            process->talk.how.late = 1;
            return 0;
        }
        if (poll(ends, 2, 200) <= 0)
            continue;
        if (ends[0].revents)
            return 1;
        if (ends[1].revents)
            listen_to_complaint(&process->talk);
    }
}

void gsn_process_close(struct gsn_process *process, int at_once, struct gsn_process_end *ret_end)
{
    struct talk *talk;

    if (!process)
        return;
    talk = &process->talk;
    talk->end = read_clock() + CLOSING_S;
    if (!at_once && !talk->how.late)
        talk->how.late = !ends_in_time(talk);
    (void)reap_child(talk, at_once, NULL);
    while (talk->complaints >= 0) {
        const size_t before = talk->complaint_size;

        listen_to_complaint(talk);
        if (talk->complaint_size == before)
            break;
    }
    close_end(&talk->complaints);
    finish_complaint(talk);
    if (ret_end)
        *ret_end = talk->how;
    gsn_free(process);
}

int gsn_process_start(const char *const argv[], pid_t *ret_child, struct gsn_error *err)
{
    posix_spawnattr_t how;
    sigset_t none;
    int r = posix_spawnattr_init(&how);

    (void)sigemptyset(&none);
    if (r == 0) {
        (void)posix_spawnattr_setsigmask(&how, &none);
        (void)posix_spawnattr_setflags(&how, POSIX_SPAWN_SETSIGMASK);
        r = posix_spawn(ret_child, argv[0], NULL, &how, (char *const *)(uintptr_t)argv, environ);
        (void)posix_spawnattr_destroy(&how);
    }
    if (r != 0)
        return gsn_fail(err, GSN_E_PROCESS, "%s could not be started: %s", argv[0], strerror(r));
    return GSN_OK;
}

int gsn_process_wait(pid_t child, int block)
{
    int status = 0;

    for (;;) {
        const pid_t ended = waitpid(child, &status, block ? 0 : WNOHANG);

        if (ended == child)
            return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
        if (ended == 0)
            return -1;
        if (errno != EINTR)
            return 127; /* not ours, or already waited for */
    }
}

int gsn_process_sibling(const char *name, char **ret_path, struct gsn_error *err)
{
    char self[4096];
    const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    gsn_auto_mem(char) installed = gsn_format("%s/%s", GSN_LIBEXECDIR, name);
    gsn_auto_mem(char) beside = NULL;
    char *slash;

    self[length > 0 ? length : 0] = '\0';
    slash = strrchr(self, '/');
    beside = gsn_format("%.*s/%s", slash ? (int)(slash - self) : 0, self, name);
    if (!beside || !installed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (slash && access(beside, X_OK) == 0)
        *ret_path = gsn_steal(&beside);
    else if (access(installed, X_OK) == 0)
        *ret_path = gsn_steal(&installed);
    else
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "the program %s is not installed: there is neither %s nor %s", name, beside,
                        installed);
    return GSN_OK;
}
