/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* giesond: the service at the bench. Light and long-lived: it keeps a gieson-intake alive for every
 * source and the queue served by gieson-work. Everything that can crash or hang is in those.
 *
 *     giesond [--store DIR] [--config FILE] [--watch FOLDER]... [--only intake|queue]
 *     giesond --check-config [--config FILE] [--json]
 *
 * Steps. One loop of events (sd-event) and no threads.
 * 1. The configuration is read, the store opened, READY=1 sent.
 * 2. Sources have their processes (supervise.h), jobs their workers (queue_runner.h).
 * 3. A write to the store (inotify), a slow timer, or the end of a child makes it look again.
 * 4. udev: what comes in a subsystem that a source waits for is gathered for a moment and told as
 * one arrival. Events are hints; whoever is told looks for himself.
 * 5. The state in one line for `systemctl status`: "2 sources ready, 1 away; 3 jobs waiting".
 *
 * SIGHUP: reads the configuration again; a wrong one is logged and the old one kept. SIGTERM: ends
 * what it started, then itself.
 * How it fails: an exit status of sysexits.h; without udev it looks every minute. */

#include <argp.h>
#include <errno.h>
#include <inttypes.h>
#include <jansson.h>
#include <libudev.h>
#include <signal.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <sysexits.h>
#include <systemd/sd-daemon.h>
#include <systemd/sd-event.h>
#include <time.h>
#include <unistd.h>

#include "acquire/source.h"
#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/printable.h"
#include "storage/bench.h"
#include "storage/queue.h"
#include "storage/store.h"
#include "systemd/service/config.h"
#include "systemd/service/log.h"
#include "systemd/service/queue_runner.h"
#include "systemd/service/supervise.h"

/* The service in one line, as `systemctl status` shows it:
 * "2 sources ready, 1 away; 3 jobs waiting". */

enum { PART_INTAKE = 1, PART_QUEUE = 2 };

/* Hears from udev that a device came. Events are hints: several within a moment are told as one,
 * and whoever is told looks for himself. */

/* What giesond does all its life: keeps the sources served and the queue worked, and reads its
 * configuration again when it is told to. */

enum { MOST_WATCHED = 32 };

/* What the command line says; store_dir may be NULL or empty: the configuration's. */
struct daemon_request {
    const char *store_dir, *config;
    const char *watched[MOST_WATCHED];
    size_t watched_count;
    unsigned parts; /* PART_INTAKE, PART_QUEUE or both */
};

struct line {
    size_t length, size;
    char *text;
};

/* The state in one line. */

/* "3 jobs waiting", then ", 1 running": the thing is named once. */
static void add_count(struct line *line, const char *thing, size_t count, const char *what,
                      int *is_named)
{
    int put;

    if (count == 0)
        return;
    if (*is_named)
        put =
            snprintf(line->text + line->length, line->size - line->length, ", %zu %s", count, what);
    else
        put = snprintf(line->text + line->length, line->size - line->length, "%s%zu %s%s %s",
                       line->length ? "; " : "", count, thing, count == 1 ? "" : "s", what);
    *is_named = 1;
    if (put > 0 && (size_t)put < line->size - line->length)
        line->length += (size_t)put;
}

static int add_sources(struct gsn_store *store, struct line *line, struct gsn_error *err)
{
    static const char *const states[] = { "ready", "receiving", "paused", "away", "failed" };
    gsn_auto(gsn_bench_sources) rows = NULL;
    int r = gsn_bench_list(store, &rows, err), is_named = 0;

    for (size_t s = 0; r >= 0 && s < sizeof states / sizeof states[0]; s++) {
        size_t count = 0;

        for (size_t i = 0; i < rows->count; i++)
            count += strcmp(rows->at[i].state, states[s]) == 0;
        add_count(line, "source", count, states[s], &is_named);
    }
    if (r >= 0 && !is_named)
        line->length = (size_t)snprintf(line->text, line->size, "no sources");
    return r;
}

static int add_jobs(struct gsn_store *store, struct line *line, struct gsn_error *err)
{
    struct gsn_job_counts counts = { 0 };
    const int r = gsn_queue_counts(store, &counts, err);
    int is_named = 0;

    if (r < 0)
        return r;
    add_count(line, "job", (size_t)counts.waiting, "waiting", &is_named);
    add_count(line, "job", (size_t)counts.running, "running", &is_named);
    add_count(line, "job", (size_t)counts.failed, "failed", &is_named);
    if (!is_named)
        (void)snprintf(line->text + line->length, line->size - line->length, "%sno jobs waiting",
                       line->length ? "; " : "");
    return GSN_OK;
}

