/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* giesond: the service at the bench. Light and long-lived: it keeps a gieson-intake alive for every
 * source and the queue worked by gieson-work. Everything that can crash or hang is in those.
 *
 *     giesond [--store DIR] [--config FILE] [--watch FOLDER]... [--only intake|queue]
 *     giesond --check-config [--config FILE] [--json]
 *
 * SIGHUP: reads the configuration again. SIGTERM: ends what it started, then itself. */
#include "systemd/config.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/printable.h"
#include "systemd/daemon.h"
#include "systemd/status_text.h"

#include <argp.h>
#include <jansson.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <unistd.h>

const char *argp_program_version = "giesond " GSN_VERSION;

enum { OPT_ONLY = 256, OPT_CHECK, OPT_JSON };

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE, else the configuration's)", 0 },
    { "config", 'c', "FILE", 0, "The configuration (default: " GSN_CONFIG_FILE ")", 0 },
    { "watch", 'w', "FOLDER", 0, "A folder that pictures come into; may be given often", 0 },
    { "only", OPT_ONLY, "PART", 0, "intake: serve the sources; queue: work the queue", 0 },
    { "check-config", OPT_CHECK, NULL, 0, "Say what is wrong with the configuration, and end", 0 },
    { "json", OPT_JSON, NULL, 0, "--check-config: print JSON", 0 },
    { 0 },
};

struct command {
    struct gsn_daemon_request request;
    bool check, json;
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
                                            .parts = GSN_STATUS_INTAKE | GSN_STATUS_QUEUE } };

    if (argp_parse(&parser, argc, argv, 0, NULL, &command) != 0)
        return EX_USAGE;
    return command.check ? report_config(&command) : gsn_daemon_run(&command.request);
}
