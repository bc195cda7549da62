/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-intake: serves one source of the bench. giesond starts one for each [source NAME], so that
 * a driver that hangs or crashes costs this source and no other.
 *
 *     gieson-intake --store DIR [--config FILE] NAME
 *     gieson-intake --list      what is plugged in, for `gieson devices`: address, name and note of
 *                               each device, each ended by a zero byte
 *
 * Exit status: 0 a source that ends (replay:) has ended; 143 asked to stop; 66 the device is away;
 * 78 the configuration is wrong; else that of sysexits.h which says what is in the way. */
#include "systemd/config.h"
#include "systemd/devices.h"
#include "systemd/lifeline.h"
#include "systemd/log.h"
#include "systemd/serve_source.h"

#include <argp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>

const char *argp_program_version = "gieson-intake " GSN_VERSION;

enum { OPT_HEARTBEAT = 256, OPT_LIST };

struct request {
    const char *store_dir, *config, *name;
    int heartbeat, list;
};

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE)", 0 },
    { "config", 'c', "FILE", 0, "The configuration (default: " GSN_CONFIG_FILE ")", 0 },
    { "heartbeat", OPT_HEARTBEAT, "FD", 0, "Tell this descriptor that we live", 0 },
    { "list", OPT_LIST, NULL, 0, "Say what is plugged in, and end", 0 },
    { 0 },
};

static error_t take_option(int key, char *arg, struct argp_state *state)
{
    struct request *request = state->input;

    switch (key) {
    case 's':
        request->store_dir = arg;
        return 0;
    case 'c':
        request->config = arg;
        return 0;
    case OPT_HEARTBEAT:
        request->heartbeat = (int)strtol(arg, NULL, 10);
        return 0;
    case OPT_LIST:
        request->list = 1;
        return 0;
    case ARGP_KEY_ARG:
        if (request->name)
            argp_error(state, "one source at a time");
        request->name = arg;
        return 0;
    case ARGP_KEY_END:
        if (!request->name && !request->list)
            argp_error(state, "say which source to serve");
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

static void say_mistake(void *context, const char *sentence)
{
    (void)context;
    gsn_log(LOG_ERR, NULL, "%s", sentence);
}

static int complain(const struct request *request, const struct gsn_error *err, int r)
{
    const struct gsn_log_about about = { .source = request->name };

    /* That a device is away is looked at every minute, and said once: see gsn_serve_source(). */
    if (r != GSN_E_NOTFOUND)
        gsn_log(LOG_ERR, &about, "%s", err->text);
    return gsn_code_exit(r);
}

static int run(const struct request *request)
{
    const struct gsn_config_ear ear = { .say = say_mistake };
    gsn_auto(gsn_lifeline) line = NULL;
    gsn_auto(gsn_config) config = NULL;
    gsn_auto(gsn_store) store = NULL;
    const struct gsn_config_source *source;
    struct gsn_error err = { 0 };
    int r = gsn_lifeline_new(request->heartbeat, &line, &err);

    if (r < 0)
        return complain(request, &err, r);
    gsn_lifeline_breathe(line, GSN_BREATH);
    if (gsn_config_read(request->config, &ear, &config, &err) < 0)
        return EX_CONFIG;
    source = gsn_config_find(config, request->name);
    if (!source) {
        gsn_log(LOG_ERR, NULL, "the configuration has no [source %s]", request->name);
        return EX_CONFIG;
    }
    r = gsn_store_open(request->store_dir, GSN_STORE_CREATE, &store, &err);
    if (r >= 0)
        r = gsn_serve_source(store, config, source, line, &err);
    if (gsn_lifeline_is_over(line))
        return GSN_INTAKE_STOPPED;
    return r < 0 ? complain(request, &err, r) : EX_OK;
}

static int list(void)
{
    gsn_auto(gsn_devices) devices = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_devices_list(&devices, &err);

    if (r < 0) {
        (void)fprintf(stderr, "%s\n", err.text);
        return gsn_code_exit(r);
    }
    for (size_t i = 0; i < devices->count; i++)
        (void)printf("%s%c%s%c%s%c", devices->at[i].address, 0, devices->at[i].name, 0,
                     devices->at[i].note, 0);
    return fflush(stdout) == 0 ? EX_OK : EX_IOERR;
}

int main(int argc, char **argv)
{
    static const struct argp parser = { .options = options,
                                        .parser = take_option,
                                        .args_doc = "NAME",
                                        .doc = "Serves one source of the bench." };
    struct request request = { .store_dir = getenv("GIESON_STORE"),
                               .config = GSN_CONFIG_FILE,
                               .heartbeat = -1 };

    if (argp_parse(&parser, argc, argv, 0, NULL, &request) != 0)
        return EX_USAGE;
    if (request.list)
        return list();
    if (!request.store_dir || !request.store_dir[0]) {
        gsn_log(LOG_ERR, NULL, "no store: say --store DIR or set GIESON_STORE");
        return EX_USAGE;
    }
    return run(&request);
}
