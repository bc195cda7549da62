/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One gieson-intake process per source, kept alive.
 *
 * Steps.
 * 1. set(): sources of the new configuration are compared as texts with those that run; what
 * changed is stopped and started, what stayed is left alone.
 * 2. start: the source's configuration goes to the child as a file in memory (descriptor 3), and a
 *    pipe comes back: the heartbeat (heartbeat.h).
 * 3. A watchdog timer restarts at each beat. When it runs out the process hangs in a driver: it is
 *    killed, and its row says so, because the process cannot.
 * 4. An exit says what follows. Asked to stop: nothing. Source at its end: nothing. Device away:
 * tried again when udev reports something in its subsystem, and every minute. Killed by somebody:
 * at once. Failed: after 1 s, doubled to a minute; a process that ran well for a while begins at 1
 * s again.
 *
 * How it fails: what hinders a start is logged, and it is tried again later; the service goes on.
 */
#include "systemd/service/supervise.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <sysexits.h>
#include <time.h>
#include <unistd.h>

#include "acquire/source.h"
#include "pipeline/core/calendar.h"
#include "pipeline/core/process.h"
#include "storage/bench.h"
#include "systemd/service/heartbeat.h"
#include "systemd/service/log.h"
#include "systemd/service/spawn.h"

enum supervised_state {
    RUNNING,
    DELAYED,  /* will be started again when its timer ends */
    AWAY,     /* the same, or when its device comes */
    ENDED,    /* nothing will follow */
    STOPPING, /* asked to */
};

struct supervised {
    struct gsn_supervisor *supervisor;
    char *name, *text; /* the configuration as it is passed on */
    char *address;
    int64_t watchdog_ms;
    enum supervised_state state;
    bool wanted;    /* by the present configuration */
    bool is_hung;   /* it was killed because of that */
    bool was_ready; /* its source answered */
    bool was_late;  /* a device came while this process was looking already */
    pid_t pid;
    int heartbeat; /* our end; -1 */
    int64_t began_ms, delay_ms;
    sd_event_source *child, *pulse, *timer;
};

struct gsn_supervisor {
    sd_event *loop;
    struct gsn_store *store;
    char *program;
    bool stopping;
    size_t count;
    struct supervised **at;
};

static void start_process(struct supervised *intake);

enum {
    STOP_MS = 4000, /* an intake ends by itself within two seconds */
    ITS_CONFIG = 3,
    ITS_HEARTBEAT = 4,
};

/* The process of one source. */

static struct gsn_log_about log_about(const struct supervised *intake, const char *id)
{
    return (struct gsn_log_about){ .id = id, .source = intake->name };
}

static void forget_process(struct supervised *intake)
{
    intake->child = sd_event_source_disable_unref(intake->child);
    intake->pulse = sd_event_source_disable_unref(intake->pulse);
    intake->timer = sd_event_source_disable_unref(intake->timer);
    if (intake->heartbeat >= 0)
        (void)close(intake->heartbeat);
    intake->heartbeat = -1;
    intake->pid = 0;
}

/* Kills what is left. */
static void supervised_free(struct supervised *intake)
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

/* Frees those that no configuration wants and that have no process any more. */
static void forget_unwanted(struct gsn_supervisor *supervisor)
{
    size_t kept = 0;

    for (size_t i = 0; i < supervisor->count; i++) {
        struct supervised *const intake = supervisor->at[i];

        if (intake->wanted || intake->pid > 0)
            supervisor->at[kept++] = intake;
        else
            supervised_free(intake);
    }
    supervisor->count = kept;
}

/* In the row that people look at, because the process cannot say it any more. */
static void record_failure(const struct supervised *intake, const char *sentence)
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

/* What follows when it ends. */

static void set_timer(struct supervised *intake, int64_t ms, sd_event_time_handler_t handler)
{
    intake->timer = sd_event_source_disable_unref(intake->timer);
    (void)sd_event_add_time_relative(intake->supervisor->loop, &intake->timer, CLOCK_MONOTONIC,
                                     (uint64_t)ms * 1000, 0, handler, intake);
}

