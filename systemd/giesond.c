/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* giesond: the service at the bench. Light and long-lived: it looks at the folders that scanners
 * write to, has whatever is ready taken into the store, and keeps the queue worked. Everything that
 * can crash runs in gieson-work.
 *
 *     giesond --store DIR [--watch FOLDER]...
 *
 * A watched folder holds one folder per specimen, each with its job.json. */
#include "acquire/source.h"
#include "pipeline/core/process.h"
#include "storage/queue.h"
#include "storage/store.h"

#include <argp.h>
#include <dirent.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <systemd/sd-daemon.h>
#include <time.h>
#include <unistd.h>

enum {
    MOST_WATCHED = 32,
    SWEEP_MS = 2000,     /* folders are looked at this often: inotify is silent on SMB and NFS */
    SETTLE_MS = 1500,    /* two looks that agree */
    PATIENCE_MS = 60000, /* an unchanged file that is not whole is taken in, to be refused aloud */
};

const char *argp_program_version = "giesond " GSN_VERSION;

struct watch {
    char *folder;
    struct gsn_source *source;
};

struct service {
    const char *store_dir;
    const char *watched[MOST_WATCHED];
    size_t watched_count;
    struct gsn_store *store;
    char *worker;
    struct watch *watch; /* one per specimen's folder */
    size_t watch_count;
};

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE)", 0 },
    { "watch", 'w', "FOLDER", 0, "A folder of specimens' folders; may be given often", 0 },
    { 0 },
};

