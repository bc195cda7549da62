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

#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "systemd/log.h"
#include "systemd/spawn.h"

enum { BREATH_MS = 500, KILL_AFTER_MS = 1000 };

/* What a process has done since it began, by the kernel's account: time, reads and writes. */
struct deeds {
    char stat[1024], io[512];
};

/* What the child says, line by line, and when it last did anything. */
struct talk {
    const struct gsn_import_child *child;
    pid_t pid;
    struct deeds deeds;
    int64_t did_ms;
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
    if (!talk->child->again)
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

static void read_deeds(pid_t pid, const char *what, char *ret_text, size_t size)
{
    char path[64];
    ssize_t got = -1;
    int fd;

    (void)snprintf(path, sizeof path, "/proc/%lld/%s", (long long)pid, what);
    if (gsn_file_open(path, &fd, NULL) >= 0) {
        got = read(fd, ret_text, size - 1);
        (void)close(fd);
    }
    ret_text[got > 0 ? got : 0] = '\0';
}

/* Whether the child has done nothing at all for its patience. Where /proc does not tell, none is
 * ever called hung. */
static bool hangs(struct talk *talk)
{
    struct deeds now;

    read_deeds(talk->pid, "stat", now.stat, sizeof now.stat);
    read_deeds(talk->pid, "io", now.io, sizeof now.io);
    if (!now.stat[0] || strcmp(now.stat, talk->deeds.stat) != 0 ||
        strcmp(now.io, talk->deeds.io) != 0) {
        talk->deeds = now;
        talk->did_ms = gsn_now_ms();
    }
    return gsn_now_ms() - talk->did_ms > talk->child->patience_ms;
}

enum outcome { SAID_ALL, STOPPED, HUNG };

/* Until the child closes its end, or we were asked to stop, or it hangs. */
static enum outcome listen_to(struct talk *talk)
{
    for (;;) {
        struct pollfd ends[] = { { .fd = talk->from, .events = POLLIN },
                                 { .fd = gsn_lifeline_fd(talk->child->line), .events = POLLIN } };

        gsn_lifeline_breathe(talk->child->line, GSN_READY);
        if (hangs(talk))
            return HUNG;
        if (poll(ends, 2, BREATH_MS) <= 0)
            continue;
        if (ends[1].revents)
            return STOPPED;
        if (ends[0].revents && !listen_once(talk)) {
            end_line(talk);
            return SAID_ALL;
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
    if (status == EX_NOPERM)
        return gsn_fail(err, GSN_E_DENIED, "%.390s", talk->last);
    if (status == EX_IOERR)
        return gsn_fail(err, GSN_E_IO, "%.390s", talk->last);
    if (status >= 128 || !talk->last[0])
        return gsn_fail(err, GSN_E_PROCESS, "gieson-work ended with %d%s%.300s", status,
                        talk->last[0] ? ": " : "", talk->last);
    return gsn_fail(err, GSN_E_INPUT, "%.390s", talk->last);
}

/* Started, with its words in talk->from; that is ours to close. */
static int start(struct talk *talk, struct gsn_error *err)
{
    const struct gsn_import_child *const child = talk->child;
    const char *const argv[] = { child->worker, "--store",     child->store_dir,
                                 "import",      child->folder, "--served",
                                 NULL };
    int ends[2], r;

    if (pipe2(ends, O_CLOEXEC) < 0)
        return gsn_fail(err, GSN_E_PROCESS, "a pipe: %s", strerror(errno));
    const struct gsn_spawn_fd places[] = { { ends[1], 1 }, { ends[1], 2 } };
    const struct gsn_spawn what = { .argv = argv, .fd_count = 2, .fd = places };

    r = gsn_spawn(&what, &talk->pid, err);
    (void)close(ends[1]);
    if (r < 0)
        (void)close(ends[0]);
    else
        talk->from = ends[0];
    talk->did_ms = gsn_now_ms();
    return r;
}

int gsn_import_child_run(const struct gsn_import_child *child, struct gsn_error *err)
{
    struct talk talk = { .child = child };
    enum outcome outcome;
    int r = start(&talk, err);

    if (r < 0)
        return r;
    outcome = listen_to(&talk);
    if (outcome == SAID_ALL) {
        r = judge(&talk, gsn_process_wait(talk.pid, 1), err);
    } else {
        end_child(talk.pid);
        r = outcome == STOPPED
                ? gsn_fail(err, GSN_E_BUSY, "the import was broken off")
                : gsn_fail(
                      err, GSN_E_PROCESS,
                      "gieson-work did nothing for %lld s while it took in this folder, and was "
                      "ended: see whether the disk or the network folder answers",
                      (long long)child->patience_ms / 1000);
    }
    (void)close(talk.from);
    return r;
}