static int on_delay_over(sd_event_source *source, uint64_t usec, void *context)
{
    (void)source;
    (void)usec;
    start_process(context);
    return 0;
}

/* Starts it after so long. */
static void start_later(struct supervised *intake, enum supervised_state state, int64_t ms)
{
    intake->state = state;
    set_timer(intake, ms, on_delay_over);
}

enum {
    KILLED_DELAY_MS = 200,
    FIRST_DELAY_MS = 1000,
    LONGEST_DELAY_MS = 60000,
    AWAY_DELAY_MS = 60000,
    FOLDER_AWAY_DELAY_MS = 5000, /* a mount is no event of a device */
    STEADY_MS = 60000,           /* who lived so long begins a new series of failures */
};

/* Later each time, until it was steady for a while. */
static int64_t next_delay(struct supervised *intake)
{
    if (intake->delay_ms == 0 || gsn_now_ms() - intake->began_ms >= STEADY_MS)
        intake->delay_ms = FIRST_DELAY_MS;
    else if (intake->delay_ms < LONGEST_DELAY_MS / 2)
        intake->delay_ms *= 2;
    else
        intake->delay_ms = LONGEST_DELAY_MS;
    return intake->delay_ms;
}

/* What follows when a process ended by itself, or could not be started. */
static void back_off(struct supervised *intake)
{
    start_later(intake, DELAYED, next_delay(intake));
}

/* A device that answered before may only have been reset; one that was not there comes with an
 * event. */
static void wait_for_device(struct supervised *intake)
{
    if (intake->was_ready || intake->was_late)
        start_later(intake, AWAY, next_delay(intake));
    else if (gsn_source_subsystem(intake->address))
        start_later(intake, AWAY, AWAY_DELAY_MS);
    else
        start_later(intake, AWAY, FOLDER_AWAY_DELAY_MS);
}

static void judge_exit(struct supervised *intake, int status)
{
    const struct gsn_log_about what = log_about(intake, NULL);

    if (status == EX_OK) {
        intake->state = ENDED;
        gsn_log(LOG_INFO, &what, "has ended: everything in it is taken in");
    } else if (status == GSN_INTAKE_STOPPED) {
        start_later(intake, DELAYED, KILLED_DELAY_MS);
    } else if (status == EX_NOINPUT) {
        wait_for_device(intake);
    } else {
        back_off(intake);
        gsn_log(LOG_WARNING, &what, "gieson-intake ended with %d; it starts again in %lld s",
                status, (long long)(intake->delay_ms / 1000));
    }
}

static void judge_death(struct supervised *intake, int signal_number)
{
    const struct gsn_log_about what = log_about(intake, NULL);

    if (signal_number == SIGKILL && !intake->is_hung)
        start_later(intake, DELAYED, KILLED_DELAY_MS);
    else
        back_off(intake);
    if (intake->is_hung)
        return;
    gsn_log(LOG_WARNING, &what, "gieson-intake died of signal %d (%s) and is started again",
            signal_number, strsignal(signal_number));
    record_failure(intake, "its process died and is started again");
}

/* Watching it, starting and stopping it. */

static int on_silence(sd_event_source *source, uint64_t usec, void *context)
{
    struct supervised *const intake = context;
    const struct gsn_log_about what = log_about(intake, GSN_LOG_HUNG);

    (void)source;
    (void)usec;
    gsn_log(LOG_ERR, &what, "was silent for %lld s, so its driver hangs: killed and started again",
            (long long)(intake->watchdog_ms / 1000));
    record_failure(intake, "its driver hung and was started again");
    intake->is_hung = true;
    (void)kill(intake->pid, SIGKILL);
    return 0;
}

static int on_stop_late(sd_event_source *source, uint64_t usec, void *context)
{
    const struct supervised *const intake = context;

    (void)source;
    (void)usec;
    (void)kill(intake->pid, SIGKILL);
    return 0;
}