static error_t take_option(int key, char *arg, struct argp_state *state)
{
    struct service *service = state->input;

    switch (key) {
    case 's':
        service->store_dir = arg;
        return 0;
    case 'w':
        if (service->watched_count == MOST_WATCHED)
            argp_error(state, "at most %d folders can be watched", MOST_WATCHED);
        else
            service->watched[service->watched_count++] = arg;
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static int64_t milliseconds(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Runs gieson-work to its end; its exit status. */
static int work(const struct service *service, const char *verb, const char *argument)
{
    const char *const argv[] = { service->worker, "--store", service->store_dir, verb,
                                 argument,        NULL };
    struct gsn_error err = { 0 };
    pid_t child;

    if (gsn_process_start(argv, &child, &err) < 0) {
        (void)fprintf(stderr, SD_ERR "%s\n", err.text);
        return EX_OSERR;
    }
    return gsn_process_wait(child, 1);
}

static int is_watched(const struct service *service, const char *folder)
{
    for (size_t i = 0; i < service->watch_count; i++)
        if (strcmp(service->watch[i].folder, folder) == 0)
            return 1;
    return 0;
}

static int add_watch(struct service *service, const char *folder, struct gsn_error *err)
{
    const struct gsn_source_options how = { .settle_ms = SETTLE_MS, .patience_ms = PATIENCE_MS };
    gsn_auto_mem(char) address = gsn_format("hot:%s", folder);
    gsn_auto_mem(char) name = gsn_strdup(folder);
    gsn_auto(gsn_source) source = NULL;
    struct watch *more;
    int r;

    if (!address || !name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = gsn_source_open(address, &how, &source, err);
    if (r < 0)
        return r;
    more = gsn_realloc_array(service->watch, service->watch_count + 1, sizeof *more);
    if (!more)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    service->watch = more;
    more[service->watch_count++] =
        (struct watch){ .folder = gsn_steal(&name), .source = gsn_steal(&source) };
    return GSN_OK;
}

/* Folders with a job.json that are new. */
static void find_specimens(struct service *service, const char *folder)
{
    DIR *directory = opendir(folder);
    const struct dirent *entry;

    while (directory && (entry = readdir(directory))) {
        gsn_auto_mem(char) specimen = gsn_format("%s/%s", folder, entry->d_name);
        gsn_auto_mem(char) job = specimen ? gsn_format("%s/job.json", specimen) : NULL;
        struct gsn_error err = { 0 };

        if (!job || entry->d_name[0] == '.' || access(job, R_OK) < 0 ||
            is_watched(service, specimen))
            continue;
        if (add_watch(service, specimen, &err) < 0)
            (void)fprintf(stderr, SD_WARNING "%s: %s\n", specimen, err.text);
        else
            (void)fprintf(stderr, SD_INFO "watching %s\n", specimen);
    }
    if (directory)
        (void)closedir(directory);
}

/* Has a folder taken in when something in it is ready; gieson-work makes the bytes durable before
 * it returns, and only then are they acknowledged here. */
static void sweep(struct service *service, struct watch *watch)
{
    gsn_auto(gsn_source_events) events = NULL;
    struct gsn_error err = { 0 };
    size_t ready = 0;
    int ended = 0;

    if (gsn_source_poll(watch->source, milliseconds(), &events, &ended, &err) < 0) {
        (void)fprintf(stderr, SD_WARNING "%s\n", err.text);
        return;
    }
    for (size_t i = 0; i < events->count; i++)
        ready += events->at[i].what == GSN_SOURCE_READY;
    if (ready == 0 || work(service, "import", watch->folder) != EX_OK)
        return;
    for (size_t i = 0; i < events->count; i++)
        if (events->at[i].what == GSN_SOURCE_READY)
            (void)gsn_source_acknowledge(watch->source, events->at[i].item, &err);
}

/* Whether a signal that ends us waits: systemd sends it to the worker too, and what died of it must
 * not be followed by the next. */
static int is_ending(const sigset_t *ends)
{
    sigset_t waiting;

    (void)sigpending(&waiting);
    return sigandset(&waiting, &waiting, ends) == 0 && !sigisemptyset(&waiting);
}

static void work_queue(const struct service *service)
{
    struct gsn_job_counts counts = { 0 };
    struct gsn_error err = { 0 };

    if (gsn_queue_counts(service->store, &counts, &err) >= 0 && counts.waiting + counts.running > 0)
        (void)work(service, "work", NULL);
}

static void serve(struct service *service, const sigset_t *ends)
{
    const struct timespec pause = { .tv_sec = SWEEP_MS / 1000 };

    (void)sd_notify(0, "READY=1");
    do {
        for (size_t i = 0; i < service->watched_count; i++)
            find_specimens(service, service->watched[i]);
        for (size_t i = 0; i < service->watch_count && !is_ending(ends); i++)
            sweep(service, &service->watch[i]);
        if (!is_ending(ends))
            work_queue(service);
        (void)sd_notifyf(0, "WATCHDOG=1\nSTATUS=watching %zu specimens", service->watch_count);
    } while (sigtimedwait(ends, NULL, &pause) < 0);
    (void)sd_notify(0, "STOPPING=1");
}

static void service_done(struct service *service)
{
    for (size_t i = 0; i < service->watch_count; i++) {
        gsn_source_free(service->watch[i].source);
        gsn_free(service->watch[i].folder);
    }
    gsn_free(service->watch);
    gsn_free(service->worker);
    gsn_store_free(service->store);
}

int main(int argc, char **argv)
{
    static const struct argp parser = {
        .options = options,
        .parser = take_option,
        .doc = "Takes panels in by itself and keeps the queue worked."
    };
    struct service service = { .store_dir = getenv("GIESON_STORE") };
    struct gsn_error err = { 0 };
    sigset_t ends;
    int r;

    if (argp_parse(&parser, argc, argv, 0, NULL, &service) != 0)
        return EX_USAGE;
    if (!service.store_dir || !service.store_dir[0]) {
        (void)fprintf(stderr, SD_ERR "no store: say --store DIR or set GIESON_STORE\n");
        return EX_USAGE;
    }
    (void)sigemptyset(&ends);
    (void)sigaddset(&ends, SIGTERM);
    (void)sigaddset(&ends, SIGINT);
    (void)sigprocmask(SIG_BLOCK, &ends, NULL);
    r = gsn_store_open(service.store_dir, GSN_STORE_CREATE, &service.store, &err);
    if (r >= 0)
        r = gsn_process_sibling("gieson-work", &service.worker, &err);
    if (r >= 0)
        serve(&service, &ends);
    else
        (void)fprintf(stderr, SD_ERR "%s\n", err.text);
    service_done(&service);
    return gsn_code_exit(r);
}
