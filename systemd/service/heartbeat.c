/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The heartbeat pipe of a child, and the signal that ends it.
 *
 * A byte goes into the pipe at every sign of life, four times a second at most. The parent's
 * watchdog (supervise.c) counts the time between them. A thread waits for SIGTERM and SIGINT,
 * because a driver may hang: it makes the descriptor gsn_heartbeat_fd() readable, and 1.8 s later
 * ends the process where it stands. Nothing is lost by that, for nothing was acknowledged that is
 * not durable. A pipe that nobody reads any more (EPIPE) asks to stop as well: whoever listened is
 * gone. */
#include "systemd/service/heartbeat.h"

#include "pipeline/core/calendar.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

enum { BEAT_MS = 250, GRACE_MS = 1800 };

struct gsn_heartbeat {
    int stop;    /* an eventfd: it is time to stop */
    int over;    /* an eventfd: the thread is to end */
    int signals; /* a signalfd */
    int fd;      /* -1: none */
    int64_t beat_ms;
    char said;
    bool has_thread;
    pthread_t thread;
};

static void ask_to_stop(const struct gsn_heartbeat *heartbeat)
{
    (void)eventfd_write(heartbeat->stop, 1);
}

static sigset_t end_signals(void)
{
    sigset_t set;

    (void)sigemptyset(&set);
    (void)sigaddset(&set, SIGTERM);
    (void)sigaddset(&set, SIGINT);
    return set;
}

/* Whether the thread is to end, rather than the wait. timeout_ms -1: until a signal. */
static bool wait_for_end(const struct gsn_heartbeat *heartbeat, int signals, int timeout_ms)
{
    struct pollfd wait[] = { { .fd = heartbeat->over, .events = POLLIN },
                             { .fd = signals, .events = POLLIN } };
    int r;

    do
        r = poll(wait, 2, timeout_ms);
    while (r < 0 && errno == EINTR);
    return r < 0 || wait[0].revents;
}

static void *wait_for_signal(void *context)
{
    const struct gsn_heartbeat *const heartbeat = context;
    struct signalfd_siginfo asked;

    if (wait_for_end(heartbeat, heartbeat->signals, -1) ||
        read(heartbeat->signals, &asked, sizeof asked) != (ssize_t)sizeof asked)
        return NULL;
    ask_to_stop(heartbeat);
    if (wait_for_end(heartbeat, -1, GRACE_MS))
        return NULL;
    _exit(128 + (int)asked.ssi_signo);
}

int gsn_heartbeat_new(int heartbeat_fd, struct gsn_heartbeat **ret_heartbeat, struct gsn_error *err)
{
    gsn_auto(gsn_heartbeat) heartbeat = gsn_alloc_array(1, sizeof *heartbeat);
    const sigset_t set = end_signals();
    int failure;

    if (!heartbeat)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a heartbeat");
    heartbeat->fd = heartbeat_fd;
    heartbeat->stop = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    heartbeat->over = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    heartbeat->signals = signalfd(-1, &set, SFD_CLOEXEC);
    if (heartbeat->stop < 0 || heartbeat->over < 0 || heartbeat->signals < 0)
        return gsn_fail(err, GSN_E_IO, "eventfd, signalfd: %s", strerror(errno));
    if (heartbeat_fd >= 0)
        (void)fcntl(heartbeat_fd, F_SETFL, O_NONBLOCK);
    if (heartbeat_fd >= 0)
        (void)fcntl(heartbeat_fd, F_SETFD, FD_CLOEXEC);
    (void)signal(SIGPIPE, SIG_IGN);
    (void)pthread_sigmask(SIG_BLOCK, &set, NULL);
    failure = pthread_create(&heartbeat->thread, NULL, wait_for_signal, heartbeat);
    if (failure)
        return gsn_fail(err, GSN_E_IO, "a thread could not be started: %s", strerror(failure));
    heartbeat->has_thread = true;
    *ret_heartbeat = gsn_steal(&heartbeat);
    return GSN_OK;
}

void gsn_heartbeat_free(struct gsn_heartbeat *heartbeat)
{
    if (!heartbeat)
        return;
    if (heartbeat->has_thread) {
        (void)eventfd_write(heartbeat->over, 1);
        (void)pthread_join(heartbeat->thread, NULL);
    }
    if (heartbeat->stop >= 0)
        (void)close(heartbeat->stop);
    if (heartbeat->over >= 0)
        (void)close(heartbeat->over);
    if (heartbeat->signals >= 0)
        (void)close(heartbeat->signals);
    gsn_free(heartbeat);
}

void gsn_heartbeat_beat(struct gsn_heartbeat *heartbeat, char what)
{
    const int64_t now = gsn_now_ms();

    if (heartbeat->fd < 0 || (heartbeat->said == what && now - heartbeat->beat_ms < BEAT_MS))
        return;
    heartbeat->said = what;
    heartbeat->beat_ms = now;
    if (write(heartbeat->fd, &what, 1) < 0 && errno == EPIPE)
        ask_to_stop(heartbeat);
}

int gsn_heartbeat_fd(const struct gsn_heartbeat *heartbeat)
{
    return heartbeat->stop;
}

int gsn_heartbeat_is_over(const struct gsn_heartbeat *heartbeat)
{
    struct pollfd stop = { .fd = heartbeat->stop, .events = POLLIN };

    return poll(&stop, 1, 0) > 0;
}