static int on_heartbeat(sd_event_source *source, int fd, uint32_t events, void *context)
{
    struct supervised *const intake = context;
    char said[64];
    const ssize_t got = read(fd, said, sizeof said);

    (void)events;
    if (got <= 0) {
        /* It closed its end: its death will be told by itself. */
        if (got == 0)
            (void)sd_event_source_set_enabled(source, SD_EVENT_OFF);
        return 0;
    }
    intake->was_ready = intake->was_ready || memchr(said, GSN_HEARTBEAT_READY, (size_t)got);
    if (intake->state == RUNNING && !intake->is_hung)
        set_timer(intake, intake->watchdog_ms, on_silence);
    return 0;
}

static int on_end(sd_event_source *source, const siginfo_t *end, void *context)
{
    struct supervised *const intake = context;
    struct gsn_supervisor *const supervisor = intake->supervisor;
    const bool was_stopping = intake->state == STOPPING;

    (void)source;
    forget_process(intake);
    if (supervisor->stopping || !intake->wanted) {
        intake->state = ENDED;
        forget_unwanted(supervisor);
        return 0;
    }
    if (was_stopping)
        start_process(intake);
    else if (end->si_code == CLD_EXITED)
        judge_exit(intake, end->si_status);
    else
        judge_death(intake, end->si_status);
    intake->is_hung = false;
    return 0;
}

/* The configuration of this one source, as a file that only the child sees. */
static int open_text(const struct supervised *intake, int *ret_fd, struct gsn_error *err)
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

static int spawn_intake(struct supervised *intake, struct gsn_error *err)
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

static int listen_to(struct supervised *intake, struct gsn_error *err)
{
    sd_event *const loop = intake->supervisor->loop;
    int r = sd_event_add_child(loop, &intake->child, intake->pid, WEXITED, on_end, intake);

    if (r >= 0)
        r = sd_event_add_io(loop, &intake->pulse, intake->heartbeat, EPOLLIN, on_heartbeat, intake);
    if (r < 0)
        return gsn_fail(err, GSN_E_PROCESS, "its end cannot be waited for: %s", strerror(-r));
    return GSN_OK;
}

/* Starts the process; what hinders it is logged, and it is tried again later. */
static void start_process(struct supervised *intake)
{
    const struct gsn_log_about what = log_about(intake, NULL);
    struct gsn_error err = { 0 };
    int r = spawn_intake(intake, &err);

    intake->began_ms = gsn_now_ms();
    intake->is_hung = intake->was_ready = intake->was_late = false;
    if (r >= 0)
        r = listen_to(intake, &err);
    if (r >= 0) {
        intake->state = RUNNING;
        set_timer(intake, intake->watchdog_ms, on_silence);
        return;
    }
    gsn_log(LOG_ERR, &what, "%s", err.text);
    if (intake->pid > 0) {
        (void)kill(intake->pid, SIGKILL);
        (void)gsn_process_wait(intake->pid, 1);
    }
    forget_process(intake);
    back_off(intake);
}

/* Asks it to end, and kills it when it does not. */
static void stop_process(struct supervised *intake)
{
    if (intake->state == RUNNING) {
        intake->state = STOPPING;
        (void)kill(intake->pid, SIGTERM);
        set_timer(intake, STOP_MS, on_stop_late);
    } else if (intake->state != STOPPING) {
        intake->state = ENDED;
        intake->timer = sd_event_source_disable_unref(intake->timer);
    }
}

/* A device that is silent breaks its transfers off after 10 s, and class requests follow. */
enum { DEVICE_PATIENCE_MS = 30000 };

/* The sources of the configuration. */

static struct supervised *find_intake(const struct gsn_supervisor *supervisor, const char *name)
{
    for (size_t i = 0; i < supervisor->count; i++)
        if (strcmp(supervisor->at[i]->name, name) == 0)
            return supervisor->at[i];
    return NULL;
}

static int add_intake(struct gsn_supervisor *supervisor, const char *name,
                      struct supervised **ret_intake, struct gsn_error *err)
{
    struct supervised **more =
        gsn_realloc_array(supervisor->at, supervisor->count + 1, sizeof(struct supervised *));
    struct supervised *intake = gsn_alloc_array(1, sizeof *intake);

