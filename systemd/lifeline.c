/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/lifeline.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <string.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

enum { BREATH_MS = 250, GRACE_MS = 1800 };

struct gsn_lifeline {
    int stop;      /* an eventfd */
    int heartbeat; /* -1: none */
    int64_t breathed_ms;
    char said;
    bool has_thread;
    pthread_t thread;
};

int64_t gsn_now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static void ask_to_stop(const struct gsn_lifeline *line)
{
    (void)eventfd_write(line->stop, 1);
}

static sigset_t ends(void)
{
    sigset_t set;

    (void)sigemptyset(&set);
    (void)sigaddset(&set, SIGTERM);
    (void)sigaddset(&set, SIGINT);
    return set;
}

static void *wait_for_the_end(void *context)
{
    const struct gsn_lifeline *const line = context;
    const struct timespec grace = { .tv_sec = GRACE_MS / 1000,
                                    .tv_nsec = (GRACE_MS % 1000) * 1000000L };
    const sigset_t set = ends();
    int signal_number = 0;

    if (sigwait(&set, &signal_number) != 0)
        return NULL;
    ask_to_stop(line);
    (void)nanosleep(&grace, NULL);
    _exit(128 + signal_number);
}

int gsn_lifeline_new(int heartbeat_fd, struct gsn_lifeline **ret_line, struct gsn_error *err)
{
    gsn_auto(gsn_lifeline) line = gsn_alloc_array(1, sizeof *line);
    const sigset_t set = ends();
    int failure;

    if (!line)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a lifeline");
    line->heartbeat = heartbeat_fd;
    line->stop = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (line->stop < 0)
        return gsn_fail(err, GSN_E_IO, "eventfd: %s", strerror(errno));
    if (heartbeat_fd >= 0)
        (void)fcntl(heartbeat_fd, F_SETFL, O_NONBLOCK);
    if (heartbeat_fd >= 0)
        (void)fcntl(heartbeat_fd, F_SETFD, FD_CLOEXEC);
    (void)signal(SIGPIPE, SIG_IGN);
    (void)pthread_sigmask(SIG_BLOCK, &set, NULL);
    failure = pthread_create(&line->thread, NULL, wait_for_the_end, line);
    if (failure)
        return gsn_fail(err, GSN_E_IO, "a thread could not be started: %s", strerror(failure));
    line->has_thread = true;
    *ret_line = gsn_steal(&line);
    return GSN_OK;
}

void gsn_lifeline_free(struct gsn_lifeline *line)
{
    if (!line)
        return;
    if (line->has_thread) {
        (void)pthread_cancel(line->thread);
        (void)pthread_join(line->thread, NULL);
    }
    if (line->stop >= 0)
        (void)close(line->stop);
    gsn_free(line);
}

void gsn_lifeline_breathe(struct gsn_lifeline *line, char what)
{
    const int64_t now = gsn_now_ms();

    if (line->heartbeat < 0 || (line->said == what && now - line->breathed_ms < BREATH_MS))
        return;
    line->said = what;
    line->breathed_ms = now;
    if (write(line->heartbeat, &what, 1) < 0 && errno == EPIPE)
        ask_to_stop(line);
}

int gsn_lifeline_fd(const struct gsn_lifeline *line)
{
    return line->stop;
}

int gsn_lifeline_is_over(const struct gsn_lifeline *line)
{
    struct pollfd stop = { .fd = line->stop, .events = POLLIN };

    return poll(&stop, 1, 0) > 0;
}
