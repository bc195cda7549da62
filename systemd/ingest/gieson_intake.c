/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-intake: serves one source of the bench. giesond starts one for each [source NAME], so that
 * a driver that hangs or crashes costs this source and no other.
 *
 *     gieson-intake --store DIR [--config FILE] NAME
 *     gieson-intake --list      what is plugged in, for `gieson devices`: address, name and note of
 *                               each device, each ended by a zero byte
 *
 * Steps. The configuration of the one source is read, the heartbeat started before anything can
 * hang, the store opened, the source served to its end (serve_source.h). Listing asks libusb for
 * Still Image devices and /dev/v4l/by-id for cameras, and writes the address under which the
 * configuration names each.
 *
 * Exit status: 0 a source that ends (replay:) has ended; 143 asked to stop; 66 the device is away;
 * 78 the configuration is wrong; else that of sysexits.h which says what is in the way. */

#include <argp.h>
#include <dirent.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <unistd.h>

#include "acquire/usb_transport.h"
#include "acquire/v4l2_device.h"
#include "pipeline/core/error.h"
#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "systemd/ingest/serve_source.h"
#include "systemd/service/config.h"
#include "systemd/service/heartbeat.h"
#include "systemd/service/log.h"

/* What is plugged in and could be a source: Still Image devices on USB, cameras of V4L2; each with
 * the address under which the configuration names it. */

/* Texts are owned; name is as the device says it: any bytes. */
struct device {
    char *address; /* "ptp:SERIAL", "v4l2:NAME" */
    char *name;
    char *note; /* why it cannot be used as it stands, or empty */
};

struct devices {
    size_t count;
    struct device *at;
};

static void devices_free(struct devices *devices)
{
    if (!devices)
        return;
    for (size_t i = 0; i < devices->count; i++) {
        gsn_free(devices->at[i].address);
        gsn_free(devices->at[i].name);
        gsn_free(devices->at[i].note);
    }
    gsn_free(devices->at);
    gsn_free(devices);
}

GSN_DEFINE_AUTO(devices);

enum { MOST_NAME_BYTES = 4096 };

static const char BY_ID[] = "/dev/v4l/by-id";

/* What is plugged in. */

/* Takes the three texts, which are NULL when memory ran out. */
static int add_device(struct devices *devices, char *address, char *name, char *note,
                      struct gsn_error *err)
{
    struct device *more = gsn_realloc_array(devices->at, devices->count + 1, sizeof *devices->at);

    if (more)
        devices->at = more;
    if (more && address && name && note) {
        more[devices->count++] = (struct device){ address, name, note };
        return GSN_OK;
    }
    gsn_free(address);
    gsn_free(name);
    gsn_free(note);
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a list of devices");
}

/* USB. */

static char *usb_address(const struct gsn_ptp_usb_devices *all, const struct gsn_ptp_usb_device *of)
{
    size_t same = 0;

    for (size_t i = 0; i < all->count; i++)
        same += strcmp(all->at[i].serial, of->serial) == 0;
    if (!of->serial[0])
        return gsn_format("ptp:%04x:%04x", (unsigned)of->vendor, (unsigned)of->product);
    if (same > 1)
        return gsn_format("ptp:%04x:%04x:%s", (unsigned)of->vendor, (unsigned)of->product,
                          of->serial);
    return gsn_format("ptp:%s", of->serial);
}

static char *usb_note(const struct gsn_ptp_usb_device *device)
{
    char holder[160] = "";

    if (gsn_usb_holder(device->bus, device->number, holder, sizeof holder))
        return gsn_format("held by %s", holder);
    if (device->refused)
        return gsn_strdup("may not be opened by this user, so its serial number is not known");
    return gsn_strdup("");
}

static int add_usb(struct devices *devices, struct gsn_error *err)
{
    struct gsn_ptp_usb_devices found;
    int r = gsn_ptp_usb_list(&found, err);

    for (size_t i = 0; r >= 0 && i < found.count; i++)
        r = add_device(devices, usb_address(&found, &found.at[i]),
                       found.at[i].name[0] ? gsn_strdup(found.at[i].name)
                                           : gsn_format("%04x:%04x", (unsigned)found.at[i].vendor,
                                                        (unsigned)found.at[i].product),
                       usb_note(&found.at[i]), err);
    return r;
}

/* ---- V4L2 -------------------------------------------------------------------------------- */

/* What the driver calls the node that a link leads to; the link's own name where it does not say.
 */