    if (more)
        supervisor->at = more;
    if (intake) {
        *intake = (struct supervised){ .supervisor = supervisor, .heartbeat = -1, .state = ENDED };
        intake->name = gsn_strdup(name);
    }
    if (!more || !intake || !intake->name) {
        supervised_free(intake);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a source");
    }
    more[supervisor->count++] = intake;
    *ret_intake = intake;
    return GSN_OK;
}

static int configure_intake(struct gsn_supervisor *supervisor, const struct gsn_config *config,
                            const struct gsn_config_source *source, struct gsn_error *err)
{
    struct supervised *intake = find_intake(supervisor, source->name);
    gsn_auto_mem(char) text = NULL;
    gsn_auto_mem(char) address = gsn_strdup(source->address);
    int r = gsn_config_write_source(config, source, &text, err);

    if (r >= 0 && !address)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for a source");
    if (r >= 0 && !intake)
        r = add_intake(supervisor, source->name, &intake, err);
    if (r < 0)
        return r;
    intake->wanted = true;
    if (intake->text && strcmp(intake->text, text) == 0 && intake->state != STOPPING)
        return GSN_OK;
    gsn_free(intake->text);
    gsn_free(intake->address);
    intake->text = gsn_steal(&text);
    intake->address = gsn_steal(&address);
    intake->watchdog_ms = source->patience_s * 1000;
    if (gsn_source_subsystem(source->address) && intake->watchdog_ms < DEVICE_PATIENCE_MS)
        intake->watchdog_ms = DEVICE_PATIENCE_MS;
    stop_process(intake);
    if (intake->state != STOPPING)
        start_process(intake);
    return GSN_OK;
}

int gsn_supervisor_set(struct gsn_supervisor *supervisor, const struct gsn_config *config,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; i < supervisor->count; i++)
        supervisor->at[i]->wanted = gsn_config_find(config, supervisor->at[i]->name) != NULL;
    for (size_t i = 0; i < supervisor->count; i++)
        if (!supervisor->at[i]->wanted)
            stop_process(supervisor->at[i]);
    forget_unwanted(supervisor);
    for (size_t i = 0; r >= 0 && i < config->source_count; i++)
        r = configure_intake(supervisor, config, &config->source[i], err);
    return r;
}

void gsn_supervisor_arrival(struct gsn_supervisor *supervisor, const char *subsystem)
{
    for (size_t i = 0; i < supervisor->count; i++) {
        struct supervised *const intake = supervisor->at[i];
        const char *const its = gsn_source_subsystem(intake->address);

        if (!its || strcmp(its, subsystem) != 0)
            continue;
        intake->was_late = intake->state == RUNNING;
        if (intake->state != AWAY && intake->state != DELAYED)
            continue;
        intake->timer = sd_event_source_disable_unref(intake->timer);
        start_process(intake);
    }
}

void gsn_supervisor_stop(struct gsn_supervisor *supervisor)
{
    supervisor->stopping = true;
    for (size_t i = 0; i < supervisor->count; i++)
        stop_process(supervisor->at[i]);
}

size_t gsn_supervisor_running(const struct gsn_supervisor *supervisor)
{
    size_t running = 0;

    for (size_t i = 0; i < supervisor->count; i++)
        running += supervisor->at[i]->pid > 0;
    return running;
}

int gsn_supervisor_new(sd_event *loop, struct gsn_store *store,
                       struct gsn_supervisor **ret_supervisor, struct gsn_error *err)
{
    gsn_auto(gsn_supervisor) supervisor = gsn_alloc_array(1, sizeof *supervisor);
    int r;

    if (!supervisor)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a supervisor");
    supervisor->loop = loop;
    supervisor->store = store;
    r = gsn_process_sibling("gieson-intake", &supervisor->program, err);
    if (r < 0)
        return r;
    *ret_supervisor = gsn_steal(&supervisor);
    return GSN_OK;
}

void gsn_supervisor_free(struct gsn_supervisor *supervisor)
{
    if (!supervisor)
        return;
    for (size_t i = 0; i < supervisor->count; i++)
        supervised_free(supervisor->at[i]);
    gsn_free(supervisor->at);
    gsn_free(supervisor->program);
    gsn_free(supervisor);
}
