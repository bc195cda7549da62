/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/supervise_parts.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/process.h"
#include "storage/bench.h"
#include "systemd/lifeline.h"
#include "systemd/spawn.h"

enum {
    STOP_MS = 4000, /* an intake ends by itself within two seconds */
    ITS_CONFIG = 3,
    ITS_HEARTBEAT = 4,
};

struct gsn_log_about gsn_supervised_about(const struct gsn_supervised *intake, const char *id)
{
    return (struct gsn_log_about){ .id = id, .source = intake->name };
}

static void forget_process(struct gsn_supervised *intake)
{
    intake->child = sd_event_source_disable_unref(intake->child);
    intake->breath = sd_event_source_disable_unref(intake->breath);
    intake->timer = sd_event_source_disable_unref(intake->timer);
    if (intake->heartbeat >= 0)
        (void)close(intake->heartbeat);
    intake->heartbeat = -1;
    intake->pid = 0;
}

void gsn_supervised_free(struct gsn_supervised *intake)
{
    if (!intake)
        return;
    if (intake->pid > 0) {
        (void)kill(intake->pid, SIGKILL);
        (void)gsn_process_wait(intake->pid, 1);
    }
    forget_process(intake);
    gsn_free(intake->name);
    gsn_free(intake->text);
    gsn_free(intake->address);
    gsn_free(intake);
}

void gsn_supervised_say_failed(const struct gsn_supervised *intake, const char *sentence)
{
    const struct gsn_bench_source row = { .name = intake->name,
                                          .address = intake->address,
                                          .device = "",
                                          .state = "failed",
                                          .message = sentence,
                                          .item = "" };
    struct gsn_error quiet = { 0 };

    (void)gsn_bench_put(intake->supervisor->store, &row, time(NULL), &quiet);
}

static void set_timer(struct gsn_supervised *intake, int64_t ms, sd_event_time_handler_t handler)
{
    intake->timer = sd_event_source_disable_unref(intake->timer);
    (void)sd_event_add_time_relative(intake->supervisor->loop, &intake->timer, CLOCK_MONOTONIC,
                                     (uint64_t)ms * 1000, 0, handler, intake);
}

static int on_rested(sd_event_source *source, uint64_t usec, void *context)
{
    (void)source;
    (void)usec;
    gsn_supervised_start(context);
    return 0;
}

void gsn_supervised_rest(struct gsn_supervised *intake, enum gsn_supervised_state state, int64_t ms)
{
    intake->state = state;
    set_timer(intake, ms, on_rested);
}

static int on_silence(sd_event_source *source, uint64_t usec, void *context)
{
    struct gsn_supervised *const intake = context;
    const struct gsn_log_about what = gsn_supervised_about(intake, GSN_LOG_HUNG);

    (void)source;
    (void)usec;
    gsn_log(LOG_ERR, &what, "was silent for %lld s, so its driver hangs: killed and started again",
            (long long)(intake->patience_ms / 1000));
    gsn_supervised_say_failed(intake, "its driver hung and was started again");
    intake->is_hung = true;
    (void)kill(intake->pid, SIGKILL);
    return 0;
}

static int on_stop_late(sd_event_source *source, uint64_t usec, void *context)
{
    const struct gsn_supervised *const intake = context;

    (void)source;
    (void)usec;
    (void)kill(intake->pid, SIGKILL);
    return 0;
}

static int on_breath(sd_event_source *source, int fd, uint32_t events, void *context)
{
    struct gsn_supervised *const intake = context;
    char said[64];
    const ssize_t got = read(fd, said, sizeof said);

    (void)events;
    if (got <= 0) {
        /* It closed its end: its death will be told by itself. */
        if (got == 0)
            (void)sd_event_source_set_enabled(source, SD_EVENT_OFF);
        return 0;
    }
    intake->was_ready = intake->was_ready || memchr(said, GSN_READY, (size_t)got);
    if (intake->state == GSN_SUPERVISED_RUNNING && !intake->is_hung)
        set_timer(intake, intake->patience_ms, on_silence);
    return 0;
}