static char *camera_name(const char *link)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", BY_ID, link);
    gsn_auto_mem(char) name = NULL;
    gsn_auto_mem(uint8_t) text = NULL;
    struct gsn_error quiet = { 0 };
    char node[PATH_MAX];
    const ssize_t length = path ? readlink(path, node, sizeof node - 1) : -1;
    size_t size;

    if (length < 0)
        return gsn_strdup(link);
    node[length] = '\0';
    name = gsn_format("/sys/class/video4linux/%s/name", basename(node));
    if (!name || gsn_file_read(name, MOST_NAME_BYTES, &text, &size, &quiet) < 0)
        return gsn_strdup(link);
    text[strcspn((const char *)text, "\n")] = '\0';
    return gsn_strdup((const char *)text);
}

/* The first node of a camera takes pictures; others carry what is said about them. */
static int takes_pictures(const struct dirent *entry)
{
    static const char first[] = "-video-index0";
    const size_t length = strlen(entry->d_name), tail = sizeof first - 1;

    return length > tail && strcmp(entry->d_name + length - tail, first) == 0;
}

static int by_address(const void *left, const void *right)
{
    return strcmp(((const struct device *)left)->address, ((const struct device *)right)->address);
}

static int add_cameras(struct devices *devices, struct gsn_error *err)
{
    const size_t first = devices->count;
    DIR *folder = opendir(BY_ID);
    const struct dirent *entry;
    int r = GSN_OK;

    while (r >= 0 && folder && (entry = readdir(folder)))
        if (takes_pictures(entry)) {
            char note[400];

            gsn_v4l2_note(entry->d_name, note, sizeof note);
            r = add_device(devices, gsn_format("v4l2:%s", entry->d_name),
                           camera_name(entry->d_name), gsn_strdup(note), err);
        }
    if (folder)
        (void)closedir(folder);
    if (devices->count > first)
        qsort(devices->at + first, devices->count - first, sizeof *devices->at, by_address);
    return r;
}

/* gives: Still Image devices first. Opens none for longer than its serial number takes. */
/* ------------------------------------------------------------------------------------------ */
static int find_devices(struct devices **ret_devices, struct gsn_error *err)
{
    gsn_auto(devices) devices = gsn_alloc_array(1, sizeof *devices);
    int r = devices ? add_usb(devices, err)
                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for a list of devices");

    if (r >= 0)
        r = add_cameras(devices, err);
    if (r >= 0)
        *ret_devices = gsn_steal(&devices);
    return r;
}

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

/* The command line. */

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

static int report_failure(const struct request *request, const struct gsn_error *err, int r)
{
    const struct gsn_log_about about = { .source = request->name };

    /* That a device is away is looked at every minute, and said once: see gsn_serve_source(). */
    if (r != GSN_E_NOTFOUND)
        gsn_log(LOG_ERR, &about, "%s", err->text);
    return gsn_code_exit(r);
}

static int run_source(const struct request *request)
{
    const struct gsn_config_ear ear = { .say = say_mistake };
    gsn_auto(gsn_heartbeat) heartbeat = NULL;
    gsn_auto(gsn_config) config = NULL;
    gsn_auto(gsn_store) store = NULL;
    const struct gsn_config_source *source;
    struct gsn_error err = { 0 };
    int r = gsn_heartbeat_new(request->heartbeat, &heartbeat, &err);

    if (r < 0)
        return report_failure(request, &err, r);
    gsn_heartbeat_beat(heartbeat, GSN_HEARTBEAT_ALIVE);
    if (gsn_config_read(request->config, &ear, &config, &err) < 0)
        return EX_CONFIG;
    source = gsn_config_find(config, request->name);
    if (!source) {
        gsn_log(LOG_ERR, NULL, "the configuration has no [source %s]", request->name);
        return EX_CONFIG;
    }
    r = gsn_store_open(request->store_dir, GSN_STORE_CREATE, &store, &err);
    if (r >= 0)
        r = gsn_serve_source(store, config, source, heartbeat, &err);
    if (gsn_heartbeat_is_over(heartbeat))
        return GSN_INTAKE_STOPPED;
    return r < 0 ? report_failure(request, &err, r) : EX_OK;
}

static int list_devices(void)
{
    gsn_auto(devices) devices = NULL;
    struct gsn_error err = { 0 };
    const int r = find_devices(&devices, &err);

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
        return list_devices();
    if (!request.store_dir || !request.store_dir[0]) {
        gsn_log(LOG_ERR, NULL, "no store: say --store DIR or set GIESON_STORE");
        return EX_USAGE;
    }
    return run_source(&request);
}