/* parts: what this service does. */
static int describe_service(struct gsn_store *store, unsigned parts, char *ret_text, size_t size,
                            struct gsn_error *err)
{
    char text[256] = "";
    struct line line = { .size = sizeof text, .text = text };
    int r = GSN_OK;

    if (parts & PART_INTAKE)
        r = add_sources(store, &line, err);
    if (r >= 0 && (parts & PART_QUEUE))
        r = add_jobs(store, &line, err);
    if (r >= 0)
        (void)snprintf(ret_text, size, "%s", text);
    return r;
}

/* A device comes with several events (itself, its interfaces, the rules' work on them); the last
 * one is followed by this much quiet. */
enum { QUIET_MS = 400, MOST_SUBSYSTEMS = 8 };

struct subsystem {
    const char *name;
    bool came;
};

struct hotplug {
    sd_event *loop;
    struct udev *udev;
    struct udev_monitor *monitor;
    sd_event_source *events, *quiet;
    void (*arrived)(void *context, const char *subsystem);
    void *context;
    size_t count;
    struct subsystem at[MOST_SUBSYSTEMS];
};

static void hotplug_free(struct hotplug *hotplug)
{
    if (!hotplug)
        return;
    (void)sd_event_source_disable_unref(hotplug->events);
    (void)sd_event_source_disable_unref(hotplug->quiet);
    if (hotplug->monitor)
        (void)udev_monitor_unref(hotplug->monitor);
    if (hotplug->udev)
        (void)udev_unref(hotplug->udev);
    gsn_free(hotplug);
}

GSN_DEFINE_AUTO(hotplug);

/* Hot-plug. */

static int on_quiet(sd_event_source *source, uint64_t usec, void *context)
{
    struct hotplug *const hotplug = context;

    (void)source;
    (void)usec;
    for (size_t i = 0; i < hotplug->count; i++) {
        if (hotplug->at[i].came)
            hotplug->arrived(hotplug->context, hotplug->at[i].name);
        hotplug->at[i].came = false;
    }
    return 0;
}

static void note_device(struct hotplug *hotplug, struct udev_device *device)
{
    const char *const action = udev_device_get_action(device);
    const char *const subsystem = udev_device_get_subsystem(device);

    if (!action || !subsystem || strcmp(action, "remove") == 0 || strcmp(action, "unbind") == 0)
        return;
    for (size_t i = 0; i < hotplug->count; i++)
        if (strcmp(hotplug->at[i].name, subsystem) == 0)
            hotplug->at[i].came = true;
}

static int on_event(sd_event_source *source, int fd, uint32_t revents, void *context)
{
    struct hotplug *const hotplug = context;
    struct udev_device *device;

    (void)source;
    (void)fd;
    (void)revents;
    while ((device = udev_monitor_receive_device(hotplug->monitor))) {
        note_device(hotplug, device);
        (void)udev_device_unref(device);
    }
    hotplug->quiet = sd_event_source_disable_unref(hotplug->quiet);
    (void)sd_event_add_time_relative(hotplug->loop, &hotplug->quiet, CLOCK_MONOTONIC,
                                     QUIET_MS * 1000, 0, on_quiet, hotplug);
    return 0;
}

static void add_subsystem(struct hotplug *hotplug, const char *name)
{
    for (size_t i = 0; i < hotplug->count; i++)
        if (strcmp(hotplug->at[i].name, name) == 0)
            return;
    if (hotplug->count < MOST_SUBSYSTEMS)
        hotplug->at[hotplug->count++] = (struct subsystem){ .name = name };
}

static int listen_to(struct hotplug *hotplug, struct gsn_error *err)
{
    int r = 0;

    hotplug->udev = udev_new();
    if (hotplug->udev)
        hotplug->monitor = udev_monitor_new_from_netlink(hotplug->udev, "udev");
    if (!hotplug->monitor)
        return gsn_fail(err, GSN_E_IO, "udev cannot be heard: %s", strerror(errno));
    for (size_t i = 0; i < hotplug->count; i++)
        (void)udev_monitor_filter_add_match_subsystem_devtype(hotplug->monitor, hotplug->at[i].name,
                                                              NULL);
    r = udev_monitor_enable_receiving(hotplug->monitor);
    if (r >= 0)
        r = sd_event_add_io(hotplug->loop, &hotplug->events, udev_monitor_get_fd(hotplug->monitor),
                            EPOLLIN, on_event, hotplug);
    return r < 0 ? gsn_fail(err, GSN_E_IO, "udev cannot be heard: %s", strerror(-r)) : GSN_OK;
}

