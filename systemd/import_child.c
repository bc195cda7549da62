/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/import_child.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/wait.h>
#include <sysexits.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/process.h"
#include "systemd/log.h"
#include "systemd/spawn.h"

enum { BREATH_MS = 1000, KILL_AFTER_MS = 1000 };

/* What the child says, line by line. */
struct talk {
    const struct gsn_import_child *child;
    int from;
    size_t length;
    char line[400], last[400];
};

static void end_line(struct talk *talk)
{
    static const char mark[] = "gieson: ";
    const struct gsn_log_about about = { .source = talk->child->source };
    const char *text = talk->line;

    talk->line[talk->length] = '\0';
    talk->length = 0;
    if (strncmp(text, mark, strlen(mark)) == 0)
        text += strlen(mark);
    if (!*text)
        return;
    gsn_log(LOG_INFO, &about, "%s", text);
    (void)snprintf(talk->last, sizeof talk->last, "%s", text);
}

/* False at the end of what it says. */
static bool listen_once(struct talk *talk)
{
    char piece[512];
    const ssize_t got = read(talk->from, piece, sizeof piece);

    for (ssize_t i = 0; i < got; i++) {
        if (piece[i] == '\n' || talk->length + 1 == sizeof talk->line)
            end_line(talk);
        if (piece[i] != '\n')
            talk->line[talk->length++] = piece[i];
    }
    return got > 0 || (got < 0 && (errno == EINTR || errno == EAGAIN));
}

/* Until the child closes its end; true when we were asked to stop meanwhile. */
static bool listen_to(struct talk *talk)
{
    for (;;) {
        struct pollfd ends[] = { { .fd = talk->from, .events = POLLIN },
                                 { .fd = gsn_lifeline_fd(talk->child->line), .events = POLLIN } };

        gsn_lifeline_breathe(talk->child->line, GSN_READY);
        if (poll(ends, 2, BREATH_MS) <= 0)
            continue;
        if (ends[1].revents)
            return true;
        if (ends[0].revents && !listen_once(talk)) {
            end_line(talk);
            return false;
        }
    }
}

/* Asks it to stop, and no longer asks after a second. */
static void end_child(pid_t pid)
{
    const struct timespec nap = { .tv_nsec = 10000000 };
    const int64_t end = gsn_now_ms() + KILL_AFTER_MS;

    (void)kill(pid, SIGTERM);
    while (gsn_process_wait(pid, 0) < 0) {
        if (gsn_now_ms() > end)
            (void)kill(pid, SIGKILL);
        (void)nanosleep(&nap, NULL);
    }
}

static int judge(const struct talk *talk, int status, struct gsn_error *err)
{
    if (status == EX_OK)
        return GSN_OK;
    if (status == EX_TEMPFAIL)
        return gsn_fail(err, GSN_E_BUSY, "%.300s", talk->last);
    if (status >= 128 || !talk->last[0])
        return gsn_fail(err, GSN_E_PROCESS, "gieson-work ended with %d%s%.300s", status,
                        talk->last[0] ? ": " : "", talk->last);
    return gsn_fail(err, GSN_E_INPUT, "%.390s", talk->last);
}

int gsn_import_child_run(const struct gsn_import_child *child, struct gsn_error *err)
{
    const char *const argv[] = { child->worker, "--store",     child->store_dir,
                                 "import",      child->folder, NULL };
    struct talk talk = { .child = child };
    int ends[2], r;
    pid_t pid;

    if (pipe2(ends, O_CLOEXEC) < 0)
        return gsn_fail(err, GSN_E_PROCESS, "a pipe: %s", strerror(errno));
    const struct gsn_spawn_fd places[] = { { ends[1], 1 }, { ends[1], 2 } };
    const struct gsn_spawn what = { .argv = argv, .fd_count = 2, .fd = places };

    r = gsn_spawn(&what, &pid, err);
    (void)close(ends[1]);
    talk.from = ends[0];
    if (r >= 0 && listen_to(&talk)) {
        end_child(pid);
        r = gsn_fail(err, GSN_E_BUSY, "the import was broken off");
    } else if (r >= 0) {
        r = judge(&talk, gsn_process_wait(pid, 1), err);
    }
    (void)close(ends[0]);
    return r;
}