static int on_end(sd_event_source *source, const siginfo_t *end, void *context)
{
    struct gsn_supervised *const intake = context;
    struct gsn_supervisor *const supervisor = intake->supervisor;
    const bool was_stopping = intake->state == GSN_SUPERVISED_STOPPING;

    (void)source;
    forget_process(intake);
    if (supervisor->stopping || !intake->wanted) {
        intake->state = GSN_SUPERVISED_ENDED;
        gsn_supervisor_forget_unwanted(supervisor);
        return 0;
    }
    if (was_stopping)
        gsn_supervised_start(intake);
    else if (end->si_code == CLD_EXITED)
        gsn_supervised_judge_exit(intake, end->si_status);
    else
        gsn_supervised_judge_death(intake, end->si_status);
    intake->is_hung = false;
    return 0;
}

/* The configuration of this one source, as a file that only the child sees. */
static int open_text(const struct gsn_supervised *intake, int *ret_fd, struct gsn_error *err)
{
    const size_t size = strlen(intake->text);
    const int fd = memfd_create("gieson.conf", MFD_CLOEXEC);

    if (fd < 0 || write(fd, intake->text, size) != (ssize_t)size) {
        (void)gsn_fail(err, GSN_E_IO, "memory for the configuration: %s", strerror(errno));
        if (fd >= 0)
            (void)close(fd);
        return GSN_E_IO;
    }
    *ret_fd = fd;
    return GSN_OK;
}

static int spawn(struct gsn_supervised *intake, struct gsn_error *err)
{
    char heartbeat[16];
    const char *const argv[] = { intake->supervisor->program,
                                 "--store",
                                 gsn_store_dir(intake->supervisor->store),
                                 "--config",
                                 "/proc/self/fd/3",
                                 "--heartbeat",
                                 heartbeat,
                                 intake->name,
                                 NULL };
    int text = -1, ends[2], r;

    (void)snprintf(heartbeat, sizeof heartbeat, "%d", (int)ITS_HEARTBEAT);
    r = open_text(intake, &text, err);
    if (r < 0)
        return r;
    if (pipe2(ends, O_CLOEXEC | O_NONBLOCK) < 0) {
        (void)close(text);
        return gsn_fail(err, GSN_E_IO, "a pipe: %s", strerror(errno));
    }
    const struct gsn_spawn_fd places[] = { { text, ITS_CONFIG }, { ends[1], ITS_HEARTBEAT } };
    const struct gsn_spawn what = { .argv = argv, .fd_count = 2, .fd = places };

    r = gsn_spawn(&what, &intake->pid, err);
    (void)close(text);
    (void)close(ends[1]);
    intake->heartbeat = ends[0];
    return r;
}

static int listen_to(struct gsn_supervised *intake, struct gsn_error *err)
{
    sd_event *const loop = intake->supervisor->loop;
    int r = sd_event_add_child(loop, &intake->child, intake->pid, WEXITED, on_end, intake);

    if (r >= 0)
        r = sd_event_add_io(loop, &intake->breath, intake->heartbeat, EPOLLIN, on_breath, intake);
    if (r < 0)
        return gsn_fail(err, GSN_E_PROCESS, "its end cannot be waited for: %s", strerror(-r));
    return GSN_OK;
}

void gsn_supervised_start(struct gsn_supervised *intake)
{
    const struct gsn_log_about what = gsn_supervised_about(intake, NULL);
    struct gsn_error err = { 0 };
    int r = spawn(intake, &err);

    intake->began_ms = gsn_now_ms();
    intake->is_hung = intake->was_ready = intake->was_late = false;
    if (r >= 0)
        r = listen_to(intake, &err);
    if (r >= 0) {
        intake->state = GSN_SUPERVISED_RUNNING;
        set_timer(intake, intake->patience_ms, on_silence);
        return;
    }
    gsn_log(LOG_ERR, &what, "%s", err.text);
    if (intake->pid > 0) {
        (void)kill(intake->pid, SIGKILL);
        (void)gsn_process_wait(intake->pid, 1);
    }
    forget_process(intake);
    gsn_supervised_back_off(intake);
}

void gsn_supervised_stop(struct gsn_supervised *intake)
{
    if (intake->state == GSN_SUPERVISED_RUNNING) {
        intake->state = GSN_SUPERVISED_STOPPING;
        (void)kill(intake->pid, SIGTERM);
        set_timer(intake, STOP_MS, on_stop_late);
    } else if (intake->state != GSN_SUPERVISED_STOPPING) {
        intake->state = GSN_SUPERVISED_ENDED;
        intake->timer = sd_event_source_disable_unref(intake->timer);
    }
}