/* Listens to the subsystems that these addresses wait for; others wake nobody. keeps: loop,
 * context. gives; NULL in ret_hotplug when no address waits for any. Fails with GSN_E_IO when udev
 * cannot be heard, which leaves the service with looking every minute. */
static int hotplug_new(sd_event *loop, const char *const *addresses, size_t count,
                       void (*arrived)(void *context, const char *subsystem), void *context,
                       struct hotplug **ret_hotplug, struct gsn_error *err)
{
    gsn_auto(hotplug) hotplug = gsn_alloc_array(1, sizeof *hotplug);
    int r;

    if (!hotplug)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a monitor of devices");
    hotplug->loop = loop;
    hotplug->arrived = arrived;
    hotplug->context = context;
    for (size_t i = 0; i < count; i++) {
        const char *const subsystem = gsn_source_subsystem(addresses[i]);

        if (subsystem)
            add_subsystem(hotplug, subsystem);
    }
    if (hotplug->count == 0) {
        *ret_hotplug = NULL;
        return GSN_OK;
    }
    r = listen_to(hotplug, err);
    if (r < 0)
        return r;
    *ret_hotplug = gsn_steal(&hotplug);
    return GSN_OK;
}

enum {
    SLOW_S = 30,     /* looks at the queue even when nothing was heard of the store */
    GATHER_MS = 250, /* writes to the store that come together are one */
};

struct service {
    const struct daemon_request *request;
    struct gsn_config *config;
    struct gsn_store *store;
    sd_event *loop;
    struct gsn_supervisor *supervisor; /* NULL: not our part */
    struct gsn_queue_runner *runner;   /* the same */
    struct hotplug *hotplug;
    sd_event_source *gather;
    int intake_lock, queue_lock; /* -1: not our part; they tell others that we are there */
    bool stopping;
    char status[256];
};

/* The loop. */

static void log_mistake(void *context, const char *sentence)
{
    (void)context;
    gsn_log(LOG_ERR, NULL, "%s", sentence);
}

static int read_config(const struct daemon_request *request, struct gsn_config **ret_config,
                       struct gsn_error *err)
{
    const struct gsn_config_ear ear = { .say = log_mistake };
    gsn_auto(gsn_config) config = NULL;
    int r = gsn_config_read(request->config, &ear, &config, err);

    for (size_t i = 0; r >= 0 && i < request->watched_count; i++)
        r = gsn_config_add_folder(config, request->watched[i], err);
    if (r >= 0)
        *ret_config = gsn_steal(&config);
    return r;
}

static void on_arrival(void *context, const char *subsystem)
{
    const struct service *const service = context;

    gsn_supervisor_arrival(service->supervisor, subsystem);
}

/* Listens before the sources are started, so that nothing arrives unheard in between. */
static void listen_to_devices(struct service *service)
{
    const struct gsn_config *const config = service->config;
    gsn_auto_mem(const char *) addresses =
        gsn_alloc_array(config->source_count, sizeof(const char *));
    struct gsn_error err = { 0 };

    hotplug_free(service->hotplug);
    service->hotplug = NULL;
    for (size_t i = 0; addresses && i < config->source_count; i++)
        addresses[i] = config->source[i].address;
    if (addresses && hotplug_new(service->loop, addresses, config->source_count, on_arrival,
                                 service, &service->hotplug, &err) < 0)
        gsn_log(LOG_WARNING, NULL, "%s; devices are looked for every minute", err.text);
}

static int keep_rows(const struct service *service, struct gsn_error *err)
{
    const struct gsn_config *const config = service->config;
    gsn_auto_mem(const char *) names = gsn_alloc_array(config->source_count, sizeof(const char *));

    if (!names)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for names");
    for (size_t i = 0; i < config->source_count; i++)
        names[i] = config->source[i].name;
    return gsn_bench_keep(service->store, names, config->source_count, time(NULL), err);
}

static int apply_config(struct service *service, struct gsn_error *err)
{
    int r = GSN_OK;

    if (service->runner)
        gsn_queue_runner_set(service->runner, service->config);
    if (!service->supervisor)
        return GSN_OK;
    listen_to_devices(service);
    r = keep_rows(service, err);
    return r < 0 ? r : gsn_supervisor_set(service->supervisor, service->config, err);
}

