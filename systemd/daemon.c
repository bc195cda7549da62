/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/daemon.h"

#include "storage/bench.h"
#include "storage/service.h"
#include "storage/store.h"
#include "systemd/config.h"
#include "systemd/hotplug.h"
#include "systemd/log.h"
#include "systemd/queue_runner.h"
#include "systemd/status_text.h"
#include "systemd/supervise.h"

#include <inttypes.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/inotify.h>
#include <sysexits.h>
#include <systemd/sd-daemon.h>
#include <time.h>
#include <unistd.h>

enum {
    SLOW_S = 30,     /* looks at the queue even when nothing was heard of the store */
    GATHER_MS = 250, /* writes to the store that come together are one */
};

struct service {
    const struct gsn_daemon_request *request;
    struct gsn_config *config;
    struct gsn_store *store;
    sd_event *loop;
    struct gsn_supervisor *supervisor; /* NULL: not our part */
    struct gsn_queue_runner *runner;   /* the same */
    struct gsn_hotplug *hotplug;
    sd_event_source *gather;
    int intake_lock, queue_lock; /* -1: not our part; they tell others that we are there */
    bool stopping;
    char status[256];
};

static void log_mistake(void *context, const char *sentence)
{
    (void)context;
    gsn_log(LOG_ERR, NULL, "%s", sentence);
}

static int read_config(const struct gsn_daemon_request *request, struct gsn_config **ret_config,
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

    gsn_hotplug_free(service->hotplug);
    service->hotplug = NULL;
    for (size_t i = 0; addresses && i < config->source_count; i++)
        addresses[i] = config->source[i].address;
    if (addresses && gsn_hotplug_new(service->loop, addresses, config->source_count, on_arrival,
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

    if (gsn_status_text(service->store, service->request->parts, status, sizeof status, &quiet) < 0)
        return;
    if (service->runner && gsn_queue_runner_is_paused(service->runner))
        (void)snprintf(status + strlen(status), sizeof status - strlen(status),
                       "; the queue rests for want of disk space");
    if (strcmp(status, service->status) == 0)
        return;
    (void)snprintf(service->status, sizeof service->status, "%s", status);
    (void)sd_notifyf(0, "STATUS=%s", status);
}

static void look(struct service *service)
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
    look(service);
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
    look(context);
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
    look(service);
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

    if (parts & GSN_STATUS_INTAKE)
        r = gsn_service_take(dir, GSN_SERVICE_INTAKE, &service->intake_lock, err);
    if (r >= 0 && (parts & GSN_STATUS_QUEUE))
        r = gsn_service_take(dir, GSN_SERVICE_QUEUE, &service->queue_lock, err);
    if (r >= 0 && (parts & GSN_STATUS_QUEUE))
        r = gsn_queue_runner_new(service->loop, service->store, &service->runner, err);
    if (r >= 0 && (parts & GSN_STATUS_INTAKE))
        r = gsn_supervisor_new(service->loop, service->store, &service->supervisor, err);
    return r < 0 ? r : apply_config(service, err);
}

static const char *store_dir(const struct service *service)
{
    return service->request->store_dir && service->request->store_dir[0]
               ? service->request->store_dir
               : service->config->store_dir;
}

static int serve(struct service *service, struct gsn_error *err)
{
    int r = gsn_store_open(store_dir(service), GSN_STORE_CREATE, &service->store, err);

    if (r >= 0)
        r = open_loop(service, err);
    if (r >= 0)
        r = open_parts(service, err);
    if (r < 0)
        return r;
    (void)sd_notify(0, "READY=1");
    look(service);
    r = sd_event_loop(service->loop);
    return r < 0 ? gsn_fail(err, GSN_E_IO, "the loop of events: %s", strerror(-r)) : GSN_OK;
}

static void service_done(struct service *service)
{
    gsn_supervisor_free(service->supervisor);
    gsn_queue_runner_free(service->runner);
    gsn_hotplug_free(service->hotplug);
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

int gsn_daemon_run(const struct gsn_daemon_request *request)
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
    r = serve(&service, &err);
    if (r < 0)
        gsn_log(LOG_ERR, NULL, "%s", err.text);
    return gsn_code_exit(r);
}
