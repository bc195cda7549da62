/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* giesond: the service at the bench. Light and long-lived: it keeps a gieson-intake alive for every
 * source and the queue worked by gieson-work. Everything that can crash or hang is in those.
 *
 *     giesond [--store DIR] [--config FILE] [--watch FOLDER]... [--only intake|queue]
 *     giesond --check-config [--config FILE]
 *
 * SIGHUP: reads the configuration again. SIGTERM: ends what it started, then itself. */
#include "systemd/config.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/printable.h"
#include "systemd/daemon.h"
#include "systemd/status_text.h"

#include <argp.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <unistd.h>

const char *argp_program_version = "giesond " GSN_VERSION;

enum { OPT_ONLY = 256, OPT_CHECK };

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE, else the configuration's)", 0 },
    { "config", 'c', "FILE", 0, "The configuration (default: " GSN_CONFIG_FILE ")", 0 },
    { "watch", 'w', "FOLDER", 0, "A folder that pictures come into; may be given often", 0 },
    { "only", OPT_ONLY, "PART", 0, "intake: serve the sources; queue: work the queue", 0 },
    { "check-config", OPT_CHECK, NULL, 0, "Say what is wrong with the configuration, and end", 0 },
    { 0 },
};

struct command {
    struct gsn_daemon_request request;
    bool check;
};

static void take_part(const char *text, struct gsn_daemon_request *request,
                      struct argp_state *state)
{
    if (strcmp(text, "intake") == 0)
        request->parts = GSN_STATUS_INTAKE;
    else if (strcmp(text, "queue") == 0)
        request->parts = GSN_STATUS_QUEUE;
    else
        argp_error(state, "--only must be intake or queue");
}

static error_t take_option(int key, char *arg, struct argp_state *state)
{
    struct command *command = state->input;
    struct gsn_daemon_request *request = &command->request;

    switch (key) {
    case 's':
        request->store_dir = arg;
        return 0;
    case 'c':
        request->config = arg;
        return 0;
    case 'w':
        if (request->watched_count == GSN_DAEMON_WATCHED)
            argp_error(state, "at most %d folders can be watched", GSN_DAEMON_WATCHED);
        else
            request->watched[request->watched_count++] = arg;
        return 0;
    case OPT_ONLY:
        take_part(arg, request, state);
        return 0;
    case OPT_CHECK:
        command->check = true;
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static void print_mistake(void *context, const char *sentence)
{
    gsn_auto_mem(char) text = gsn_strdup(sentence);

    (void)context;
    if (text)
        gsn_printable(text);
    (void)fprintf(stderr, "%s\n", text ? text : "out of memory");
}

static int check_config(const char *file)
{
    const struct gsn_config_ear ear = { .say = print_mistake };
    gsn_auto(gsn_config) config = NULL;
    struct gsn_error err = { 0 };
    int r;

    /* The service runs without a file; who names one means it. */
    if (strcmp(file, GSN_CONFIG_FILE) != 0 && access(file, F_OK) < 0) {
        (void)gsn_fail(&err, GSN_E_NOTFOUND, "there is no %s", file);
        print_mistake(NULL, err.text);
        return EX_NOINPUT;
    }
    r = gsn_config_read(file, &ear, &config, &err);
    if (r == GSN_E_INPUT)
        return EX_CONFIG;
    if (r < 0) {
        print_mistake(NULL, err.text);
        return gsn_code_exit(r);
    }
    (void)printf("the configuration is fine: %zu source%s, %u worker%s\n", config->source_count,
                 config->source_count == 1 ? "" : "s", config->workers,
                 config->workers == 1 ? "" : "s");
    return EX_OK;
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
                                            .parts = GSN_STATUS_INTAKE | GSN_STATUS_QUEUE } };

    if (argp_parse(&parser, argc, argv, 0, NULL, &command) != 0)
        return EX_USAGE;
    return command.check ? check_config(command.request.config) : gsn_daemon_run(&command.request);
}