/* ---- events ------------------------------------------------------------------------------ */

static void tell_status(struct service *service)
{
    char status[sizeof service->status];
    struct gsn_error quiet = { 0 };

    if (describe_service(service->store, service->request->parts, status, sizeof status, &quiet) <
        0)
        return;
    if (service->runner && gsn_queue_runner_is_paused(service->runner))
        (void)snprintf(status + strlen(status), sizeof status - strlen(status),
                       "; the queue rests for want of disk space");
    if (strcmp(status, service->status) == 0)
        return;
    (void)snprintf(service->status, sizeof service->status, "%s", status);
    (void)sd_notifyf(0, "STATUS=%s", status);
}

static void look_at_queue(struct service *service)
{
    if (service->stopping)
        return;
    if (service->runner)
        gsn_queue_runner_look(service->runner);
    tell_status(service);
}

static int on_gathered(sd_event_source *source, uint64_t usec, void *context)
{
    struct service *const service = context;

    (void)source;
    (void)usec;
    service->gather = sd_event_source_disable_unref(service->gather);
    look_at_queue(service);
    return 0;
}

static int on_store_change(sd_event_source *source, const struct inotify_event *event,
                           void *context)
{
    struct service *const service = context;

    (void)source;
    (void)event;
    if (!service->gather)
        (void)sd_event_add_time_relative(service->loop, &service->gather, CLOCK_MONOTONIC,
                                         GATHER_MS * 1000, 0, on_gathered, service);
    return 0;
}

static int on_slow_timer(sd_event_source *source, uint64_t usec, void *context)
{
    look_at_queue(context);
    (void)sd_event_source_set_time(source, usec + (uint64_t)SLOW_S * 1000000);
    return sd_event_source_set_enabled(source, SD_EVENT_ON);
}

static int on_end(sd_event_source *source, const struct signalfd_siginfo *info, void *context)
{
    struct service *const service = context;

    (void)source;
    (void)info;
    if (service->stopping)
        return 0;
    service->stopping = true;
    (void)sd_notify(0, "STOPPING=1\nSTATUS=stopping");
    if (service->supervisor)
        gsn_supervisor_stop(service->supervisor);
    if (service->runner)
        gsn_queue_runner_stop(service->runner);
    return 0;
}

static int on_reload(sd_event_source *source, const struct signalfd_siginfo *info, void *context)
{
    struct service *const service = context;
    gsn_auto(gsn_config) config = NULL;
    struct gsn_error err = { 0 };
    struct timespec now;

    (void)source;
    (void)info;
    /* It would start what nobody stops any more. */
    if (service->stopping)
        return 0;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    (void)sd_notifyf(0, "RELOADING=1\nMONOTONIC_USEC=%" PRIu64,
                     (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000);
    if (read_config(service->request, &config, &err) < 0) {
        gsn_log(LOG_ERR, NULL, "%s; the old configuration stays", err.text);
    } else {
        gsn_config_free(service->config);
        service->config = gsn_steal(&config);
        if (apply_config(service, &err) < 0)
            gsn_log(LOG_ERR, NULL, "%s", err.text);
        else
            gsn_log(LOG_INFO, NULL, "the configuration was read again");
    }
    (void)sd_notify(0, "READY=1");
    look_at_queue(service);
    return 0;
}

/* After every event: whether the last child of a stopping service has ended. */
static int on_any(sd_event_source *source, void *context)
{
    const struct service *const service = context;

    (void)source;
    if (service->stopping &&
        (!service->supervisor || gsn_supervisor_running(service->supervisor) == 0) &&
        (!service->runner || gsn_queue_runner_running(service->runner) == 0))
        (void)sd_event_exit(service->loop, 0);
    return 0;
}

/* ---- life -------------------------------------------------------------------------------- */

static int open_loop(struct service *service, struct gsn_error *err)
{
    const char *const dir = gsn_store_dir(service->store);
    sd_event *loop = NULL;
    int r = sd_event_default(&loop);

    service->loop = loop;
    if (r >= 0)
        r = sd_event_add_signal(loop, NULL, SIGTERM, on_end, service);
    if (r >= 0)
        r = sd_event_add_signal(loop, NULL, SIGINT, on_end, service);
    if (r >= 0)
        r = sd_event_add_signal(loop, NULL, SIGHUP, on_reload, service);
    if (r >= 0)
        r = sd_event_add_post(loop, NULL, on_any, service);
    if (r >= 0)
        r = sd_event_add_time_relative(loop, NULL, CLOCK_MONOTONIC, (uint64_t)SLOW_S * 1000000,
                                       5000000, on_slow_timer, service);
    if (r >= 0)
        r = sd_event_add_inotify(loop, NULL, dir, IN_MODIFY, on_store_change, service);
    if (r >= 0)
        r = sd_event_set_watchdog(loop, 1);
    return r < 0 ? gsn_fail(err, GSN_E_IO, "the loop of events: %s", strerror(-r)) : GSN_OK;
}

static int open_parts(struct service *service, struct gsn_error *err)
{
    const char *const dir = gsn_store_dir(service->store);
    const unsigned parts = service->request->parts;
    int r = GSN_OK;

    if (parts & PART_INTAKE)
        r = gsn_service_take(dir, GSN_SERVICE_INTAKE, &service->intake_lock, err);
    if (r >= 0 && (parts & PART_QUEUE))
        r = gsn_service_take(dir, GSN_SERVICE_QUEUE, &service->queue_lock, err);
    if (r >= 0 && (parts & PART_QUEUE))
        r = gsn_queue_runner_new(service->loop, service->store, &service->runner, err);
    if (r >= 0 && (parts & PART_INTAKE))
        r = gsn_supervisor_new(service->loop, service->store, &service->supervisor, err);
    return r < 0 ? r : apply_config(service, err);
}

static const char *store_dir(const struct service *service)
{
    return service->request->store_dir && service->request->store_dir[0]
               ? service->request->store_dir
               : service->config->store_dir;
}

static int run_service(struct service *service, struct gsn_error *err)
{
    int r = gsn_store_open(store_dir(service), GSN_STORE_CREATE, &service->store, err);

    if (r >= 0)
        r = open_loop(service, err);
    if (r >= 0)
        r = open_parts(service, err);
    if (r < 0)
        return r;
    (void)sd_notify(0, "READY=1");
    look_at_queue(service);
    r = sd_event_loop(service->loop);
    return r < 0 ? gsn_fail(err, GSN_E_IO, "the loop of events: %s", strerror(-r)) : GSN_OK;
}

static void service_done(struct service *service)
{
    gsn_supervisor_free(service->supervisor);
    gsn_queue_runner_free(service->runner);
    hotplug_free(service->hotplug);
    (void)sd_event_source_disable_unref(service->gather);
    (void)sd_event_unref(service->loop);
    gsn_store_free(service->store);
    gsn_config_free(service->config);
    if (service->intake_lock >= 0)
        (void)close(service->intake_lock);
    if (service->queue_lock >= 0)
        (void)close(service->queue_lock);
}

static void block_signals(void)
{
    sigset_t ours;

    (void)sigemptyset(&ours);
    (void)sigaddset(&ours, SIGTERM);
    (void)sigaddset(&ours, SIGINT);
    (void)sigaddset(&ours, SIGHUP);
    (void)sigaddset(&ours, SIGCHLD);
    (void)sigprocmask(SIG_BLOCK, &ours, NULL);
    (void)signal(SIGPIPE, SIG_IGN);
}

/* Serves until SIGTERM or SIGINT; SIGHUP reads the configuration again. Returns the exit status;
 * why it is not 0 is in the journal. borrows: request. */
static int run_daemon(const struct daemon_request *request)
{
    __attribute__((cleanup(service_done))) struct service service = { .request = request,
                                                                      .intake_lock = -1,
                                                                      .queue_lock = -1 };
    struct gsn_error err = { 0 };
    int r;

    block_signals();
    r = read_config(request, &service.config, &err);
    if (r < 0) {
        gsn_log(LOG_ERR, NULL, "%s", err.text);
        return r == GSN_E_INPUT ? EX_CONFIG : gsn_code_exit(r);
    }
    if (!store_dir(&service)[0]) {
        gsn_log(LOG_ERR, NULL, "no store: say --store DIR or set GIESON_STORE or Directory=");
        return EX_USAGE;
    }
    r = run_service(&service, &err);
    if (r < 0)
        gsn_log(LOG_ERR, NULL, "%s", err.text);
    return gsn_code_exit(r);
}

const char *argp_program_version = "giesond " GSN_VERSION;

enum { OPT_ONLY = 256, OPT_CHECK, OPT_JSON };

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE, else the configuration's)", 0 },
    { "config", 'c', "FILE", 0, "The configuration (default: " GSN_CONFIG_FILE ")", 0 },
    { "watch", 'w', "FOLDER", 0, "A folder that pictures come into; may be given often", 0 },
    { "only", OPT_ONLY, "PART", 0, "intake: serve the sources; queue: do the jobs", 0 },
    { "check-config", OPT_CHECK, NULL, 0, "Say what is wrong with the configuration, and end", 0 },
    { "json", OPT_JSON, NULL, 0, "--check-config: print JSON", 0 },
    { 0 },
};

struct command {
    struct daemon_request request;
    bool check, json;
};

/* The command line. */

static void take_part(const char *text, struct daemon_request *request, struct argp_state *state)
{
    if (strcmp(text, "intake") == 0)
        request->parts = PART_INTAKE;
    else if (strcmp(text, "queue") == 0)
        request->parts = PART_QUEUE;
    else
        argp_error(state, "--only must be intake or queue");
}

static error_t take_option(int key, char *arg, struct argp_state *state)
{
    struct command *command = state->input;
    struct daemon_request *request = &command->request;

    switch (key) {
    case 's':
        request->store_dir = arg;
        return 0;
    case 'c':
        request->config = arg;
        return 0;
    case 'w':
        if (request->watched_count == MOST_WATCHED)
            argp_error(state, "at most %d folders can be watched", MOST_WATCHED);
        else
            request->watched[request->watched_count++] = arg;
        return 0;
    case OPT_ONLY:
        take_part(arg, request, state);
        return 0;
    case OPT_CHECK:
        command->check = true;
        return 0;
    case OPT_JSON:
        command->json = true;
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

/* context: the list of mistakes, or NULL where they are printed one by one. */
static void tell_mistake(void *context, const char *sentence)
{
    gsn_auto_mem(char) text = gsn_strdup(sentence);

    if (text)
        gsn_printable(text);
    if (context)
        (void)json_array_append_new(context, json_string(text ? text : "out of memory"));
    else
        (void)fprintf(stderr, "%s\n", text ? text : "out of memory");
}

static void print_verdict(const struct gsn_config *config, json_t *mistakes)
{
    json_t *root =
        json_pack("{s:b, s:O, s:o, s:o}", "fine", config != NULL, "mistakes", mistakes, "sources",
                  config ? json_integer((json_int_t)config->source_count) : json_null(), "workers",
                  config ? json_integer((json_int_t)config->workers) : json_null());

    (void)json_dumpf(root, stdout, JSON_INDENT(2));
    (void)putchar('\n');
    json_decref(root);
}

/* mistakes: a list for them, or NULL. */
static int check_config(const char *file, json_t *mistakes, struct gsn_config **ret_config)
{
    const struct gsn_config_ear ear = { .say = tell_mistake, .context = mistakes };
    struct gsn_error err = { 0 };
    int r;

    /* The service runs without a file; who names one means it. */
    if (strcmp(file, GSN_CONFIG_FILE) != 0 && access(file, F_OK) < 0) {
        (void)gsn_fail(&err, GSN_E_NOTFOUND, "there is no %s", file);
        tell_mistake(mistakes, err.text);
        return EX_NOINPUT;
    }
    r = gsn_config_read(file, &ear, ret_config, &err);
    if (r < 0 && r != GSN_E_INPUT)
        tell_mistake(mistakes, err.text);
    return r == GSN_E_INPUT ? EX_CONFIG : r < 0 ? gsn_code_exit(r) : EX_OK;
}

static int report_config(const struct command *command)
{
    gsn_auto(gsn_config) config = NULL;
    json_t *mistakes = command->json ? json_array() : NULL;
    const int status = check_config(command->request.config, mistakes, &config);

    if (command->json)
        print_verdict(config, mistakes);
    else if (config)
        (void)printf("the configuration is fine: %zu source%s, %u worker%s\n", config->source_count,
                     config->source_count == 1 ? "" : "s", config->workers,
                     config->workers == 1 ? "" : "s");
    json_decref(mistakes);
    return status;
}

int main(int argc, char **argv)
{
    static const struct argp parser = {
        .options = options,
        .parser = take_option,
        .doc = "Takes panels in by itself and keeps the queue worked."
    };
    struct command command = { .request = { .store_dir = getenv("GIESON_STORE"),
                                            .config = GSN_CONFIG_FILE,
                                            .parts = PART_INTAKE | PART_QUEUE } };

    if (argp_parse(&parser, argc, argv, 0, NULL, &command) != 0)
        return EX_USAGE;
    return command.check ? report_config(&command) : run_daemon(&command.request);
}
